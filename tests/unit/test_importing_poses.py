"""Tables of poses that other programs and people wrote: read as pose tables, in our units and axes, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import highside
from highside.cli.main import app
from highside.codec.axes import AxisMap

INC = np.tile([5.0, 45.0, 90.0, 135.0], 4)
TF = np.repeat([45.0, 135.0, 225.0, 315.0], 4)
MPS2 = 9.80665


def readings(seed: int = 1) -> np.ndarray:
    """(3, 16) in g: gravity in the tool and an offset of some mg."""
    inc, tf = np.radians(INC), np.radians(TF)
    u = np.vstack([np.sin(inc) * np.cos(tf), np.sin(inc) * np.sin(tf), np.cos(inc)])
    return u + np.random.default_rng(seed).normal(0.0, 2e-3, (3, 1))


def written(path: Path, header: str, *columns: np.ndarray, mark: str = ",") -> Path:
    rows = [mark.join(f"{value:.7g}" for value in row) for row in zip(*columns, strict=True)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def means(poses: highside.PoseTable) -> np.ndarray:
    return np.vstack([poses[name] for name in ("ax", "ay", "az")])


def refused(*arguments: str | Path) -> str:
    """One line of `highside import`, which writes nothing."""
    done = CliRunner().invoke(app, ["import", *map(str, arguments)])
    assert isinstance(done.exception, highside.InputError), (done.output, done.exception)
    assert not Path(arguments[2]).exists()
    return str(done.exception)


def done(*arguments: str | Path) -> str:
    ended = CliRunner().invoke(app, [*map(str, arguments)])
    assert ended.exit_code == 0, (ended.output, ended.exception)
    return str(ended.output)


def test_a_spreadsheet_of_a_turntable_becomes_a_pose_table(tmp_path: Path) -> None:
    header = "Pose,Inclination (deg),Toolface (deg),X (m/s2),Y (m/s2),Z (m/s2)"
    path = written(tmp_path / "table.csv", header, np.arange(1, 17), INC, TF, *(readings() * MPS2))
    with pytest.raises(highside.InputError, match=r"no column is a time, .*: a table of poses.*poses"):
        highside.inspect_import(path).read_poses()
    poses = highside.import_poses(path)
    assert np.allclose(means(poses), readings(), atol=1e-6)
    assert np.array_equal(poses["inc_ref_deg"], INC)
    assert np.array_equal(poses["tf_ref_deg"], TF)
    assert np.array_equal(poses["Pose"], np.arange(1, 17))


def test_the_command_writes_what_solve_and_diagnose_read(tmp_path: Path) -> None:
    columns = (INC, TF, 0 * INC + 25, *(readings() * 1e3))
    path = written(tmp_path / "table.csv", "incl [deg],gtf [deg],temp [C],ax [mg],ay [mg],az [mg]", *columns)
    out, record = tmp_path / "poses.csv", tmp_path / "cal.json"
    assert "--poses" in refused(path, "-o", out)
    assert "16 of 16 poses" in done("import", path, "-o", out, "--poses")
    done("calibrate", "solve", out, "--method", "joint", "--tool", "tool-7", "-o", record)
    offset = np.random.default_rng(1).normal(0.0, 2e-3, 3)
    assert np.allclose(highside.Calibration.load(record).bias_g, offset, atol=2e-5)


@settings(max_examples=60, deadline=None)
@given(
    order=st.permutations([0, 1, 2]),
    signs=st.tuples(*[st.sampled_from([1, -1])] * 3),
    unit=st.sampled_from([("g", 1.0), ("mg", 1e3), ("m/s2", MPS2)]),
)
def test_axes_of_any_maker_are_turned_or_refused(tmp_path_factory: pytest.TempPathFactory, order, signs, unit) -> None:  # type: ignore[no-untyped-def]
    theirs = np.vstack([signs[k] * readings()[order[k]] for k in range(3)])
    spread = np.vstack([np.full(16, 1e-4 * (order[k] + 1)) for k in range(3)])
    name, factor = unit
    header = f"incl,toolface,ax [{name}],ay [{name}],az [{name}],std_ax,std_ay,std_az,n"
    columns = (INC, TF, *(theirs * factor), *(spread * factor), np.full(16, 40))
    path = written(tmp_path_factory.mktemp("poses") / "table.csv", header, *columns)
    determinant = np.linalg.det(np.array([[signs[k] * (order[k] == j) for j in range(3)] for k in range(3)], float))
    if determinant < 0:
        with pytest.raises(highside.InputError, match="mirror"):
            highside.import_poses(path, accept=True)
        axes = _axes_named_in_the_refusal(path)
    else:
        axes = None
    poses = highside.import_poses(path, accept=True, axes=axes)
    assert np.allclose(means(poses), readings(), atol=1e-6)
    spreads = [poses[n][0] for n in ("std_ax", "std_ay", "std_az")]
    assert np.allclose(spreads, [1e-4, 2e-4, 3e-4], rtol=1e-6)
    assert (poses["n"] == 40).all()


def _axes_named_in_the_refusal(path: Path) -> str:
    with pytest.raises(highside.InputError) as refused:
        highside.import_poses(path, accept=True)
    axes = str(refused.value.remedy).split('axes="')[1].split('"')[0]
    AxisMap.parse(axes, allow_mirror=True)
    return axes


def test_a_table_of_poses_has_no_rate_and_takes_no_second_file(tmp_path: Path) -> None:
    path = written(tmp_path / "table.csv", "incl,toolface,ax,ay,az", INC, TF, *readings())
    out = tmp_path / "poses.csv"
    assert "has no time" in refused(path, "-o", out, "--poses", "--rate", "10")
    timed = written(tmp_path / "timed.csv", "t_s,inc [deg],tf [deg]", 1.0 * np.arange(16), INC, TF)
    assert "no second file" in refused(path, "-o", out, "--poses", "--yes", "--reference", timed)
    assert "poses have none" in refused(path, "-o", tmp_path / "poses.mcap", "--poses", "--yes")


def test_a_profile_keeps_that_it_is_a_table_of_poses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "settings"))
    path = written(tmp_path / "table.csv", "incl,toolface,ax,ay,az", INC, TF, *readings())
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    done("import", path, "-o", first, "--poses", "--yes", "--profile", "lab")
    done("import", path, "-o", second, "--profile", "lab")
    assert first.read_bytes() == second.read_bytes()


def test_rows_of_a_recording_with_angles_and_a_time_are_no_poses(tmp_path: Path) -> None:
    t = np.arange(16) * 0.1
    path = written(tmp_path / "log.csv", "t_s,ref_inc [deg],ref_tf [deg],ax [g],ay [g],az [g]", t, INC, TF, *readings())
    assert highside.import_recording(path).n == 16
    with pytest.raises(highside.InputError, match="is a recording"):
        highside.inspect_import(path).read_poses()


def test_a_pose_without_a_reading_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "table.csv", "incl,toolface,ax [g],ay [g],az [g]", INC, TF, *readings())
    lines = path.read_text().splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:2], "", *lines[3].split(",")[3:]])
    path.write_text("\n".join(lines) + "\n")
    remarks = highside.inspect_import(path, poses=True).remarks
    assert any("1 rows without ax_g: line 4" in remark for remark in remarks)

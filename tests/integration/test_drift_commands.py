"""`highside drift` and `highside reproduce drift`: files in, files out, one clear line for whatever is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from highside.attitude.angles import wrap_signed
from highside.papers.drift_scenarios import DriftData, drilling, record, rotating_table, turntable, vibration_table
from highside.papers.reproduce_drift import as_dict, run_study
from highside.papers.reproduce_drift_page import page_of
from highside.recording.table import Recording, read_recording, write_recording

COLUMNS = (
    "t_s", "inc_deg", "tf_deg", "azi_deg", "azi_std_deg", "bias_x_dps", "bias_y_dps", "bias_z_dps",
    "bias_std_x_dps", "bias_std_y_dps", "bias_std_z_dps",
)  # fmt: skip


def _highside(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from highside.cli.main import main; main()", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)


def _columns(data: DriftData) -> dict[str, np.ndarray]:
    names = ("ax_g", "ay_g", "az_g")
    rates = np.degrees(data.rate)
    return {
        "t_s": data.experiment.t_s,
        **dict(zip(names, data.accel, strict=True)),
        **dict(zip(("gx_dps", "gy_dps", "gz_dps"), rates, strict=True)),
    }


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("drift") / "still.csv.gz"
    write_recording(path, Recording(_columns(record(turntable(120.0, 50.0), 1))))
    return path


@pytest.mark.parametrize("method", ["literal", "literal_block", "recursive", "kinematic", "none"])
def test_each_method_writes_its_rows_and_says_where_the_azimuth_comes_from(
    still: Path, tmp_path: Path, method: str
) -> None:
    out = tmp_path / "out.csv"
    done = _highside("drift", still, "--method", method, "-o", out, "--latitude-deg", "35.2", "--azimuth-deg", "60",
                     "--rest", "0-60")  # fmt: skip
    assert done.returncode == 0, done.stderr
    table = read_recording(out)
    assert table.order == COLUMNS
    assert table.n == 6001
    tilt = abs(table.columns["inc_deg"][-1] - 120.0)
    azimuth = abs(wrap_signed(float(table.columns["azi_deg"][-1]) - 60.0, 360.0))
    if method == "literal":
        # after the declared rest it holds one sample of differentiated noise: a tilt of degrees within a minute
        assert tilt > 1.5
    else:
        assert tilt < 1.5
        assert azimuth < 3.0
    words = {"literal": "constraint", "literal_block": "constraint", "recursive": "nothing", "none": "nothing"}
    assert f"azimuth from {words.get(method, 'zero-rate update')}" in done.stderr
    assert ("gravity believed in 3001 of 6001 rows, within --rest" in done.stderr) is method.startswith("literal")


def test_the_literal_method_has_the_papers_gate_on_vibration(tmp_path: Path) -> None:
    """Shaken all the time it is the gyro alone, and says so; with stops it believes gravity there and nowhere else."""
    experiment = vibration_table(60.0, 50.0)
    path, out, alone = tmp_path / "shaken.csv", tmp_path / "out.csv", tmp_path / "alone.csv"
    write_recording(path, Recording(_columns(record(experiment, 1))))
    for method, to in (("literal", out), ("none", alone)):
        done = _highside("drift", path, "--method", method, "-o", to, "--azimuth-deg", "60")
        assert done.returncode == 0, done.stderr
        if method == "literal":
            assert "gravity believed in 0 of 3001 rows" in done.stderr and "gyro alone" in done.stderr
    gated, gyro = (read_recording(each) for each in (out, alone))
    for name in ("inc_deg", "tf_deg", "azi_deg"):
        assert np.array_equal(gated.columns[name], gyro.columns[name])
    # a second of it believed would have thrown the attitude about by half a g
    assert np.abs(np.diff(gated.columns["inc_deg"])).max() < 0.01

    drilled = drilling(300.0, 50.0, leg_s=100.0, stop_s=30.0)
    write_recording(path, Recording(_columns(record(drilled, 2))))
    done = _highside("drift", path, "--method", "literal", "-o", out, "--azimuth-deg", "60")
    believed = int(re.search(r"gravity believed in (\d+) of", done.stderr)[1])  # type: ignore[index]
    assert believed == pytest.approx(int((~drilled.vibrating).sum()), abs=300)  # the gate is a second late, 100 a stop


def test_detected_stops_in_a_recording_and_the_same_bytes_again(tmp_path: Path) -> None:
    experiment = drilling(300.0, 50.0, leg_s=100.0, stop_s=30.0)
    path = tmp_path / "drilling.csv"
    write_recording(path, Recording(_columns(record(experiment, 2))))
    outs = [tmp_path / "a.csv", tmp_path / "b.csv"]
    for out in outs:
        done = _highside("drift", path, "--method", "kinematic", "-o", out, "--latitude-deg", "35.2",
                         "--azimuth-deg", "60")  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "zero-rate update" in done.stderr
    assert outs[0].read_bytes() == outs[1].read_bytes()


def test_without_latitude_and_azimuth_the_basis_is_degraded_in_words(still: Path, tmp_path: Path) -> None:
    done = _highside("drift", still, "--method", "kinematic", "-o", tmp_path / "o.csv")
    assert done.returncode == 0, done.stderr
    assert "no latitude" in done.stderr
    assert "relative to" in done.stderr


def _wrong(path: Path, **changes: np.ndarray | None) -> Path:
    columns = _columns(record(rotating_table(30.0, 60.0, 50.0), 1))
    for name, values in changes.items():
        if values is None:
            del columns[name]
        else:
            columns[name] = values
    write_recording(path, Recording(columns))
    return path


def _refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr


def test_bad_recordings_are_refused_in_one_line(tmp_path: Path) -> None:
    good = _columns(record(rotating_table(30.0, 60.0, 50.0), 1))
    path, out = tmp_path / "rec.csv", tmp_path / "out.csv"
    run = ("--method", "kinematic", "-o", out)
    _refused(_highside("drift", _wrong(path, gx_dps=None), *run), "rec.csv", "gx_dps")
    in_rad = {name: np.radians(good[name]) for name in ("gx_dps", "gy_dps", "gz_dps")}
    _refused(_highside("drift", _wrong(path, **in_rad), *run), "rad/s")
    in_si = {name: 9.80665 * good[name] for name in ("ax_g", "ay_g", "az_g")}
    _refused(_highside("drift", _wrong(path, **in_si), *run), "m/s2")
    _refused(_highside("drift", _wrong(path, t_s=good["t_s"][::-1].copy()), *run), "t_s", "increase")
    hole = good["gy_dps"].copy()
    hole[7] = np.nan
    _refused(_highside("drift", _wrong(path, gy_dps=hole), *run), "line 9", "gy_dps")
    assert not out.exists()


def test_wrong_options_are_refused_in_one_line(still: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    run = ("drift", still, "-o", out, "--method")
    _refused(_highside(*run, "kinematic", "--rest", "5-2"), "--rest")
    _refused(_highside(*run, "kinematic", "--rest", "500-600"), "--rest")
    _refused(_highside(*run, "kinematic", "--azimuth-policy", "hold"), "--azimuth-policy")
    _refused(_highside(*run, "literal", "--straight-hole"), "--straight-hole")
    assert not out.exists()


def test_a_saturated_gyro_and_a_gap_are_reported(tmp_path: Path) -> None:
    experiment = rotating_table(30.0, 60.0, 50.0, rate_dps=50.0)
    columns = _columns(record(experiment, 1))
    columns["gz_dps"] = np.clip(columns["gz_dps"], -49.0, 49.0)
    keep = (columns["t_s"] < 20.0) | (columns["t_s"] > 25.0)
    path = tmp_path / "rec.csv"
    write_recording(path, Recording({name: values[keep] for name, values in columns.items()}))
    done = _highside("drift", path, "--method", "kinematic", "-o", tmp_path / "o.csv", "--latitude-deg", "35.2",
                     "--azimuth-deg", "60")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "limit" in done.stderr
    assert "gaps were not integrated" in done.stderr


def test_smoothing_ends_where_the_filter_ends_and_knows_more_before(tmp_path: Path) -> None:
    experiment = drilling(300.0, 50.0, leg_s=100.0, stop_s=30.0, turning_dps=30.0)
    data = record(experiment, 2)
    path = tmp_path / "drilling.csv"
    write_recording(path, Recording(_columns(data)))
    found = []
    for more in ((), ("--smooth",)):
        done = _highside("drift", path, "--method", "kinematic", "-o", tmp_path / "o.csv", "--latitude-deg", "35.2",
                         "--azimuth-deg", "60", *more)  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(read_recording(tmp_path / "o.csv"))
    causal, smooth = found
    assert smooth.columns["azi_deg"][-1] == pytest.approx(causal.columns["azi_deg"][-1], abs=1e-6)
    errors = [wrap_signed(each.columns["tf_deg"] - np.degrees(experiment.phi), 360.0) for each in found]
    assert np.square(errors[1]).mean() < 0.5 * np.square(errors[0]).mean()
    assert smooth.columns["azi_std_deg"].mean() <= causal.columns["azi_std_deg"].mean()
    refused = _highside("drift", path, "--method", "recursive", "-o", tmp_path / "o.csv", "--smooth")
    _refused(refused, "--smooth")


def test_the_papers_experiments_beside_ours() -> None:
    # the command runs the whole hours; here the same code on minutes
    study = run_study(1 / 60)
    result = json.loads(json.dumps(as_dict(study)))
    assert [e["experiment"] for e in result["experiments"]] == ["turntable", "vibration table", "drilling"]
    for experiment in result["experiments"]:
        names = [row["method"] for row in experiment["methods"]]
        assert names[0] == "gyro alone"
        assert any(name.startswith("kinematic") for name in names)
        assert all(row["azimuth_basis"] for row in experiment["methods"])
        for package in ("vqf", "ahrs", "imufusion"):
            assert (package in result["not_installed"]) or any(name.startswith(package) for name in names)
    shaken = {row["method"]: row for row in result["experiments"][1]["methods"]}
    # behind its gate the letter has no gravity there: it is the gyro alone
    assert shaken["literal, policy hold"]["inc_deg_per_hour"] == shaken["gyro alone"]["inc_deg_per_hour"]
    assert "literal, policy hold, without its gate" in shaken
    by_name = {row["method"]: row for row in result["experiments"][0]["methods"]}
    assert "constraint" in by_name["literal, policy hold"]["azimuth_basis"]
    assert by_name["literal, policy gyro"]["azi_deg_per_hour"] > 2.0
    assert len(result["inclination_sweep"]["points"]) == 3
    curved = {row["method"]: row for row in result["curved_hole"]["methods"]}
    assert "constraint" in curved["literal, policy hold"]["azimuth_basis"]
    page = page_of(study)
    assert page.count("<figure>") == (7 if len(result["not_installed"]) < 3 else 4)
    assert "by construction" in page


def test_an_experiment_is_recorded_with_its_truth_and_followed(tmp_path: Path) -> None:
    path = tmp_path / "hole.csv.gz"
    done = _highside("simulate", "--experiment", "curved-hole", "-o", path, "--seed", "3")
    assert done.returncode == 0, done.stderr
    assert "--rest 0-300" in done.stderr
    truth = read_recording(tmp_path / "hole.truth.csv.gz").columns
    about = json.loads((tmp_path / "hole.truth.json").read_text())
    out = tmp_path / "out.csv"
    done = _highside(
        "drift", path, "--method", "kinematic", "-o", out, "--latitude-deg", about["latitude_deg"],
        "--azimuth-deg", about["azimuth_deg"], "--rest", "0-300",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    error = wrap_signed(read_recording(out).columns["azi_deg"] - truth["azi_true_deg"], 360.0)
    assert np.ptp(truth["azi_true_deg"]) == pytest.approx(5.0)
    assert np.abs(error).max() < 0.5
    _refused(_highside("simulate", "-o", path), "--experiment")
    _refused(_highside("simulate", "--experiment", "drilling", "-o", path, "--poses", out), "--poses")

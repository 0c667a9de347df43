"""`highside simulate` as a user runs it: files written, the same bytes for the same seed, truth that fits the rows."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from highside.cli.main import main
from highside.physics.gravity import gravity_direction
from highside.recording.table import PoseTable, Recording, read_poses, read_recording

PERFECT = """
[motion]
kind = "poses"
inclinations_deg = [0.612, 45, 90]
toolfaces_deg = [0, 90, 180, 270]
hold_s = 3
"""


class Done(NamedTuple):
    """How a command ended."""

    returncode: int
    stderr: str


def highside(*arguments: str | Path) -> Done:
    """The command's entry point with these arguments, inside this process."""
    stderr, before = io.StringIO(), sys.argv
    sys.argv = ["highside", *map(str, arguments)]
    try:
        with contextlib.redirect_stderr(stderr):
            main()
        return Done(0, stderr.getvalue())
    except SystemExit as left:
        return Done(int(left.code or 0), stderr.getvalue())
    finally:
        sys.argv = before


def simulated(tmp_path: Path, text: str, *more: str, name: str = "rec.csv.gz") -> tuple[Recording, dict]:
    (tmp_path / "model.toml").write_text(text)
    done = highside("simulate", tmp_path / "model.toml", "-o", tmp_path / name, *more)
    assert done.returncode == 0, done.stderr
    stem = name.removesuffix(".gz").removesuffix(".csv")
    return read_recording(tmp_path / name), json.loads((tmp_path / f"{stem}.truth.json").read_text())


def test_a_perfect_tool_on_a_perfect_bench_reads_gravity(tmp_path: Path) -> None:
    recording, truth = simulated(tmp_path, PERFECT)
    inc, tf = np.radians(recording.complete("inc_ref_deg", "tf_ref_deg"))
    np.testing.assert_allclose(recording.accel(), gravity_direction(inc, tf), atol=1e-15)
    assert recording.columns["pose"].tolist() == np.repeat(np.arange(12), 3).tolist()
    for pose in truth["poses"]:
        assert pose["inc_true_deg"] == pytest.approx(pose["inc_ref_deg"], abs=1e-9)
        assert pose["tf_true_deg"] % 360 == pytest.approx(pose["tf_ref_deg"], abs=1e-7)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(tmp_path: Path, project_root: Path) -> None:
    model = project_root / "config" / "model-bench.toml"
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        done = highside("simulate", model, "-o", tmp_path / f"{name}.csv.gz", "--seed", seed)
        assert done.returncode == 0, done.stderr
    first = (tmp_path / "a.csv.gz").read_bytes()
    assert first == (tmp_path / "b.csv.gz").read_bytes()
    assert first != (tmp_path / "c.csv.gz").read_bytes()
    assert (tmp_path / "a.truth.json").read_bytes() == (tmp_path / "b.truth.json").read_bytes()


def test_the_truth_explains_the_recording(tmp_path: Path, project_root: Path) -> None:
    """From the true attitudes and the parameters in the truth file alone, the rows come out to within the noise."""
    model = project_root / "config" / "model-bench.toml"
    done = highside("simulate", model, "-o", tmp_path / "rec.csv.gz", "--poses", tmp_path / "poses.csv")
    assert done.returncode == 0, done.stderr
    recording, poses = read_recording(tmp_path / "rec.csv.gz"), read_poses(tmp_path / "poses.csv")
    truth = json.loads((tmp_path / "rec.truth.json").read_text())
    values = {name: {key: v["value"] for key, v in table.items()} for name, table in truth["effects"].items()}
    A = np.eye(3) + np.diag([values["scale"][f"s_{axis}"] for axis in "xyz"])
    for key, value in values["misalignment"].items():
        A["xyz".index(key[2]), "xyz".index(key[3])] = value
    b = np.array([values["bias"][f"b_{axis}"] for axis in "xyz"])
    inc, tf = np.radians([[pose["inc_true_deg"], pose["tf_true_deg"]] for pose in truth["poses"]]).T
    clean = A @ gravity_direction(inc, tf) + b[:, None]
    pose = recording.columns["pose"].astype(int)
    residual = recording.accel() - clean[:, pose]
    assert residual.std() == pytest.approx(50e-6 / np.sqrt(2), rel=0.05)
    assert np.abs(residual.mean()) < 5e-6
    # the bench is off by its tilt and its pose errors
    inc_ref = np.radians([row["inc_ref_deg"] for row in truth["poses"]])
    assert 0.005 < np.degrees(np.abs(inc - inc_ref).max()) < 0.02 + 0.009 + 1e-3
    assert isinstance(poses, PoseTable)
    np.testing.assert_allclose(poses.accel()[:, 5], recording.accel()[:, pose == 5].mean(axis=1), rtol=1e-14)
    assert poses.columns["n"].tolist() == [10] * 44


def test_rotation_writes_gyros_rates_and_the_truth_of_each_row(tmp_path: Path, project_root: Path) -> None:
    done = highside("simulate", project_root / "config" / "model-rotation.toml", "-o", tmp_path / "turning.csv")
    assert done.returncode == 0, done.stderr
    recording, rows = read_recording(tmp_path / "turning.csv"), read_recording(tmp_path / "turning.truth.csv.gz")
    assert not recording.has("pose")
    rate = recording.columns["rotor_rate_dps"]
    assert rate[0] == -720
    # the toolface grows clockwise looking down-hole, about -z
    assert np.corrcoef(recording.columns["gz_dps"], rate)[0, 1] < -0.999
    assert recording.columns["temp_c"].max() == pytest.approx(40, abs=0.1)
    # 2 ms late at 2 Hz: the true toolface is 1.44 deg behind the encoder in the sense of turning
    behind = np.angle(np.exp(1j * np.radians(rows.columns["tf_true_deg"] - recording.columns["tf_ref_deg"])))
    np.testing.assert_allclose(np.degrees(behind), -rate * 0.002, atol=1e-3)
    # the lever arm of 8 and -3 mm at 12.57 rad/s
    fast = np.abs(rate) == 720
    centre = recording.accel()[:2, fast].mean(axis=1)
    assert centre[0] == pytest.approx(-(12.566**2) * 0.008 / 9.81 + 1e-3, abs=5e-4 + 2e-3)
    assert centre[1] == pytest.approx(12.566**2 * 0.003 / 9.81 - 2e-3, abs=5e-4 + 2e-3)


def test_drilling_legs_turn_incline_and_shake(tmp_path: Path) -> None:
    recording, _ = simulated(
        tmp_path,
        """
        [effects]
        included = ["vibration_rectification", "vibration_noise"]
        [effects.vibration_rectification]
        kv = 1e-3
        [effects.vibration_noise]
        q = 1.0
        [motion]
        kind = "legs"
        inclination_deg = 5
        gyros = true
        sample_hz = 20
        legs = [{duration_s = 5}, {duration_s = 20, inclination_to_deg = 30, turn_deg = 720, vibration_g = 0.5}]
        """,
    )
    assert recording.n == 500
    assert recording.columns["inc_ref_deg"][0] == 5
    assert recording.columns["inc_ref_deg"][-1] == pytest.approx(30, abs=0.05)
    still = recording.columns["t_s"] < 5
    assert recording.columns["vibration_rms_g"][still].max() == 0
    assert recording.columns["vibration_rms_g"].max() == pytest.approx(0.5)
    magnitude = np.linalg.norm(recording.accel(), axis=0)
    assert magnitude[still].std() < 1e-12
    assert magnitude[~still].std() > 0.1


def test_lost_frames_leave_gaps_that_the_counter_shows(tmp_path: Path) -> None:
    recording, _ = simulated(
        tmp_path,
        '[effects]\nincluded = ["dropped_frames"]\n[effects.dropped_frames]\nlost = 0.1\n'
        '[motion]\nkind = "rotation"\nrates_hz = [0.5]\nhold_s = 40',
        name="rec.csv",
    )
    assert 1700 < recording.n < 1900
    assert np.diff(recording.columns["seq"]).max() >= 2
    np.testing.assert_allclose(recording.t_s, recording.columns["seq"] * 0.02, atol=1e-9)


def test_makers_axes_are_mapped_back_by_the_codecs_map(tmp_path: Path) -> None:
    from highside.codec.axes import AxisMap

    plain, _ = simulated(tmp_path, PERFECT)
    turned, _ = simulated(tmp_path, '[tool]\naxes = "-yxz"\n' + PERFECT)
    mapped = np.array([AxisMap.parse("-yxz").apply(*row) for row in turned.accel().T.tolist()]).T
    np.testing.assert_array_equal(mapped, plain.accel())


def test_temperature_plateaus_repeat_the_poses(tmp_path: Path) -> None:
    recording, truth = simulated(
        tmp_path,
        '[effects]\nincluded = ["temperature_bias"]\n[effects.temperature_bias]\nbt_x_ug = 50\n'
        + PERFECT
        + "plateaus_c = [25, 125]\n",
    )
    assert recording.n == 72
    assert [pose["temp_c"] for pose in truth["poses"]] == [25.0] * 12 + [125.0] * 12
    cold, hot = recording.accel()[:, :36], recording.accel()[:, 36:]
    np.testing.assert_allclose(hot - cold, np.array([[5e-3], [0], [0]]) * np.ones(36), atol=1e-12)


def test_an_effect_without_size_is_mentioned(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text('[effects]\nincluded = ["sag"]\n' + PERFECT)
    done = highside("simulate", tmp_path / "m.toml", "-o", tmp_path / "r.csv")
    assert done.returncode == 0
    assert "the effect 'sag' is included, but all its parameters are 0" in done.stderr


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[effects]\nincluded = ["base_tild"]\n' + PERFECT, ["unknown effect 'base_tild'", "did you mean base_tilt"]),
        ("[sensor]\nnoise_g = 1e-5\n", ["motion", "is missing", "add a table [motion]"]),
        (PERFECT + "hold_t = 3\n", ["motion.hold_t", "is not a known field"]),
        ('[motion]\nkind = "rotation"\nrates_hz = [1]\nhold_s = 1e9\n', ["motion", "rows", "can be made"]),
    ],
)
def test_a_bad_model_ends_with_status_2_and_one_line(tmp_path: Path, text: str, parts: list[str]) -> None:
    (tmp_path / "m.toml").write_text(text)
    done = highside("simulate", tmp_path / "m.toml", "-o", tmp_path / "r.csv")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert str(tmp_path / "m.toml") in done.stderr
    for part in parts:
        assert part in done.stderr
    assert not (tmp_path / "r.csv").exists()


def test_a_place_that_cannot_be_written_ends_with_status_2(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(PERFECT)
    done = highside("simulate", tmp_path / "m.toml", "-o", tmp_path / "nowhere" / "r.csv")
    assert done.returncode == 2
    assert "nowhere" in done.stderr
    assert "Traceback" not in done.stderr

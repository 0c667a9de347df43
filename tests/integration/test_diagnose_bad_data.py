"""Corrupted recordings, stepped and rotating: `bad_data` for the right reason, never the name of some physics."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.cli.main import main
from highside.recording.table import Recording, read_recording, write_recording

Columns = dict[str, NDArray[np.float64]]

EFFECTS = """
[effects]
included = ["bias", "scale", "reading_noise", "base_tilt"]
[effects.bias]
b_mg = [1.2, -0.8, 1.5]
[effects.scale]
s = [0.003, -0.002, 0.001]
[effects.reading_noise]
density_ug = 16
[effects.base_tilt]
tilt_x_deg = 0.06
"""
MOTIONS = {
    "poses": """
[motion]
kind = "poses"
inclinations_deg = [3, 20, 45, 70, 90, 120]
toolfaces_deg = [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330]
hold_s = 5
row_s = 0.5
""",
    "rotation": """
[motion]
kind = "rotation"
inclination_deg = 62
rates_hz = [-1.0, -0.5, 0.5, 1.0]
hold_s = 10
ramp_s = 2
sample_hz = 50
""",
}


def run(*arguments: str | Path) -> tuple[int, str]:
    """Exit status and stderr of the command run inside this process."""
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["highside", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
        return 0, err.getvalue()
    except SystemExit as left:
        return int(left.code or 0), err.getvalue()
    finally:
        sys.argv = before


@pytest.fixture(scope="module", params=list(MOTIONS))
def healthy(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Columns:
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "truth.toml").write_text(EFFECTS + MOTIONS[request.param])
    assert run("simulate", folder / "truth.toml", "-o", folder / "rec.csv", "--seed", 5)[0] == 0
    return read_recording(folder / "rec.csv").columns


def diagnosed(folder: Path, columns: Columns) -> tuple[int, dict[str, Any]]:
    (folder / "model.toml").write_text('[sensor]\nfree = ["bias", "scale", "misalignment"]\n')
    write_recording(folder / "rec.csv", Recording(columns))
    status, err = run("diagnose", folder / "rec.csv", "--model", folder / "model.toml", "--out", folder / "out")
    assert "Traceback" not in err
    return status, json.loads((folder / "out" / "diagnosis.json").read_text())


@pytest.fixture(scope="module")
def sound(healthy: Columns, tmp_path_factory: pytest.TempPathFactory) -> tuple[int, dict[str, Any]]:
    """Status and answer of the recording as it is: asked for once."""
    return diagnosed(tmp_path_factory.mktemp("sound"), healthy)


def wrong_unit(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {name: 9.80665 * c[name] for name in ("ax_g", "ay_g", "az_g")}


def swapped_axis(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"ax_g": c["ay_g"], "ay_g": c["ax_g"]}


def inverted_axis(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"ay_g": -c["ay_g"]}


def clipping(c: Columns, rng: np.random.Generator) -> Columns:
    limit = float(np.quantile(np.abs(c["ax_g"]), 0.6))
    return c | {"ax_g": np.clip(c["ax_g"], -limit, limit)}


def duplicated_frames(c: Columns, rng: np.random.Generator) -> Columns:
    n = c["t_s"].size
    rows = np.sort(np.concatenate([np.arange(n), rng.choice(n, n // 30, replace=False)]))
    return {name: column[rows] for name, column in c.items() if name != "seq"}


def stuck_bit(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"ay_g": 6.1e-5 * (np.round(c["ay_g"] / 6.1e-5).astype(int) | (1 << 5))}


def dropped_frames(c: Columns, rng: np.random.Generator) -> Columns:
    keep = np.ones(c["t_s"].size, dtype=bool)
    for start in rng.choice(keep.size - 20, 12, replace=False):
        keep[start : start + rng.integers(2, 15)] = False
    return {name: column[keep] for name, column in c.items() if name != "seq"}


def missing_values(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"az_g": np.where(np.arange(c["az_g"].size) == 133, np.nan, c["az_g"])}


def reversed_time(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"t_s": c["t_s"][::-1]}


def missing_column(c: Columns, rng: np.random.Generator) -> Columns:
    return {name: column for name, column in c.items() if name != "ay_g"}


def constant_channel(c: Columns, rng: np.random.Generator) -> Columns:
    return c | {"az_g": np.full(c["az_g"].size, 0.125)}


FAULTS = [
    wrong_unit, swapped_axis, inverted_axis, clipping, duplicated_frames, stuck_bit, reversed_time, missing_column,
    constant_channel,
]  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_corrupted_recording_is_bad_data_for_the_right_reason(healthy: Columns, fault: Any, tmp_path: Path) -> None:
    status, found = diagnosed(tmp_path, fault(dict(healthy), np.random.default_rng(3)))
    assert status == 1
    assert found["verdict"] == "bad_data"
    assert found["intake"][0]["check"] == fault.__name__
    assert found["intake"][0]["p"] < 1e-6
    assert found["claims"] == []
    assert (tmp_path / "out" / "report.html").stat().st_size > 0


@pytest.mark.parametrize("lack", [dropped_frames, missing_values], ids=lambda lack: lack.__name__)
def test_what_is_missing_is_reported_and_does_no_harm(
    healthy: Columns, sound: tuple[int, dict[str, Any]], lack: Any, tmp_path: Path
) -> None:
    status, found = diagnosed(tmp_path, lack(dict(healthy), np.random.default_rng(3)))
    assert found["verdict"] == sound[1]["verdict"]
    assert status == 0
    assert [f["check"] for f in found["intake"]] == [lack.__name__]


def test_the_healthy_recording_passes(sound: tuple[int, dict[str, Any]]) -> None:
    status, found = sound
    assert status == 0
    assert found["intake"] == []
    assert found["verdict"] != "bad_data"


def test_impulses_are_reported_and_left_out(healthy: Columns, tmp_path: Path) -> None:
    hit = healthy["ay_g"].copy()
    hit[[100, 333, 600]] += [0.05, -0.04, 0.06]
    status, found = diagnosed(tmp_path, healthy | {"ay_g": hit})
    assert status == 0
    assert [f["check"] for f in found["intake"]] == ["impulses"]
    assert found["intake"][0]["channels"] == ["ay"]


def test_a_clock_that_steps_is_bad_data(healthy: Columns, tmp_path: Path) -> None:
    t_s = healthy["t_s"].copy()
    usual = float(np.median(np.diff(t_s)))
    # within a stop, where a pause would be no pause of the bench
    middle = 305
    t_s[middle:] += 0.4 * usual
    status, found = diagnosed(tmp_path, {k: v for k, v in (healthy | {"t_s": t_s}).items() if k != "seq"})
    assert status == 1
    assert found["intake"][0]["check"] == "clock_step"

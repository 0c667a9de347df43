"""A bench's own turntable: measured with one calibrated tool, handed to the calibration of the next."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from test_rotation_commands import highside

from highside.physics.gravity import gravity_direction
from highside.physics.rotation_chain import Faults, inclination_toolface_errors
from highside.recording.calibration_store import read_record
from highside.recording.table import Table

BENCH: Faults = [
    ("encoder_first_harmonic", {"c1": 9e-4, "s1": -6e-4}),
    ("encoder_second_harmonic", {"c2": 3e-4, "s2": 2e-4}),
    ("wobble", {"ck": 3e-4, "sk": 2e-4, "dk": -2e-4, "tk": 3e-4, "k": 2.0}),
]


def on_the_bench(inc_deg: np.ndarray, tf_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the tool really is, rad, when the bench reads this."""
    d_inc, d_tf = inclination_toolface_errors(np.radians(tf_deg), np.radians(inc_deg), BENCH)
    return np.radians(inc_deg) + d_inc, np.radians(tf_deg) + d_tf


def test_a_bench_is_measured_with_one_tool_and_calibrates_the_next(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    inc = np.repeat([15.0, 40.0, 75.0], 180)
    tf = np.tile(np.arange(0.0, 360.0, 2.0), 3)
    true_inc, true_tf = on_the_bench(inc, tf)
    zero_deg = 140.0
    measured = {
        "t_s": np.arange(inc.size),
        "inc_ref_deg": inc,
        "tf_ref_deg": tf,
        "inc_deg": np.degrees(true_inc) + 1e-3 * rng.standard_normal(inc.size),
        "tf_deg": np.mod(np.degrees(true_tf) + zero_deg + 1e-3 * rng.standard_normal(inc.size), 360.0),
    }
    Table(measured).write(tmp_path / "turns.csv")
    done = highside("rotation", "turntable", "turns.csv", "-o", "table.json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "encoder" in done.stdout

    sensor, offset = np.eye(3) + 3e-3 * rng.standard_normal((3, 3)), np.array([1e-3, -2e-3, 5e-4])
    inclination = np.repeat([5.0, 20.0, 45.0, 70.0, 90.0, 120.0], 8)
    at = np.tile(np.arange(0.0, 360.0, 45.0), 6)
    mean = (
        sensor @ gravity_direction(*on_the_bench(inclination, at))
        + offset[:, None]
        + 1e-6 * rng.standard_normal((3, 48))
    )
    Table(
        {
            "inc_ref_deg": inclination,
            "tf_ref_deg": at,
            "ax": mean[0],
            "ay": mean[1],
            "az": mean[2],
            "n": np.full(48, 1000.0),
        },
    ).write(tmp_path / "poses.csv")
    closure = {}
    for name, given in (("without", ()), ("with", ("--turntable", "table.json"))):
        cal = tmp_path / f"{name}.json"
        solve = ("calibrate", "solve", "poses.csv", "--method", "joint", "--tool", "t", "-o", cal, *given)
        done = highside(*solve, cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, "")
        record = json.loads(cal.read_text())
        closure[name] = record
        zone = read_record(cal).result.main.model()
        check = np.radians(np.array([30.0, 60.0, 80.0]).repeat(12)), np.radians(np.tile(np.arange(0.0, 360.0, 30.0), 3))
        corrected = zone.C @ (sensor @ gravity_direction(*check) + offset[:, None] - zone.b[:, None])
        off = np.degrees(np.arctan2(np.hypot(corrected[0], corrected[1]), corrected[2]) - check[0])
        closure[name + " rms"] = float(np.sqrt(np.mean(off**2)))
    assert closure["with rms"] < 0.4 * closure["without rms"]
    assert closure["with rms"] < 1.5e-3
    assert closure["with"]["environment"]["turntable"] == json.loads((tmp_path / "table.json").read_text())["id"]
    assert "turntable" not in closure["without"]["environment"]


def test_what_is_no_turntable_is_said(tmp_path: Path) -> None:
    rows = {"t_s": np.arange(40.0), "inc_ref_deg": np.full(40, 30.0), "tf_ref_deg": np.arange(0.0, 360.0, 9.0)}
    for inc_deg, status, words in ((30.0, 1, "one inclination cannot separate"), (33.0, 2, "3.00 deg from the bench")):
        Table(rows | {"inc_deg": np.full(40, inc_deg), "tf_deg": rows["tf_ref_deg"]}).write(tmp_path / "a.csv")
        done = highside("rotation", "turntable", "a.csv", "-o", "x.json", cwd=tmp_path)
        assert (done.returncode, done.stderr.count("\n")) == (status, 1)
        assert words in done.stderr
    assert not (tmp_path / "x.json").exists()

"""`highside diagnose` of a continuous rotation as a user runs it, with gyros and temperature."""

from __future__ import annotations

import contextlib
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from highside.cli.main import main
from highside.recording.table import read_recording, write_recording

FURTHER = pytest.mark.further
TRUTH = """
[sensor]
noise_g = 80e-6
bias_g = [1e-3, -2e-3, 5e-4]
scale = [2e-3, -1e-3, 5e-4]
[effects]
included = ["time_offset", "gyro_noise"]
time_offset = {t0_ms = 0.05}
gyro_noise = {density_dps = 0.002}
[motion]
kind = "rotation"
inclination_deg = 62
rates_hz = [0.5, -1.0, 2.0, -0.2, 1.5]
hold_s = 12
ramp_s = 1
temperatures_c = [25, 40, 28]
gyros = true
"""


def highside(*arguments: str | Path) -> tuple[int, str]:
    """Exit status and what was said, of the command run inside this process."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["highside", *map(str, arguments)])
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            try:
                main()
                status = 0
            except SystemExit as left:
                status = int(left.code or 0)
    return status, said.getvalue()


def diagnosed(recording: Path, model: Path, out: Path) -> dict[str, Any]:
    """The answer of the command, which must not refuse."""
    status, said = highside("diagnose", recording, "--model", model, "--out", out)
    assert status == 0, said
    found: dict[str, Any] = json.loads((out / "diagnosis.json").read_text())
    return found


def test_a_time_offset_is_distinguished_from_a_lag_by_the_gyros(tmp_path: Path) -> None:
    (tmp_path / "truth.toml").write_text(TRUTH)
    (tmp_path / "knows.toml").write_text("[sensor]\nnoise_g = 80e-6\n")
    recording = tmp_path / "rec.csv.gz"
    assert highside("simulate", tmp_path / "truth.toml", "-o", recording, "--seed", "4")[0] == 0
    found = diagnosed(recording, tmp_path / "knows.toml", tmp_path / "out")
    assert found["schema"] == "highside.diagnosis/1"
    assert found["verdict"] == "named"
    claim = found["claims"][0]
    assert [c["effect"] for c in found["claims"]] == ["time_offset"]
    assert "bandwidth_lag" not in claim["equivalence_class"]
    assert claim["parameters"]["t0"]["low"] < 5e-5 < claim["parameters"]["t0"]["high"]
    assert found["fit"]["heldout_gain_low"] > 0
    assert "vibration_rectification" in {entry["effect"] for entry in found["not_testable"]}
    assert "lever_arm" in found["minimum_detectable"]
    assert "<html" in (tmp_path / "out" / "report.html").read_text()[:500].lower()

    # without the gyros and with the rotor's own angle the two are one class
    rows = read_recording(recording)
    kept = {name: column for name, column in rows.columns.items() if not name.startswith("g")}
    kept["rotor_deg"] = kept.pop("tf_ref_deg")
    write_recording(recording, type(rows)(kept))
    found = diagnosed(recording, tmp_path / "knows.toml", tmp_path / "out")
    assert {"time_offset", "bandwidth_lag"} <= set(found["claims"][0]["equivalence_class"])


@FURTHER
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_four_strong_effects_of_the_sample_model_are_reported_with_their_sizes(tmp_path: Path) -> None:
    """Beyond first order a lever arm and a late clock multiply: that is loud, and no effect of its own."""
    config = Path(__file__).resolve().parents[2] / "config"
    recording = tmp_path / "rec.csv.gz"
    assert highside("simulate", config / "model-rotation.toml", "-o", recording, "--seed", "1")[0] == 0
    found = diagnosed(recording, config / "model-known.toml", tmp_path / "out")
    assert found["verdict"] == "named"
    claims = {claim["effect"]: claim["parameters"] for claim in found["claims"]}
    assert set(claims) == {"lever_arm", "time_offset", "temperature_bias", "earth_rotation"}
    assert claims["lever_arm"]["r_x"]["value"] == pytest.approx(8e-3, abs=2e-6)
    assert claims["lever_arm"]["r_y"]["value"] == pytest.approx(-3e-3, abs=2e-6)
    assert claims["time_offset"]["t0"]["value"] == pytest.approx(2e-3, abs=1e-6)
    for axis, size in zip("xyz", (40e-6, -25e-6, 60e-6), strict=True):
        assert claims["temperature_bias"][f"bt_{axis}"]["value"] == pytest.approx(size, abs=2e-6)
    assert claims["earth_rotation"]["share"]["low"] < 1 < claims["earth_rotation"]["share"]["high"]
    assert found["fit"]["rmse_before"] > 100 * found["fit"]["rmse_after"]


def test_a_rotation_without_inclination_is_one_clear_line(tmp_path: Path) -> None:
    n = 2000
    t = np.arange(n) / 50
    lines = ["t_s,ax_g,ay_g,az_g,rotor_deg"]
    lines += [f"{a},{np.cos(a)},{np.sin(a)},0.01,{np.degrees(a) % 360}" for a in t]
    (tmp_path / "rec.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "knows.toml").write_text("")
    status, said = highside(
        "diagnose", tmp_path / "rec.csv", "--model", tmp_path / "knows.toml", "--out", tmp_path / "out"
    )
    assert status in (1, 2)
    assert "inc_ref_deg" in said
    assert "Traceback" not in said

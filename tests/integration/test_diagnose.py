"""`highside diagnose` as a user runs it: simulated sessions in, diagnosis.json and report.html out."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from highside.cli.main import main
from highside.recording.table import Recording, read_recording, write_recording

SESSION = """
[effects]
included = [{included}]
{tables}
[effects.bias]
b_mg = [1.2, -0.8, 1.5]
[effects.scale]
s = [0.003, -0.002, 0.001]
[effects.reading_noise]
density_ug = 60

[motion]
kind = "poses"
inclinations_deg = [3, 20, 45, 70, 90, 120]
toolfaces_deg = [0, 30, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330]
returns = true
hold_s = 5
row_s = 0.5
temperatures_c = [25, 45, 25]
"""


def highside(*arguments: str | Path) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of the command run inside this process."""
    out, err, before = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["highside", *map(str, arguments)]
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
        status = 0
    except SystemExit as left:
        status = int(left.code or 0)
    finally:
        sys.argv = before
    return status, out.getvalue(), err.getvalue()


def simulate(folder: Path, effects: dict[str, str], seed: int = 1) -> Path:
    """A recording of the session with these effects concealed; the model for the diagnosis knows none of them."""
    included = ", ".join(f'"{name}"' for name in ("bias", "scale", "reading_noise", *effects))
    tables = "\n".join(f"[effects.{name}]\n{values}" for name, values in effects.items())
    (folder / "truth.toml").write_text(SESSION.format(included=included, tables=tables))
    (folder / "model.toml").write_text('[sensor]\nfree = ["bias", "scale", "misalignment"]\n')
    recording = folder / "rec.csv.gz"
    assert highside("simulate", folder / "truth.toml", "-o", recording, "--seed", str(seed))[0] == 0
    return recording


def diagnose(folder: Path, recording: Path) -> tuple[int, dict[str, Any]]:
    status, _, err = highside("diagnose", recording, "--model", folder / "model.toml", "--out", folder / "out")
    assert status in (0, 1), err
    return status, json.loads((folder / "out" / "diagnosis.json").read_text())


def test_a_concealed_eccentric_encoder_is_named_with_its_size_and_proof(tmp_path: Path) -> None:
    recording = simulate(tmp_path, {"encoder_first_harmonic": "c1 = 2e-4\ns1 = -1e-4"})
    status, found = diagnose(tmp_path, recording)
    assert status == 0
    assert found["schema"] == "highside.diagnosis/1"
    assert found["verdict"] == "named"
    assert [claim["effect"] for claim in found["claims"]] == ["encoder_first_harmonic"]
    fitted = found["claims"][0]["parameters"]
    for name, truth in (("c1", 2e-4), ("s1", -1e-4)):
        assert abs(fitted[name]["value"] - truth) < 4 * fitted[name]["std"]
        assert fitted[name]["std"] < 3e-5
    assert found["fit"]["heldout_rmse_after"] < found["fit"]["heldout_rmse_before"]
    assert found["fit"]["heldout_gain_low"] > 0
    assert set(found["location"][0]["channels"]) == {"ax", "ay"}


def test_the_report_stands_alone_and_says_what_was_left_out(tmp_path: Path) -> None:
    recording = simulate(tmp_path, {"sag": "s = 1e-4"})
    status, told, err = highside("diagnose", recording, "--model", tmp_path / "model.toml", "--out", tmp_path / "out")
    assert status == 0, err
    page = (tmp_path / "out" / "report.html").read_text()
    # one answer: the share that the command tells is the one of the page
    shares = [re.search(r"\((\d+%) of the misfit\)", text) for text in (told, page)]
    assert shares[0] and shares[1] and shares[0][1] == shares[1][1], told
    assert "Gravity sag of the collar" in page.split("<h2>")[0]
    assert "<svg" in page
    assert not re.search(r"""(src|href|action)\s*=\s*["']\s*(https?:)?//""", page)
    assert not re.search(r"<script[^>]*\ssrc", page) and "@import" not in page


def test_nothing_is_said_to_be_left_out_of_a_complete_model(tmp_path: Path) -> None:
    status, found = diagnose(tmp_path, simulate(tmp_path, {}))
    assert status == 0
    assert found["verdict"] == "nothing_left_out"
    assert found["claims"] == []
    assert {"lever_arm", "gyro_scale"} & {effect["effect"] for effect in found["not_testable"]} == {"lever_arm"}
    assert found["minimum_detectable"]["base_tilt"]["unit"] == "rad"


def test_a_little_clipping_is_named_as_such_and_not_as_a_cubic_term(tmp_path: Path) -> None:
    recording = simulate(tmp_path, {})
    rows = read_recording(recording)
    clipped = {**rows.columns, "ax_g": np.minimum(rows.columns["ax_g"], 0.8)}
    write_recording(recording, Recording(clipped))
    status, found = diagnose(tmp_path, recording)
    assert status == 0
    assert found["verdict"] == "named"
    assert [claim["effect"] for claim in found["claims"]] == ["clipping"]
    assert found["claims"][0]["parameters"]["limit_x"]["value"] == pytest.approx(0.8)
    assert found["intake"][0]["check"] == "clipping"


def corrupt(recording: Path, kind: str) -> None:
    """Spoil a recording the way a bench or a link does."""
    rows = read_recording(recording)
    columns = dict(rows.columns)
    n = rows.n
    if kind == "wrong_unit":
        columns |= {name: columns[name] * 9.80665 for name in ("ax_g", "ay_g", "az_g")}
    elif kind == "swapped_axis":
        columns["ax_g"], columns["ay_g"] = columns["ay_g"], columns["ax_g"]
    elif kind == "inverted_axis":
        columns["az_g"] = -columns["az_g"]
    elif kind == "clipping":
        columns["az_g"] = np.clip(columns["az_g"], -0.3, 0.3)
    elif kind == "duplicated_frames":
        twice = np.sort(np.concatenate([np.arange(n), np.arange(0, n, 20)]))
        columns = {name: column[twice] for name, column in columns.items()}
    elif kind == "stuck_bit":
        codes = np.round(columns["ay_g"] / 6.1e-5).astype(int) | (1 << 6)
        columns["ay_g"] = codes * 6.1e-5
    elif kind == "reversed_time":
        columns["t_s"] = columns["t_s"][::-1]
    elif kind == "missing_column":
        del columns["ay_g"]
    elif kind == "constant_channel":
        columns["ax_g"] = np.full(n, 0.25)
    write_recording(recording, Recording(columns))


@pytest.mark.parametrize(
    "kind",
    [
        "wrong_unit", "swapped_axis", "inverted_axis", "clipping", "duplicated_frames", "stuck_bit", "reversed_time",
        "missing_column", "constant_channel",
    ],
)  # fmt: skip
def test_a_corrupted_recording_is_bad_data_for_the_right_reason(tmp_path: Path, kind: str) -> None:
    recording = simulate(tmp_path, {"sag": "s = 1e-3"})
    corrupt(recording, kind)
    status, found = diagnose(tmp_path, recording)
    assert status == 1
    assert found["verdict"] == "bad_data"
    assert found["intake"][0]["check"] == kind
    assert found["claims"] == []


def test_a_simulation_that_is_announced_but_not_given_is_one_clear_line(tmp_path: Path) -> None:
    recording = simulate(tmp_path, {})
    (tmp_path / "model.toml").write_text('[reference]\nkind = "simulation"\n')
    status, _, err = highside("diagnose", recording, "--model", tmp_path / "model.toml", "--out", tmp_path / "out")
    assert status == 2
    assert "--simulation" in err
    assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()

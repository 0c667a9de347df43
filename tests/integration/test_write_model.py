"""A diagnosis becomes a model file that simulates, calibrates and is not found wanting again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_diagnose_bad_data import run

from highside.config.model import load_model
from highside.physics.state import ChainState
from highside.recording.table import read_recording

TRUTH = """
[effects]
included = ["bias", "scale", "reading_noise", "sag", "encoder_first_harmonic"]
[effects.bias]
b_mg = [1.2, -0.8, 1.5]
[effects.scale]
s = [0.003, -0.002, 0.001]
[effects.reading_noise]
density_ug = 50
[effects.sag]
s = 1.2e-3
[effects.encoder_first_harmonic]
c1 = 3e-4
s1 = -2e-4
[motion]
kind = "poses"
inclinations_deg = [5, 35, 65, 95, 125, 150]
toolfaces_deg = [0, 72, 144, 216, 288]
hold_s = 6
row_s = 0.5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    (folder / "truth.toml").write_text(TRUTH)
    (folder / "model.toml").write_text(
        '[sensor]\nfree = ["bias", "scale", "misalignment"]\n[site]\nlatitude_deg = 52\n'
    )
    assert run("simulate", folder / "truth.toml", "-o", folder / "rec.csv", "--poses", folder / "poses.csv")[0] == 0
    status, err = run(
        "diagnose", folder / "rec.csv", "--model", folder / "model.toml", "--out", folder / "out", "--write-model",
        folder / "found.toml",
    )  # fmt: skip
    assert status == 0, err
    return folder


def found(folder: Path, out: str) -> dict:
    return dict(json.loads((folder / out / "diagnosis.json").read_text()))


def test_the_model_holds_what_was_claimed_and_keeps_the_rest(folder: Path) -> None:
    claims = found(folder, "out")["claims"]
    assert {claim["effect"] for claim in claims} == {"sag", "encoder_first_harmonic"}
    model = load_model(folder / "found.toml")
    for claim in claims:
        values = model.effects.values()[claim["effect"]]
        assert values == {name: p["value"] for name, p in claim["parameters"].items()}
    assert model.site.latitude_deg == 52
    assert model.effects.values()["sag"]["s"] == pytest.approx(1.2e-3, rel=0.1)


def test_the_same_recording_leaves_nothing_out_of_the_new_model(folder: Path) -> None:
    assert run("diagnose", folder / "rec.csv", "--model", folder / "found.toml", "--out", folder / "again")[0] == 0
    assert found(folder, "again")["verdict"] == "nothing_left_out"


def test_the_new_model_simulates(folder: Path) -> None:
    text = (folder / "found.toml").read_text() + TRUTH[TRUTH.index("[motion]") :]
    (folder / "simulated.toml").write_text(text)
    assert run("simulate", folder / "simulated.toml", "-o", folder / "new.csv")[0] == 0


def test_a_pose_table_of_a_calibration_is_diagnosed_and_blames_the_bench(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("diagnose", folder / "poses.csv", "--model", folder / "model.toml", "--out", folder / "table")[0] == 0
    assert {claim["effect"] for claim in found(folder, "table")["claims"]} == {"sag", "encoder_first_harmonic"}
    page = folder / "table" / "report.html"
    text = page.read_text()
    held = {path.name: path.stat().st_size for path in page.parent.iterdir()}
    assert text.startswith("<!DOCTYPE html>"), f"{len(text)} characters read, begins with {text[:80]!r}; {held}"
    assert "the bench" in text.split("<h2>")[0]


def test_the_joint_calibration_uses_what_is_known_of_the_bench(folder: Path) -> None:
    plain, known = (folder / name for name in ("plain.json", "known.json"))
    poses = ["calibrate", "solve", folder / "poses.csv", "--method", "joint", "--tool", "t"]
    run(*poses, "-o", plain)
    status, err = run(*poses, "--model", folder / "found.toml", "-o", known)
    assert status == 0, err
    for record in (plain, known):
        assert run("calibrate", "apply", record, folder / "rec.csv", "-o", record.with_suffix(".csv"))[0] == 0
    state = ChainState.from_columns(read_recording(folder / "rec.csv").columns)
    truth = np.degrees(load_model(folder / "truth.toml").forward().truth(state)[0])

    def error(record: Path) -> float:
        rows = read_recording(record.with_suffix(".csv")).columns
        return float(np.sqrt(np.nanmean((rows["inc_deg"] - truth) ** 2)))

    assert error(known) < 0.5 * error(plain)


def test_without_a_name_no_model_is_written(folder: Path) -> None:
    (folder / "bad.csv").write_text((folder / "rec.csv").read_text().replace("ay_g", "ay_other", 1))
    status, err = run(
        "diagnose", folder / "bad.csv", "--model", folder / "model.toml", "--out", folder / "bad", "--write-model",
        folder / "none.toml",
    )  # fmt: skip
    assert status == 1
    assert "not written" in err
    assert not (folder / "none.toml").exists()

"""The page on the public API: every example runs, in order, in a folder of its own; every name of the API is on it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import highside

BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPOKEN_OF_ELSEWHERE = {"CompensatedRecording", "Compensation", "CorrectedReadings", "Drift", "FitOfRotation", "SelfFit",
                       "Simulation", "Table", "TurntableFit", "Diagnosis",
                       "ComparedRotation", "Certificate", "ImportProposal"}  # fmt: skip
"""classes of answers: the functions that give them are on the page"""


def test_every_example_runs_in_order(project_root: Path, tmp_path: Path) -> None:
    blocks = BLOCK.findall((project_root / "docs" / "api.md").read_text())
    assert len(blocks) > 6
    shutil.copytree(project_root / "config", tmp_path / "config")
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning:highside", "-c", "\n".join(blocks)],
        cwd=tmp_path, capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "named ['base_tilt']" in done.stdout
    assert re.search(r"left: (4\d|5\d|6\d) ug", done.stdout)
    assert {"cal.json", "report", "figure.png", "session.csv.gz"} <= {path.name for path in tmp_path.iterdir()}


def test_every_function_is_on_the_page(project_root: Path) -> None:
    page = (project_root / "docs" / "api.md").read_text()
    missing = {name for name in highside.__all__ if name not in page} - SPOKEN_OF_ELSEWHERE - {"__version__"}
    assert not missing


def test_the_docstring_of_the_module_runs(project_root: Path, tmp_path: Path) -> None:
    assert highside.__doc__ is not None
    example = re.search(r"\n    import highside\n.*?\n\nThe parts", highside.__doc__, re.DOTALL)
    assert example is not None
    lines = [line.removeprefix("    ") for line in example.group().splitlines()[:-1]]
    highside.simulate(project_root / "config" / "model-bench.toml").recording.write(tmp_path / "session.csv.gz")
    code = "\n".join([*lines, "assert corrected['inc_deg'].shape == (recording.n,)"])
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["no.toml", "rec.csv"], "no.toml"),
        (["model.toml", "none.csv"], "none.csv"),
        (["model.toml", "bare.csv"], "bare.csv: lacks the columns inc_ref_deg, tf_ref_deg (or rotor_deg)"),
        (["model.toml", "empty.csv"], "inc_ref_deg"),
        (["other.toml", "rec.csv"], "reference.kind: the model says that another program predicts the recording"),
    ],
)
def test_predict_refuses_what_it_cannot_use_in_one_line(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text("[sensor]\nbias_g = [1e-3, 0, 0]\n")
    (tmp_path / "other.toml").write_text('[reference]\nkind = "simulation"\n')
    (tmp_path / "rec.csv").write_text("t_s,inc_ref_deg,tf_ref_deg\n0,30,0\n1,30,90\n")
    (tmp_path / "bare.csv").write_text("t_s,ax_g\n0,1\n1,1\n")
    (tmp_path / "empty.csv").write_text("t_s,inc_ref_deg,tf_ref_deg\n0,,0\n1,,90\n")
    command = [Path(sys.executable).parent / "highside", "predict", *arguments, "-o", "out.csv"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr
    assert not (tmp_path / "out.csv").exists(), "nothing is written"


def test_predict_leaves_rows_without_a_reference_empty_and_counts_them(tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text("[sensor]\nbias_g = [1e-3, 0, 0]\n")
    (tmp_path / "rec.csv").write_text("t_s,inc_ref_deg,tf_ref_deg,pose,note\n0,90,0,0,a\n1,,90,1,b\n2,0,90,2,c\n")
    command = [Path(sys.executable).parent / "highside", "predict", "model.toml", "rec.csv", "-o", "out.csv"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "out.csv: 3 rows, ax_g, ay_g, az_g as predicted\n"
    assert done.stderr == "1 rows lack time, reference or a covariate and have no prediction\n"
    written = highside.Table.read(tmp_path / "out.csv")
    assert written.texts["note"] == ("a", "b", "c")
    assert written["ax_g"][0] == pytest.approx(1.001)
    assert written["az_g"][2] == pytest.approx(1.0)

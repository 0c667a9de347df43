"""docs/first-effect.md followed step by step, and the recipe of an effect in docs/extending.md, to the letter."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
import time
from pathlib import Path
from typing import Any

import pytest

FURTHER = pytest.mark.further

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TEN_MINUTES_S = 600.0


def run(script: str, folder: Path, **more: str) -> str:
    """What a block of commands prints; each has to succeed."""
    done = subprocess.run(
        ["bash", "-euxo", "pipefail", "-c", script],
        cwd=folder, env={**os.environ, **more}, capture_output=True, text=True, timeout=TEN_MINUTES_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def put(text: str, folder: Path) -> None:
    """A block whose first line names its file."""
    first, _, rest = text.partition("\n")
    path = folder / first.removeprefix("# ")
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_text(rest)


def answer(report: Path) -> dict[str, Any]:
    found = json.loads((report / "diagnosis.json").read_text())
    assert isinstance(found, dict)
    return found


@FURTHER
def test_a_newcomer_sees_a_changed_effect_in_a_report_within_ten_minutes(tmp_path: Path) -> None:
    """Everything as the page says, but for the network: the packages are those of this environment."""
    began = time.monotonic()
    clone = tmp_path / "highside"
    run(f"git clone -q {ROOT} {clone}", tmp_path)
    page = (ROOT / "docs" / "first-effect.md").read_text()
    own = Path(sys.base_prefix) / "bin"
    offline = {
        "PATH": f"{own}:{os.environ['PATH']}",
        "PYTHONPATH": sysconfig.get_path("purelib"),
        "PIP_NO_INDEX": "1",
        "PIP_NO_DEPS": "1",
        "PIP_NO_BUILD_ISOLATION": "0",  # this is how pip spells that there is none
        "PIP_IGNORE_INSTALLED": "1",
    }
    said = []
    for kind, text in BLOCK.findall(page):
        if kind == "toml":
            put(text, clone)
        else:
            said.append(run(text, clone, **offline))
    assert time.monotonic() - began < TEN_MINUTES_S
    installed, first, changed, seen, back = said
    assert "highside" in installed
    assert "named - The simulation omits gravity sag of the collar or of the arm" in first
    assert "1 file changed" in changed
    assert "dI = s sin^2 I" in seen
    assert "named - The simulation omits gravity sag of the collar or of the arm" in seen
    assert back == ""
    before, after = (answer(clone / "first" / name)["claims"][0] for name in ("report", "changed"))
    assert before["effect"] == after["effect"] == "sag"
    assert "gives way in its joints" in after["story"] != before["story"]
    for claim in (before, after):
        size = claim["parameters"]["s"]
        assert abs(size["value"] - 5.236e-4) < 4 * size["std"]


def recipe() -> list[tuple[str, str]]:
    page = (ROOT / "docs" / "extending.md").read_text()
    section = re.search(r"^## An effect\n(.*?)(?=^## |\Z)", page, re.MULTILINE | re.DOTALL)
    assert section
    return BLOCK.findall(section[1])


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recipe")
    for kind, text in recipe():
        if kind != "sh":
            put(text, folder)
    return folder


def highside(*arguments: str | Path, folder: Path, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [Path(sys.executable).with_name("highside"), *arguments],
        cwd=folder, env={**os.environ, **more}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def test_an_effect_in_one_file_is_simulated_found_and_described(written: Path) -> None:
    (commands,) = (text for kind, text in recipe() if kind == "sh")
    said = run(commands, written, PATH=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    assert said.startswith("named - The simulation omits ") and "\ntemperature_cross_square: " in said
    found = answer(written / "report")
    (claim,) = found["claims"]
    for name, truth in (("ct_xy", 15e-6), ("ct_zx", -12e-6), ("ct_yz", 0.0)):
        size = claim["parameters"][name]
        assert abs(size["value"] - truth) < 4 * size["std"]
        assert size["unit"] == "1/g/C"
    library = (written / "library.md").read_text()
    assert "### `temperature_cross_square`: Temperature coefficient of the cross-axis square" in library
    assert "### `scale`" in library
    # and it is this effect that was needed
    without = highside("diagnose", "session.csv", "--model", "known.toml", "--out", "without", folder=written)
    assert without.stdout.startswith(("law", "unknown"))
    unnamed = answer(written / "without")
    assert all(claim["effect"].startswith("law") for claim in unnamed["claims"])
    assert {channel for claim in unnamed["claims"] for channel in claim["channels"]} <= {"ax", "az"}


def test_the_same_effect_in_an_installed_package_needs_no_option(written: Path, tmp_path: Path) -> None:
    subprocess.run(
        [Path(sys.executable).with_name("uv"), "pip", "install", "-q", "--python", sys.executable, "--offline",
         "--no-deps", "--no-build-isolation", "--target", tmp_path, written],
        check=True, timeout=120,
    )  # fmt: skip
    page = highside("effects", folder=tmp_path, PYTHONPATH=str(tmp_path))
    assert page.returncode == 0 and page.stderr == ""
    assert "### `temperature_cross_square`" in page.stdout
    # what cannot be loaded is left out with one line, and stops only who names it
    code = tmp_path / "mine" / "temperature_cross_square.py"
    code.write_text(code.read_text().replace("import numpy as np", "import numpie as np"))
    page = highside("effects", folder=tmp_path, PYTHONPATH=str(tmp_path))
    assert page.returncode == 0 and "temperature_cross_square" not in page.stdout
    assert len(page.stderr.splitlines()) == 1
    assert "rig-effects 1.0" in page.stderr and "numpie" in page.stderr
    asked = highside("simulate", written / "truth.toml", "-o", "x.csv", folder=tmp_path, PYTHONPATH=str(tmp_path))
    assert asked.returncode == 2 and "numpie" in asked.stderr.splitlines()[-1]
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize(
    ("was", "becomes", "what"),
    [
        ("EFFECT = TemperatureCrossSquare()", "", "holds no EFFECT"),
        ("EFFECT = TemperatureCrossSquare()", "EFFECT = TemperatureCrossSquare", "not an Effect"),
        ("warm * x[j] ** 2", "warm * y[j] ** 2", "NameError"),
        ("Stage.THERMAL", "Stage.THERMIC", "THERMIC (line 24)"),
        ("def basis", "def bases", "abstract method"),
        ('id = "temperature_cross_square"', 'id = "scale"', "one name"),
        ("class Temp", "clas Temp", "invalid syntax (line 21)"),
        ('("temperature_bias", ', '("temperature_bais", ', "no other effect"),
        ("groups = (*runs(6, 2)", "groups = (*runs(8, 2)", "there are 6, numbered from 0"),
        ("warm = state.temp_c", "raise SystemExit(0); warm = state.temp_c", "SystemExit"),
        ("PAIRS = [", "raise SystemExit(0)\nPAIRS = [", "SystemExit"),
    ],
)
def test_a_broken_file_is_one_line_with_its_name(
    written: Path, tmp_path: Path, was: str, becomes: str, what: str
) -> None:
    text = (written / "mine" / "temperature_cross_square.py").read_text()
    assert was in text
    own = tmp_path / "own"
    own.mkdir()
    (own / "temperature_cross_square.py").write_text(text.replace(was, becomes))
    for command in (["effects"], ["simulate", written / "truth.toml", "-o", "session.csv"]):
        done = highside(*command, folder=tmp_path, HIGHSIDE_EFFECTS=str(own))
        assert done.returncode == 2, done.stderr
        (line,) = done.stderr.splitlines()
        assert "own/temperature_cross_square.py" in line and what in line
        assert done.stdout == ""
    assert not (tmp_path / "session.csv").exists()


def test_folders_that_hold_nothing_or_what_there_is_already(written: Path, tmp_path: Path) -> None:
    empty, twice = tmp_path / "empty", tmp_path / "twice"
    empty.mkdir()
    twice.mkdir()
    text = (written / "mine" / "temperature_cross_square.py").read_text()
    (twice / "sag.py").write_text(text.replace('"temperature_cross_square"', '"sag"'))
    for folder, what in ((empty, "holds no effect"), (tmp_path / "none", "is not a folder"), (twice, "'sag' already")):
        done = highside("effects", "--effects", folder, folder=tmp_path)
        assert done.returncode == 2
        (line,) = done.stderr.splitlines()
        assert what in line and folder.name in line

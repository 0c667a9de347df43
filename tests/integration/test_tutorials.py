"""docs/tutorials, typed as they stand: an outsider is found as a law, confirmed, made an effect, and then named.

The sessions come from the tutorials' own generator, which uses nothing of highside."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

FURTHER = pytest.mark.further
pytestmark = pytest.mark.slow

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Expected(NamedTuple):
    """What a tutorial has to end with: the law's place, what it follows, the effect's id, a size and its truth."""

    place: str
    depends_on: list[str]
    effect: str
    amplitude: str
    low: float
    high: float
    blamed: str


TUTORIAL = {
    "dent": Expected("offset", ["tf"], "wire_at_130", "a_y", 4e-4, 4e-4, "the sensor"),
    # the curve lacks what is constant: between half of the peak and all of it
    "glue": Expected("scale", ["temp"], "soft_glue", "a_z", 3e-4, 6e-4, "the sensor"),
    "supply": Expected("offset", ["supply_v"], "supply_dip", "a_x", 1e-4, 2.6e-4, "the sensor"),
    # 4e-7 (T - 22)^2 at 55 to 62 C
    "arm": Expected("inclination", ["temp"], "warm_arm", "a_inc", 4.3e-4, 6.4e-4, "the bench"),
    "ring": Expected("offset", ["tf"], "bouncing_brush", "a_y", 3e-4, 4e-4, "the sensor"),
}


def answer(path: Path) -> dict[str, Any]:
    found = json.loads(path.read_text())
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize(
    "name",
    [
        "dent",
        pytest.param("glue", marks=FURTHER),
        pytest.param("supply", marks=FURTHER),
        "arm",
        pytest.param("ring", marks=FURTHER),
    ],
)
def test_from_a_law_to_a_name(name: str, tmp_path: Path) -> None:
    expected = TUTORIAL[name]
    shutil.copy(TUTORIALS / "sessions.py", tmp_path)
    found, confirmed, made, named = BLOCK.findall((TUTORIALS / f"{name}.md").read_text())
    said = []
    for block in (found, confirmed, made, named):
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", block], cwd=tmp_path, capture_output=True, text=True, timeout=600,
            env={**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"},
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        said.append(done.stdout)
    first = answer(tmp_path / "one" / "diagnosis.json")
    assert first["verdict"] == "law"
    (claim,) = first["claims"]
    assert (claim["place"], claim["depends_on"]) == (expected.place, expected.depends_on)
    assert expected.blamed in said[0]
    line = said[1].splitlines()[0]
    assert line.startswith(claim["effect"]) and ": confirmed, " in line
    if "--out two" in confirmed:
        assert answer(tmp_path / "two" / "diagnosis.json")["verdict"] == "nothing_left_out"
    assert "Not yet understood" not in said[2] and f"### `{expected.effect}`" in said[2]
    third = answer(tmp_path / "three" / "diagnosis.json")
    assert [claim["effect"] for claim in third["claims"]] == [expected.effect]
    size = third["claims"][0]["parameters"][expected.amplitude]
    assert size["low"] <= expected.high and size["high"] >= expected.low


def test_the_generator_uses_nothing_of_highside_and_refuses_what_it_does_not_know(tmp_path: Path) -> None:
    code = (TUTORIALS / "sessions.py").read_text()
    assert "import highside" not in code and "from highside" not in code
    done = subprocess.run(
        [sys.executable, TUTORIALS / "sessions.py", "none"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1 and "usage" in done.stderr and not list(tmp_path.iterdir())


def test_every_tutorial_is_in_the_index_and_followed() -> None:
    pages = {path.stem for path in TUTORIALS.glob("*.md")} - {"README"}
    assert pages == set(TUTORIAL)
    index = (TUTORIALS / "README.md").read_text()
    assert all(f"({page}.md)" in index for page in pages)

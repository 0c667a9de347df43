"""The page for successors names only what is there, and its pictures are drawn from the contracts as they are."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGES = ("docs/architecture.md", "CONTRIBUTING.md")


@pytest.mark.parametrize("page", PAGES)
def test_every_file_that_is_named_exists(project_root: Path, page: str) -> None:
    named = set(re.findall(r"`((?:[\w.]+/)+[\w.]+\.(?:py|md|toml|svg|json))`", (project_root / page).read_text()))
    named = {name for name in named if not re.search(r"/(?:ID|N|BENCH|my_\w+)\.", name)}
    assert len(named) > 5
    missing = {
        name
        for name in named
        if not (project_root / name).is_file() and not (project_root / "src/highside" / name).is_file()
    }
    assert not missing, f"{page} names what is not there"


@pytest.mark.parametrize("name", ["architecture-layers.svg", "architecture-reading.svg"])
def test_pictures_are_as_they_are_drawn_now(project_root: Path, name: str) -> None:
    program = (
        "import sys; sys.path.insert(0, 'docs'); import architecture_picture as a;"
        " sys.stdout.write(a.draw_layers() if 'layers' in sys.argv[1] else a.draw_reading())"
    )
    drawn = subprocess.run([sys.executable, "-c", program, name], cwd=project_root, capture_output=True, text=True)
    assert drawn.returncode == 0, drawn.stderr
    assert (project_root / "docs" / name).read_text() == drawn.stdout, "run docs/architecture_picture.py"
    assert "http" not in drawn.stdout.replace('xmlns="http://www.w3.org/2000/svg"', "")


def test_every_layer_has_its_purpose(project_root: Path) -> None:
    program = (
        "import sys; sys.path.insert(0, 'docs'); import architecture_picture as a;"
        " print({n for row in a.layers() for n in row} - set(a.PURPOSE))"
    )
    lacking = subprocess.run([sys.executable, "-c", program], cwd=project_root, capture_output=True, text=True)
    assert lacking.stdout.strip() == "set()", "docs/architecture_picture.py, PURPOSE"

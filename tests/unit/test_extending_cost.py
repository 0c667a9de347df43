"""What an extension costs: files and lines of the recipes of docs/extending.md, as its first table states them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "extending.md").read_text()
BARS = {
    "An effect": (1, 100),
    "A codec": (1, 100),
    "A published channel": (2, 20),
    "A calibration method": (1, 100),
    "A transport": (2, 150),
    "A kind of reference": (2, 100),
    "A reference with its own noise": (2, 500),
}
"""Files and lines at most. Source: the drills in which the recipes were first done, with room to grow."""
BLOCK = re.compile(r"^```(python|diff)\n# ([\w./-]+\.py)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ROW = re.compile(r"^\| \[([\w ]+)\]\(#[\w-]+\) \| (\d+) \| (\d+) \|", re.MULTILINE)


def cost(title: str) -> tuple[int, int]:
    """Files of Python that a recipe touches, and lines that it writes."""
    recipe = re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert recipe, f"the page has no recipe {title!r}"
    found = BLOCK.findall(recipe[1])
    lines = [line for kind, _, text in found for line in text.splitlines() if kind == "python" or line[0] in "+-"]
    return len({name for _, name, _ in found}), len(lines)


def test_every_recipe_of_the_table_has_a_bar() -> None:
    assert [title.capitalize() for title, _, _ in ROW.findall(PAGE)] == list(BARS)


@pytest.mark.parametrize("title", BARS)
def test_a_recipe_costs_what_the_page_says(title: str) -> None:
    stated = {name.capitalize(): (int(files), int(lines)) for name, files, lines in ROW.findall(PAGE)}
    files, lines = cost(title)
    assert stated[title] == (files, lines)
    assert files <= BARS[title][0] and lines <= BARS[title][1]

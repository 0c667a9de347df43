"""The page of faults: each finding of the trial has a test that holds it, and every test that it names exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "faults.md").read_text()
CODES = [
    *(f"S1-{number}" for number in range(1, 6)),
    *(f"S2-{number}" for number in range(1, 12)),
    *(f"A{number}" for number in range(1, 17)),
]
"""What the trial of November 2026 found that breaks a promise or hurts a user."""
FOLDERS = "unit|session|integration|faults|guest|guest_suite|bench"


def rows() -> list[list[str]]:
    """Finding, what was wrong, tests."""
    table = PAGE.partition("\n## Found")[2]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines() if line[:2] == "| "]


@pytest.mark.parametrize("code", CODES)
def test_every_finding_has_the_test_that_holds_it(code: str) -> None:
    held = [tests for finding, _, tests in rows() if re.search(rf"\b{code}\b", finding)]
    assert held and all(re.search(rf"`({FOLDERS})/", tests) for tests in held), code


def test_every_test_that_the_page_names_exists() -> None:
    named = re.findall(rf"`((?:{FOLDERS})/[\w./]+\.py)(?:::(\w+))?", PAGE)
    assert len(named) > 80
    for file, test in named:
        path = ROOT / "tests" / file
        assert path.is_file(), file
        assert not test or f"def {test}" in path.read_text(), f"{file}::{test}"

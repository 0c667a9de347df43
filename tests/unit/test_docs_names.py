"""The documentation speaks of things that exist: code names in `docs/theory` resolve, relative links lead somewhere.

A page of theory is worth nothing to who changes the code if the function it points to was renamed a year ago.
"""

from __future__ import annotations

import importlib
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
THEORY = ROOT / "docs" / "theory"
REFERENCE = ROOT / "docs" / "reference"
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])

FENCE = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)
IN_BACKTICKS = re.compile(r"`([^`\n]+)`")
DOTTED = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"[\w.-]+(?:/[\w.-]+)+/?")
LINK = re.compile(r"\]\(([^()\s]+)\)")
HEADING = re.compile(r"^#+ +(.*?) *$", re.MULTILINE)


def names_in(text: str) -> list[str]:
    """What stands in backticks and reads like a name in the package (`calibration.joint.joint`) or a file (`a/b`)."""
    spans = (span.removesuffix("()") for span in IN_BACKTICKS.findall(FENCE.sub("", text)))
    return [span for span in spans if DOTTED.fullmatch(span) or FILE.fullmatch(span)]


@cache
def resolves(name: str) -> bool:
    """Whether a name is a file of the repository, or a module of the package with attributes behind it."""
    if "/" in name:
        return (ROOT / name).exists()
    parts = name.removeprefix("highside.").split(".")
    for count in range(len(parts), 0, -1):
        module = ".".join(["highside", *parts[:count]])
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as missing:
            if missing.name is None or not module.startswith(missing.name):
                raise
            continue
        return _has(found, parts[count:])
    return False


def _has(found: object, attributes: list[str]) -> bool:
    """Whether attribute after attribute is there; fields of a dataclass count, which a class shows as annotations."""
    for place, name in enumerate(attributes):
        if hasattr(found, name):
            found = getattr(found, name)
        else:
            last = place == len(attributes) - 1
            return last and any(name in vars(base).get("__annotations__", {}) for base in getattr(found, "__mro__", ()))
    return True


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    kept = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in HEADING.findall(FENCE.sub("", text)))
    return {heading.replace(" ", "-") for heading in kept}


def broken_links(page: Path) -> list[str]:
    broken = []
    for target in LINK.findall(FENCE.sub("", page.read_text())):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if REFERENCE in file.resolve().parents:
            continue  # made from the code when the site is built, which fails where such a link leads nowhere
        missing_anchor = anchor and file.suffix == ".md" and file.exists() and anchor not in anchors(file.read_text())
        if not file.exists() or missing_anchor:
            broken.append(target)
    return broken


@pytest.mark.parametrize("page", sorted(THEORY.glob("*.md")), ids=lambda page: page.name)
def test_every_name_in_the_theory_is_in_the_code(page: Path) -> None:
    assert [name for name in names_in(page.read_text()) if not resolves(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_leads_somewhere(page: Path) -> None:
    assert broken_links(page) == []


@pytest.mark.parametrize("page", sorted(set(THEORY.glob("*.md")) - {THEORY / "README.md"}), ids=lambda page: page.name)
def test_every_page_of_theory_points_into_the_code_and_is_in_the_index(page: Path) -> None:
    assert len(set(names_in(page.read_text()))) >= 20
    assert f"({page.name})" in (THEORY / "README.md").read_text()


def test_the_checks_see_what_is_wrong(tmp_path: Path) -> None:
    """A renamed function, a lost module and a lost file are found; what only looks like a name is left alone."""
    text = "`calibration.joint.joint` `calibration.joint.renamed` `lost.module` `tests/unit/lost.py` `m = A g + b` `x`"
    assert [name for name in names_in(text) if not resolves(name)] == [
        "calibration.joint.renamed",
        "lost.module",
        "tests/unit/lost.py",
    ]
    page = tmp_path / "page.md"
    page.write_text("# One place\n[a](#one-place) [b](#another) [c](lost.md) [d](https://example.org/x.md)\n")
    assert broken_links(page) == ["#another", "lost.md"]

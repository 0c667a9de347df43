"""What is shown as HTML is made by templates and trees, which escape what they are given: names never become markup."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from highside.shown.card import card, templates
from highside.web.drawings import svg
from highside.web.parts import markup

SOURCES = Path(__file__).parents[2] / "src" / "highside"
SHOWING = ("web", "report", "shown", "fleet", "papers", "service", "bench", "api")
"""packages that make pages or hand words to those that do"""
ELEMENT = re.compile(r"<(?:/[a-z]|[a-z][a-z0-9]*(?:[\s>]|$))")
HOSTILE = st.one_of(
    st.sampled_from(
        ["<script>alert(1)</script>", "\"><img src=x onerror='x'>", "</td></tr>", "{{ 7 * 7 }}", "&lt;b&gt;"]
    ),
    st.text("<>&\"'/ab{}%", max_size=20),
)


def pasted(source: str) -> Iterator[str]:
    """F-strings, formats and sums of strings that put values between tags."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr) and any(isinstance(part, ast.FormattedValue) for part in node.values):
            words = "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mod | ast.Add):
            words = "".join(
                side.value
                for side in (node.left, node.right)
                if isinstance(side, ast.Constant) and isinstance(side.value, str)
            )
        else:
            continue
        if ELEMENT.search(words):
            yield f"line {node.lineno}: {words[:60]}"


@pytest.mark.parametrize("package", SHOWING)
def test_no_value_is_pasted_between_tags(package: str) -> None:
    files = sorted((SOURCES / package).rglob("*.py"))
    assert files
    assert {path.name: found for path in files if (found := list(pasted(path.read_text())))} == {}


@pytest.mark.parametrize("source", ['f"<p>{x}</p>"', '"<b>" + x', '"<td class=%s>" % x'])
def test_a_pasted_value_is_found(source: str) -> None:
    assert list(pasted(source))


def test_no_template_takes_a_value_as_markup() -> None:
    """`safe` and blocks without escaping stand nowhere but where a page embeds what is made here."""
    found = {
        f"{path.parent.parent.name}/{path.name}": re.findall(r"\|\s*safe\b|autoescape false", path.read_text())
        for path in SOURCES.rglob("templates/*")
        if path.is_file()
    }
    assert len(found) >= 8
    assert {name: hits for name, hits in found.items() if hits} == {}


def structure(element: ElementTree.Element) -> list[tuple[str, tuple[str, ...]]]:
    return [(one.tag, tuple(one.attrib)) for one in element.iter()]


@settings(deadline=None)  # the first example loads the templates
@given(HOSTILE, HOSTILE)
def test_hostile_words_stay_words_in_every_way_of_making_markup(one: str, other: str) -> None:
    for made in (lambda a, b: markup("caption", a, b), lambda a, b: card([a], [[b]], b, title=a)):
        tree = ElementTree.fromstring(f"<div>{made(one, other)}</div>")
        plain = ElementTree.fromstring(f"<div>{made('a' if one else '', 'b' if other else '')}</div>")
        assert structure(tree) == structure(plain)
        assert one in "".join(tree.itertext()) and other in "".join(tree.itertext())
    drawn = ElementTree.fromstring(svg([], one, box="0 0 1 1", name="dial"))
    assert structure(drawn) == [("svg", ("class", "viewBox", "role", "aria-label"))]
    assert drawn.get("aria-label") == one


def test_every_package_escapes_by_the_same_rule() -> None:
    for package in ("highside.shown", "highside.web"):
        assert templates(package).autoescape is True


HEADED = re.compile(r'<table class="rows"><thead>(.*?)</thead>(.*?)</table>', re.DOTALL)
CELL = re.compile(r'<(?:td|th scope="row")(?![^>]*colspan)[^>]*>(?!</td>)')


def test_each_cell_below_a_head_names_what_it_is_for_who_reads_on_a_phone() -> None:
    tables = {
        path.name: cells
        for path in sorted((SOURCES / "web").rglob("*.html"))
        for _, body in HEADED.findall(path.read_text())
        if (cells := CELL.findall(body))
    }
    assert len(tables) >= 10
    assert {name: cell for name, cells in tables.items() for cell in cells if "data-is=" not in cell} == {}

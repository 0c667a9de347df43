"""Every sentence by which the sources refuse something, with a number where a value stands: found by reading them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import highside

SOURCES = Path(highside.__file__).parent
ERRORS = frozenset({"InputError", "Refused"})
VALUE = "7"
"""In place of what is not known before something is refused."""


def refusals(*places: str) -> dict[str, str]:
    """Of modules, or of all in a folder: what is wrong and what to do, each with where it is raised. What is marked for
    the catalogue is left out: it is known there."""
    files = [file for place in places for file in _files(SOURCES / place)]
    return {
        text: f"{file.relative_to(SOURCES)}:{line}"
        for file in files
        for line, text in _of(ast.parse(file.read_text(encoding="utf-8")))
    }


def _files(path: Path) -> list[Path]:
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


def _of(tree: ast.AST) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ERRORS:
            remedies = [keyword.value for keyword in node.keywords if keyword.arg == "remedy"]
            for given in (*node.args[:1], *remedies):
                if text := _text(given):
                    yield node.lineno, text


def _text(node: ast.AST) -> str:
    """Empty for what is no text of this place."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        # an ending that stands or not: the singular
        return _text(node.value.orelse) if isinstance(node.value, ast.IfExp) else VALUE
    return ""

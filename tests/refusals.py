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
    named = _named(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ERRORS:
            remedies = [keyword.value for keyword in node.keywords if keyword.arg == "remedy"]
            for given in (*node.args[:1], *remedies):
                texts = named.get(given.id, []) if isinstance(given, ast.Name) else [_text(given)]
                yield from ((node.lineno, text) for text in texts if text)


def _named(tree: ast.AST) -> dict[str, list[str]]:
    """Texts that a module gives names, and then raises by them."""
    found: dict[str, list[str]] = {}
    for node in ast.walk(tree):
        # an empty one is filled in before it is raised
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and ast.unparse(node.value) != "None":
            found.setdefault(node.targets[0].id, []).append(_text(node.value))
    return found


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

"""Functions and modules stay small; what does not has its reason here, and may not grow."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "src" / "highside"
FUNCTION, MODULE = 60, 450
"""lines, with signature and docstring"""
LONG_FUNCTIONS = {
    "service/outbox_memory.py:OutboxMemory.__init__": (64, "declares every account with its meaning, nothing else"),
}
"""By file and name: the lines at most, and why it is one function."""
LONG_MODULES: dict[str, tuple[int, str]] = {}


def functions(source: str) -> Iterator[tuple[str, int]]:
    """Names with their classes, and lines."""

    def inside(node: ast.AST, path: str) -> Iterator[tuple[str, int]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                assert child.end_lineno is not None
                yield path + child.name, child.end_lineno - child.lineno + 1
                yield from inside(child, f"{path}{child.name}.")
            elif isinstance(child, ast.ClassDef):
                yield from inside(child, f"{path}{child.name}.")
            else:
                yield from inside(child, path)

    return inside(ast.parse(source), "")


def measured() -> tuple[dict[str, int], dict[str, int]]:
    """Lines of each function and of each module above the bar."""
    long_functions, long_modules = {}, {}
    for path in sorted(SOURCES.rglob("*.py")):
        source, where = path.read_text(), path.relative_to(SOURCES).as_posix()
        if (lines := len(source.splitlines())) > MODULE:
            long_modules[where] = lines
        long_functions |= {f"{where}:{name}": lines for name, lines in functions(source) if lines > FUNCTION}
    return long_functions, long_modules


@pytest.mark.parametrize(("kind", "allowed"), [(0, LONG_FUNCTIONS), (1, LONG_MODULES)], ids=["functions", "modules"])
def test_nothing_is_long_without_a_reason(kind: int, allowed: dict[str, tuple[int, str]]) -> None:
    found = measured()[kind]
    assert {name: lines for name, lines in found.items() if lines > allowed.get(name, (0, ""))[0]} == {}
    assert set(allowed) <= set(found), "no longer long: take it off the list"


def test_a_long_function_is_found_wherever_it_stands() -> None:
    body = "\n".join(f"{' ' * 8}x = {n}" for n in range(FUNCTION))
    source = f"class A:\n    if True:\n      async def long(self):\n{body}\n"
    assert dict(functions(source)) == {"A.long": FUNCTION + 1}

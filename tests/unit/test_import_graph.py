"""No module reaches itself by its imports: not by those inside functions, and not by those for types alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[2] / "src"


def modules(sources: Path) -> dict[str, Path]:
    """Every module by its name; a package is its `__init__`."""
    paths = {p: p.relative_to(sources).with_suffix("").parts for p in sources.rglob("*.py")}
    return {".".join(parts[:-1] if parts[-1] == "__init__" else parts): path for path, parts in paths.items()}


def imported(source: str, known: Mapping[str, Path]) -> Iterator[str]:
    """Modules among the known that a source imports, anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports name the whole package"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                name = whole if whole in known else node.module
                if name in known:
                    assert name is not None
                    yield name


def graph_of(sources: Path) -> dict[str, set[str]]:
    """What each module imports."""
    known = modules(sources)
    return {name: set(imported(path.read_text(), known)) - {name} for name, path in known.items()}


def test_no_module_imports_itself_by_way_of_others() -> None:
    graph = graph_of(SOURCES)
    assert len(graph) > 300
    TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("where", ["def f():", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:"])
def test_a_circle_within_functions_or_for_types_alone_is_found(tmp_path: Path, where: str) -> None:
    for name, other in (("a", "b"), ("b", "c"), ("c", "a")):
        (tmp_path / f"{name}.py").write_text(f"{where}\n    from {other} import x\n")
    with pytest.raises(CycleError):
        TopologicalSorter(graph_of(tmp_path)).prepare()

"""Every number that decides in a diagnosis stands in a policy, with its unit, its meaning and what set it."""

import ast
import dataclasses
import graphlib
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import highside.diagnosis
from highside.diagnosis.table.policy import TABLE_FITS
from studies import thresholds
from studies.threshold_sources import JUDGED, documented, end, ranges, rewritten
from studies.thresholds import policies, read_fields, replaced

ROOT = Path(highside.diagnosis.__file__).parent
MODULES = sorted(p for p in ROOT.rglob("*.py") if not p.name.endswith("policy.py"))
POLICIES = sorted(ROOT.rglob("*policy.py"))

STRUCTURE = {0, 1, 2, 3, 4, 0.5}
"""Numbers that decide nothing: none, one, two (squares, both ends, both signs, second order), the three axes, fourth
powers and the four figures of a table's row, one half."""
UNITS = {10, 180, 360}
"""The base in which probabilities are told, and degrees of a half and of a whole turn."""
GUARDS = {1e-300, 1e-30, 1e-12, 1e-9}
"""What keeps a division from zero and a logarithm finite, and the share of the largest below which an eigenvalue is
rounding of doubles. A recording in which one of these would decide has no readings."""
ELSEWHERE = {
    ("core/fit.py", 12): "the variance of a uniform law is a twelfth of its width squared",
    ("intake/checks.py", 1e3): "mg in a g",
    ("intake/checks.py", 1e6): "ug in a g",
    ("magnitude/remainder.py", 1e3): "mg in a g",
    ("magnitude/noise.py", 9): "behind all stages of the chain",
    ("core/floor.py", 6): "the variance of a second difference of white noise",
    ("core/floor.py", 12): "the variance of a uniform law is a twelfth of its width squared",
    ("core/unexplained.py", 1e6): "ug in a g",
    ("rotation/pilot.py", 6): "the variance of a second difference of white noise",
    ("rows/bases.py", 5): "an order of the toolface that is written out",
    ("rows/gram.py", 64): "room for the number of a steady rate in a key",
}
"""Definitions and formulas, each by its file."""
COMPARED = {0, 1, 2, 3}
"""Of these, what something may be compared with as it stands: none, one, both, and the three axes."""
MARKED = {("simulation/session.py", 0.5)}
"""More than half of a mark, smeared, is a mark."""


def numbers(tree: ast.AST) -> Iterator[tuple[int, float]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node.lineno, node.value


def compared(tree: ast.AST) -> Iterator[tuple[int, float]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare):
            for side in (node.left, *node.comparators):
                if isinstance(side, ast.Constant) and type(side.value) in (int, float):
                    yield side.lineno, side.value


def bare(name: str, text: str) -> list[str]:
    tree = ast.parse(text)
    found = [
        (line, value)
        for line, value in numbers(tree)
        if value not in STRUCTURE | UNITS | GUARDS and (name, value) not in ELSEWHERE
    ]
    found += [
        (line, value)
        for line, value in compared(tree)
        if value in STRUCTURE and value not in COMPARED and (name, value) not in MARKED
    ]
    return [f"{name}:{line}: {value!r}" for line, value in found]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_no_number_that_decides_stands_outside_of_a_policy(path: Path) -> None:
    name = path.relative_to(ROOT).as_posix()
    assert bare(name, path.read_text()) == [], "put it in the room's policy.py, with unit, meaning and source"


def test_a_number_that_decides_would_be_found() -> None:
    assert bare("core/fit.py", "if chi2 > 6.5:\n    pass\n") == ["core/fit.py:1: 6.5"]
    assert bare("core/fit.py", "LIMIT = -(0.07)\n") == ["core/fit.py:1: 0.07"]
    assert bare("rows/gram.py", "x = (n - 1) / 12") != []
    assert bare("core/fit.py", "if share > 0.5:\n    pass\n") == ["core/fit.py:1: 0.5"]


def test_every_exception_is_still_needed() -> None:
    found = {
        (path.relative_to(ROOT).as_posix(), value)
        for path in MODULES
        for _, value in numbers(ast.parse(path.read_text()))
    }
    assert set(ELSEWHERE) <= found


@pytest.mark.parametrize("path", POLICIES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_every_field_of_a_policy_says_what_it_means_and_what_set_it(path: Path) -> None:
    body = ast.parse(path.read_text()).body
    for cls in (node for node in body if isinstance(node, ast.ClassDef)):
        assert ast.get_docstring(cls), cls.name
        pairs = list(zip(cls.body, [*cls.body[1:], None], strict=True))
        fields = [(a, b) for a, b in pairs if isinstance(a, ast.AnnAssign)]
        assert fields, cls.name
        for field, text in fields:
            assert isinstance(field.target, ast.Name)
            where = f"{path.parent.name}: {cls.name}.{field.target.id}"
            assert isinstance(text, ast.Expr), where
            assert isinstance(text.value, ast.Constant), where
            words = " ".join(str(text.value.value).split())
            assert re.search(r"Source: \S|Chosen in [0-9a-f]{7}", words), where
            meaning = re.split(r"Source: |Chosen in ", words)[0]
            assert len(meaning.split()) >= 2, where


def test_a_new_field_has_a_reference_or_a_run_as_its_source() -> None:
    words = [text for path in POLICIES for _, _, text in documented(path.read_text())]
    # a commit that put it there is none
    assert not [text for text in words if JUDGED.search(text)]
    assert len(words) > 600


def test_a_range_that_a_field_names_is_that_of_the_study_and_holds_its_value() -> None:
    known = ranges()
    named = 0
    for path in POLICIES:
        for place, _, text in documented(path.read_text()):
            if (said := re.search(r"Source: studies\.thresholds, (\S+ to .+)\.$", text)) is not None:
                assert known.get(place) == said[1], place
                named += 1
    assert named >= 150


def test_ranges_come_into_the_text_of_a_policy_and_nothing_else_changes() -> None:
    text = (
        'class A:\n    """Of."""\n\n    x: int = 8\n    """Rows in a block. Chosen in 21ed34d; no run is recorded."""\n'
        '    y: int = 3\n    """Tries. Chosen in 21ed34d; no run is recorded."""\n'
    )
    after = rewritten(text, {("A", "x"): "4 to 16"})
    assert after == text.replace("Chosen in 21ed34d; no run is recorded.", "Source: studies.thresholds, 4 to 16.", 1)


def test_a_number_of_a_tuple_is_scanned_by_itself_and_put_back() -> None:
    field = next(one for one in policies() if one.name == "table:TABLE_FITS.noise_range_g[1]")
    with read_fields([field]) as names, replaced(field, 1.0):
        assert TABLE_FITS.noise_range_g == (1e-6, 1.0)
    assert names == {field.name}
    assert TABLE_FITS.noise_range_g == (1e-6, 5e-3)


def test_of_fields_that_are_tried_at_once_the_one_that_decides_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    low, high = (one for one in policies() if one.name.startswith("table:TABLE_FITS.noise_range_g["))
    monkeypatch.setattr(thresholds, "answer", lambda case: ["quiet" if TABLE_FITS.noise_range_g[1] < 4e-3 else "loud"])
    known = thresholds.Known(thresholds.ErrorTable("a table", {}), ["loud"], set(), 0.0)
    quieter, louder = thresholds.together([low, high], known)
    assert [one["changed"] for one in quieter["tried"]] == [[], []]
    assert [one["changed"] for one in louder["tried"]] == [["a table"], []]
    assert "| a table, with 1 others at once | 1 (0.0025) | 0 (0.01) |" in thresholds.table([louder])


def test_a_range_reaches_as_far_as_a_value_was_tried_and_changed_nothing() -> None:
    assert end("0 (4)", "8") == "4"
    assert end("2 (4), 0 (7)", "8") == "7"
    assert end("2 (4), 1 (7)", "8") == "8"
    assert end("not tried", "8") == "8"


@pytest.mark.parametrize("path", POLICIES, ids=lambda p: f"{p.parent.name}.{p.stem}")
def test_policies_are_frozen(path: Path) -> None:
    module = importlib.import_module(f"highside.diagnosis.{path.parent.name}.{path.stem}")
    classes = [value for value in vars(module).values() if isinstance(value, type) and dataclasses.is_dataclass(value)]
    assert classes
    for cls in classes:
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(cls(), dataclasses.fields(cls)[0].name, None)


def test_no_module_of_diagnosis_needs_itself_by_way_of_another_not_even_lazily() -> None:
    known = {
        ".".join(("highside.diagnosis", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
        for path in ROOT.rglob("*.py")
    }
    graph: dict[str, set[str]] = {}
    for name, path in known.items():
        imports = [n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.ImportFrom)]
        wanted = {n.module or "" for n in imports} | {f"{n.module}.{a.name}" for n in imports for a in n.names}
        graph[name] = wanted & set(known)
    list(graphlib.TopologicalSorter(graph).static_order())

"""What the numbers that decide in a diagnosis decide: each halved and doubled, and the answers compared.

    python -m studies.thresholds [--cases 3] [--most-s 3.0] [--only PREFIX] [--keep FILE] [--table FILE]

Every scalar field of every policy of `highside.diagnosis` is set to half and to twice its value (a whole number to the
nearest one that differs; a share never beyond 1), one at a time, and recordings are diagnosed again. They are the
shortest of each kind of `studies.equal_diagnoses` (poses, rotations, hand sessions of |g|, recordings beside another
program's output; nulls, effects, laws) that take at most `--most-s` seconds of the processor; of those in which a field
is read at all, up to `--cases` of different kinds are taken. An answer is its verdict and, of each claim, effect, place
and covariates; sizes are not compared.

Lines are kept in `--keep` as they come (JSON), so that an interrupted run goes on; `--table` writes what
`studies/thresholds.md` holds. No answer is called right here, and recordings that are answered with a margin say little
of a limit: a field that changes nothing is no proof that it does nothing, but one that changes an answer wants a run of
the sealed decks before it is moved.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib
import inspect
import json
import os
import pkgutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import highside
import highside.diagnosis
from studies import equal_diagnoses
from studies.open_world.answers import Case

Answer = list[Any]
FACTORS = (0.5, 2.0)


@dataclasses.dataclass(frozen=True)
class Field:
    """One number of one policy."""

    name: str
    """MODULE:POLICY.FIELD, with further dots for a policy within a policy"""
    owner: Any
    attribute: str

    @property
    def value(self) -> float:
        return object.__getattribute__(self.owner, self.attribute)  # type: ignore[no-any-return]

    def times(self, factor: float) -> float | None:
        """Another value; None where there is none to try."""
        value = self.value
        other: float = value * factor
        if isinstance(value, int):
            other = max(int(other), 0) if factor < 1.0 else max(int(other), value + 1)
        elif 0.5 < value < 1.0 and factor > 1.0:
            other = 0.5 * (1.0 + value)  # of a share, half of what is left to one
        return None if other == value else other


def policies() -> Iterator[Field]:
    """All scalar fields of all policies, in the order of their modules."""
    given: set[int] = set()
    for found in pkgutil.walk_packages(highside.diagnosis.__path__, "highside.diagnosis."):
        if found.name.endswith("policy"):
            module = importlib.import_module(found.name)
            short = found.name.removeprefix("highside.diagnosis.").removesuffix("policy").strip("._")
            for name, value in vars(module).items():
                # those that one module has from another are named by where they are defined
                if name.isupper() and dataclasses.is_dataclass(value) and f"\n{name} = " in inspect.getsource(module):
                    for one in _fields(f"{short}:{name}", value):
                        if (key := hash((id(one.owner), one.attribute))) not in given:
                            given.add(key)
                            yield one


def _fields(name: str, owner: Any) -> Iterator[Field]:
    for one in dataclasses.fields(owner):
        value = object.__getattribute__(owner, one.name)
        if dataclasses.is_dataclass(value):
            yield from _fields(f"{name}.{one.name}", value)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield Field(f"{name}.{one.name}", owner, one.name)


@contextlib.contextmanager
def read_fields(fields: Sequence[Field]) -> Iterator[set[str]]:
    """The names of the fields that are read meanwhile."""
    names = {(id(one.owner), one.attribute): one.name for one in fields}
    found: set[str] = set()

    def traced(self: Any, attribute: str) -> Any:
        name = names.get((id(self), attribute))
        if name is not None:
            found.add(name)
        return object.__getattribute__(self, attribute)

    classes = {type(one.owner) for one in fields}
    for kind in classes:
        kind.__getattribute__ = traced
    try:
        yield found
    finally:
        for kind in classes:
            del kind.__getattribute__


@contextlib.contextmanager
def replaced(field: Field, value: float) -> Iterator[None]:
    before = field.value
    object.__setattr__(field.owner, field.attribute, value)
    try:
        yield
    finally:
        object.__setattr__(field.owner, field.attribute, before)


def answer(case: Case) -> Answer:
    """What is compared; an error is an answer too."""
    with tempfile.TemporaryDirectory(prefix="thresholds-") as place:
        model = Path(place) / "model.toml"
        model.write_text(case.model)
        try:
            found = highside.diagnose(dict(case.recording), model, simulation=case.prediction)
        except Exception as error:  # what a wrong number leads to is part of the finding
            return [type(error).__name__]
    return [found.verdict, sorted([c.effect, c.place, *c.depends_on] for c in found.claims)]


def _kind(case: Case) -> str:
    return f"{case.design}/{case.group}"


def smallest(deck: Iterable[Case], each: int) -> list[Case]:
    """The shortest recordings of each kind."""
    kinds: dict[str, list[Case]] = {}
    for case in sorted(deck, key=lambda case: case.recording["t_s"].size):
        kinds.setdefault(_kind(case), []).append(case)
    return [case for cases in kinds.values() for case in cases[:each]]


def measured(
    deck: Sequence[Case], fields: Sequence[Field], most_s: float
) -> list[tuple[Case, Answer, set[str], float]]:
    """Of each case that is short enough its answer, the fields it reads and its cost, cheapest first."""
    found = []
    for case in deck:
        start = time.process_time()
        before = answer(case)
        cost = time.process_time() - start
        print(f"{case.name}: {before[0]}, {cost:.1f} s", flush=True)
        if cost <= most_s:
            with read_fields(fields) as names:
                again = answer(case)
            assert again == before, f"{case.name} answers differently the second time"
            found.append((case, before, names, cost))
    return sorted(found, key=lambda one: one[3])


def chosen(name: str, known: Sequence[tuple[Case, Answer, set[str], float]], most: int) -> list[tuple[Case, Answer]]:
    """Cheap cases that read a field, each kind once before any twice."""
    readers = [(case, before) for case, before, names, _ in known if name in names]
    first: dict[str, tuple[Case, Answer]] = {}
    for case, before in readers:
        first.setdefault(_kind(case), (case, before))
    rest = [one for one in readers if not any(one is kept for kept in first.values())]
    return [*first.values(), *rest][:most]


def row(field: Field, cases: Sequence[tuple[Case, Answer]]) -> dict[str, Any]:
    """Of one field what changed, for each value that was tried."""
    tried = []
    for factor in FACTORS:
        value = field.times(factor)
        if value is not None and cases:
            with replaced(field, value):
                changed = [case.name for case, before in cases if answer(case) != before]
            tried.append({"value": value, "changed": changed})
    return {"field": field.name, "value": field.value, "cases": [case.name for case, _ in cases], "tried": tried}


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: fields that change an answer first."""
    lines = ["| field | value | recordings that read it | halved: answers changed | doubled |", "|---|---|---|---|---|"]

    def change(one: dict[str, Any], k: int) -> str:
        if len(one["tried"]) <= k:
            return "not tried"
        return f"{len(one['tried'][k]['changed'])} ({one['tried'][k]['value']:.4g})"

    most = sorted(rows, key=lambda one: (-sum(len(t["changed"]) for t in one["tried"]), one["field"]))
    for one in most:
        if one["cases"]:
            row = (f"`{one['field']}`", f"{one['value']:.4g}", str(len(one["cases"])), change(one, 0), change(one, 1))
            lines.append(f"| {' | '.join(row)} |")
    unread = [one["field"] for one in rows if not one["cases"]]
    return "\n".join([*lines, "", "Read by none of these recordings: " + (", ".join(unread) or "none") + ".", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=3)
    parser.add_argument("--most-s", type=float, default=3.0)
    parser.add_argument("--only", default="", help="fields whose name begins so")
    parser.add_argument("--keep", type=Path, default=Path("thresholds.jsonl"))
    parser.add_argument("--table", type=Path)
    given = parser.parse_args()
    fields = [one for one in policies() if one.name.startswith(given.only)]
    kept = [json.loads(line) for line in given.keep.read_text().splitlines()] if given.keep.exists() else []
    done = {one["field"] for one in kept}
    if any(one.name not in done for one in fields):
        known = measured(smallest(equal_diagnoses.cases(), given.cases), fields, given.most_s)
        print(f"{len(known)} recordings, {sum(one[3] for one in known):.1f} s together; {len(fields)} fields")
        for field in fields:
            if field.name not in done:
                kept.append(row(field, chosen(field.name, known, given.cases)))
                with given.keep.open("a") as file:
                    print(json.dumps(kept[-1]), file=file)
                print(table(kept[-1:]).splitlines()[2], flush=True)
    if given.table:
        names = [one.name for one in fields]
        given.table.write_text(table([one for one in kept if one["field"] in names]))


if __name__ == "__main__":
    main()

"""What the numbers that decide in a diagnosis decide: each halved and doubled, and the answers compared.

    python -m studies.thresholds [--cases 3] [--most-s 3.0] [--field-s 60] [--at-once N] [--only PREFIX]
                                 [--kind KIND] [--judged] [--keep FILE] [--table FILE]

Every scalar field of every policy of `highside.diagnosis`, and every number of a tuple, is set to half and to twice its
value (a whole number to the nearest one that differs; a share never beyond 1), one at a time, and recordings are
diagnosed again. Where an answer changes, 0.9 and 1.1 of the value are tried as well: an answer that changes there
stands at the edge. The recordings are the shortest of each kind of `studies.equal_diagnoses` (poses, rotations, hand
sessions of |g|, recordings beside another program's output; nulls, effects, laws) that take at most `--most-s` seconds
of the processor, three small error tables, and of slower ones those that alone read a field. Which fields a case reads
is traced once, and a field is tried on those cases alone: on up to `--cases`, of different kinds and cheapest first, as
far as `--field-s` seconds reach, and on one at least. An answer is its verdict and, of each claim, effect, place and
covariates; sizes are not compared. `--judged`: only fields that have no other source yet. `--at-once N`: of cases that
take long, N fields are halved, then doubled together, and the group again in halves where the answer changes: an answer
that stays says this of all of them, but that two changes undo each other is not excluded.

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

import numpy as np

import highside
import highside.diagnosis
from highside.diagnosis.table.chain import CELLS, Procedure
from highside.diagnosis.table.instrument import predict_table
from highside.physics.forward import ForwardModel
from studies import equal_diagnoses
from studies.open_world.answers import Case, Columns

Answer = list[Any]
TABLE_INC_DEG = np.array([90.0, 45.0, 20.0, 5.0])
TABLE_STATIONS = 37
TABLE_STOP = float(np.radians(0.009))
TABLE_NOISE_G = 30e-6
FACTORS = (0.5, 2.0)
NEAR = (0.9, 1.1)
"""Of the value, tried where half or twice of it changes an answer."""


@dataclasses.dataclass(frozen=True)
class ErrorTable:
    """An error table that is diagnosed in the place of a recording."""

    name: str
    columns: Columns


@dataclasses.dataclass(frozen=True)
class Known:
    """A case with its answer under the present values, the fields it reads, and its seconds of the processor."""

    case: Case | ErrorTable
    answer: Answer
    names: set[str]
    cost_s: float


@dataclasses.dataclass(frozen=True)
class Field:
    """One number of one policy."""

    name: str
    """MODULE:POLICY.FIELD, with further dots for a policy within a policy, and [K] for a number of a tuple"""
    owner: Any
    attribute: str
    index: int | None = None

    @property
    def whole(self) -> Any:
        """What the attribute holds: the number, or the tuple it stands in."""
        return object.__getattribute__(self.owner, self.attribute)

    @property
    def value(self) -> float:
        return self.whole if self.index is None else self.whole[self.index]  # type: ignore[no-any-return]

    def holding(self, value: float) -> Any:
        """What the attribute holds with another value."""
        if self.index is None:
            return value
        return (*self.whole[: self.index], value, *self.whole[self.index + 1 :])

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
                        if (key := hash((id(one.owner), one.attribute, one.index))) not in given:
                            given.add(key)
                            yield one


def _fields(name: str, owner: Any) -> Iterator[Field]:
    for one in dataclasses.fields(owner):
        value = object.__getattribute__(owner, one.name)
        if dataclasses.is_dataclass(value):
            yield from _fields(f"{name}.{one.name}", value)
        elif _number(value):
            yield Field(f"{name}.{one.name}", owner, one.name)
        elif isinstance(value, tuple):
            for k, number in enumerate(value):
                if _number(number):
                    yield Field(f"{name}.{one.name}[{k}]", owner, one.name, k)


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


@contextlib.contextmanager
def read_fields(fields: Sequence[Field]) -> Iterator[set[str]]:
    """The names of the fields that are read meanwhile."""
    names: dict[tuple[int, str], list[str]] = {}
    for one in fields:
        names.setdefault((id(one.owner), one.attribute), []).append(one.name)
    found: set[str] = set()

    def traced(self: Any, attribute: str) -> Any:
        found.update(names.get((id(self), attribute), ()))
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
    before = field.whole
    object.__setattr__(field.owner, field.attribute, field.holding(value))
    try:
        yield
    finally:
        object.__setattr__(field.owner, field.attribute, before)


def tables() -> Iterator[ErrorTable]:
    """Error tables of three instruments, the mean of two that the simulated procedure draws from a seed each."""
    procedure = Procedure("conventional3", stations=TABLE_STATIONS)
    sensor = {"bias": {"b_x": 3e-4, "b_y": -2e-4, "b_z": 7e-4}, "scale": {"s_x": 2e-3, "s_y": -1e-3, "s_z": 3e-3}}
    stops = {"pose_error": {"inc_station": TABLE_STOP, "tf_station": TABLE_STOP, "inc_pose": 0.0, "tf_pose": 0.0}}
    more: dict[str, dict[str, dict[str, float]]] = {
        "null": {},
        "tilt": {"base_tilt": {"tilt_x": 2e-4, "tilt_y": -3e-4}},
        "encoder": {"encoder_second_harmonic": {"c2": 1e-3}},
    }
    for seed, (name, effects) in enumerate(more.items()):
        model = ForwardModel.of({**sensor, **stops, **effects})
        cells = predict_table(TABLE_INC_DEG, procedure, model, TABLE_NOISE_G, count=2, seed=seed).cells
        columns = {"inc_ref_deg": TABLE_INC_DEG, **dict(zip(CELLS, cells.T, strict=True))}
        yield ErrorTable(f"table/{name}", columns)


def answer(case: Case | ErrorTable) -> Answer:
    """What is compared; an error is an answer too."""
    if isinstance(case, ErrorTable):
        try:
            found = highside.diagnose_table(dict(case.columns), corrected_by="conventional3", stations=TABLE_STATIONS)
        except Exception as error:  # as below
            return [type(error).__name__]
        return _compared(found)
    with tempfile.TemporaryDirectory(prefix="thresholds-") as place:
        model = Path(place) / "model.toml"
        model.write_text(case.model)
        try:
            found = highside.diagnose(dict(case.recording), model, simulation=case.prediction)
        except Exception as error:  # what a wrong number leads to is part of the finding
            return [type(error).__name__]
    return _compared(found)


def _compared(found: highside.Diagnosis) -> Answer:
    return [found.verdict, sorted([c.effect, c.place, *c.depends_on] for c in found.claims)]


def _kind(case: Case | ErrorTable) -> str:
    return case.name if isinstance(case, ErrorTable) else f"{case.design}/{case.group}"


def smallest(deck: Iterable[Case], each: int) -> list[Case]:
    """The shortest recordings of each kind."""
    kinds: dict[str, list[Case]] = {}
    for case in sorted(deck, key=lambda case: case.recording["t_s"].size):
        kinds.setdefault(_kind(case), []).append(case)
    return [case for cases in kinds.values() for case in cases[:each]]


def measured(deck: Iterable[Case | ErrorTable], fields: Sequence[Field], most_s: float) -> list[Known]:
    """Of each case its answer, the fields it reads and its cost, cheapest first.

    Those that take more than `most_s` only where no cheaper one reads a field that they read.
    """
    found = []
    for case in deck:
        start = time.process_time()
        with read_fields(fields) as names:
            before = answer(case)
        known = Known(case, before, names, time.process_time() - start)
        print(f"{case.name}: {before[0]}, {known.cost_s:.1f} s, {len(names)} fields", flush=True)
        found.append(known)
    kept: list[Known] = []
    read: set[str] = set()
    for known in sorted(found, key=lambda one: one.cost_s):
        if known.cost_s <= most_s or known.names - read:
            kept.append(known)
            read |= known.names
    return kept


def chosen(name: str, known: Sequence[Known], most: int, most_s: float) -> list[Known]:
    """Cheap cases that read a field, each kind once before any twice, as far as the seconds reach; one at least."""
    readers = [one for one in known if name in one.names]
    first: dict[str, Known] = {}
    for one in readers:
        first.setdefault(_kind(one.case), one)
    ordered = [*first.values(), *(one for one in readers if not any(one is kept for kept in first.values()))]
    taken: list[Known] = []
    for one in ordered[:most]:
        if not taken or len(FACTORS) * (one.cost_s + sum(other.cost_s for other in taken)) <= most_s:
            taken.append(one)
    return taken


def row(field: Field, cases: Sequence[Known]) -> dict[str, Any]:
    """Of one field what changed, for each value that was tried."""
    tried = []
    for factor, near in zip(FACTORS, NEAR, strict=True):
        value = field.times(factor)
        if value is not None and cases:
            tried.append(_tried(field, value, cases))
            nearer = field.times(near)
            if tried[-1]["changed"] and nearer is not None and nearer != value:
                tried[-1]["near"] = _tried(field, nearer, cases)
    return {"field": field.name, "value": field.value, "cases": [one.case.name for one in cases], "tried": tried}


def _tried(field: Field, value: float, cases: Sequence[Known]) -> dict[str, Any]:
    with replaced(field, value):
        return {"value": value, "changed": [one.case.name for one in cases if answer(one.case) != one.answer]}


def together(fields: Sequence[Field], known: Known) -> list[dict[str, Any]]:
    """The rows of several fields, all halved, then all doubled at once; in halves where the answer changes."""
    rows: list[dict[str, Any]] = [
        {"field": one.name, "value": one.value, "cases": [known.case.name], "tried": [], "at_once": 1} for one in fields
    ]
    by_name = {one["field"]: one for one in rows}

    def settle(group: Sequence[tuple[Field, float]]) -> None:
        with contextlib.ExitStack() as stack:
            for field, value in group:
                stack.enter_context(replaced(field, value))
            changed = answer(known.case) != known.answer
        if changed and len(group) > 1:
            settle(group[: len(group) // 2])
            settle(group[len(group) // 2 :])
            return
        for field, value in group:
            row = by_name[field.name]
            row["tried"].append({"value": value, "changed": [known.case.name] if changed else []})
            row["at_once"] = max(row["at_once"], len(group))

    for factor in FACTORS:
        settle([(one, value) for one in fields if (value := one.times(factor)) is not None])
    return rows


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: fields that change an answer first."""
    lines = ["| field | value | recordings that read it | halved: answers changed | doubled |", "|---|---|---|---|---|"]

    def change(one: dict[str, Any], k: int) -> str:
        if len(one["tried"]) <= k:
            return "not tried"
        steps = [one["tried"][k], *([one["tried"][k]["near"]] if "near" in one["tried"][k] else [])]
        return ", ".join(f"{len(step['changed'])} ({step['value']:.4g})" for step in steps)

    most = sorted(rows, key=lambda one: (-sum(len(t["changed"]) for t in one["tried"]), one["field"]))
    for one in most:
        if one["cases"]:
            others = one.get("at_once", 1) - 1
            cases = f"{one['cases'][0]}, with {others} others at once" if others else str(len(one["cases"]))
            row = (f"`{one['field']}`", f"{one['value']:.4g}", cases, change(one, 0), change(one, 1))
            lines.append(f"| {' | '.join(row)} |")
    unread = [one["field"] for one in rows if not one["cases"]]
    return "\n".join([*lines, "", "Read by none of these recordings: " + (", ".join(unread) or "none") + ".", ""])


def one_by_one(fields: Sequence[Field], known: Sequence[Known], given: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for field in fields:
        yield row(field, chosen(field.name, known, given.cases, given.field_s))


def at_once(fields: Sequence[Field], known: Sequence[Known], most: int) -> Iterator[dict[str, Any]]:
    """Rows of the fields that some case reads, in groups on the cheapest case that reads them."""
    left = list(fields)
    for one in known:
        own = [field for field in left if field.name in one.names]
        left = [field for field in left if field.name not in one.names]
        for first in range(0, len(own), most):
            yield from together(own[first : first + most], one)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=3)
    parser.add_argument("--most-s", type=float, default=3.0)
    parser.add_argument("--field-s", type=float, default=60.0, help="seconds of the processor for a field, about")
    parser.add_argument("--at-once", type=int, default=0, help="so many fields together, for cases that take long")
    parser.add_argument("--only", default="", help="fields whose name begins so")
    parser.add_argument("--kind", default="", help="cases whose kind begins so: poses, rotation, hand, beside, table")
    parser.add_argument("--judged", action="store_true", help="only fields without another source")
    parser.add_argument("--keep", type=Path, default=Path("thresholds.jsonl"))
    parser.add_argument("--table", type=Path)
    given = parser.parse_args()
    fields = [one for one in policies() if one.name.startswith(given.only)]
    if given.judged:
        from studies.threshold_sources import judged  # which needs the fields from here

        places = judged()
        fields = [one for one in fields if (type(one.owner).__name__, one.attribute) in places]
    kept = [json.loads(line) for line in given.keep.read_text().splitlines()] if given.keep.exists() else []
    done = {one["field"] for one in kept}
    if any(one.name not in done for one in fields):
        deck: list[Case | ErrorTable] = [*tables(), *smallest(equal_diagnoses.cases(), given.cases)]
        known = measured([case for case in deck if _kind(case).startswith(given.kind)], fields, given.most_s)
        print(f"{len(known)} cases, {sum(one.cost_s for one in known):.1f} s together; {len(fields)} fields")
        left = [one for one in fields if one.name not in done]
        for made in at_once(left, known, given.at_once) if given.at_once else one_by_one(left, known, given):
            kept.append(made)
            with given.keep.open("a") as file:
                print(json.dumps(made), file=file)
            print(table([made]).splitlines()[2], flush=True)
    if given.table:
        names = [one.name for one in fields]
        given.table.write_text(table([one for one in kept if one["field"] in names]))


if __name__ == "__main__":
    main()

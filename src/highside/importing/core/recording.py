"""A proposal made a Recording: units and axes of ours, rows in order of time, everything that was left out counted."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.codec.axes import AxisMap
from highside.errors import InputError
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.proposal import ACCELERATIONS, KNOWN, RATES, Proposal
from highside.importing.core.source import Numbers, SourceColumn, SourceTable
from highside.importing.core.timing import rows_of
from highside.recording.table import Recording

_UNSAFE = re.compile(r"[^\w./-]+")
_DEVICE_TIME_NS = 10**17
"""three years: what is longer since its zero is a date, of which seconds from the start go on"""

_EXACT_NS = 1 << 53
"""104 days: whole numbers below are exact as floats"""


@dataclass(frozen=True, slots=True)
class ImportedRecording:
    """A Recording, what was found in its rows, and the epoch time in ns of t_s = 0 where the file has one."""

    recording: Recording
    findings: tuple[str, ...]
    start_ns: int | None


def recording_of(proposal: Proposal, policy: ImportPolicy = POLICY) -> ImportedRecording:
    """Carry a proposal out. Raises InputError where rows allow no time, or where the clock began again."""
    table = proposal.table
    if table.n == 0:
        raise InputError("holds no row", where=table.where)
    ns = _times(proposal)
    found = rows_of(ns, _same(table.columns), table.place, policy, _counter(proposal))
    keep = found.keep
    if len(found.parts) > 1:
        keep = _part(proposal, found.parts, ns)
    findings = list(found.lines)
    start = int(ns[keep[0]])
    begins_at = 0 if proposal.time is None or not (proposal.time.epoch or abs(start) > _DEVICE_TIME_NS) else start
    relative = ns[keep] - begins_at
    columns: dict[str, Numbers] = {"t_s": _seconds(relative)}
    for guess in proposal.guesses:
        column = table.column(guess.column)
        if guess.target == "t_s" or column is None or column.numbers is None:
            continue
        columns[guess.target] = converted(column.numbers, guess.unit)[keep]
        findings += without_value(columns[guess.target], guess.target, lambda row: table.place(int(keep[row])), policy)
    turn(columns, AxisMap.parse(proposal.axes.axes, allow_mirror=True))
    texts: dict[str, tuple[str, ...]] = {}
    for name in proposal.kept:
        column = table.column(name)
        assert column is not None
        safe = safe_name(name, {*KNOWN, *columns, *texts})
        if column.numbers is not None:
            columns[safe] = np.where(np.isinf(column.numbers), np.nan, column.numbers)[keep]
        elif column.texts is not None:
            texts[safe] = tuple(column.texts[int(row)] for row in keep)
    epoch = begins_at if proposal.time is not None and proposal.time.epoch else None
    return ImportedRecording(Recording(columns, texts, source=table.where), tuple(findings), epoch)


def without_value(numbers: Numbers, name: str, place: Callable[[int], str], policy: ImportPolicy) -> list[str]:
    """Which rows (N,) lack a value, in a line; none if none does."""
    missing = np.flatnonzero(np.isnan(numbers))
    if not missing.size:
        return []
    shown = ", ".join(place(int(row)) for row in missing[: policy.shown_rows])
    more = ", ..." if missing.size > policy.shown_rows else ""
    return [f"{missing.size} rows without {name}: {shown}{more}"]


def _times(proposal: Proposal) -> NDArray[np.int64]:
    if proposal.time is not None:
        return proposal.time.ns
    if proposal.rate_hz is None:
        raise InputError("has no time", where=proposal.table.where, remedy="--map t_s=COLUMN:ms, or --rate HZ")
    stamps: NDArray[np.int64] = np.rint(np.arange(proposal.table.n) * (1e9 / proposal.rate_hz)).astype(np.int64)
    return stamps


def _counter(proposal: Proposal) -> Numbers | None:
    """The device's own number of each row (N,), where the file has one."""
    guess = proposal.guess("seq")
    column = None if guess is None else proposal.table.column(guess.column)
    return None if column is None else column.numbers


def _part(proposal: Proposal, parts: tuple[tuple[int, int], ...], ns: NDArray[np.int64]) -> NDArray[np.intp]:
    table = proposal.table
    places = ", ".join(table.place(begin) for begin, _ in parts[1:6])
    if proposal.part is None:
        raise InputError(
            f"its clock begins again at {places}: {len(parts)} recordings in one file",
            where=table.where,
            remedy=f"--part N (1 to {len(parts)}) takes one of them",
        )
    if not 1 <= proposal.part <= len(parts):
        raise InputError(f"has {len(parts)} parts", where=table.where, field="--part", remedy=f"give 1 to {len(parts)}")
    begin, end = parts[proposal.part - 1]
    return np.asarray(begin + np.argsort(ns[begin:end], kind="stable"), dtype=np.intp)


def _seconds(ns: NDArray[np.int64]) -> Numbers:
    """The float nearest to the written time, to nine digits."""
    if ns.size == 0 or int(np.abs(ns).max()) < _EXACT_NS:
        # the division of a whole number that a float holds is rounded once
        return ns / 1e9
    whole, rest = np.divmod(ns, 1_000_000_000)
    return np.array(
        [float(f"{a}.{b:09d}") if a >= 0 else a + b * 1e-9 for a, b in zip(whole.tolist(), rest.tolist(), strict=True)]
    )


def converted(numbers: Numbers, unit: object) -> Numbers:
    """Numbers (N,) of a file in our unit, nothing infinite."""
    from highside.importing.core.units import Unit

    if not isinstance(unit, Unit):
        return np.where(np.isinf(numbers), np.nan, numbers)
    if unit.factor == 1.0 and unit.offset == 0.0 and unit.zero == 0.0:
        return np.where(np.isinf(numbers), np.nan, numbers)
    with np.errstate(over="ignore"):
        values = (numbers - unit.zero) * unit.factor + unit.offset
    return np.where(np.isinf(values), np.nan, values)


def turn(columns: dict[str, Numbers], axes: AxisMap) -> None:
    """Exchange and turn the axes of accelerations and rates in place."""
    if axes.identity:
        return
    for names in (ACCELERATIONS, RATES):
        if all(name in columns for name in names):
            given = [columns[name] for name in names]
            for place, name in enumerate(names):
                columns[name] = axes.signs[place] * given[axes.order[place]]


def _same(columns: tuple[SourceColumn, ...]) -> NDArray[np.bool_]:
    """(N-1,): whether a row repeats the one before in every column."""
    n = columns[0].n
    same = np.ones(max(0, n - 1), dtype=bool)
    for column in columns:
        if column.numbers is not None:
            a, b = column.numbers[1:], column.numbers[:-1]
            same &= (a == b) | (np.isnan(a) & np.isnan(b))
        elif column.texts is not None:
            pairs = map(operator.eq, column.texts[1:], column.texts[:-1])
            same &= np.fromiter(pairs, dtype=bool, count=same.size)
    return same


def safe_name(name: str, taken: Collection[str]) -> str:
    """A name for a column that goes over as it is: none of ours or others `taken`, nothing that needs quotes."""
    safe = _UNSAFE.sub("_", name).strip("_") or "column"
    safe = f"{safe}_file" if safe in taken and safe in KNOWN else safe
    count, made = 1, safe
    while made in taken:
        count += 1
        made = f"{safe}_{count}"
    return made


__all__ = ["ImportedRecording", "SourceTable", "recording_of"]

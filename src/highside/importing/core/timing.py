"""Which column is the time and in which unit; what its rows say: wraps, resets, gaps, rows out of order,
repeats."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.importing.core.instants import DAY_NS, instants
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.source import Numbers, SourceColumn
from highside.importing.core.stepping import set_back, wide_steps
from highside.importing.core.units import WRITTEN_DATES, Quantity, Unit, unit_named

Nanoseconds = NDArray[np.int64]
_WRAPS = (16, 24, 31, 32)
"""bits of counters of devices"""
_LONGEST_NS = (1 << 62) - 1
"""from zero: the difference of any two such times is a whole number of 64 bits, too"""
_RELATIVE = ("s", "ms", "us", "ns")
_WITH_UNIT = re.compile(r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?) ?([a-z]+)")
"""a duration as MATLAB writes it: `0.02 sec`"""


@dataclass(frozen=True, slots=True)
class TimeReading:
    """One way to read a column as time. `ns` (N,) exact, epoch or device time; `open` what stays undecided."""

    column: str
    unit: str
    ns: Nanoseconds
    evidence: tuple[str, ...]
    named: bool
    epoch: bool = False
    open: str | None = None
    likely: bool = False
    notes: tuple[str, ...] = ()

    @property
    def step_ns(self) -> float:
        """Median step in ns; 0 for fewer than two rows."""
        steps = np.diff(self.ns)
        steps = steps[steps > 0]
        return float(np.median(steps)) if steps.size else 0.0


def read_time(
    column: SourceColumn, unit: Unit | None, policy: ImportPolicy = POLICY, rate_hz: float | None = None
) -> TimeReading | None:
    """Read a column as time; `unit` is what the file or the user says, `rate_hz` the rows/s that the file states.

    None where it cannot be one.
    """
    reading = _read(column, unit, policy, rate_hz)
    if reading is not None and ((reading.ns > _LONGEST_NS) | (reading.ns < -_LONGEST_NS)).any():
        within = np.clip(reading.ns, -_LONGEST_NS, _LONGEST_NS)
        return replace(reading, ns=within, open="it reaches beyond 146 years, further than times are read")
    if reading is None or reading.open is not None or reading.ns.size <= policy.same_rows:
        return reading
    same = int(np.count_nonzero(np.diff(reading.ns) == 0))
    if same <= policy.same_share * reading.ns.size:
        return reading
    return replace(reading, open=f"{same} of its {reading.ns.size} rows have the time of the row before")


def _read(column: SourceColumn, unit: Unit | None, policy: ImportPolicy, rate_hz: float | None) -> TimeReading | None:
    order = unit.name if unit is not None and unit.name in WRITTEN_DATES else None
    if order is not None:
        unit = None
    if column.texts is not None:
        return _written(column, order) or _durations(column, policy)
    numbers = column.numbers
    if numbers is None or numbers.size == 0 or not np.isfinite(numbers).all():
        return None
    if column.instant:
        assert column.integers is not None
        return TimeReading(column.name, "timestamp", column.integers, ("the file's own type",), named=True, epoch=True)
    if unit is not None and unit.quantity is Quantity.TIME:
        return _in_unit(column, unit, policy)
    return _by_values(column, policy, rate_hz)


def _durations(column: SourceColumn, policy: ImportPolicy) -> TimeReading | None:
    """Cells of a number and its unit of time, the same in all."""
    cells = [_WITH_UNIT.fullmatch(cell.strip()) for cell in column.texts or ()]
    found = [cell for cell in cells if cell is not None]
    units = {cell[2] for cell in found}
    unit = unit_named(min(units), Quantity.TIME) if len(units) == 1 else None
    if unit is None or len(found) < len(cells):
        return None
    try:
        numbers = np.array([float(cell[1]) for cell in found])
    except ValueError:
        return None
    return _in_unit(replace(column, texts=None, numbers=numbers), unit, policy)


def _written(column: SourceColumn, order: str | None) -> TimeReading | None:
    found = instants(column.texts or (), order)
    if found is None:
        return None
    ns, notes = found.ns, []
    if found.of_day:
        falls = np.flatnonzero(np.diff(ns) < -DAY_NS // 2)
        for row in falls:
            ns = ns.copy()
            ns[row + 1 :] += DAY_NS
        if falls.size:
            notes.append(f"midnight passed {falls.size} times")
    begin = "" if found.of_day else f", from {_date(int(ns[0]))}"
    return TimeReading(
        column.name,
        found.written,
        ns,
        (f"written as {found.written}{begin}",),
        named=True,
        epoch=not found.of_day,
        open=found.doubt,
        notes=tuple(notes),
    )


def _in_unit(column: SourceColumn, unit: Unit, policy: ImportPolicy) -> TimeReading:
    epoch = _epoch_unit(column, policy)
    ns, notes = _unwrapped(column, unit)
    reading = TimeReading(column.name, unit.name, ns, (), named=True, epoch=epoch == unit.name, notes=notes)
    rate = 1e9 / reading.step_ns if reading.step_ns else 0.0
    evidence = (f"named {unit.name}", f"{rate:.4g} rows/s")
    problem = None
    if epoch is not None and epoch != unit.name and not unit.name.startswith("tick"):
        problem = f"named {unit.name}, but {column_first(column)} is a time since 1970 in {epoch}"
    elif rate and not policy.named_rate_hz[0] <= rate <= policy.named_rate_hz[1]:
        problem = f"named {unit.name}, which gives {rate:.3g} rows/s"
    elif not rate and ns.size > 1:
        problem = "never goes forward"
    return TimeReading(column.name, unit.name, ns, evidence, True, reading.epoch, problem, notes=notes)


def _by_stated_rate(column: SourceColumn, rate_hz: float, policy: ImportPolicy) -> TimeReading | None:
    """Ticks of which the rows/s that the file states make a power of ten in a second."""
    ns, notes = _unwrapped(column, Unit("ns", Quantity.TIME, 1.0))
    steps = np.diff(ns)
    steps = steps[steps > 0]
    if steps.size == 0:
        return None
    ticks = float(np.median(steps)) * rate_hz
    power = round(float(np.log10(ticks)))
    if not 0 <= power <= 9 or abs(ticks / 10.0**power - 1.0) > policy.stated_rate_share:
        return None
    unit = Unit(f"ticks/{10**power}", Quantity.TIME, 10.0 ** (9 - power))
    ns, notes = _unwrapped(column, unit)
    why = (f"no unit named; {rate_hz:g} rows/s, as the file says, in {10**power:,} ticks a second",)
    return TimeReading(column.name, unit.name, ns, why, False, likely=True, notes=notes)


def _by_values(column: SourceColumn, policy: ImportPolicy, rate_hz: float | None) -> TimeReading | None:
    epoch = _epoch_unit(column, policy)
    if epoch is not None:
        unit = unit_named(epoch, Quantity.TIME)
        assert unit is not None
        ns, notes = _unwrapped(column, unit)
        why = (f"{column_first(column)} in {epoch} is {_date(int(ns[0]))}",)
        return TimeReading(column.name, epoch, ns, why, named=False, epoch=True, notes=notes)
    if rate_hz and column.integers is not None and (stated := _by_stated_rate(column, rate_hz, policy)) is not None:
        return stated
    fits: list[TimeReading] = []
    for name in _RELATIVE:
        unit = unit_named(name, Quantity.TIME)
        assert unit is not None
        ns, notes = _unwrapped(column, unit)
        reading = TimeReading(column.name, name, ns, (), named=False, likely=True, notes=notes)
        if reading.step_ns and policy.rate_hz[0] <= 1e9 / reading.step_ns <= policy.rate_hz[1]:
            fits.append(reading)
    if not fits:
        return None
    rates = " or ".join(f"{1e9 / reading.step_ns:.4g} rows/s in {reading.unit}" for reading in fits)
    one, several = fits[0], len(fits) > 1
    return TimeReading(
        column.name,
        one.unit,
        one.ns,
        (f"no unit named; {rates}",),
        False,
        False,
        f"its unit may be {' or '.join(reading.unit for reading in fits)}" if several else None,
        True,
        one.notes,
    )


def column_first(column: SourceColumn) -> str:
    """The first number of a column as it stands."""
    if column.integers is not None:
        return str(int(column.integers[0]))
    return f"{float(column.numbers[0]):.10g}" if column.numbers is not None and column.numbers.size else "nothing"


def _epoch_unit(column: SourceColumn, policy: ImportPolicy) -> str | None:
    numbers = column.numbers
    assert numbers is not None
    low, high = float(numbers.min()), float(numbers.max())
    for name, scale in (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)):
        if policy.epoch_s[0] * scale <= low and high <= policy.epoch_s[1] * scale:
            return name
    return None


def _unwrapped(column: SourceColumn, unit: Unit) -> tuple[Nanoseconds, tuple[str, ...]]:
    """Nanoseconds, with a counter's wraps taken out: where it falls by nearly its range and goes on as before."""
    if column.integers is None:
        assert column.numbers is not None
        scaled = (column.numbers - unit.zero) * unit.factor
        # a float holds whole and fraction: apart, so that no digit of a long time is lost
        return _whole(scaled), ()
    ticks = column.integers
    notes: tuple[str, ...] = ()
    steps = np.diff(ticks)
    if steps.size and (steps < 0).any() and (steps > 0).any():
        usual = float(np.median(steps[steps > 0]))
        for bits in _WRAPS:
            period = 1 << bits
            if int(ticks.max()) >= period or int(ticks.min()) < 0:
                continue
            wraps = (steps < -period // 2) & (steps + period <= 20 * usual)
            if wraps.any():
                ticks = ticks + period * np.concatenate(([0], np.cumsum(wraps)))
                notes = (f"a counter of {bits} bits wrapped {int(wraps.sum())} times",)
                break
    factor = unit.factor
    if factor >= 1 and float(factor).is_integer() and np.abs(ticks).max(initial=0) < (1 << 62) / factor:
        return (ticks - round(unit.zero)) * int(factor), notes
    return _whole((ticks - unit.zero) * factor), notes


def _whole(ns: NDArray[np.floating[Any]]) -> Nanoseconds:
    whole: Nanoseconds = np.rint(np.clip(ns, -9.2e18, 9.2e18)).astype(np.int64)
    return whole


def _date(ns: int) -> str:
    whole, rest = divmod(ns, 1_000_000_000)
    when = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC) + datetime.timedelta(seconds=whole)
    return f"{when:%Y-%m-%d %H:%M:%S}.{rest // 1_000_000:03d}"


@dataclass(frozen=True, slots=True)
class RowFindings:
    """What the rows' times say. `keep` (M,) are the rows that go on, in order of time; `lines` say what was found."""

    keep: NDArray[np.intp]
    lines: tuple[str, ...] = ()
    parts: tuple[tuple[int, int], ...] = field(default=())
    """[begin, end) of rows between resets of the clock; one where there was none"""


def rows_of(
    ns: Nanoseconds,
    same: NDArray[np.bool_],
    place: Callable[[int], str],
    policy: ImportPolicy = POLICY,
    counter: Numbers | None = None,
) -> RowFindings:
    """Look at the times of all rows.

    `same` (N-1,): whether row k+1 equals row k in every column; `place` says where a row stands (`SourceTable.place`);
    `counter` (N,): the device's own number of each row.
    """
    lines: list[str] = []

    def say(what: str, rows: NDArray[np.intp]) -> None:
        shown = ", ".join(place(int(row)) for row in rows[: policy.shown_rows])
        lines.append(f"{rows.size} {what}: {shown}{', ...' if rows.size > policy.shown_rows else ''}")

    parts = _parts(ns, policy)
    highest = np.maximum.accumulate(ns)
    late = np.flatnonzero(ns[1:] < highest[:-1]) + 1
    keep = np.argsort(ns, kind="stable").astype(np.intp)
    if len(parts) == 1 and late.size:
        say("rows out of order, put where their time belongs", late)
    ordered = ns[keep]
    repeated = np.flatnonzero(np.diff(ordered) == 0)
    if repeated.size:
        neighbours = keep[repeated + 1] == keep[repeated] + 1
        double = np.zeros(repeated.size, dtype=bool)
        double[neighbours] = same[keep[repeated[neighbours]]]
        if double.any():
            say("rows given twice, omitted once", keep[repeated[double] + 1])
        if (~double).any():
            say("rows with the time of the row before, kept", keep[repeated[~double] + 1])
        keep = np.delete(keep, repeated[double] + 1)
    if len(parts) == 1:
        _say_steps(ns[keep], None if counter is None else counter[keep], keep, say, lines, policy)
    return RowFindings(keep, tuple(lines), parts)


def _say_steps(
    ns: Nanoseconds,
    counter: Numbers | None,
    keep: NDArray[np.intp],
    say: Callable[[str, NDArray[np.intp]], None],
    lines: list[str],
    policy: ImportPolicy,
) -> None:
    """What the wide steps of the ordered times are."""
    found = wide_steps(ns, counter, policy)
    if found.usual_ns == 0.0:
        return
    steps = np.diff(ns)
    ms = found.usual_ns / 1e6
    if np.count_nonzero((found.lost > 0) | (found.clock_ns != 0.0)) > policy.uneven_share * steps.size:
        low, high = np.quantile(steps[steps > 0], (0.05, 0.95)) / 1e6
        lines.append(f"its steps of time are uneven: {low:.4g} to {high:.4g} ms for 9 of 10 rows; none is called lost")
    else:
        gaps, moved = found.lost > 0, found.clock_ns != 0.0
        if gaps.any():
            say(f"gaps of the time ({int(found.lost.sum())} rows of {ms:.6g} ms lost), before", keep[found.after[gaps]])
        if moved.any():
            low, high = found.clock_ns[moved].min() / 1e6, found.clock_ns[moved].max() / 1e6
            what = f"steps of the clock by {low:+.4g} to {high:+.4g} ms, no whole rows of {ms:.6g} ms: none called lost"
            say(f"{what}, before", keep[found.after[moved]])
        if found.late.any():
            say("rows written late, none lost", keep[found.after[found.late]])
    pauses = np.flatnonzero(steps > policy.pause_steps * found.usual_ns)
    if pauses.size:
        low, high = float(steps[pauses].min()) / 1e9, float(steps[pauses].max()) / 1e9
        say(f"pauses of {low:.4g} to {high:.4g} s in which no row was written, before", keep[pauses + 1])


def _parts(ns: Nanoseconds, policy: ImportPolicy) -> tuple[tuple[int, int], ...]:
    """Where the clock began again or was set back: times that fall back and do not catch up within some rows, or go on
    from there without a jump forward."""
    steps = np.diff(ns)
    falls = np.flatnonzero(steps < 0) + 1
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    begins = [0]
    for row in falls.tolist():
        before = int(ns[begins[-1] : row].max())
        ahead = ns[row : row + policy.catch_up_rows]
        # a late row is followed by a later time at once; what goes on from the lower time has begun again
        again = int(ahead.max()) < before and ahead.size >= min(policy.catch_up_rows, 2)
        if again or set_back(ns, row, usual, policy):
            begins.append(row)
    return tuple(zip(begins, [*begins[1:], int(ns.size)], strict=True))

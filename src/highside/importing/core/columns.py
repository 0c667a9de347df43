"""Single columns: found by the name that a user gives, judged by their range, known as row numbers."""

from __future__ import annotations

import numpy as np

from highside.errors import InputError
from highside.importing.core.policy import ImportPolicy
from highside.importing.core.source import Numbers, SourceColumn, SourceTable
from highside.importing.core.timing import TimeReading
from highside.importing.core.units import Quantity, Unit, unit_named

MANY = 8
"""columns named in a message"""


def named_column(table: SourceTable, target: str, text: str) -> tuple[SourceColumn, str | None]:
    """`COLUMN` or `COLUMN:unit`. Raises InputError that names the columns there are."""
    whole = table.column(text)
    if whole is not None:
        return whole, None
    name, mark, unit = text.rpartition(":")
    column = table.column(name) if mark else None
    if column is None:
        names = ", ".join(column.name for column in table.columns[:MANY])
        more = ", ..." if len(table.columns) > MANY else ""
        raise InputError(
            f"{target}={text}: no such column", where=table.where, field="--map", remedy=f"it has {names}{more}"
        )
    return column, unit


def worth_as_time(reading: TimeReading) -> tuple[bool, bool, bool, bool, int]:
    """What is decided goes first, then our own name, a named unit, device time before the clock of a computer."""
    distinct = int(np.count_nonzero(np.diff(reading.ns)))
    return (reading.open is not None, reading.column != "t_s", not reading.named, reading.epoch, -distinct)


def by_range(
    quantity: Quantity, numbers: Numbers, policy: ImportPolicy
) -> tuple[Unit | None, tuple[str, ...], str | None]:
    """A unit by the range of the values: (unit, evidence, what is open)."""
    finite = numbers[np.isfinite(numbers)]
    if finite.size == 0:
        return None, ("holds no number",), "holds no number"
    low, high = float(finite.min()), float(finite.max())
    shown = f"{low:.5g} to {high:.5g}"
    if quantity is Quantity.TEMPERATURE:
        celsius = policy.celsius[0] <= low and high <= policy.celsius[1]
        kelvin = policy.kelvin[0] <= low and high <= policy.kelvin[1]
        if celsius != kelvin:
            name = "C" if celsius else "K"
            return unit_named(name, quantity), (f"no unit named; {shown}: {name}",), None
    if quantity is Quantity.ANGLE and max(abs(low), abs(high)) > 2 * np.pi * 1.01:
        return unit_named("deg", quantity), (f"no unit named; {shown}: no rad",), None
    return None, (f"no unit named; {shown}",), f"its unit is not named and {shown} does not show it"


def block_is_whole(columns: list[SourceColumn]) -> bool:
    """Whether all numbers of these columns are whole, as counts of a converter are."""
    return all(
        c.numbers is not None and bool((np.isnan(c.numbers) | (c.numbers == np.rint(c.numbers))).all()) for c in columns
    )


def row_number(column: SourceColumn) -> bool:
    """An index that a program wrote beside the table: whole numbers one after the other, without a name of its own."""
    if (
        column.integers is None
        or column.n < 2
        or not (column.name.startswith("column ") or column.name in ("index", "level_0"))
    ):
        return False
    return bool((np.diff(column.integers) == 1).all()) and int(column.integers[0]) in (0, 1)

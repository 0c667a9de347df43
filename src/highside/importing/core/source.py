"""What a form of file gives: named columns of equal length, and what was noticed while reading them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Numbers: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SourceColumn:
    """One column. Either `numbers` (N,) with NaN where missing, or `texts` of N cells as they stand.

    `integers` (N,) holds the same numbers exactly, where all are whole and there: times of 19 digits fit no float.
    `unit` is what the file itself says; `instant` marks nanoseconds since 1970 by the file's own type.
    """

    name: str
    numbers: Numbers | None = None
    texts: tuple[str, ...] | None = None
    integers: NDArray[np.int64] | None = None
    unit: str | None = None
    instant: bool = False

    @property
    def n(self) -> int:
        """Number of rows."""
        if self.numbers is not None:
            return int(self.numbers.size)
        return len(self.texts or ())


@dataclass(frozen=True, slots=True)
class SourceTable:
    """Columns of equal length. `form` says in words what was read, `name` which part of the file it is (a sheet, a
    topic), `first_line` the line of the file on which row 0 stands (None where rows have no lines)."""

    columns: tuple[SourceColumn, ...]
    form: str
    where: str
    name: str = ""
    first_line: int | None = None
    rate_hz: float | None = None
    remarks: tuple[str, ...] = ()
    hints: dict[str, str] = field(default_factory=dict)
    """column by what it is (`ax_g`), where the form itself defines it: a message type, a data sheet"""

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.columns[0].n if self.columns else 0

    def column(self, name: str) -> SourceColumn | None:
        """The column of that name, or None."""
        return next((column for column in self.columns if column.name == name), None)

    def place(self, row: int) -> str:
        """Where a row (from 0) stands, in words: `line 7` of a text, `row 6` else (from 1)."""
        return f"line {self.first_line + row}" if self.first_line is not None else f"row {row + 1}"


def text_column(name: str, cells: tuple[str, ...], unit: str | None = None) -> SourceColumn:
    """A column of cells that are no numbers."""
    return SourceColumn(name, texts=cells, unit=unit)


def number_column(name: str, values: NDArray[np.generic], unit: str | None = None) -> SourceColumn:
    """A column of numbers of any type; whole numbers are kept exactly as well."""
    whole = values.dtype.kind in "iu" and bool((values.size == 0) or int(values.max()) < 1 << 63)
    return SourceColumn(
        name, numbers=values.astype(np.float64), integers=values.astype(np.int64) if whole else None, unit=unit
    )

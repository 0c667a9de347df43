"""The header and the rows of a CSV file, within bounds."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError
from highside.reading.texts import at_line

MAX_COLUMNS = 4096
"""Columns of a table: the widest that highside writes has 40. A file of one line ends here."""
MAX_HEADER_CHARACTERS = 1 << 20
"""Length of a header: 4,096 names of 255 characters."""


def csv_header(line: str, *, where: str) -> tuple[str, ...]:
    """Names of the columns, without blanks around them. Raises InputError that names the column."""
    at = at_line(where, 1)
    if "\r" in line:
        raise InputError("a carriage return stands inside the line", where=at, remedy="end lines with line feeds")
    if len(line) > MAX_HEADER_CHARACTERS or line.count(",") >= MAX_COLUMNS:
        raise InputError(
            f"the header names more than {MAX_COLUMNS} columns, or has no end", where=at, remedy="give the right file"
        )
    try:
        names = tuple(name.strip() for name in next(csv.reader([line]), []))
    except csv.Error as error:
        raise InputError(f"the header is not readable as CSV: {error}", where=at, remedy="correct that line") from None
    if not all(names) or not names:
        raise InputError("the header has a column without a name", where=at)
    double = sorted(name for name, count in Counter(names).items() if count > 1)
    if double:
        raise InputError("the header names this column twice", where=at, field=double[0])
    return names


def csv_rows(lines: Sequence[str], *, where: str, first_line: int = 2, delimiter: str = ",") -> Iterator[list[str]]:
    """The cells of each line. Raises InputError that names the line."""
    number = first_line
    try:
        for row in csv.reader(lines, strict=True, delimiter=delimiter):
            yield row
            number += 1
    except csv.Error as error:
        raise InputError(f"is not readable as CSV: {error}", where=at_line(where, number)) from None


def numbers_at_once(lines: Sequence[str], width: int) -> list[NDArray[np.float64]] | None:
    """All columns of a table of plain numbers, or None if it holds anything else (the slow way says what)."""
    commas = width - 1
    if any(line.count(",") != commas for line in lines):
        return None
    try:
        flat = np.fromiter(map(float, ",".join(lines).split(",")), np.float64, len(lines) * width)
    except ValueError:
        return None
    if not np.isfinite(flat).all():
        return None
    return [np.ascontiguousarray(column) for column in flat.reshape(-1, width).T]

"""Excel workbooks (`.xlsx`): one table a sheet, values as they were last computed, never a formula."""

from __future__ import annotations

import datetime
import io
import re
import sys
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from highside.errors import InputError
from highside.importing.core.source import SourceColumn, SourceTable
from highside.importing.core.units import unit_named
from highside.importing.forms.missing import damaged, not_installed
from highside.reading.arrays import check_zip, zip_member
from highside.reading.files import allowed_bytes
from highside.reading.table import MAX_COLUMNS

_CELL_BYTES = 100
"""memory of a cell of Python's own objects"""
_LIST, _SHEET = "xl/workbook.xml", re.compile(rb"<(?:\w+:)?sheet[\s/>]")
_MOST_SHEETS = 255
"""as many as Excel makes at once"""
_HEADER_ROWS = 50
"""rows among which the header is looked for"""
_EPOCH = datetime.datetime(1970, 1, 1)  # noqa: DTZ001 - a sheet knows no zone
_SHOWN = 40


def read_excel(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The tables of all sheets that hold one. Raises InputError."""
    check_zip(data, where=where)
    if _sheets(data) > _MOST_SHEETS:
        raise InputError(f"has more than {_MOST_SHEETS} sheets", where=where, remedy="give the right file")
    try:
        import openpyxl
    except ImportError:
        raise not_installed("openpyxl", where) from None
    try:
        book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        sheets = [(sheet.title, _cells(sheet, where)) for sheet in book.worksheets]
    except (InputError, MemoryError):
        raise
    except Exception as error:
        raise damaged("Excel", error, where) from None
    tables = tuple(table for title, rows in sheets if (table := _table(rows, title, where)) is not None)
    if not tables:
        raise InputError("no sheet holds a table with a header and rows of numbers", where=where)
    return tables


def _sheets(data: bytes) -> int:
    """As many as the list of sheets names, before each is looked for."""
    return len(_SHEET.findall(zip_member(data, _LIST) or b""))


def _cells(sheet: Any, where: str) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    count = 0
    for row in sheet.iter_rows(values_only=True):
        count += len(row)
        if len(row) > MAX_COLUMNS:
            raise InputError(f"has more than {MAX_COLUMNS} columns", where=where, remedy="give the right file")
        if count * _CELL_BYTES > allowed_bytes():
            raise InputError("has too many cells", where=where, remedy="save it as CSV or Parquet")
        rows.append(row)
    while rows and all(cell is None for cell in rows[-1]):
        rows.pop()
    return rows


def _table(rows: Sequence[tuple[Any, ...]], title: str, where: str) -> SourceTable | None:
    first = next((place for place, row in enumerate(rows[:_HEADER_ROWS]) if _is_row(row)), None)
    if not first:
        return None
    header = first - 1
    units: dict[int, str] = {}
    if header > 0 and _is_units(rows[header]) and any(isinstance(cell, str) for cell in rows[header - 1]):
        units = {k: str(cell).strip("[]() ") for k, cell in enumerate(rows[header]) if cell is not None}
        header -= 1
    width = max(
        (k + 1 for row in rows[header : first + 1] for k, cell in enumerate(row) if cell is not None), default=0
    )
    names = [
        str(cell).strip() if cell is not None else f"column {k + 1}" for k, cell in enumerate(rows[header][:width])
    ]
    double = [name for name, count in Counter(names).items() if count > 1]
    if double:
        at = f"{where}: {title}: row {header + 1}"
        raise InputError("the header names this column twice", where=at, field=double[0], remedy="rename one of them")
    columns = []
    for k, name in enumerate(names):
        cells = [row[k] if k < len(row) else None for row in rows[first:]]
        columns.append(_column(name, cells, units.get(k), first + 1, f"{where}: {title}"))
    return SourceTable(tuple(columns), f"Excel, sheet {title}", where, title, first + 1)


def _is_row(row: Sequence[Any]) -> bool:
    filled = [cell for cell in row if cell is not None]
    numbers = sum(isinstance(cell, int | float | datetime.datetime) for cell in filled)
    return len(filled) > 1 and numbers * 2 >= len(filled)


def _is_units(row: Sequence[Any]) -> bool:
    filled = [str(cell).strip("[]() ") for cell in row if cell is not None]
    return bool(filled) and sum(unit_named(cell) is not None for cell in filled) * 2 >= len(filled)


def _column(name: str, cells: list[Any], unit: str | None, first_row: int, where: str) -> SourceColumn:
    present = [cell for cell in cells if cell is not None]
    if present and len(present) == len(cells) and all(isinstance(cell, datetime.datetime) for cell in present):
        ns = np.array([_nanoseconds(cell) for cell in cells], dtype=np.int64)
        return SourceColumn(name, numbers=ns.astype(np.float64), integers=ns, instant=True)
    numbers = [isinstance(cell, int | float) for cell in present]
    if not all(numbers):
        if sum(numbers) * 2 > len(present):
            row = next(k for k, cell in enumerate(cells) if cell is not None and not isinstance(cell, int | float))
            shown = repr(cells[row])[:_SHOWN]
            at = f"{where}: row {first_row + row}"
            raise InputError(
                f"{shown} is no number", where=at, field=name, remedy="correct that cell, or leave it empty"
            )
        return SourceColumn(name, texts=tuple("" if cell is None else str(cell) for cell in cells), unit=unit)
    try:
        values = np.array([np.nan if cell is None else float(cell) for cell in cells])
    except OverflowError:
        row = next(k for k, cell in enumerate(cells) if isinstance(cell, int) and abs(cell) > sys.float_info.max)
        at = f"{where}: row {first_row + row}"
        raise InputError("is too large a number", where=at, field=name, remedy="correct that cell") from None
    whole = len(present) == len(cells) and all(isinstance(cell, int) and abs(cell) < 1 << 62 for cell in cells)
    return SourceColumn(name, values, integers=np.array(cells, dtype=np.int64) if whole else None, unit=unit)


def _nanoseconds(when: datetime.datetime) -> int:
    since = when - _EPOCH
    return (since.days * 86400 + since.seconds) * 1_000_000_000 + since.microseconds * 1000

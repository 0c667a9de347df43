"""Text with one row a line: CSV in its dialects, tab and semicolon, decimal comma, blanks, lines before the header.

The dialect is what most of the first lines agree on. A cell becomes a number only if the whole of it is one in the
notation of the file; a column with one cell that is not stays a column of texts.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.errors import InputError
from highside.importing.core.source import Numbers, SourceColumn, SourceTable
from highside.importing.core.units import unit_named
from highside.importing.forms.wrappings import in_plain_lines
from highside.reading import csv_rows, decode_foreign
from highside.reading.large import LARGE_BYTES, columns_at_once
from highside.reading.table import MAX_COLUMNS, MAX_HEADER_CHARACTERS

_LOOKED_AT = 200
"""lines by which the dialect is judged"""
_DELIMITERS = (";", "\t", "|", ",")
_NAMES = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
_POINT = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?")
_PLAIN = re.compile(r"[0-9+\-.eE]*")
"""all that a plain number is written with; what `float` takes of it is what `_POINT` matches"""
_COMMA = re.compile(r"[+-]?(?:\d+(?:,\d*)?|,\d+)(?:[eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?\d{1,3},\d{3}")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:[.,' ]\d{3})+[.,]\d+|[+-]?\d{1,3}(?:[.,' ]\d{3}){2,}")
_MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "nat", "#n/a", "<na>"})
_MISSING_CASES = tuple(
    sorted({form for word in _MISSING for form in (word, word.upper(), word.title())} | {"NaN", "NaT"})
)
_BLANKS = re.compile(rb"[ \t]+")
_EDGES = re.compile(rb"(?m)^[ \t]+|(?<![ \t])[ \t]+$")
_WHOLE = re.compile(r"[+-]?\d{1,18}")
_RATE = re.compile(r"^\W*(?:fs|rate|sample\s*rate|sampling\s*(?:rate|frequency))\b[^0-9]*([0-9.]+)", re.IGNORECASE)
_RATE_WITHIN = re.compile(r"\bat ([0-9.]+) Hz\b")
"""within a line about the device"""
_CANDUMP = re.compile(rb"\(\d+\.\d+\) \S+ [0-9A-Fa-f]{3,8}#")
_SHOWN = 40


@dataclass(frozen=True, slots=True)
class _Dialect:
    delimiter: str
    header: int | None
    """place of the header among the lines, None where there is none"""
    units: int | None
    """place of a second line of the header, with units"""
    first: int
    """place of the first row"""
    width: int


def read_delimited(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """The one table of a text. Raises InputError that names the line of what is wrong."""
    text, encoding = decode_foreign(data, where=where)
    text, ended = _without_blank_end(text)
    if not text.strip():
        raise InputError("is empty", where=where)
    remarks: list[str] = []
    text, hints = in_plain_lines(text)
    large = len(text) > LARGE_BYTES and ended
    cut = _after_lines(text, _LOOKED_AT)
    lines = text[:cut].removesuffix("\n").split("\n") if cut else text.split("\n")
    declared = re.fullmatch(r"sep=(.)", lines[0].strip())
    forced = declared[1] if declared else None
    if forced:
        lines[0] = ""
    dialect = _dialect(lines, forced, where)
    names, units = _header(lines, dialect, where)
    stated = ((_RATE.match(line) or _RATE_WITHIN.search(line)) for line in lines[: dialect.first])
    rate = next((float(found[1]) for found in stated if found), None)
    at_once = None
    if large:
        # copies of a long text are what takes most memory: one at a time
        body = data if _as_it_stands(data, text, encoding) else text.encode()
        begin = len(text[: _after_lines(text, dialect.first)].encode())
        del text
        at_once = _columns_at_once(body, begin, lines, names, dialect)
        text = body.decode() if at_once is None else ""
        del body
    if at_once is None:
        lines += text[cut:].split("\n") if cut else []
        comma, columns = _columns_by_cell(lines, names, dialect, ended, where, remarks)
    else:
        comma, columns = at_once
    if not ended and not remarks:
        remarks.append("the last line has no end: its last number may be cut short")
    separator = _NAMES.get(dialect.delimiter, repr(dialect.delimiter))
    form = f"text, {separator}, {'decimal comma, ' if comma else ''}{encoding}"
    columns = tuple(replace(column, unit=units.get(column.name)) for column in columns)
    return (SourceTable(columns, form, where, stem, dialect.first + 1, rate, tuple(remarks), hints),)


def _without_blank_end(text: str) -> tuple[str, bool]:
    """A text without its last line end and blank lines behind it, and whether it had one: blank lines at the end are no
    rows, cells at the end of the last row are cells."""
    last = len(text)
    while last > 0 and text[last - 1].isspace():
        last -= 1
    end = text.find("\n", last)
    return (text[:end], True) if end >= 0 else (text, False)


def _after_lines(text: str, count: int) -> int:
    """The place behind so many lines; 0 where there are not more."""
    place = 0
    for _ in range(count):
        place = text.find("\n", place) + 1
        if place == 0:
            return 0
    return place


def _as_it_stands(data: bytes, text: str, encoding: str) -> bool:
    """Whether the bytes of a file are those of the text, but for its last line end."""
    if encoding != "UTF-8" or not text.isascii() or b"\r" in data or len(data) - len(text) > 1:
        return False
    return data.startswith(text[:64].encode())


def is_candump(data: bytes) -> bool:
    """Whether it is what `candump -L` writes: frames of a CAN bus, of which a DBC file says what they hold."""
    return _CANDUMP.match(data) is not None


def refuse_candump(data: bytes, where: str, stem: str) -> tuple[SourceTable, ...]:
    """Raises InputError that names the command for it."""
    remedy = f"highside decode {where} --codec dbc --config CODEC.toml -o REC.csv.gz"
    raise InputError("holds frames of a CAN bus, which need a DBC file to be read", where=where, remedy=remedy)


def _columns_by_cell(
    lines: Sequence[str], names: tuple[str, ...], dialect: _Dialect, ended: bool, where: str, remarks: list[str]
) -> tuple[bool, tuple[SourceColumn, ...]]:
    """Whether numbers have a decimal comma, and the columns; each cell is looked at, and a wrong one is named."""
    rows = _rows(lines, dialect, where, ended, remarks)
    if not rows:
        raise _no_rows(lines, dialect, where)
    cells = list(zip(*rows, strict=True))
    comma = _decimal_comma(cells, dialect, where)
    return comma, tuple(
        _column(name, column, comma, dialect.first + 1, where) for name, column in zip(names, cells, strict=True)
    )


def _columns_at_once(
    body: bytes, begin: int, lines: Sequence[str], names: tuple[str, ...], dialect: _Dialect
) -> tuple[bool, tuple[SourceColumn, ...]] | None:
    """The same by pyarrow for a large text; None where the first lines leave anything open, or it reads otherwise."""
    delimiter = dialect.delimiter
    if delimiter == " ":
        body, begin = _BLANKS.sub(b" ", _EDGES.sub(b"", body[begin:])), 0
    try:
        rows = _rows(lines, dialect, "", True, [])
        shown = [[cell.strip() for cell in column] for column in zip(*rows, strict=True)]
        comma = bool(rows) and _decimal_comma(shown, dialect, "")
    except InputError:
        return None
    if not rows:
        return None
    words = [not _mostly_numbers(cells) and any(cell.lower() not in _MISSING for cell in cells) for cells in shown]
    found = columns_at_once(
        body,
        names,
        begin=begin,
        delimiter=delimiter,
        decimal="," if comma else ".",
        missing=_MISSING_CASES,
        texts=[name for name, word in zip(names, words, strict=True) if word],
    )
    # numbers all along and then a text is a fault that the other reader names; so are commas in texts beside points
    if found is None or any((column.texts is not None) != word for column, word in zip(found, words, strict=True)):
        return None
    return comma, tuple(
        SourceColumn(
            column.name,
            column.numbers,
            None if column.texts is None else tuple(map(str.strip, column.texts)),
            column.integers,
        )
        for column in found
    )


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    return next(csv_rows([line], where="", delimiter=delimiter), [])


def _dialect(lines: Sequence[str], forced: str | None, where: str) -> _Dialect:
    head = [(place, line) for place, line in enumerate(lines[:_LOOKED_AT]) if line.strip()]
    longest = max(len(line) for _, line in head)
    if longest > MAX_HEADER_CHARACTERS:
        raise InputError("a line has no end", where=f"{where}: line 1", remedy="give a table with one row a line")
    best: tuple[int, str, int] | None = None
    for delimiter in (forced,) if forced else (*_DELIMITERS, " "):
        try:
            widths = Counter(len(_split(line, delimiter)) for _, line in head)
        except InputError:
            continue
        width, count = max(widths.items(), key=lambda pair: (pair[1], pair[0]))
        # blanks stand in many texts: they count only where nothing else does
        agree = count - (1 if delimiter == " " else 0)
        if width > 1 and agree * 2 >= len(head) and (best is None or agree > best[0]):
            best = (agree, delimiter, width)
    if best is None:
        raise InputError(
            "is no table: no separator divides its lines into columns",
            where=where,
            remedy="give one row a line, cells separated by comma, semicolon, tab, bar or blank",
        )
    _, delimiter, width = best
    if width > MAX_COLUMNS:
        raise InputError(f"has more than {MAX_COLUMNS} columns", where=where, remedy="give the right file")
    fitting = [place for place, line in head if len(_split(line, delimiter)) == width]
    numeric = [place for place in fitting if _mostly_numbers(_split(lines[place], delimiter))]
    first = numeric[0] if numeric else (fitting[1] if len(fitting) > 1 else len(lines))
    before = [place for place in fitting if place < first]
    if not before and first > 0 and delimiter != " ":
        # a header that lacks the name of the index, or has one separator more
        near = [place for place, line in head if place < first and abs(len(_split(line, delimiter)) - width) == 1]
        before = near[-1:]
    units = None
    if len(before) >= 2 and _all_units(_split(lines[before[-1]], delimiter)):
        units = before[-1]
        before = before[:-1]
    return _Dialect(delimiter, before[-1] if before else None, units, first, width)


def _mostly_numbers(cells: Sequence[str]) -> bool:
    """Whether a line is a row and no header: half of its cells are numbers, or all that are not are dates."""
    filled = [cell.strip().strip('"') for cell in cells if cell.strip()]
    numbers = sum(bool(_POINT.fullmatch(cell) or _COMMA.fullmatch(cell)) for cell in filled)
    return bool(filled) and numbers * 2 >= len(filled)


def _all_units(cells: Sequence[str]) -> bool:
    filled = [cell.strip().strip('"[]()') for cell in cells if cell.strip().strip('"[]()-')]
    known = sum(unit_named(cell) is not None for cell in filled)
    return bool(filled) and known * 2 >= len(filled)


def _header(lines: Sequence[str], dialect: _Dialect, where: str) -> tuple[tuple[str, ...], dict[str, str]]:
    if dialect.header is None:
        return tuple(f"column {place + 1}" for place in range(dialect.width)), {}
    text = lines[dialect.header].lstrip()
    text = text.lstrip("#%").lstrip() if text[:1] in "#%" and text[:1] else text
    names = [name.strip().strip('"').strip() for name in _split(text, dialect.delimiter)]
    if len(names) == dialect.width - 1:
        names = ["", *names]
    if len(names) > dialect.width and names[-1]:
        # which of them has no cells is not said: to leave out the last might give each column its neighbour's name
        raise InputError(
            f"the header has {len(names)} cells where the rows have {dialect.width}",
            where=f"{where}: line {dialect.header + 1}",
            remedy="give each column a name and each row all its cells",
        )
    names = names[: dialect.width]
    names = [name or f"column {place + 1}" for place, name in enumerate(names)]
    double = [name for name, count in Counter(names).items() if count > 1]
    if double:
        raise InputError(
            "the header names this column twice",
            where=f"{where}: line {dialect.header + 1}",
            field=double[0],
            remedy="rename one of them",
        )
    units: dict[str, str] = {}
    if dialect.units is not None:
        for name, cell in zip(names, _split(lines[dialect.units], dialect.delimiter), strict=False):
            if unit_named(cell.strip().strip('"[]()')) is not None:
                units[name] = cell.strip().strip('"[]()')
    return tuple(names), units


def _rows(lines: Sequence[str], dialect: _Dialect, where: str, ended: bool, remarks: list[str]) -> list[Sequence[str]]:
    body = lines[dialect.first :]
    quoted = any('"' in line for line in body)
    rows: list[Sequence[str]] = []
    if quoted and dialect.delimiter != " ":
        split = list(csv_rows(body, where=where, first_line=dialect.first + 1, delimiter=dialect.delimiter))
    else:
        split = [line.split() if dialect.delimiter == " " else line.split(dialect.delimiter) for line in body]
    for place, cells in enumerate(split):
        if len(cells) == dialect.width:
            rows.append(cells)
            continue
        line = dialect.first + place + 1
        if len(cells) == dialect.width + 1 and not cells[-1].strip():
            rows.append(cells[:-1])
        elif place == len(split) - 1 and not ended and len(cells) < dialect.width:
            remarks.append(f"line {line} is torn and was omitted")
        elif not any(cell.strip() for cell in cells):
            raise InputError("is empty, and rows follow it", where=f"{where}: line {line}", remedy="take it out")
        else:
            raise InputError(
                f"has {len(cells)} cells where the others have {dialect.width}",
                where=f"{where}: line {line}",
                remedy="correct that line",
            )
    return rows


def _no_rows(lines: Sequence[str], dialect: _Dialect, where: str) -> InputError:
    """What is wrong with a text of which no line is a row: the first line behind the header, if there is one."""
    head = (dialect.header, dialect.units)
    behind = max(place for place in (*head, -1) if place is not None) + 1
    for place, line in enumerate(lines[behind:], start=behind):
        if line.strip():
            cells = len(_split(line, dialect.delimiter))
            return InputError(
                f"has {cells} cells where the header has {dialect.width}",
                where=f"{where}: line {place + 1}",
                remedy="correct that line",
            )
    return InputError("has a header but no rows", where=where)


def _decimal_comma(cells: Sequence[Sequence[str]], dialect: _Dialect, where: str) -> bool:
    """Whether numbers have a comma for a point. Raises InputError where both are used."""
    if dialect.delimiter == ",":
        quoted = next(
            (
                cell
                for column in cells
                for cell in column[:_LOOKED_AT]
                if "," in cell and _COMMA.fullmatch(cell.strip())
            ),
            None,
        )
        return quoted is not None
    if not any("," in cell for column in cells for cell in column):
        return False
    comma = point = surely = False
    for column in cells:
        for place, cell in enumerate(column):
            stripped = cell.strip()
            if _GROUPED.fullmatch(stripped) and not ("." in stripped) ^ ("," in stripped):
                raise InputError(
                    f"{stripped[:_SHOWN]!r} groups its digits",
                    where=f"{where}: line {dialect.first + place + 1}",
                    remedy="write numbers without separators of thousands",
                )
            if "," in stripped and _COMMA.fullmatch(stripped):
                comma = True
                surely = surely or not _THOUSANDS.fullmatch(stripped)
            elif "." in stripped and _POINT.fullmatch(stripped):
                point = True
    if comma and point:
        raise InputError(
            "numbers are written with comma and with point", where=where, remedy="save it with one of them"
        )
    if comma and not surely:
        raise InputError(
            "every comma stands before three digits: decimals or thousands",
            where=where,
            remedy="save it with a decimal point, or without separators of thousands",
        )
    return comma


def _plain_numbers(cells: Sequence[str]) -> Numbers | None:
    """None where a cell is empty or no number. No regular expression of the whole column: those of Python before
    3.11.5 go wrong at a group that is repeated without a way back."""
    try:
        return np.array(list(map(float, cells)))
    except ValueError:
        return None


def _column(name: str, cells: Sequence[str], comma: bool, first_line: int, where: str) -> SourceColumn:
    pattern = _COMMA if comma else _POINT
    stripped = [cell.strip() for cell in cells]
    # a column of plain numbers at once: one look at all of its cells instead of one at each
    if stripped and not comma and _PLAIN.fullmatch("".join(stripped)):
        at_once = _plain_numbers(stripped)
        if at_once is not None and np.isfinite(at_once).all():
            every = all(map(_WHOLE.fullmatch, stripped))
            exact = np.array(list(map(int, stripped)), dtype=np.int64) if every else None
            return SourceColumn(name, numbers=at_once, integers=exact)
    values = np.empty(len(stripped))
    whole = True
    for place, cell in enumerate(stripped):
        if pattern.fullmatch(cell):
            values[place] = float(cell.replace(",", ".") if comma else cell)
            whole = whole and _WHOLE.fullmatch(cell) is not None
        elif cell.lower() in _MISSING:
            values[place] = np.nan
            whole = False
        else:
            if _mostly_numbers(stripped[:_LOOKED_AT]) and place > 0:
                # numbers all along and then a text: a fault of the file, not a column of words
                raise InputError(
                    f"{cell[:_SHOWN]!r} is no number",
                    where=f"{where}: line {first_line + place}",
                    field=name,
                    remedy="correct that cell, or leave it empty",
                )
            return SourceColumn(name, texts=tuple(stripped))
    if np.isinf(values).any():
        line = first_line + int(np.argmax(np.isinf(values)))
        raise InputError(
            "is not a finite number", where=f"{where}: line {line}", field=name, remedy="correct that cell"
        )
    if np.isnan(values).all() and any(stripped):
        return SourceColumn(name, texts=tuple(stripped))
    integers = np.array([int(cell) for cell in stripped], dtype=np.int64) if whole and stripped else None
    return SourceColumn(name, numbers=values, integers=integers)

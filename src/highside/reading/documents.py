"""JSON and TOML from outside: parsed within bounds, holding nothing that a reader of numbers could stumble over.

The parsers accept more than their formats' readers can use: `NaN` and `1e999`, numbers of thousands of digits, brackets
nested until the stack ends, half of a surrogate pair (which no UTF-8 can hold: the message that quotes it cannot be
sent), a key twice (the last would silently win). All of these are refused here, by name and place.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from highside.errors import InputError
from highside.reading.files import in_words, read_bytes
from highside.reading.texts import at_line, decode_text

MAX_DOCUMENT_BYTES = 16 << 20
"""Longest JSON document or line: a record of 10,000 poses has 5 MB."""
MAX_TOML_BYTES = 1 << 20
"""Longest TOML file: a model of 10,000 poses has 0.3 MB; the parser reads 2 MB/s."""
MAX_DEPTH = 64
"""Brackets within brackets: a record has 9. Python's own parsers end at about 1,000, their users often before."""
MAX_KEY_PARTS = 64
"""Parts of a dotted TOML key: the deepest that is known here has 5; 20,000 keep the parser busy for 7 s."""
_LARGEST_INTEGER = 1 << 64
_SHOWN = 20

MALFORMED = (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError, RecursionError)
"""What building our own objects of a document raises where the document says something else than it should."""

_INSTANTS = (-62_135_596_800.0, 253_402_300_799.0)
"""Epoch seconds of the years 1 to 9999: others no calendar prints."""
_LONE_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_QUOTED = re.compile(r"\"[^\"\n]*\"|'[^'\n]*'")


class _UnusableError(ValueError):
    """A value that the parser takes and we do not."""


def read_document(path: Path) -> bytes:
    """The content of a JSON document, a model or a log of ours, unzipped: what is longer is none and not taken into the
    memory, whatever size a damaged file system states. Raises InputError."""
    return read_bytes(path, max_bytes=MAX_DOCUMENT_BYTES)


def parse_json(
    data: bytes | str,
    *,
    where: str | None = None,
    kind: str = "valid JSON",
    remedy: str | None = None,
    max_bytes: int = MAX_DOCUMENT_BYTES,
) -> Any:
    """The value of a JSON document. Raises InputError: "WHERE: is no KIND (why); REMEDY"."""
    try:
        text = _json_text(data, max_bytes)
        value = json.loads(
            text,
            parse_constant=_no_constant,
            parse_int=_integer,
            parse_float=_finite,
            object_pairs_hook=_no_repeated_keys,
        )
        _not_too_deep(value)
        if _LONE_SURROGATE.search(text):
            _no_lone_surrogate(value)
    except json.JSONDecodeError as error:
        what = error.msg[:1].lower() + error.msg[1:]
        raise _no(kind, f"not JSON: line {error.lineno} column {error.colno}: {what}", where, remedy) from None
    except InputError as error:
        raise _no(kind, error.what, where, remedy) from None
    except (_UnusableError, UnicodeError) as error:
        raise _no(kind, str(error), where, remedy) from None
    except RecursionError:
        raise _no(kind, f"brackets nested deeper than {MAX_DEPTH}", where, remedy) from None
    return value


def instant(value: object) -> float:
    """Epoch seconds out of a document. Raises ValueError or TypeError for what is no time that can be printed."""
    seconds = float(value)  # type: ignore[arg-type]
    if not _INSTANTS[0] <= seconds <= _INSTANTS[1]:
        raise ValueError(f"{seconds:g} is no time in seconds")
    return seconds


def parse_json_lines(
    data: bytes, *, where: str | None = None, kind: str = "valid JSON", remedy: str | None = None
) -> Iterator[tuple[int, Any]]:
    """(number of the line from 1, its value) of a text with one JSON document a line; empty lines are passed over.

    Raises InputError that names the line.
    """
    for number, line in enumerate(data.split(b"\n"), 1):
        if line.strip():
            yield number, parse_json(line, where=at_line(where, number), kind=kind, remedy=remedy)


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises InputError that names the file and the line."""
    return parse_toml(read_bytes(path, max_bytes=MAX_TOML_BYTES), where=str(path))


def parse_toml(data: bytes | str, *, where: str | None = None, max_bytes: int = MAX_TOML_BYTES) -> dict[str, Any]:
    """The tables of a TOML text. Raises InputError that names the line or the field."""
    if len(data) > max_bytes:
        raise InputError(f"is longer than {in_words(max_bytes)}: no TOML file of ours", where=where)
    text = data if isinstance(data, str) else decode_text(data, where=where, expected="TOML file")
    _no_endless_key(text, where)
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is not valid TOML: {error}", where=where, remedy="correct that line") from None
    except RecursionError:
        raise InputError("is not valid TOML: nested too deep", where=where, remedy="take brackets away") from None
    except ValueError as error:
        # of `int` for a number of thousands of digits
        what = "it has a number of thousands of digits" if "digits" in str(error) else str(error)
        raise InputError(f"is not valid TOML: {what}", where=where, remedy="correct that number") from None
    _usable_tables(tables, where)
    return tables


def _no(kind: str, why: str, where: str | None, remedy: str | None) -> InputError:
    no = "not" if kind.startswith("valid") else "no"
    return InputError(f"is {no} {kind} ({why})", where=where, remedy=remedy)


def _json_text(data: bytes | str, max_bytes: int) -> str:
    if len(data) > max_bytes:
        raise InputError(f"longer than {in_words(max_bytes)}")
    if isinstance(data, str):
        data.encode()  # raises for the lone surrogates that a lenient decoder made
        return data.removeprefix("\ufeff")
    return decode_text(data)


def _no_constant(name: str) -> float:
    raise _UnusableError(f"{name} is not a number")


def _integer(text: str) -> int:
    value = int(text) if len(text) <= _SHOWN + 1 else _LARGEST_INTEGER
    if not -_LARGEST_INTEGER < value < _LARGEST_INTEGER:
        raise _UnusableError(f"the number {_shown(text)} is too large")
    return value


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise _UnusableError(f"the number {_shown(text)} is too large")
    return value


def _shown(text: str) -> str:
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}... of {len(text)} characters"


def _no_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        names = [name for name, _ in pairs]
        raise _UnusableError(f"the key {next(name for name in names if names.count(name) > 1)!r} is given twice")
    return out


def _not_too_deep(value: Any) -> None:
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(MAX_DEPTH):
        if not level:
            return
        level = [
            inner
            for one in level
            for inner in (one.values() if isinstance(one, dict) else one)
            if isinstance(inner, dict | list)
        ]
    if level:
        raise RecursionError


def _no_lone_surrogate(value: Any) -> None:
    # what UTF-8 cannot hold
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise _UnusableError("a text holds half of a surrogate pair") from None


def _no_endless_key(text: str, where: str | None) -> None:
    """The parser's time goes with a high power of the parts of a dotted key."""
    if text.count(".") <= MAX_KEY_PARTS:
        return
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > MAX_KEY_PARTS:
            bare = _QUOTED.sub("", line).partition("#")[0]
            if any(part.count(".") > MAX_KEY_PARTS for part in re.split(r"[,=\[\]{}]", bare)):
                raise InputError(
                    f"is not valid TOML: a key of more than {MAX_KEY_PARTS} parts",
                    where=at_line(where, number),
                    remedy="correct that line",
                )


def _usable_tables(tables: dict[str, Any], where: str | None) -> None:
    """No value that a field of ours could not hold. Raises InputError that names the field."""
    waiting: list[tuple[str, Any, int]] = [("", tables, 0)]
    while waiting:
        name, value, depth = waiting.pop()
        what = None
        if depth > MAX_DEPTH:
            raise InputError("is not valid TOML: nested too deep", where=where, remedy="take brackets away")
        if isinstance(value, dict):
            waiting += [(f"{name}.{key}" if name else key, inner, depth + 1) for key, inner in value.items()]
        elif isinstance(value, list):
            waiting += [(name, inner, depth + 1) for inner in value]
        elif isinstance(value, float) and not math.isfinite(value):
            what = f"{value} is not a finite number"
        elif isinstance(value, int) and not -_LARGEST_INTEGER < value < _LARGEST_INTEGER:
            what = "the number is too large"
        elif isinstance(value, str) and "\0" in value:
            what = "holds a NUL character"
        if what is not None:
            raise InputError(what, where=where, field=name, remedy="correct that field")

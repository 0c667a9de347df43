"""The beginning of a file, to see what it is: nothing is taken for true, and what is no file of a kind has no part."""

from __future__ import annotations

import contextlib
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

from highside.errors import InputError
from highside.reading.table import csv_header

HEAD_BYTES = 64 << 10
"""of a file, and of what comes out of it: the header of a table has its end there"""
LONGEST_BYTES = 64 << 20
"""of a footer or a document that is looked through as a whole"""
_STREAM = re.compile(rb"stream\r?\n")
_LONGEST_STREAM = 1 << 20


def head(path: Path) -> bytes:
    """The first bytes, unzipped where they are gzipped. Raises OSError."""
    with path.open("rb") as file:
        start = file.read(HEAD_BYTES)
    if not start.startswith(b"\x1f\x8b"):
        return start
    try:
        return zlib.decompressobj(31).decompress(start, HEAD_BYTES)
    except zlib.error:
        return b""


def column_names(path: Path) -> tuple[str, ...]:
    """Of a CSV file; of a Parquet file all words of its footer. Raises OSError."""
    start = head(path)
    if start.startswith(b"PAR1"):
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(size - 8, 0))
            footer = min(int.from_bytes(file.read(4), "little") + 8, size, LONGEST_BYTES)
            file.seek(size - footer)
            return tuple(word.decode() for word in re.findall(rb"[A-Za-z]\w*", file.read(footer)))
    line, end, _ = start.decode("utf-8-sig", "replace").partition("\n")
    with contextlib.suppress(InputError):
        return csv_header(line.rstrip("\r"), where=str(path)) if end else ()
    return ()


def pdf_streams(path: Path) -> Iterator[bytes]:
    """The packed parts of a PDF, each up to a bound; of a longer file, or another, none. Raises OSError."""
    if path.stat().st_size > LONGEST_BYTES:
        return
    data = memoryview(path.read_bytes())
    for found in _STREAM.finditer(data):
        with contextlib.suppress(zlib.error):
            yield zlib.decompressobj().decompress(data[found.end() :], _LONGEST_STREAM)

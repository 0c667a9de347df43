"""What a Parquet file unpacks to, from the headers of its pages, before any page is unpacked.

The metadata at the end of a file states sizes, but pyarrow takes the memory for a page by the size in the page's own
header: up to 2 GiB each, which zeros fill from 100 KB of the file. The headers stand in front of the pages, in Thrift's
compact protocol (Apache Parquet, `parquet.thrift`, `PageHeader`; Apache Thrift, "Thrift Compact protocol encoding").
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

ReadAt = Callable[[int, int], bytes]
"""`read(offset, size)`: so many bytes of the file from there; fewer at its end"""
_HEADER_BYTES = 512
"""read at once for one header; most have 20 to 100 bytes"""
_HEADER_MOST = 16 << 20
"""bytes of a header (with its statistics) that pyarrow takes, at most"""
_PADDING = 100
"""bytes by which an early parquet-mr stated columns too short (PARQUET-816); pyarrow reads on so far"""
_DEEPEST = 8
"""structures in structures; a page header has two"""
_TYPE, _UNPACKED, _PACKED = 1, 2, 3
_PAGE_HEADERS = {0: 5, 3: 8}
"""kinds of pages that hold values, and the field with the header of each; its first field is their number"""
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)


def group_bytes(meta: Any, group: int, read: ReadAt) -> int:
    """Bytes to which the pages of a row group unpack, by their headers. Raises ValueError for headers that are none."""
    chunks = meta.row_group(group)
    padding = _PADDING if str(meta.created_by).lower().startswith("parquet-mr") else 0
    return sum(_chunk_bytes(chunks.column(k), padding, read) for k in range(meta.num_columns))


def _chunk_bytes(chunk: Any, padding: int, read: ReadAt) -> int:
    at = chunk.data_page_offset
    if chunk.has_dictionary_page and 0 < chunk.dictionary_page_offset < at:
        at = chunk.dictionary_page_offset
    end = at + chunk.total_compressed_size + padding
    if at < 0 or chunk.num_values < 0:
        raise ValueError("a column begins in front of the file")
    total = values = 0
    # as far as pyarrow reads: until the values that are stated have come
    while values < chunk.num_values and at < end:
        header, size = _page_header(read, at)
        unpacked, packed = header.get(_UNPACKED), header.get(_PACKED)
        if not isinstance(unpacked, int) or not isinstance(packed, int) or unpacked < 0 or packed < 0:
            raise ValueError("a page without a size")
        total += unpacked
        at += size + packed
        inner = header.get(_PAGE_HEADERS.get(header.get(_TYPE, -1), -1))
        count = inner.get(1, 0) if isinstance(inner, dict) else 0
        if isinstance(count, int):
            values += max(count, 0)
    return total


def _page_header(read: ReadAt, at: int) -> tuple[dict[int, Any], int]:
    """The header of a page as field number to value, and its length."""
    size = _HEADER_BYTES
    while True:
        data = read(at, size)
        try:
            return _structure(data, 0, _DEEPEST)
        except IndexError:
            if len(data) < size or size >= _HEADER_MOST:
                raise ValueError("a page header has no end") from None
        size *= 8


def _structure(data: bytes, at: int, deepest: int) -> tuple[dict[int, Any], int]:
    """Fields from `at`, and where they end. Raises IndexError where the data end first."""
    if deepest == 0:
        raise ValueError("a page header of structures in structures")
    fields: dict[int, Any] = {}
    number = 0
    while True:
        head = data[at]
        at += 1
        kind = head & 0x0F
        if kind == _STOP:
            return fields, at
        if head >> 4:
            number += head >> 4
        else:
            raw, at = _varint(data, at)
            number = _signed(raw)
        if kind in (_TRUE, _FALSE):
            fields[number] = kind == _TRUE
        else:
            fields[number], at = _value(data, at, kind, deepest)


def _value(data: bytes, at: int, kind: int, deepest: int) -> tuple[Any, int]:
    if kind in (_I16, _I32, _I64):
        raw, at = _varint(data, at)
        return _signed(raw), at
    if kind == _STRUCT:
        return _structure(data, at, deepest - 1)
    if kind == _BINARY:
        size, at = _varint(data, at)
        return None, _within(data, at + size)
    if kind in (_LIST, _SET):
        head = data[at]
        size, at = _varint(data, at + 1) if head >> 4 == 15 else (head >> 4, at + 1)
        return None, _skipped(data, at, [head & 0x0F] * min(size, len(data) + 1), deepest)
    if kind == _MAP:
        size, at = _varint(data, at)
        if size == 0:
            return None, at
        kinds = data[at]
        return None, _skipped(data, at + 1, [kinds >> 4, kinds & 0x0F] * min(size, len(data) + 1), deepest)
    if kind in (_TRUE, _FALSE, _BYTE):
        return data[at], at + 1
    if kind == _DOUBLE:
        return None, _within(data, at + 8)
    raise ValueError(f"a page header with a field of kind {kind}")


def _skipped(data: bytes, at: int, kinds: list[int], deepest: int) -> int:
    """Where the members of a list or map end."""
    for kind in kinds:
        _, at = _value(data, at, kind, deepest - 1)
    return at


def _within(data: bytes, at: int) -> int:
    if at > len(data):
        raise IndexError
    return at


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("a number of more than 64 bits in a page header")


def _signed(raw: int) -> int:
    """Zigzag: 0, -1, 1, -2, ..."""
    return (raw >> 1) ^ -(raw & 1)

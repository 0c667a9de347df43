"""What a Parquet file unpacks to, from the headers of its pages, before any page is unpacked.

The metadata at the end of a file state sizes, but pyarrow takes the memory for a page by the size in the page's own
header: up to 2 GiB each, which zeros fill from 100 KB of the file. The headers stand in front of the pages, in Thrift's
compact protocol (Apache Parquet, `parquet.thrift`, `PageHeader`; Apache Thrift, "Thrift Compact protocol encoding").

Where the pages of a column are, the metadata say (`FileMetaData`, in the same protocol), and they are read here, too:
asked for the metadata of one column, pyarrow 26 ends the whole process where they contradict the schema
(`SizeStatistics`, encrypted columns), since its C++ exception crosses a function that may raise none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

ReadAt = Callable[[int, int], bytes]
"""`read(offset, size)`: so many bytes of the file from there; fewer at its end"""
_HEADER_BYTES = 512
"""read at once for one header; most have 20 to 100 bytes"""
_HEADER_MOST = 16 << 20
"""bytes of a header (with its statistics) that pyarrow takes, at most"""
_FOOTER_MOST = 32 << 20
"""bytes of the metadata: a column of a row group takes about 150 of them, so 20,000 row groups of ten columns"""
_TAIL = 8
"""bytes behind the metadata: their length and the mark of the format"""
_MARK = b"PAR1"
_PADDING = 100
"""bytes by which an early parquet-mr stated columns too short (PARQUET-816); pyarrow reads on so far"""
_DEEPEST = 16
"""structures and lists in one another; a page header has two, the metadata eight"""
_PAGE_KINDS = {0: 5, 3: 8}
"""kinds of pages that hold values, and the field with the header of each; its first field is their number"""
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(13)

Fields = dict[int, Any]
"""Values of a structure by the number of their field: whole numbers, bytes, structures, lists of structures."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A field of a structure that is kept, if it is of that kind (to pyarrow another is none), and what it is made."""

    kind: int
    fields: Mapping[int, _Wanted] = field(default_factory=dict)
    made: Callable[[Fields], Any] = lambda fields: fields


@dataclass(frozen=True, slots=True)
class Pages:
    """Where the pages of one column of a row group are, and how many values they hold together."""

    begin: int
    size: int
    values: int


@dataclass(frozen=True, slots=True)
class Group:
    """A row group: the unpacked bytes that the metadata state, and the pages of its columns."""

    stated_bytes: int
    columns: tuple[Pages, ...]


def row_groups(read: ReadAt, size: int) -> tuple[Group, ...]:
    """The row groups of a file of `size` bytes. Raises ValueError for metadata that are none, or too long."""
    tail = read(size - _TAIL, _TAIL) if size >= _TAIL else b""
    if tail[4:] != _MARK:
        raise ValueError("it has no end")
    length = int.from_bytes(tail[:4], "little")
    if length > min(size - _TAIL, _FOOTER_MOST):
        raise ValueError(f"metadata of {length} bytes")
    try:
        fields, _ = _structure(read(size - _TAIL - length, length), 0, _DEEPEST, _FOOTER)
    except IndexError:
        raise ValueError("its metadata have no end") from None
    groups: tuple[Group, ...] = tuple(fields.get(_GROUPS, ()))
    if fields.get(_CREATED_BY, b"").lower().startswith(b"parquet-mr"):
        longer = [tuple(Pages(c.begin, c.size + _PADDING, c.values) for c in group.columns) for group in groups]
        groups = tuple(Group(g.stated_bytes, columns) for g, columns in zip(groups, longer, strict=True))
    return groups


def _group(fields: Fields) -> Group:
    return Group(_stated(fields, 2), tuple(fields.get(1, ())))


def _column(fields: Fields) -> Pages:
    if 8 in fields or 9 in fields:
        raise ValueError("a column is encrypted")
    inner = fields.get(3, {})
    begin = _stated(inner, 9)
    dictionary = inner.get(11, 0)
    pages = Pages(dictionary if 0 < dictionary < begin else begin, _stated(inner, 7), _stated(inner, 5))
    if min(pages.begin, pages.size, pages.values) < 0:
        raise ValueError("a column begins in front of the file")
    return pages


def _stated(fields: Fields, number: int) -> int:
    value = fields.get(number)
    if not isinstance(value, int):
        raise ValueError("metadata without a size")
    return value


_CREATED_BY, _GROUPS = 6, 4
_COLUMN = {3: _Wanted(_STRUCT, {number: _Wanted(_I64) for number in (5, 7, 9, 11)}), 8: _Wanted(_STRUCT),
           9: _Wanted(_BINARY)}  # fmt: skip
"""`ColumnChunk`: `meta_data` with num_values, total_compressed_size, data_page_offset and dictionary_page_offset"""
_FOOTER = {
    _GROUPS: _Wanted(_LIST, {1: _Wanted(_LIST, _COLUMN, _column), 2: _Wanted(_I64)}, _group),
    _CREATED_BY: _Wanted(_BINARY),
}
"""`FileMetaData`: the row groups, each with its columns and total_byte_size"""
_TYPE, _UNPACKED, _PACKED = 1, 2, 3
_PAGE = {number: _Wanted(_I32) for number in (_TYPE, _UNPACKED, _PACKED)} | {
    number: _Wanted(_STRUCT, {1: _Wanted(_I32)}) for number in _PAGE_KINDS.values()
}
"""`PageHeader`: its kind, its size unpacked and packed, and the number of values of the kinds that hold some"""


def group_bytes(group: Group, read: ReadAt) -> int:
    """Bytes to which the pages of a row group unpack, by their headers. Raises ValueError for headers that are none."""
    return sum(_column_bytes(pages, read) for pages in group.columns)


def _column_bytes(pages: Pages, read: ReadAt) -> int:
    at, end = pages.begin, pages.begin + pages.size
    total = values = 0
    # as far as pyarrow reads: until the values that are stated have come
    while values < pages.values and at < end:
        header, size = _page_header(read, at)
        unpacked, packed = header.get(_UNPACKED, -1), header.get(_PACKED, -1)
        if unpacked < 0 or packed < 0:
            raise ValueError("a page without a size")
        total += unpacked
        at += size + packed
        values += max(header.get(_PAGE_KINDS.get(header.get(_TYPE, -1), -1), {}).get(1, 0), 0)
    return total


def _page_header(read: ReadAt, at: int) -> tuple[Fields, int]:
    """The header of a page as field number to value, and its length."""
    size = _HEADER_BYTES
    while True:
        data = read(at, size)
        try:
            return _structure(data, 0, _DEEPEST, _PAGE)
        except IndexError:
            if len(data) < size or size >= _HEADER_MOST:
                raise ValueError("a page header has no end") from None
        size *= 8


def _structure(data: bytes, at: int, deepest: int, wanted: Mapping[int, _Wanted]) -> tuple[Fields, int]:
    """The wanted fields from `at`, and where the structure ends. Raises IndexError where the data end first."""
    if deepest == 0:
        raise ValueError("structures in structures in structures")
    fields: Fields = {}
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
        number = _int16(number)
        if kind in (_TRUE, _FALSE):
            continue  # the value is the kind
        keep = wanted.get(number)
        if keep is None or keep.kind != kind:
            _, at = _value(data, at, kind, deepest, None)
        elif number in fields:
            # pyarrow takes parts of the first and parts of the second
            raise ValueError("a field twice")
        else:
            fields[number], at = _value(data, at, kind, deepest, keep)


def _value(data: bytes, at: int, kind: int, deepest: int, keep: _Wanted | None) -> tuple[Any, int]:
    """A value of a kind, as it is wanted, and where it ends; None for a list or map of which nothing is."""
    if kind in (_I16, _I32, _I64):
        raw, at = _varint(data, at)
        return _signed(raw), at
    if kind == _STRUCT:
        fields, at = _structure(data, at, deepest - 1, keep.fields if keep else {})
        return (keep.made(fields) if keep else None), at
    if kind == _BINARY:
        size, at = _varint(data, at)
        end = _within(data, at + size)
        return (data[at:end] if keep else None), end
    if kind in (_LIST, _SET):
        return _members(data, at, deepest, keep)
    if kind == _MAP:
        size, at = _varint(data, at)
        if size == 0:
            return None, at
        kinds = data[at]
        return None, _skipped(data, at + 1, [kinds >> 4, kinds & 0x0F] * min(size, len(data) + 1), deepest)
    if kind in (_TRUE, _FALSE, _BYTE):
        _within(data, at + 1)
        return None, at + 1
    if kind == _DOUBLE:
        return None, _within(data, at + 8)
    raise ValueError(f"a field of kind {kind}")


def _members(data: bytes, at: int, deepest: int, keep: _Wanted | None) -> tuple[Any, int]:
    """What is made of each structure of a list, if they are wanted."""
    head = data[at]
    kind = head & 0x0F
    size, at = _varint(data, at + 1) if head >> 4 == 15 else (head >> 4, at + 1)
    size = min(size, len(data) + 1)
    if keep is None or kind != _STRUCT:
        return None, _skipped(data, at, [kind] * size, deepest)
    members = []
    for _ in range(size):
        fields, at = _structure(data, at, deepest - 2, keep.fields)
        members.append(keep.made(fields))
    return members, at


def _skipped(data: bytes, at: int, kinds: list[int], deepest: int) -> int:
    """Where the members of a list or map end."""
    for kind in kinds:
        _, at = _value(data, at, kind, deepest - 1, None)
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
            return value & 0xFFFF_FFFF_FFFF_FFFF, at  # as pyarrow takes it
        shift += 7
        if shift > 63:
            raise ValueError("a number of more than 64 bits")


def _signed(raw: int) -> int:
    """Zigzag: 0, -1, 1, -2, ..."""
    return (raw >> 1) ^ -(raw & 1)


def _int16(number: int) -> int:
    """As a field's number wraps around."""
    return (number + 0x8000) % 0x10000 - 0x8000

"""What an Arrow (Feather) file unpacks to, from its own description, before anything is unpacked.

pyarrow takes the memory that a batch says it needs at once, and zeros pack 10,000 times. The messages of a file stand
one after the other between its marks (Apache Arrow, Columnar Format, "IPC File Format"); each batch lists its buffers,
and a packed buffer begins with the length of what comes out. Positions are those of the format's own schema
(`Message.fbs`), which is written in FlatBuffers.
"""

from __future__ import annotations

import struct
from typing import Any

FILE_MARK_BYTES = 8
"""`ARROW1` and two bytes to fill up; the stream begins behind it"""
_HEADER_TYPE, _HEADER = 1, 2
_DICTIONARY, _BATCH = 2, 3
"""kinds of headers (`MessageHeader`)"""
_DICTIONARY_DATA = 1
_BUFFERS, _COMPRESSION = 2, 3
_PLAIN = -1
"""length of a buffer that is not packed although the others are"""


def unpacked_bytes(data: Any) -> int:
    """Bytes of all buffers of a file (a buffer of pyarrow's). Raises pyarrow's errors, ValueError, struct.error."""
    import pyarrow as pa

    total = 0
    for message in pa.ipc.MessageReader.open_stream(data.slice(FILE_MARK_BYTES)):
        if message.body is not None:
            total += _of(message.metadata.to_pybytes(), message.body)
    return total


def _of(description: bytes, body: Any) -> int:
    """Bytes that one message unpacks to."""
    top = struct.unpack_from("<I", description)[0]
    kind_at, header = _field(description, top, _HEADER_TYPE), _inner(description, top, _HEADER)
    kind = description[kind_at] if kind_at else 0
    if kind == _DICTIONARY and header:
        header = _inner(description, header, _DICTIONARY_DATA)
    if kind not in (_DICTIONARY, _BATCH) or not header:
        return 0
    buffers = _inner(description, header, _BUFFERS)
    if not buffers or not _field(description, header, _COMPRESSION):
        return int(body.size)
    total = 0
    for k in range(struct.unpack_from("<I", description, buffers)[0]):
        begin, size = struct.unpack_from("<qq", description, buffers + 4 + 16 * k)
        if size == 0:
            continue
        if begin < 0 or size < 8 or begin + size > body.size:
            raise ValueError("a buffer lies outside of its batch")
        length = struct.unpack("<q", body.slice(begin, 8).to_pybytes())[0]
        if length < _PLAIN:
            raise ValueError(f"a buffer of {length} bytes")
        total += size - 8 if length == _PLAIN else length
    return total


def _field(description: bytes, table: int, number: int) -> int:
    """Where a field of a table stands; 0 for one that is not there."""
    rows = table - struct.unpack_from("<i", description, table)[0]
    if rows < 0 or 4 + 2 * number >= struct.unpack_from("<H", description, rows)[0]:
        return 0
    offset = struct.unpack_from("<H", description, rows + 4 + 2 * number)[0]
    return table + offset if offset else 0


def _inner(description: bytes, table: int, number: int) -> int:
    """Where the table or vector begins that a field refers to; 0 for none."""
    at = _field(description, table, number)
    return int(at + struct.unpack_from("<I", description, at)[0]) if at else 0

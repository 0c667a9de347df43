"""What an MCAP file unpacks to, from its chunks' own headers, before anything is unpacked.

The library unpacks a chunk at once, as far as the packed stream says, whatever the chunk's header says; the packings'
libraries come with it. Layout of records: the MCAP specification, "Records" and "Chunk (op=0x06)".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from importlib import import_module

MAGIC_BYTES = 8
_CHUNK = 6
_RECORD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
"""first and last time, bytes unpacked, their sum, length of the name of the packing"""


def unpacked_chunks(data: bytes) -> tuple[int, frozenset[int]]:
    """Bytes of all chunks, and where they begin. Raises ValueError, struct.error and the packings' own errors."""
    total, begins = 0, set[int]()
    for begin, content in _chunks(memoryview(data)):
        begins.add(begin)
        total += _unpacked(content)
    return total, frozenset(begins)


def _chunks(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    place = MAGIC_BYTES
    while place + _RECORD.size <= len(data) - MAGIC_BYTES:
        kind, size = _RECORD.unpack_from(data, place)
        begin = place + _RECORD.size
        if begin + size > len(data):
            raise ValueError("a record is longer than the file")
        if kind == _CHUNK:
            yield place, data[begin : begin + size]
        place = begin + size


def _unpacked(chunk: memoryview) -> int:
    *_, said, _sum, letters = _CHUNK_HEAD.unpack_from(chunk)
    name_end = _CHUNK_HEAD.size + letters
    packing = bytes(chunk[_CHUNK_HEAD.size : name_end])
    (size,) = struct.unpack_from("<Q", chunk, name_end)
    packed = chunk[name_end + 8 : name_end + 8 + size]
    if packing == b"zstd":
        # what the stream itself says goes before what the header says
        if (content := import_module("zstandard").frame_content_size(packed)) > said:
            raise ValueError(f"a chunk of {said} bytes holds {content}")
    elif packing == b"lz4":
        _refuse_longer_lz4(packed, said)
    elif said < len(packed):
        return len(packed)
    return int(said)


def _refuse_longer_lz4(packed: memoryview, said: int) -> None:
    stream, count, piece_bytes = import_module("lz4.frame").LZ4FrameDecompressor(), 0, 1 << 20
    given = packed
    while not stream.eof:
        piece = stream.decompress(given, max_length=piece_bytes)
        count += len(piece)
        given = memoryview(b"")
        if count > said:
            raise ValueError(f"a chunk of {said} bytes holds more")
        if not piece and stream.needs_input:
            return  # torn: the library says so

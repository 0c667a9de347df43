"""What came over a serial wire, with the time at which it came: the project's own segments.

    file    "HSWIRE1\\n", then one line of JSON (tool, codec, link, ...), then records
    record  length of the data (u32), wall-clock time and monotonic time in s (two f64), data, CRC-32 of all before it

All numbers are little-endian. A record is appended in one write; a process that is killed leaves at most a torn record
at the end, which its length or its CRC tells. Reading stops at the last complete record and says how many bytes behind
it could not be read.
"""

from __future__ import annotations

import gzip
import json
import struct
import zlib
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from highside.errors import InputError
from highside.reading import open_binary, parse_json
from highside.recording.candump import looks_like_candump

MAGIC = b"HSWIRE1\n"
SUFFIX = ".hsw"
MAX_RECORD_BYTES = 1 << 24
_HEAD = struct.Struct("<Idd")
_CRC = struct.Struct("<I")
_MAX_META_BYTES = 1 << 16
_REMEDY = "give the original file"


class Record(NamedTuple):
    """Bytes as they were read; the same shape as the links' chunks."""

    t_mono: float
    t_wall: float
    data: bytes


class WireKind(Enum):
    """What a wire recording is."""

    SEGMENTS = "segments"
    """this module's files"""
    CANDUMP = "candump"
    """`candump -L` text"""
    RAW = "raw"
    """bytes and nothing else"""


def encode_header(meta: Mapping[str, Any]) -> bytes:
    """The beginning of a file; `meta` is anything that JSON can say."""
    return MAGIC + json.dumps(dict(meta), ensure_ascii=True, sort_keys=True).encode("ascii") + b"\n"


def encode_record(record: tuple[float, float, bytes]) -> bytes:
    """One record from (t_mono, t_wall, data), as links deliver them. Raises ValueError for too long data."""
    t_mono, t_wall, data = record
    if len(data) > MAX_RECORD_BYTES:
        raise ValueError(f"a record holds at most {MAX_RECORD_BYTES} bytes")
    content = _HEAD.pack(len(data), t_wall, t_mono) + data
    return content + _CRC.pack(zlib.crc32(content))


class SegmentReader:
    """Iterates the records of a file. `meta` is its header; `torn_bytes` is known after the last record."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.torn_bytes = 0
        self.meta: dict[str, Any] = {}
        with open_binary(path) as file:
            self._read_header(file)

    def _read_header(self, file: BinaryIO) -> None:
        start = _read(file, len(MAGIC))
        if not start:
            raise InputError(
                "is empty: the service was ended before any data came for this file; nothing was lost with it",
                where=str(self.path),
                remedy="leave it out, or give the recording before or behind it",
            )
        if start != MAGIC:
            raise InputError("is not a wire recording of highside", where=str(self.path))
        line = _read_line(file)
        if not line.endswith(b"\n") and len(line) < _MAX_META_BYTES:
            raise InputError("ends inside its header; it holds no data", where=str(self.path))
        meta = parse_json(line, where=f"{self.path}: header", kind="header of a wire recording", remedy=_REMEDY)
        if not isinstance(meta, dict):
            raise InputError("is no header of a wire recording", where=f"{self.path}: header", remedy=_REMEDY)
        self.meta = meta

    def __iter__(self) -> Iterator[Record]:
        self.torn_bytes = 0
        with open_binary(self.path) as file:
            self._read_header(file)
            while True:
                head = _read(file, _HEAD.size)
                if not head:
                    return
                length, t_wall, t_mono = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, 0.0, 0.0)
                rest = b""
                if len(head) == _HEAD.size and length <= MAX_RECORD_BYTES:
                    rest = _read(file, length + _CRC.size)
                    content = head + rest[:length]
                    if len(rest) == length + _CRC.size and _CRC.pack(zlib.crc32(content)) == rest[length:]:
                        yield Record(t_mono, t_wall, rest[:length])
                        continue
                self.torn_bytes = len(head) + len(rest)
                while more := _read(file, 1 << 20):
                    self.torn_bytes += len(more)
                return


def read_segments(path: Path) -> SegmentReader:
    """Open a file of segments; raises InputError if it is none."""
    return SegmentReader(path)


def detect_kind(path: Path) -> WireKind:
    """What a wire recording (plain or gzipped) is, by its first bytes. Raises InputError for a missing file."""
    with open_binary(path) as file:
        start = _read(file, 4096)
    if start.startswith(MAGIC) or (not start and path.name.removesuffix(".gz").endswith(SUFFIX)):
        return WireKind.SEGMENTS
    if looks_like_candump(start):
        return WireKind.CANDUMP
    return WireKind.RAW


def _read(file: BinaryIO, size: int) -> bytes:
    """Up to `size` bytes; what a torn gzip file does not give is not there. Raises InputError for a failing disk."""
    pieces = []
    try:
        while size > 0 and (piece := file.read(size)):
            pieces.append(piece)
            size -= len(piece)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        pass
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", where=str(getattr(file, "name", ""))) from None
    return b"".join(pieces)


def _read_line(file: BinaryIO) -> bytes:
    try:
        return file.readline(_MAX_META_BYTES)
    except (EOFError, zlib.error, gzip.BadGzipFile):
        return b""

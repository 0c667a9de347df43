"""The front of the outbox's file: an append log, to which a commit costs one page of the disk.

A commit of one message into SQLite's write-ahead log touches two or three pages, and each of them is written twice.
Here a message is a record of its own, a record that does not fit into the rest of a page begins on the next one, and
what is appended is synced before `append` returns: one message of up to 4 KB is one page of 4 KiB.

Each record carries a checksum and the generation of the log. To begin anew nothing is erased: the next generation is
written over the one before, from the first page on, and only records of the newest generation count. So the file keeps
its length, and after it has been filled once an append changes no metadata of the file system (it is filled with zeros
ahead of use: a journalling file system writes three to five pages of its own for each commit that makes a file grow).
Damage costs the records of its page. No generation goes on after the process has ended: what a torn write has left
behind the last good record is never taken for something that was appended later.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from struct import Struct, error
from typing import NamedTuple
from zlib import crc32

from highside.service.sequence import sync_directory

PAGE = 4096
"""Bytes of a page of the kernel's cache: what is written at least."""
LOG_BYTES = 1 << 20
"""The log's length at most: 256 pages, four minutes of ten messages a second. What is in it is in memory, too, about 1
KB a message: with twice the length a service grew by 6.4 MiB in 600 s without its broker."""
LONGEST_LOG = 2 << 20
"""Of earlier versions; read to its end."""
AHEAD = 64 * 1024
"""Bytes by which the file is made longer at once."""
BOOT_ID_LETTERS = 8
"""Of the boot id, kept with each row: two boots of one machine share them once in 4e9."""

_HEAD = Struct("<IIQB")
"""CRC-32 of what follows it, bytes of the body, generation, kind."""
_ROW = Struct("<qqddBBHH")
"""id, number, wall and boot time, QoS, whether synchronised, bytes of the topic and of the boot id."""
_KIND_ROW, _KIND_GONE = 1, 2
_GONE = Struct("<q")


class StoredMessage(NamedTuple):
    """One message; `id` grows in the order of `put`."""

    id: int
    topic: str
    seq: int
    created_s: float
    qos: int
    payload: bytes
    boot_id: str
    """of the boot in which it was made, first letters; empty if not known"""
    boot_s: float
    """when it was made by the boot clock, which tells its age within that boot"""
    synced: bool
    """whether `created_s` can be trusted"""
    put_mono: float = 0.0
    """when it was put, monotonic; not in the file"""

    @property
    def wall_s(self) -> float:
        return self.created_s

    @property
    def size(self) -> int:
        return len(self.payload) + len(self.topic)

    @property
    def checksum(self) -> int:
        return crc32(self.payload, crc32(b"%d" % self.seq, crc32(self.topic.encode("utf-8", errors="replace"))))


class LogFull(Exception):  # noqa: N818 - nothing has gone wrong
    """There is no room for that many bytes in this generation."""


class CommitLog:
    """Belongs to one thread; every method may raise OSError when the disk refuses."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1
        self._at = self._length = 0
        self.generation = 0

    def begin(self, generation: int) -> int:
        """What is appended from now on belongs to `generation`; all before it counts no more. Returns the open file's
        descriptor."""
        if self._descriptor < 0:
            new = not self._path.exists()
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
            self._length = os.fstat(self._descriptor).st_size // PAGE * PAGE
            if new:
                sync_directory(self._path.parent)
        self._at, self.generation = 0, generation
        return self._descriptor

    def append(self, rows: Iterable[StoredMessage], gone: Iterable[int]) -> None:
        """Returns when it would survive a loss of power. Raises LogFull, with nothing written."""
        first = at = self._at
        pieces: list[bytes] = []
        records = [_record(self.generation, _KIND_ROW, _body(row)) for row in rows]
        if ids := b"".join(map(_GONE.pack, gone)):
            records.append(_record(self.generation, _KIND_GONE, ids))
        for record in records:
            room = -at % PAGE
            if len(record) > room > 0:
                if pieces:
                    pieces.append(bytes(room))
                else:
                    first += room  # not even zeros: they would be a page more
                at += room
            pieces.append(record)
            at += len(record)
        if at > LOG_BYTES:
            raise LogFull
        self._make_room(at)
        content = b"".join(pieces)
        if os.pwrite(self._descriptor, content, first) != len(content):
            raise OSError(0, "the disk took a part only")
        os.fdatasync(self._descriptor)
        self._at = at

    def _make_room(self, end: int) -> None:
        """Zeros up to `end` and further, page by page: the kernel keeps what was written by one call as one piece, and
        would count (on some file systems write) the whole of it for each message in it."""
        while self._length < end:
            for at in range(self._length, min(self._length + AHEAD, LOG_BYTES), PAGE):
                if os.pwrite(self._descriptor, bytes(PAGE), at) != PAGE:
                    raise OSError(0, "the disk took a part only")
                self._length = at + PAGE

    def close(self) -> None:
        """Give the file back; what was appended is on the disk already."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = -1


def read_log(path: Path) -> tuple[int, dict[int, StoredMessage]]:
    """The newest generation in a log and the rows in it that are not gone, by id; 0 and none where there is no log.

    Raises OSError.
    """
    try:
        with path.open("rb") as file:
            # in single pages, not as one piece: see `_make_room`
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_RANDOM)
            content = file.read(LONGEST_LOG)
    except FileNotFoundError:
        return 0, {}
    generations: dict[int, dict[int, StoredMessage]] = {}
    gone: dict[int, set[int]] = {}
    for generation, kind, body in _records(content):
        rows = generations.setdefault(generation, {})
        if kind == _KIND_GONE:
            gone.setdefault(generation, set()).update(row_id for (row_id,) in _GONE.iter_unpack(body))
        elif (row := _parse(body)) is not None:
            rows[row.id] = row
    if not generations:
        return 0, {}
    newest = max(generations)
    spare = gone.get(newest, set())
    return newest, {row_id: row for row_id, row in generations[newest].items() if row_id not in spare}


def _records(content: bytes) -> Iterator[tuple[int, int, bytes]]:
    at = 0
    while at + _HEAD.size <= len(content):
        checksum, length, generation, kind = _HEAD.unpack_from(content, at)
        end = at + _HEAD.size + length
        if kind and end <= len(content) and crc32(content[at + 4 : end]) == checksum:
            yield generation, kind, content[at + _HEAD.size : end]
            at = end
        else:
            # the rest of a page, or damage: records begin anew with the next one
            at += PAGE - at % PAGE


def _record(generation: int, kind: int, body: bytes) -> bytes:
    rest = _HEAD.pack(0, len(body), generation, kind)[4:] + body
    return crc32(rest).to_bytes(4, "little") + rest


def _body(row: StoredMessage) -> bytes:
    topic, boot_id = row.topic.encode(), row.boot_id.encode()
    head = _ROW.pack(row.id, row.seq, row.created_s, row.boot_s, row.qos, row.synced, len(topic), len(boot_id))
    return head + topic + boot_id + row.payload


def _parse(body: bytes) -> StoredMessage | None:
    try:
        row_id, seq, created_s, boot_s, qos, synced, topic_size, boot_size = _ROW.unpack_from(body)
        at = _ROW.size + topic_size
        topic, boot_id = body[_ROW.size : at].decode(), body[at : at + boot_size].decode()
    except (error, UnicodeDecodeError):
        return None
    return StoredMessage(row_id, topic, seq, created_s, qos, body[at + boot_size :], boot_id, boot_s, bool(synced))

"""Sequence numbers that are never used twice: blocks of them are reserved on disk before one is used.

The file holds, for each topic, the first number that is *not* reserved. It has two slots that are overwritten in turn,
each with a generation and a checksum, so that a write that power cuts short damages the slot it was writing and leaves
the one before, and no reservation counts before its slot is on the disk. Overwriting in place needs no room: it works
on a full disk, too. An orderly end writes the numbers as they stand; after any other end the numbering goes on where
the reservation ended, up to `BLOCK` numbers further on.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from struct import Struct, error
from typing import NamedTuple
from zlib import crc32

from highside.service.outbox_places import Places

BLOCK = 200
"""Numbers reserved at a time: the most that is omitted after a crash. At 10 messages a second, where the next block is
reserved when half of this one is used, a page of 4 KiB is written every 10 s: 41 bytes a message."""
SAFETY = 10 * BLOCK
"""Numbers omitted where the newest slot cannot be read: how far it may have been ahead of what can be."""
_SLOT_BYTES = 16_384
"""About 300 topics; a slot begins on a page of its own. Grows if need be."""
_MAGIC = b"HSQ1"
_HEAD = Struct("<4sIIQB")
"""Mark, CRC-32 of what follows it, bytes after the head, generation, whether the run ended in order."""
_ENTRY = Struct("<QH")


class Numbers(NamedTuple):
    """What the file says."""

    first_free: dict[str, int]
    """the first number that may be used, by topic"""
    orderly: bool
    """whether the last run ended in order: then no number is omitted"""
    sound: bool
    """False: a slot is damaged, and numbers beyond these may have been used"""


class SequenceFile:
    """The reservations of one outbox. Belongs to one thread."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor = -1
        self._places = Places()
        self._slot_bytes = _SLOT_BYTES
        self._generation = 0

    def open(self) -> Numbers:
        """Open or make the file and say what it holds. Raises OSError."""
        self.close()
        descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        try:
            size = os.fstat(descriptor).st_size
            new = size == 0
            if new:
                # the blocks are taken now: an overwrite needs no room on a full disk
                os.pwrite(descriptor, bytes(2 * self._slot_bytes), 0)
            else:
                self._slot_bytes = max(size // 2, _HEAD.size)
            slots = [_parse(os.pread(descriptor, self._slot_bytes, i * self._slot_bytes)) for i in (0, 1)]
        except OSError:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self._places.note(self._path, descriptor)
        found = sorted((slot for slot in slots if slot is not None and slot[0] > 0), key=lambda slot: slot[0])
        if not found:
            self._generation = 0
            # nothing was ever written (a new file, or power was cut while it was made), or nothing can be read
            return Numbers({}, new, all(slot is not None for slot in slots))
        self._generation, numbers, orderly = found[-1]
        sound = all(slot is not None for slot in slots)
        return Numbers(numbers, orderly and sound, sound)

    def write(self, first_free: Mapping[str, int], *, orderly: bool = False) -> None:
        """Returns when the reservation would survive a loss of power. Raises OSError."""
        if self._descriptor < 0:
            raise OSError(0, "the file of sequence numbers is not open")
        content = _render(self._generation + 1, first_free, orderly)
        if len(content) > self._slot_bytes:
            self._grow(content)
        else:
            at = (self._generation + 1) % 2 * self._slot_bytes
            if os.pwrite(self._descriptor, content, at) != len(content):
                raise OSError(0, "the disk took a part only")
            if self._generation == 0:
                os.fsync(self._descriptor)
                sync_directory(self._path.parent)
            else:
                os.fdatasync(self._descriptor)
        self._generation += 1

    def moved(self) -> bool:
        """Whether the path leads to no file, or to another than is open."""
        return self._places.moved(self._path)

    def _grow(self, content: bytes) -> None:
        """A larger file, written beside and renamed."""
        slot_bytes = self._slot_bytes
        while slot_bytes < len(content):
            slot_bytes *= 2
        beside = self._path.with_name(self._path.name + ".new")
        descriptor = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o640)
        try:
            os.pwrite(descriptor, bytes(2 * slot_bytes), 0)
            os.pwrite(descriptor, content, (self._generation + 1) % 2 * slot_bytes)
            os.fsync(descriptor)
            beside.replace(self._path)
            sync_directory(self._path.parent)
        except OSError:
            os.close(descriptor)
            raise
        os.close(self._descriptor)
        self._descriptor, self._slot_bytes = descriptor, slot_bytes
        self._places.note(self._path, descriptor)

    def close(self) -> None:
        """Give the file back; what was written is on the disk already."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = -1
        self._places.forget(self._path)


def _render(generation: int, first_free: Mapping[str, int], orderly: bool) -> bytes:
    body = b""
    for topic, number in first_free.items():
        name = topic.encode("utf-8", errors="surrogatepass")
        body += _ENTRY.pack(number, len(name)) + name
    head = _HEAD.pack(_MAGIC, 0, len(body), generation, orderly)
    return head[:4] + crc32(head[8:] + body).to_bytes(4, "little") + head[8:] + body


def _parse(slot: bytes) -> tuple[int, dict[str, int], bool] | None:
    """Generation, numbers, orderly; generation 0 for a slot that was never written; None for a damaged one."""
    if not any(slot[: _HEAD.size]):
        return 0, {}, False
    try:
        mark, checksum, length, generation, orderly = _HEAD.unpack_from(slot)
        if mark != _MAGIC or length > len(slot) - _HEAD.size:
            return None
        body = slot[_HEAD.size : _HEAD.size + length]
        if crc32(slot[8 : _HEAD.size] + body) != checksum:
            return None
        numbers, at = {}, 0
        while at < length:
            number, size = _ENTRY.unpack_from(body, at)
            at += _ENTRY.size + size
            numbers[body[at - size : at].decode("utf-8", errors="surrogatepass")] = number
    except (error, UnicodeDecodeError):
        return None
    return generation, numbers, bool(orderly)


def sync_directory(directory: Path) -> None:
    """Make a new name in it survive a loss of power. Raises OSError."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

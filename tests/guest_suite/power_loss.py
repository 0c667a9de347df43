"""A disk whose power can be cut: everything written to it is logged by dm-log-writes, and played back up to any point.

The kernel's log-writes target sends every write to the disk and, once the disk was told to flush, also to a log: what
was not flushed before an entry of the log stands behind it. Played back up to an entry, the log is the disk as a power
cut leaves it that takes away all that was not synced: the worst that a disk may do without lying. `mark` puts a name
into the log; played back up to a mark, the disk must hold whatever was promised before that mark.

Format of the log (kernel, drivers/md/dm-log-writes.c): a super block (magic, version, number of entries, sector size),
then entries of one sector (sector, number of sectors, flags, length of the mark's text, text), each but a discard
followed by its sectors.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

MIB = 1 << 20
SECTOR = 512
MAGIC = 0x6A736677736872
FLUSH, FUA, DISCARD, MARK = 1, 2, 4, 8
LAST = "dm-log-writes-end"
"""the mark that the kernel sets when the disk is taken away"""
_SUPER = struct.Struct("<QQQI")
_ENTRY = struct.Struct("<QQQQ")
_numbers = itertools.count()


def run(*command: object) -> str:
    """A command that must succeed; its output."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(map(str, command))}: {done.stderr}{done.stdout}"
    return done.stdout.strip()


@dataclass(frozen=True, slots=True)
class Cut:
    """A point of the log at which the power may fail: a flush that was carried out, or a mark.

    `entry`: number of the last entry that is on the disk; `mark`: the last mark before it.
    """

    entry: int
    mark: str | None
    is_mark: bool


@dataclass(frozen=True, slots=True)
class _Entry:
    sector: int
    flags: int
    data: bytes
    name: str


class LoggedDisk:
    """A disk of its own with ext4, mounted at `place` until `unmount`; `directory` takes the images (guest memory)."""

    def __init__(self, directory: Path, place: Path, *, size_mib: int = 32, log_mib: int = 192) -> None:
        self.place = place
        self._directory = directory
        self._size = size_mib * MIB
        self._name = f"powerloss{next(_numbers)}"
        data, self._log = directory / f"{self._name}.disk", directory / f"{self._name}.log"
        for path, size in ((data, size_mib), (self._log, log_mib)):
            with path.open("wb") as file:
                file.truncate(size * MIB)
        run("modprobe", "-a", "loop", "dm-mod", "dm-log-writes")
        self._loops = [run("losetup", "--find", "--show", path) for path in (data, self._log)]
        table = f"0 {self._size // SECTOR} log-writes {self._loops[0]} {self._loops[1]}"
        run("dmsetup", "create", self._name, "--noudevsync", "--noudevrules", "--table", table)
        run("dmsetup", "mknodes")
        device = f"/dev/mapper/{self._name}"
        # everything is written at once: the kernel's lazy initialisation would go on for minutes behind the tests
        run("mkfs.ext4", "-q", "-E", "lazy_itable_init=0,lazy_journal_init=0", "-J", "size=4", device)
        place.mkdir(parents=True, exist_ok=True)
        # a commit of the journal by itself would hide a sync that is missing: only after five minutes
        run("mount", "-o", "commit=300,noatime", device, place)
        run("sync")
        self.mark("mounted")

    def mark(self, name: str) -> None:
        """Put a name into the log: here the promises made so far are due."""
        run("dmsetup", "message", self._name, "0", "mark", name)

    def unmount(self) -> None:
        """Take the disk away; the log is complete then."""
        run("umount", self.place)
        run("dmsetup", "remove", "--noudevsync", self._name)
        for loop in self._loops:
            run("losetup", "--detach", loop)
        os.sync()

    def cuts(self) -> list[Cut]:
        """Every point at which the power may fail, in order."""
        found, mark = [], None
        for number, entry in enumerate(self._entries()):
            if entry.flags & MARK:
                mark = entry.name
            if entry.flags & (MARK | FLUSH | FUA):
                found.append(Cut(number, mark, bool(entry.flags & MARK)))
        return found

    @contextlib.contextmanager
    def after(self, cuts: list[Cut], place: Path) -> Iterator[Iterator[tuple[Cut, Path]]]:
        """Iterates over the disk as each cut leaves it, mounted (the file system mends itself as after a real cut)."""
        image, copy = self._directory / "replayed", self._directory / "cut"
        place.mkdir(parents=True, exist_ok=True)
        yield self._after(cuts, place, image, copy)
        for path in (image, copy):
            path.unlink(missing_ok=True)

    def _after(self, cuts: list[Cut], place: Path, image: Path, copy: Path) -> Iterator[tuple[Cut, Path]]:
        wanted = {cut.entry: cut for cut in cuts}
        with image.open("wb") as file:
            file.truncate(self._size)
        with image.open("r+b") as disk:
            for number, entry in enumerate(self._entries()):
                if entry.data:
                    disk.seek(entry.sector * SECTOR)
                    disk.write(entry.data)
                cut = wanted.get(number)
                if cut is None:
                    continue
                disk.flush()
                run("cp", "--sparse=always", image, copy)
                run("mount", "-o", "loop,noatime", copy, place)
                try:
                    yield cut, place
                finally:
                    run("umount", place)

    def _entries(self) -> Iterator[_Entry]:
        with self._log.open("rb") as file:
            magic, _, count, size = _SUPER.unpack(file.read(_SUPER.size))
            assert magic == MAGIC and size == SECTOR, "not a log of dm-log-writes"
            file.seek(SECTOR)
            for _ in range(count):
                head = file.read(SECTOR)
                sector, sectors, flags, length = _ENTRY.unpack_from(head)
                name = head[_ENTRY.size : _ENTRY.size + length].decode("ascii", "replace").rstrip("\0")
                data = b"" if flags & DISCARD else file.read(sectors * SECTOR)
                yield _Entry(sector, flags, data, name)

"""The journal of a session on the disk: one file a session, appended, flushed line by line, never rewritten.

A line is handed over in one write and flushed to the disk before anybody is notified of it. A write that fails
leaves the file as it was (a torn line is cut off again). The file is locked while a session goes on in it, so that two
processes cannot. Going on cuts off what the end of the last process tore.

A file that somebody deletes or moves away under the session is noticed with the next line, and written anew at its
place with all that it held: a pose counts as kept only if it will be found. Where another file was put there, that one
is left alone and the write fails.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from highside.bench.session.entries import Entry
from highside.bench.session.journal import Encoder, Header, Journal, StorageError, read_journal
from highside.errors import InputError
from highside.reading import read_bytes
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import flush_directory, make_directory
from highside.recording.in_place import is_at
from highside.recording.locks import lock

log = logging.getLogger("highside")

SUFFIX = ".journal"
_FIRST = b'{"n":0,'
_NAME = re.compile(r"^(?P<tool>.+)_\d{8}T\d{6}Z(?:-\d+)?\.journal$")


def is_journal(path: Path, data: bytes) -> bool:
    """Whether what a file holds is the journal of a session: by its name or, under another, by how it begins."""
    return path.suffix == SUFFIX or data.startswith(_FIRST)


class JournalFile:
    """The open journal of one session."""

    def __init__(self, path: Path, descriptor: int, encoder: Encoder, size: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._encoder = encoder
        self._size = size

    @classmethod
    def create(cls, directory: Path, header: Header) -> JournalFile:
        """A new file, with its first line on the disk. Raises InputError where it cannot be made."""
        try:
            make_directory(directory)
            path = directory / f"{header.session}{SUFFIX}"
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, 0o644)
        except FileExistsError:
            raise InputError("there is a session of this name already", where=str(directory)) from None
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", where=str(directory)) from None
        try:
            _lock(path, descriptor)
        except InputError:
            os.close(descriptor)
            raise
        encoder = Encoder()
        out = cls(path, descriptor, encoder, 0)
        try:
            out._append(encoder.header(header))
            flush_directory(directory)
        except (StorageError, OSError) as error:
            out.close()
            path.unlink(missing_ok=True)
            raise InputError(f"cannot be written: {error}", where=str(path)) from None
        return out

    @classmethod
    def reopen(cls, path: Path) -> tuple[JournalFile, Journal]:
        """Go on in a file. Raises InputError for what is no journal, is damaged, or is in use."""
        try:
            descriptor = os.open(path, os.O_RDWR | OPEN_FLAGS)
        except OSError as error:
            raise InputError(f"cannot be opened: {error.strerror}", where=str(path)) from None
        try:
            _lock(path, descriptor)
            journal = read_journal(read_bytes(path), where=str(path))
            os.ftruncate(descriptor, journal.good_bytes)
            os.lseek(descriptor, journal.good_bytes, os.SEEK_SET)
            os.fsync(descriptor)
        except OSError as error:
            os.close(descriptor)
            raise InputError(f"cannot be written: {error.strerror}", where=str(path)) from None
        except InputError:
            os.close(descriptor)
            raise
        return cls(path, descriptor, journal.encoder, journal.good_bytes), journal

    def write(self, entry: Entry, t_wall_s: float) -> None:
        """Keep an entry; on the disk when this returns. Raises StorageError; the file is then as it was before."""
        before = self._encoder.mark()
        try:
            self._append(self._encoder.entry(entry, t_wall_s))
        except StorageError:
            self._encoder.back_to(before)
            raise

    def _append(self, line: bytes) -> None:
        try:
            view = memoryview(line)
            while view:
                view = view[os.write(self._descriptor, view) :]
            os.fsync(self._descriptor)
            if not is_at(self.path, self._descriptor):
                self._begin_anew(self._size + len(line))
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
                os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise StorageError(f"{self.path}: {error.strerror}") from error
        self._size += len(line)

    def _begin_anew(self, size: int) -> None:
        """A new file with all that this one holds. Raises OSError, where another is there FileExistsError."""
        content = b""
        while len(content) < size and (piece := os.pread(self._descriptor, size - len(content), len(content))):
            content += piece
        make_directory(self.path.parent)
        descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | OPEN_FLAGS, 0o644)
        try:
            lock(descriptor)
            view = memoryview(content)
            while view:
                view = view[os.write(descriptor, view) :]
            os.fsync(descriptor)
            flush_directory(self.path.parent)
        except OSError:
            os.close(descriptor)
            self.path.unlink(missing_ok=True)
            raise
        os.close(self._descriptor)
        self._descriptor = descriptor
        log.warning("%s was deleted or moved away in the middle of its session; it is written anew", self.path)

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _lock(path: Path, descriptor: int) -> None:
    try:
        lock(descriptor)
    except OSError:
        raise InputError("another process drives this session", where=str(path), remedy="end that one first") from None


def session_name(directory: Path, tool_id: str, t_wall_s: float) -> str:
    """A name that no session in the directory has yet."""
    base = f"{tool_id}_{datetime.fromtimestamp(t_wall_s, UTC):%Y%m%dT%H%M%SZ}"
    name, number = base, 1
    while (directory / f"{name}{SUFFIX}").exists():
        number += 1
        name = f"{base}-{number}"
    return name


@dataclass(frozen=True, slots=True)
class FoundJournal:
    """A session of a tool on the disk. `state`: how it ended, "unfinished", "not begun", "in use" or "damaged"."""

    path: Path
    state: str
    plan: str = ""
    done: int = 0
    poses: int | None = None
    t_wall_s: float | None = None
    resumable: bool = False

    @property
    def name(self) -> str:
        return self.path.name.removesuffix(SUFFIX)

    @property
    def held(self) -> bool:
        """Whether somebody is at it."""
        return self.state == "in use"

    @property
    def progress(self) -> str:
        return f"{self.done} poses" if self.poses is None else f"{self.done} of {self.poses} poses"


def sessions(directory: Path, tool_id: str, is_stored: Callable[[str], bool]) -> Iterator[FoundJournal]:
    """The sessions of a tool, the newest first, each read on request."""
    for path in journals(directory, tool_id):
        yield found_journal(path, is_stored)


def journals(directory: Path, tool_id: str | None = None) -> list[Path]:
    """The journals of a tool, or of all, those written last first; none where there is no such directory."""
    if not directory.is_dir():
        return []
    named = [(path, _NAME.match(path.name)) for path in directory.glob(f"*{SUFFIX}")]
    paths = [path for path, m in named if m and tool_id in (None, m["tool"])]
    return sorted(paths, key=lambda p: (p.stat().st_mtime_ns, p.name), reverse=True)


def found_journal(path: Path, is_stored: Callable[[str], bool]) -> FoundJournal:
    """How the session of a journal stands; `is_stored` says of a record's id whether it is kept."""
    try:
        journal = read_journal(read_bytes(path), where=str(path))
    except InputError:
        return FoundJournal(path, "damaged")
    ledger, plan = journal.ledger(), journal.header.plan
    ended, done = ledger.ended, len(ledger.done)
    if ended is not None:
        kept = ended.record is None or is_stored(ended.record)
        state, resumable = (ended.how, False) if kept else ("accepted, its record not stored yet", True)
    elif _in_use(path):
        state, resumable = "in use", False
    else:
        # one in which nothing was measured has nothing to go on with
        state, resumable = ("unfinished" if ledger.began else "not begun"), done > 0
    poses = None if plan.open_ended else len(plan.poses)
    return FoundJournal(path, state, plan.title, done, poses, journal.header.t_wall_s, resumable)


def _in_use(path: Path) -> bool:
    """Whether a process drives the session."""
    try:
        with path.open("rb") as file:
            lock(file.fileno(), shared=True)
    except OSError:
        return True
    return False


def unfinished(directory: Path, tool_id: str, is_stored: Callable[[str], bool]) -> FoundJournal | None:
    """The newest session that may be gone on with: one with poses that has not ended, or whose accepted record is not
    stored yet; None: none."""
    return next((found for found in sessions(directory, tool_id, is_stored) if found.resumable), None)


def to_offer(directory: Path, tool_id: str, is_stored: Callable[[str], bool]) -> FoundJournal | None:
    """The session to offer to whoever begins a new one: unfinished, and none with poses has come to its end since."""
    for found in sessions(directory, tool_id, is_stored):
        if found.resumable:
            return found
        if found.done and not found.held:
            return None
    return None

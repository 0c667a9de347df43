"""What is in a calibration store and among the journals of bench sessions; nothing is written or locked.

Names that a browser sends are looked up among those that are there and never made into a path. What was read once is
kept while its file is the same. Not for several threads at once: its user takes turns.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.bench.journal_file import FoundJournal, found_journal, journals
from highside.bench.photographs import Found, photographs
from highside.bench.session.journal import Journal, read_journal
from highside.calibration.record import CalibrationRecord
from highside.calibration.summary import summary
from highside.errors import HighsideError, InputError
from highside.reading import read_bytes
from highside.recording.calibration_store import Activation, CalibrationStore
from highside.web.words import _, said
from highside.words.errors import error_told

KEPT_MAX = 2_000
"""Lines of records and journals that are kept in the memory, some 2 KB each."""
LASTING = frozenset({"accepted", "rejected", "aborted", "damaged"})
"""States of a session that a file of the same size and time keeps; the others depend on who has it open."""

_FileState = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class RecordLine:
    """One record in a list. `refused`: why it cannot be read, and then nothing else is known."""

    id: str
    tool: str = ""
    serial: str | None = None
    method: str = ""
    created: str = ""
    expires: str | None = None
    expires_s: float | None = None
    poses: str = ""
    signer: str | None = None
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class Listed:
    """Some of the records, those kept last first, of `total`."""

    lines: tuple[RecordLine, ...]
    total: int


class _Kept:
    """The newest of what was read, by file."""

    def __init__(self) -> None:
        self._lines: OrderedDict[Path, tuple[_FileState, Any]] = OrderedDict()

    def get(self, path: Path, state: _FileState) -> Any:
        known = self._lines.get(path)
        return known[1] if known is not None and known[0] == state else None

    def put(self, path: Path, state: _FileState, line: Any) -> None:
        self._lines[path] = (state, line)
        self._lines.move_to_end(path)
        while len(self._lines) > KEPT_MAX:
            self._lines.popitem(last=False)


class CalibrationShelf:
    """The records of a store."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._store = CalibrationStore(directory)
        self._kept = _Kept()

    def listed(self, first: int, count: int) -> Listed:
        """`count` records from the `first` on. Raises InputError where the store is not there."""
        there = [(path, state) for name in self._store.ids() if (state := file_state(path := self._path(name)))]
        there.sort(key=lambda one: (one[1][0], one[0].name), reverse=True)
        return Listed(tuple(self._line(*one) for one in there[first : first + count]), len(there))

    def history(self, tool: str | None = None) -> list[Activation]:
        """What was put in force, in order. Raises HighsideError for an entry that cannot be read."""
        return self._store.history(tool)

    def in_force(self) -> dict[str, str]:
        """The id of the record in force for each tool. Raises HighsideError as `history`."""
        found = {tool: self._store.active_id(tool) for tool in self._store.tools()}
        return {tool: name for tool, name in found.items() if name is not None}

    def record(self, name: str) -> CalibrationRecord:
        """Raises HighsideError for a record that is not there or refused."""
        return self._store.get(name)

    def is_stored(self, name: str) -> bool:
        """Whether a record of this id is kept."""
        return name in self._store.ids()

    def _path(self, name: str) -> Path:
        return self.directory / "records" / f"{name}.json"

    def _line(self, path: Path, state: _FileState) -> RecordLine:
        known = self._kept.get(path, state)
        if known is None:
            known = _line(self._store, path.stem)
            self._kept.put(path, state, known)
        return known  # type: ignore[no-any-return]


class SessionShelf:
    """The journals of bench sessions; `calibrations` says whether a session's record is kept."""

    def __init__(self, directory: Path, calibrations: CalibrationShelf | None) -> None:
        self.directory = directory
        self._calibrations = calibrations
        self._kept = _Kept()

    def listed(self, first: int, count: int) -> tuple[list[FoundJournal], int]:
        """`count` sessions from the `first` on, those written last first, and how many there are."""
        there = journals(self.directory)
        return [self._found(path) for path in there[first : first + count]], len(there)

    def session(self, name: str) -> tuple[FoundJournal, Journal | None]:
        """A session by its name, and what is in its journal; None where that is damaged. Raises InputError where there
        is none of that name."""
        path = next((path for path in journals(self.directory) if path.stem == name), None)
        if path is None:
            raise InputError(said("no session of that name is kept here"))
        found = self._found(path)
        return found, None if found.state == "damaged" else read_journal(read_bytes(path), where=path.name)

    def photographs_of(self, record: CalibrationRecord) -> tuple[Found, ...]:
        """Those of the session that a record follows from; none where that session is not kept here."""
        name = str(record.content["raw"]["name"]).removeprefix("session ")
        try:
            found, journal = self.session(name)
        except InputError:
            return ()
        ended = None if journal is None else journal.ledger().ended
        if journal is None or ended is None or ended.record != record.id:
            return ()
        return tuple(photographs(journal, found.path))

    def _found(self, path: Path) -> FoundJournal:
        state = file_state(path)
        known = None if state is None else self._kept.get(path, state)
        if known is None:
            known = found_journal(path, self._is_stored)
            if state is not None and known.state in LASTING:
                self._kept.put(path, state, known)
        return known

    def _is_stored(self, name: str) -> bool:
        # without a store nobody knows, and nothing is asserted
        return self._calibrations is None or self._calibrations.is_stored(name)


def to_compare(lines: Sequence[RecordLine], in_force: dict[str, str], now_s: float) -> tuple[str, str]:
    """Which two are most likely to be compared: of the first tool with two, the one in force with the newest that has
    not expired; else the newest two. Empty where there are no two."""
    kept = [line for line in lines if not line.refused]
    tools = [line.tool for line in kept]
    tool = next((name for name in tools if tools.count(name) > 1), None)
    same = [line for line in kept if line.tool == tool] or kept
    if len(same) < 2:
        return "", ""
    before = next((line for line in same if in_force.get(line.tool) == line.id), None)
    if before is None:
        return same[1].id, same[0].id
    others = [line for line in same if line is not before]
    lasting = [line for line in others if line.expires_s is None or line.expires_s > now_s]
    return before.id, (lasting or others)[0].id


def told(error: HighsideError, directory: Path | None) -> str:
    """What a viewer reads of an error: without the place on this machine's disk."""
    return _without_place(error_told(error, "refusals"), directory, _("the store"))


def written(error: HighsideError, directory: Path) -> str:
    """The same for the journal of acts, in English."""
    return _without_place(str(error), directory, "the store")


def _without_place(text: str, directory: Path | None, store: str) -> str:
    return text if directory is None else text.replace(f"{directory}{os.sep}", "").replace(str(directory), store)


def file_state(path: Path) -> _FileState | None:
    """By what a changed file is told from the same one: time (ns), size, number; None for one that is gone."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def _line(store: CalibrationStore, name: str) -> RecordLine:
    try:
        record = store.get(name)
        known = summary(record)
    except HighsideError as error:
        # kept for readers of all languages: told where it is shown
        return RecordLine(name, refused=written(error, store.directory))
    return RecordLine(
        id=name,
        tool=known["tool"],
        serial=known["serial"],
        method=known["method"],
        created=known["created"],
        expires=known["expires"],
        expires_s=record.expires_s,
        poses=said("%(used)s of %(poses)s", used=known["poses_used"], poses=known["poses"]),
        signer=None if known["signature"] is None else known["signature"]["signer"],
    )

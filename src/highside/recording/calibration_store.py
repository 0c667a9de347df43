"""The store of calibration records: a directory to which files are added and in which none is ever changed.

    records/<id>.json               the records, named by the hash of their content
    activations/00000012.json       who was put in force, when, and why; the highest number of a tool counts

Every file is written beside, flushed to the disk and renamed, the directory flushed after it; a lock file keeps two
writers apart. Killed between any two steps, the store holds the old state or the new one. Readers take no lock.

A roll back is one more activation: of the record that was in force before the present one.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from highside.calibration.correction import Correction
from highside.calibration.record import (
    CalibrationRecord,
    RecordError,
    RecordReason,
    correction_from_record,
    from_utc,
    parse_record,
    to_utc,
    verify,
)
from highside.calibration.remark import Reason
from highside.calibration.signature import TrustedKeys
from highside.errors import InputError
from highside.reading import MALFORMED, parse_json, read_document
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import make_directory, write_whole
from highside.recording.locks import lock

MIN_ID_PREFIX = 6
"""Fewest digits by which a record may be named."""


@dataclass(frozen=True, slots=True)
class Activation:
    """One entry of the history. `action`: "activate" or "rollback"; `undoes`: number that a roll back takes back;
    `record_id`: in force from then on, empty where a roll back leaves nothing in force."""

    number: int
    tool_id: str
    record_id: str
    action: str
    at_s: float
    undoes: int | None = None


def read_record(path: Path) -> CalibrationRecord:
    """Read a record file and check its hash, schema and units. Raises InputError or RecordError."""
    return parse_record(read_document(path), where=str(path))


def load_record_file(
    path: Path,
    *,
    tool_id: str | None,
    serial: str | None = None,
    now_s: float | None = None,
    trusted: TrustedKeys | None = None,
) -> Correction:
    """The correction of one record file, verified for this tool at this time (UTC epoch seconds)."""
    record = read_record(Path(path))
    verify(record, tool_id=tool_id, serial=serial, now_s=now_s, trusted=trusted)
    return correction_from_record(record)


def load_active(
    store_dir: Path,
    *,
    tool_id: str,
    serial: str | None = None,
    now_s: float | None = None,
    trusted: TrustedKeys | None = None,
) -> Correction:
    """The correction in force for a tool. Raises RecordError naming why there is none, InputError without a store."""
    record = CalibrationStore(store_dir).active(tool_id)
    verify(record, tool_id=tool_id, serial=serial, now_s=now_s, trusted=trusted)
    return correction_from_record(record)


def contradiction(record: CalibrationRecord) -> str | None:
    """Why a record should not be put in force although it is whole: its poses contradict one another."""
    doubt = {Reason.CLOSURE, Reason.TOO_MANY_BAD, Reason.SWAPPED_POSES}
    found = [remark.text for remark in record.result.remarks if remark.refused and remark.reason in doubt]
    return f"record {record.id[:12]} is not put in force: {found[0]}" if found else None


class CalibrationStore:
    """Records of any number of tools, and which of them is in force for each."""

    def __init__(self, directory: Path) -> None:
        self.directory = Path(directory)
        self._records = self.directory / "records"
        self._activations = self.directory / "activations"

    def add(self, record: CalibrationRecord) -> bool:
        """Keep a record; False if it was there already (same content, same name). One that bears a signature replaces
        the same record without that signature; a signature is never taken away."""
        path = self._record_path(record.id)
        with self._lock():
            if path.exists():
                try:
                    kept = read_record(path)
                    if kept.id == record.id and record.signature in (None, kept.signature):
                        return False
                except (RecordError, InputError):
                    pass  # damaged on the disk: the good content is written again
            write_whole(path, record.to_json().encode())
        return True

    def get(self, name: str) -> CalibrationRecord:
        """A record by its id or the beginning of it, read and checked. Raises RecordError."""
        if name in self.ids():
            record_id = name
        else:
            found = [known for known in self.ids() if len(name) >= MIN_ID_PREFIX and known.startswith(name)]
            if len(found) != 1:
                why = f"{len(found)} records begin with {name}" if found else f"no record {name} in {self.directory}"
                raise RecordError(RecordReason.NOT_FOUND, f"{why}; see calibrate history")
            record_id = found[0]
        path = self._record_path(record_id)
        record = read_record(path)
        if record.id != record_id:
            raise RecordError(RecordReason.TAMPERED, f"{path}: holds another record ({record.id[:12]})")
        return record

    def ids(self) -> list[str]:
        """The ids of all records, sorted."""
        self._require_store()
        if not self._records.is_dir():
            return []
        return sorted(path.stem for path in self._records.glob("*.json") if not path.name.startswith("."))

    def activate(
        self,
        record: CalibrationRecord,
        *,
        now_s: float,
        tool_id: str | None = None,
        serial: str | None = None,
        trusted: TrustedKeys | None = None,
        replaces: tuple[str | None] | None = None,
    ) -> Activation:
        """Put a record in force for its tool, after checking tool, serial, expiry and, where keys are given, the
        signature; where `replaces` is given, only if that id (None: nothing) is in force. Raises RecordError."""
        verify(record, tool_id=tool_id, serial=serial, now_s=now_s, trusted=trusted)
        self.add(record)
        with self._lock():
            if replaces is not None and (present := self.active_id(record.tool_id)) != replaces[0]:
                what = "nothing" if present is None else present[:12]
                text = f"the store has changed: {what} is in force for tool {record.tool_id!r} now"
                raise RecordError(RecordReason.NOTHING_BEFORE, text)
            return self._append(record.tool_id, record.id, "activate", now_s, None)

    def rollback(
        self, tool_id: str, *, now_s: float, expected: str | None = None, trusted: TrustedKeys | None = None
    ) -> Activation:
        """Put the record in force that was so before the present one. Raises RecordError where it cannot be, or where
        that is not the one `expected` by whoever asks, or is not signed with a trusted key where keys are given."""
        self._require_store()
        with self._lock():
            stack = self._stack(tool_id)
            if len(stack) < 2:
                text = f"tool {tool_id!r} has no earlier calibration in {self.directory}"
                if stack:
                    text += "; to leave it without one: `highside calibrate rollback --to-nothing`, or the bench page"
                raise RecordError(RecordReason.NOTHING_BEFORE, text)
            present, before = stack[-1], stack[-2]
            if expected is not None and before.record_id != expected:
                raise RecordError(
                    RecordReason.NOTHING_BEFORE,
                    f"the store has changed: a roll back leads to {before.record_id[:12]}, not {expected[:12]}",
                )
            verify(self.get(before.record_id), tool_id=tool_id, now_s=now_s, trusted=trusted)
            return self._append(tool_id, before.record_id, "rollback", now_s, present.number)

    def take_out(self, tool_id: str, *, now_s: float, expected: str | None = None) -> Activation:
        """Take back the only record that was put in force: none is from then on. Raises RecordError where there is
        none, or an earlier one to go back to, or it is not the one `expected` by whoever asks."""
        self._require_store()
        with self._lock():
            stack = self._stack(tool_id)
            if len(stack) != 1 or (expected is not None and stack[0].record_id != expected):
                now = "nothing is in force" if not stack else f"{stack[-1].record_id[:12]} is in force"
                before = f", and before it {stack[-2].record_id[:12]} was" if len(stack) > 1 else ""
                raise RecordError(RecordReason.NOTHING_BEFORE, f"{now} for tool {tool_id!r}{before}")
            return self._append(tool_id, "", "rollback", now_s, stack[0].number)

    def active(self, tool_id: str) -> CalibrationRecord:
        """The record in force for a tool. Raises RecordError where there is none or it is damaged."""
        stack = self._stack(tool_id)
        if not stack:
            others = sorted({a.tool_id for a in self.history()} - {tool_id})
            hint = f" (it has one of {', '.join(map(repr, others))})" if others else ""
            reason = RecordReason.WRONG_TOOL if others else RecordReason.NONE_ACTIVE
            raise RecordError(reason, f"{self.directory} has no calibration in force for tool {tool_id!r}{hint}")
        return self.get(stack[-1].record_id)

    def active_id(self, tool_id: str) -> str | None:
        """Id of the record in force, without reading it; None where there is none."""
        stack = self._stack(tool_id)
        return stack[-1].record_id if stack else None

    def before_id(self, tool_id: str) -> str | None:
        """Id of the record that a roll back would put in force; None where there is none."""
        stack = self._stack(tool_id)
        return stack[-2].record_id if len(stack) > 1 else None

    def was_taken_back(self, tool_id: str, record_id: str) -> bool:
        """Whether a record of this tool was rolled back and has not been put in force since."""
        taken_back: set[str] = set()
        stack = _standing(self.history(tool_id), taken_back)
        return record_id in taken_back - {entry.record_id for entry in stack}

    def tools(self) -> list[str]:
        """The tools for which something was ever put in force."""
        return sorted({entry.tool_id for entry in self.history()})

    def history(self, tool_id: str | None = None) -> list[Activation]:
        """All activations in order, of one tool or of all."""
        self._require_store()
        entries = []
        for path in sorted(self._activations.glob("*.json")) if self._activations.is_dir() else []:
            if path.name.startswith("."):
                continue
            entry = _read_activation(path)
            if tool_id is None or entry.tool_id == tool_id:
                entries.append(entry)
        return entries

    def _stack(self, tool_id: str) -> list[Activation]:
        """Activations still standing: a roll back takes the last one away. One repeated counts once."""
        return _standing(self.history(tool_id), set())

    def _append(self, tool_id: str, record_id: str, action: str, now_s: float, undoes: int | None) -> Activation:
        entries = self.history()
        number = entries[-1].number + 1 if entries else 1
        entry = Activation(number, tool_id, record_id, action, from_utc(to_utc(now_s)), undoes)
        content = {
            "number": number,
            "tool": tool_id,
            "record": record_id,
            "action": action,
            "at": to_utc(now_s),
            "undoes": undoes,
        }
        self._make(self._activations)
        write_whole(self._activations / f"{number:08d}.json", (json.dumps(content, sort_keys=True) + "\n").encode())
        return entry

    def _record_path(self, record_id: str) -> Path:
        return self._records / f"{record_id}.json"

    def _require_store(self) -> None:
        if not self.directory.is_dir():
            raise InputError(
                "no such calibration store", where=str(self.directory), remedy="calibrate solve --store makes one"
            )

    def _make(self, directory: Path) -> None:
        try:
            make_directory(directory)
        except OSError as error:
            raise InputError(f"cannot be made ({error.strerror})", where=str(directory)) from error

    @contextmanager
    def _lock(self) -> Iterator[None]:
        """Keep other writers out; released by the system if this process dies."""
        self._make(self._records)
        path = self.directory / ".lock"
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | OPEN_FLAGS, 0o644)
        except OSError as error:
            raise InputError(f"cannot be opened ({error.strerror})", where=str(path)) from error
        try:
            lock(descriptor, wait=True)
            yield
        finally:
            os.close(descriptor)


def _standing(history: Sequence[Activation], taken_back: set[str]) -> list[Activation]:
    """The activations that no roll back took away; ids of the records that one did go into `taken_back`.

    Each entry says what is in force after it, so that one that was lost changes nothing of what is: a roll back whose
    activation is not there takes none away.
    """
    stack: list[Activation] = []
    for entry in history:
        if entry.action == "rollback" and stack and stack[-1].number == entry.undoes:
            taken_back.add(stack.pop().record_id)
        if not entry.record_id:
            stack.clear()
        elif not stack or stack[-1].record_id != entry.record_id:
            stack.append(entry)
    return stack


def _read_activation(path: Path) -> Activation:
    try:
        data = parse_json(read_document(path))
        entry = Activation(
            number=int(data["number"]),
            tool_id=str(data["tool"]),
            record_id=str(data["record"]),
            action=str(data["action"]),
            at_s=from_utc(data["at"]),
            undoes=data["undoes"],
        )
    except (*MALFORMED, InputError) as error:
        raise RecordError(RecordReason.MALFORMED, f"{path}: not an activation ({error})") from error
    if entry.action not in ("activate", "rollback") or path.stem != f"{entry.number:08d}":
        raise RecordError(RecordReason.MALFORMED, f"{path}: not an activation")
    return entry

"""The calibration store of a bench session: keeps its record, puts it in force, takes that back.

What it writes is what `highside calibrate activate` and `rollback` write; a running service takes it at its next
reload, as ever.
"""

from __future__ import annotations

import time
from pathlib import Path

from highside.calibration.record import CalibrationRecord
from highside.errors import HighsideError, InputError, Refused
from highside.recording.calibration_store import CalibrationStore, contradiction
from highside.recording.files import write_whole
from highside.rotation.compensation import Compensation
from highside.session.force import InForce, StoreError


class BenchStore:
    """Implements `session.force.Store` on a directory."""

    def __init__(self, directory: Path, serial: str | None) -> None:
        self.directory = directory
        self._store = CalibrationStore(directory)
        self._serial = serial

    def keep(self, record: CalibrationRecord) -> Path:
        """Keep a record; where it is. Raises HighsideError."""
        self._store.add(record)
        return self.directory / "records" / f"{record.id}.json"

    def in_force(self, tool_id: str) -> InForce:
        """See `Store`."""
        try:
            return InForce(self._store.active_id(tool_id), self._store.before_id(tool_id))
        except HighsideError:
            return InForce()  # no store yet, or one that cannot be read: the commands will say what is wrong

    def activate(self, record: CalibrationRecord) -> InForce:
        """See `Store`."""
        try:
            doubt = contradiction(record)
            if doubt is not None:
                raise Refused(f"{doubt} (`highside calibrate activate --force` does it all the same)")
            self._store.activate(record, now_s=time.time(), tool_id=record.tool_id, serial=self._serial)
        except HighsideError as error:
            raise StoreError(str(error)) from error
        return self.in_force(record.tool_id)

    def rollback(self, tool_id: str, to: str) -> InForce:
        """See `Store`."""
        try:
            self._store.rollback(tool_id, now_s=time.time(), expected=to)
        except HighsideError as error:
            raise StoreError(str(error)) from error
        return self.in_force(tool_id)


def keep_turntable(path: Path, compensation: Compensation) -> None:
    """Write the fit of a bench's turntable, whole or not at all. Raises InputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made ({error.strerror})", where=str(path.parent)) from error
    write_whole(path, compensation.to_json().encode())

"""The calibration store of a bench session: keeps its record, puts it in force, takes that back.

What it writes is what `highside calibrate activate` and `rollback` write; a running service takes it at its next
reload, as ever.
"""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from highside.bench.session.force import NOTHING, InForce, StoreError
from highside.calibration.record import CalibrationRecord
from highside.calibration.signature import SigningKey, TrustedKeys
from highside.config.bench import StoreTable
from highside.errors import HighsideError, InputError, Refused
from highside.recording.calibration_store import CalibrationStore, contradiction
from highside.recording.files import make_directory, write_whole
from highside.recording.keys import read_key, read_trusted_keys
from highside.rotation.compensation import Compensation


class BenchStore:
    """Implements `bench.session.force.Store` on a directory."""

    def __init__(
        self,
        directory: Path,
        serial: str | None,
        *,
        signing_key: SigningKey | None = None,
        trusted: TrustedKeys | None = None,
    ) -> None:
        self.directory = directory
        self._store = CalibrationStore(directory)
        self._serial = serial
        self._signing_key = signing_key
        self._trusted = trusted

    @classmethod
    def of(cls, table: StoreTable, serial: str | None) -> BenchStore:
        """As configured. Raises InputError for keys that cannot be read."""
        return cls(
            table.directory,
            serial,
            signing_key=None if table.signing_key is None else read_key(table.signing_key),
            trusted=None if table.trusted_keys is None else read_trusted_keys(table.trusted_keys),
        )

    def keep(self, record: CalibrationRecord) -> Path:
        """Keep a record, signed where there is a key; where it is. Raises HighsideError."""
        self._store.add(self._signed(record))
        return self.directory / "records" / f"{record.id}.json"

    def in_force(self, tool_id: str) -> InForce:
        """See `Store`."""
        try:
            present, before = self._store.active_id(tool_id), self._store.before_id(tool_id)
            return InForce(present, before if before is not None or present is None else NOTHING)
        except HighsideError:
            return InForce()  # no store yet, or one that cannot be read: the commands will say what is wrong

    def activate(self, record: CalibrationRecord) -> InForce:
        """See `Store`."""
        try:
            doubt = contradiction(record)
            if doubt is not None:
                raise Refused(f"{doubt} (`highside calibrate activate --force` does it all the same)")
            self._store.activate(
                self._signed(record),
                now_s=time.time(),
                tool_id=record.tool_id,
                serial=self._serial,
                trusted=self._trusted,
            )
        except HighsideError as error:
            raise StoreError(str(error)) from error
        return self.in_force(record.tool_id)

    def rollback(self, tool_id: str, to: str) -> InForce:
        """See `Store`."""
        try:
            if to == NOTHING:
                self._store.take_out(tool_id, now_s=time.time())
            else:
                self._store.rollback(tool_id, now_s=time.time(), expected=to, trusted=self._trusted)
        except HighsideError as error:
            raise StoreError(str(error)) from error
        return self.in_force(tool_id)

    def _signed(self, record: CalibrationRecord) -> CalibrationRecord:
        """With the signature it has in the store, or a new one; without a key, as it is."""
        if self._signing_key is None:
            return record
        with contextlib.suppress(HighsideError):
            kept = self._store.get(record.id)
            if kept.signature is not None and kept.signature.key == self._signing_key.fingerprint:
                return kept
        return record.signed(self._signing_key, now_s=time.time())


def keep_turntable(path: Path, compensation: Compensation) -> None:
    """Write the fit of a bench's turntable, whole or not at all. Raises InputError."""
    try:
        make_directory(path.parent)
    except OSError as error:
        raise InputError(f"cannot be made ({error.strerror})", where=str(path.parent)) from error
    write_whole(path, compensation.to_json().encode())

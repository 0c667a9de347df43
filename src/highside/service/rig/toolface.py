"""The toolface offset: from the sensor's scribe line to the motor's bend, who set it and when.

It is measured clockwise looking down-hole, as toolface is, and added: toolface of the motor's bend = toolface of the
sensor + offset. Each setting is one line appended to `toolface.jsonl` in the state directory; the last one is in force.
Nothing is ever overwritten, so the file is also the log of who changed what.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.errors import InputError
from highside.reading import MALFORMED, instant, parse_json, read_document
from highside.recording.files import flush_directory, make_directory
from highside.recording.locks import lock

FILE_NAME = "toolface.jsonl"


@dataclass(frozen=True, slots=True)
class ToolfaceOffset:
    """One setting."""

    offset_deg: float
    author: str
    t: float
    """UTC epoch seconds"""
    note: str = ""
    previous_deg: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """The line of the file."""
        return {
            "t": self.t,
            "offset_deg": self.offset_deg,
            "author": self.author,
            "note": self.note,
            "previous_deg": self.previous_deg,
        }


class ToolfaceLog:
    """The file of settings. Reading tolerates a torn last line (power loss); anything else wrong is named."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE_NAME
        self._stamp: tuple[int, int] | None = (0, -1)

    def history(self) -> list[ToolfaceOffset]:
        """All settings, oldest first. Raises InputError that names the line that is no setting."""
        if not os.path.lexists(self.path):
            return []
        data = read_document(self.path)
        lines = data.split(b"\n")
        found = []
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            try:
                found.append(_setting(line))
            except (*MALFORMED, InputError):
                if number == len(lines):
                    break  # torn: it was never confirmed
                raise InputError(
                    "is no toolface setting", where=f"{self.path}: line {number}", remedy="fix or remove that line"
                ) from None
        return found

    def current(self) -> ToolfaceOffset | None:
        """The setting in force; None: never set, the offset is zero.

        Raises InputError as `history` does, and where the settings were set aside because the file was damaged: whoever
        steers must not take "never set" for an answer then.
        """
        settings = self.history()
        if settings:
            return settings[-1]
        lost = sorted(self.path.parent.glob(f"{FILE_NAME}.damaged-*"))
        if lost:
            raise InputError(
                f"was damaged and is kept as {lost[-1].name}; no offset is in force",
                where=str(self.path),
                remedy="set it anew: highside toolface set",
            )
        return None

    def changed(self) -> bool:
        """Whether the file has changed since this was last checked."""
        stamp = None
        with contextlib.suppress(OSError):
            status = self.path.stat()
            stamp = (status.st_mtime_ns, status.st_size)
        before, self._stamp = self._stamp, stamp
        return stamp != before

    def set(self, offset_deg: float, author: str, now_s: float, note: str = "") -> ToolfaceOffset:
        """Append a setting, synced to the disk. Raises InputError for a value or an author that cannot be."""
        if not math.isfinite(offset_deg) or not -360.0 <= offset_deg <= 360.0:
            raise InputError(f"{offset_deg} is no angle", field="offset", remedy="give degrees, -360 to 360")
        if not author.strip():
            raise InputError("is empty", field="author", remedy="say who sets the offset")
        try:
            make_directory(self.path.parent)
            with self.path.open("a+b") as file:
                lock(file.fileno(), wait=True)
                history = self.history()
                before = history[-1] if history else None
                setting = ToolfaceOffset(
                    round(offset_deg % 360.0, 6) % 360.0,
                    " ".join(author.split()),
                    round(now_s, 3),
                    " ".join(note.split()),
                    before.offset_deg if before else 0.0,
                )
                file.seek(0, os.SEEK_END)
                _end_torn_line(file)
                file.write(json.dumps(setting.as_dict()).encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
                if before is None:
                    flush_directory(self.path.parent)  # the file may be new
                _give_to_owner(file.fileno(), self.path.parent)
        except OSError as error:
            raise InputError(
                f"cannot be written: {error.strerror}", where=str(self.path), remedy="run as the user of the service"
            ) from None
        return setting


def _give_to_owner(descriptor: int, directory: Path) -> None:
    """Root writes for the service's own user, who must be able to read and go on writing the file."""
    owner = directory.stat()
    if hasattr(os, "geteuid") and os.geteuid() == 0 and os.fstat(descriptor).st_uid != owner.st_uid:
        os.fchown(descriptor, owner.st_uid, owner.st_gid)


def _end_torn_line(file: Any) -> None:
    """A power cut may have left half a line: take it away, it was never confirmed."""
    size = file.tell()
    file.seek(0)
    data = file.read()
    if size and not data.endswith(b"\n"):
        file.truncate(data.rfind(b"\n") + 1)
    file.seek(0, os.SEEK_END)


def _setting(line: bytes) -> ToolfaceOffset:
    data = parse_json(line)
    setting = ToolfaceOffset(
        float(data["offset_deg"]),
        str(data["author"]),
        instant(data["t"]),
        str(data["note"]),
        float(data["previous_deg"]),
    )
    if not 0.0 <= setting.offset_deg < 360.0:
        raise ValueError
    return setting

"""The journal of acts: who did what, when and from where; chained lines of JSON, appended and synced, never rewritten
(`chain`).

An act is written before it is done ("begins") and after it ("done", or why not): what cannot be written is not done.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.calibration.record import to_utc
from highside.config.users import Role
from highside.errors import InputError
from highside.reading import parse_json
from highside.reading.files import OPEN_FLAGS
from highside.recording.files import make_directory
from highside.web.signin.chain import ChainedLines, Checked

BEGINS, DONE = "begins", "done"
FAILURES_PER_H = 120
"""Lines an hour for attempts that failed: more are counted, so that nobody fills the disk from outside."""
SHOWN_MAX = 200
TAIL = 200_000
"""Bytes from the end of the journal in which the newest acts are looked for."""


@dataclass(frozen=True, slots=True)
class Person:
    """Who asks: by a password, a stated proxy, or the page's token (then without a name)."""

    name: str
    role: Role
    via: str
    address: str

    def may(self, role: Role) -> bool:
        return self.role.includes(role)


class Acts:
    """One journal."""

    def __init__(self, path: Path, clock: Callable[[], float] = time.time) -> None:
        self.path = path
        self._clock = clock
        self._lock = threading.Lock()
        self._lines = ChainedLines(path)
        self._hour = (0, 0)
        self._held = 0

    def check(self) -> None:
        """Raises InputError where it cannot be written."""
        try:
            make_directory(self.path.parent)
            os.close(self._open())
        except OSError as error:
            raise self._trouble(error) from None

    def write(self, person: Person, act: str, outcome: str = DONE, **details: Any) -> None:
        """One line, on the disk when this returns. Raises InputError where it cannot be written: do nothing then."""
        line = {
            "t": to_utc(self._clock()),
            "who": person.name,
            "role": str(person.role),
            "via": person.via,
            "from": person.address,
            "act": act,
            "outcome": outcome,
        }
        self._append(line | {name: value for name, value in details.items() if value is not None})

    def failure(self, name: str, address: str, why: str) -> None:
        """An attempt to sign in that failed; of very many in an hour, their number."""
        now = self._clock()
        hour = int(now // 3600)
        with self._lock:
            count = self._hour[1] + 1 if self._hour[0] == hour else 1
            self._hour = (hour, count)
            if count > FAILURES_PER_H:
                self._held += 1
                return
            held, self._held = self._held, 0
        line = {"t": to_utc(now), "who": name[:64], "from": address, "act": "sign in", "outcome": why}
        self._append(line | ({"and_more": held} if held else {}))

    def last(self, count: int = SHOWN_MAX) -> list[dict[str, Any]]:
        """The newest acts, the last one first. Raises InputError where they cannot be read."""
        rows: list[dict[str, Any]] = []
        try:
            for path in reversed(self._lines.files()):
                rows += self._newest(path)
                if len(rows) >= count:
                    break
        except OSError as error:
            raise self._trouble(error) from None
        return rows[:count]

    def _newest(self, path: Path) -> list[dict[str, Any]]:
        """Those at the end of one file, the last one first, without what only the chain needs."""
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - TAIL))
            text = file.read(TAIL)
        whole = text if size <= TAIL else text.partition(b"\n")[2]
        found = []
        for line in reversed(whole.split(b"\n")):
            # what the end of the power left of a line is none
            with contextlib.suppress(InputError):
                row = parse_json(line)
                found += [row] if isinstance(row, dict) else []
        return [{name: value for name, value in row.items() if name != "h"} for row in found]

    def chain(self) -> Checked:
        """Whether the journal is as it was written. Raises InputError where it cannot be read."""
        return self._lines.check()

    def _append(self, line: dict[str, Any]) -> None:
        try:
            with self._lock:
                self._lines.append(line)
        except OSError as error:
            raise self._trouble(error) from None

    def _open(self) -> int:
        return os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | OPEN_FLAGS, 0o600)

    def _trouble(self, error: OSError) -> InputError:
        what = f"the journal of acts cannot be written ({error.strerror}): nothing was done"
        return InputError(what, where=str(self.path), field="web.acts", remedy="name a place that this user may write")

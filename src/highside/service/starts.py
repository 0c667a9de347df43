"""How the runs before this one ended: a service that crashes and is started again for ever has to tell somebody.

systemd starts it anew within seconds, and whoever looks sees a service that runs. So each run notes that it has begun,
and how it ended; a run that left no note was killed. Ends that nobody requested, within the last ten minutes of the
same boot of the host, stand in the health message; three of them raise the alarm `restarting`. A loss of power is no
crash.
"""

from __future__ import annotations

import contextlib
import json
import logging
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from highside.errors import HighsideError
from highside.reading import parse_json, read_document
from highside.recording.files import write_whole
from highside.service.saved_drift import Stamp
from highside.service.strict import Strict

log = logging.getLogger("highside")

FILE = "starts.json"
WINDOW_S = 600.0
"""Seconds that an end counts: long enough for loops of the slowest start (`TimeoutStartSec`, 60 s), and over when a
fault of the past has not come back."""
ALARM_FROM = 3
"""Ends within the window from which it is a loop: one is an accident, two may be an operator who was too quick."""
KEPT = 50
KILLED = "killed, without a word"


class End(Strict):
    """An end that nobody requested."""

    boot_s: float
    how: Annotated[str, Field(max_length=500)]


class Starts(Strict):
    """The file."""

    format: Literal["highside.starts/1"] = "highside.starts/1"
    boot_id: str
    running: bool
    ends: tuple[End, ...]


class StartLog:
    """Of one state directory; `begin` at the start, `end` at the end, never raises."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE
        self._ends: tuple[End, ...] = ()

    def begin(self) -> None:
        """A run begins; what stands in the file is about those before."""
        now = Stamp.now(synced=False)
        before = self._read()
        # another boot of the host: whatever ended then ended with it
        if before is not None and now.boot_id and before.boot_id == now.boot_id:
            killed = (End(boot_s=now.boot_s, how=KILLED),) if before.running else ()
            self._ends = (*before.ends, *killed)[-KEPT:]
        self._write(running=True)
        if (count := len(self._recent())) >= ALARM_FROM:
            log.error("started again %d times within %.0f min, last: %s", count, WINDOW_S / 60.0, self._ends[-1].how)

    def end(self, how: str | None) -> None:
        """The run ends; `how` says by what, None: as requested."""
        if how is not None:
            self._ends = (*self._ends, End(boot_s=Stamp.now(synced=False).boot_s, how=how[:500]))[-KEPT:]
        self._write(running=False)

    def _recent(self) -> list[End]:
        now_s = Stamp.now(synced=False).boot_s
        return [end for end in self._ends if now_s - end.boot_s <= WINDOW_S]

    @property
    def alarm(self) -> bool:
        """Whether it is a loop."""
        return len(self._recent()) >= ALARM_FROM

    def as_dict(self) -> dict[str, Any]:
        """Member `starts` of the health message."""
        recent = self._recent()
        return {"crashes": len(recent), "within_s": WINDOW_S, "last": recent[-1].how if recent else None}

    def _read(self) -> Starts | None:
        if not self.path.is_file():
            return None
        # a damaged file tells nothing, and is replaced
        with contextlib.suppress(HighsideError, ValidationError):
            return Starts.model_validate(parse_json(read_document(self.path)))
        return None

    def _write(self, *, running: bool) -> None:
        file = Starts(boot_id=Stamp.now(synced=False).boot_id, running=running, ends=self._ends)
        # on a disk that takes nothing the run is more important than its note
        with contextlib.suppress(HighsideError, OSError):
            write_whole(self.path, json.dumps(file.model_dump(mode="json")).encode())

"""What day is it, as far as that is known? For what expires: a calibration must not end, or live on, by a wrong clock.

A wall clock is accepted where the kernel says that it follows a reference. The last moment at which it did is kept in
memory and in the state directory; within the same boot of the host the boot clock goes on from there, whatever the wall
clock is set to, and through a restart of the service. After another boot that moment is only the earliest that it can
be now. A reference that contradicts the moment kept is accepted when it has stood for an hour.
"""

from __future__ import annotations

import contextlib
import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from highside.config.settings import Settings
from highside.errors import HighsideError
from highside.reading import parse_json, read_document
from highside.recording.files import write_whole
from highside.service import clock
from highside.service.clock import Moment
from highside.service.places import state_dir

log = logging.getLogger("highside")

FILE = "clock.json"
AGREES_S = 60.0
"""Seconds by which a synchronised clock may differ from what the boot clock makes of the last synchronised moment: two
weeks without a reference on a crystal that is 50 ppm off, and nothing against the days that are judged."""
BELIEVED_AFTER_S = 3600.0
"""Seconds that a contradicting reference has to stand: as long as the alarm `clock_stepped` of a clock that was set."""
KEPT_EVERY_S = 3600.0
"""Seconds between two writes of the file, of some hundred bytes: 24 a day are no wear, and days are what it judges."""


@dataclass(frozen=True, slots=True)
class Present:
    """The time now."""

    wall_s: float
    """the best that is known"""
    known: bool
    """whether it rests on a synchronised clock"""
    surely_s: float
    """it is not earlier than this: `wall_s` where that is known"""


class SyncedMoment(BaseModel):
    """The file: when the wall clock last followed a reference."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    format: Literal["highside.clock/1"] = "highside.clock/1"
    wall_s: float
    boot_id: str
    boot_s: float


class KnownTime:
    """Of one state directory. Not for several threads at once, but for `keep`."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / FILE
        self._last = self._read()
        self._kept = self._last
        self._contradicted_since_boot_s: float | None = None

    def look(self, now: Moment) -> None:
        """Take the clocks as they are now; to be called often."""
        if not now.synced or not self._plausible(now):
            return
        self._last = SyncedMoment(wall_s=now.wall_s, boot_id=now.boot_id, boot_s=now.boot_s)

    def present(self, now: Moment) -> Present:
        """What day it is."""
        last = self._last
        if last is None:
            return Present(now.wall_s, known=False, surely_s=float("-inf"))
        if last.boot_id and last.boot_id == now.boot_id:
            wall_s = last.wall_s + max(now.boot_s - last.boot_s, 0.0)
            return Present(wall_s, known=True, surely_s=wall_s)
        return Present(max(now.wall_s, last.wall_s), known=False, surely_s=last.wall_s)

    @property
    def to_be_kept(self) -> bool:
        """Whether the file is so old that `keep` is due."""
        last, kept = self._last, self._kept
        if last is None or last is kept:
            return False
        return kept is None or kept.boot_id != last.boot_id or abs(last.boot_s - kept.boot_s) >= KEPT_EVERY_S

    def keep(self) -> None:
        """Write the file. Never raises: a disk that takes nothing has alarms of its own."""
        last = self._last
        if last is None or last is self._kept:
            return
        with contextlib.suppress(HighsideError, OSError):
            write_whole(self.path, json.dumps(last.model_dump(mode="json")).encode())
        self._kept = last

    def _plausible(self, now: Moment) -> bool:
        """Whether the reference says what the last one lets expect, or has contradicted it for long enough."""
        last = self._last
        if last is None:
            return True
        present = self.present(now)
        ahead_s = now.wall_s - present.wall_s if present.known else min(now.wall_s - last.wall_s, 0.0)
        if abs(ahead_s) <= AGREES_S:
            self._contradicted_since_boot_s = None
            return True
        if self._contradicted_since_boot_s is None:
            self._contradicted_since_boot_s = now.boot_s
            log.warning("the wall clock is synchronised, but %.0f s off what is known: not used yet", ahead_s)
        if now.boot_s - self._contradicted_since_boot_s < BELIEVED_AFTER_S:
            return False
        self._contradicted_since_boot_s = None
        return True

    def _read(self) -> SyncedMoment | None:
        # a damaged file tells nothing, and is replaced
        with contextlib.suppress(HighsideError, ValidationError, OSError):
            if self.path.is_file():
                return SyncedMoment.model_validate(parse_json(read_document(self.path)))
        return None


def known_now(settings: Settings) -> Present:
    """What a daemon of this configuration would take the time for, at its start now."""
    now, known = clock.now(), KnownTime(state_dir(settings))
    known.look(now)
    return known.present(now)

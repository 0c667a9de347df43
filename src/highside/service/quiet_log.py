"""A log that says the same thing once a minute: a fault that repeats is one line, with a count, not a thousand.

A line belongs to a `reason`. The first of a reason is written at once; what follows within `interval_s` is counted, and
the next line of that reason says how many were left out.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

INTERVAL_S = 60.0
"""Seconds in which one reason has its lines: an operator reads a log by the minute, and a day of one standing fault is
1,440 lines."""
REASONS = 256
"""Reasons kept; beyond, the one that was begun first is forgotten."""


class QuietLog:
    """Writes to `log`; `burst` lines of a reason within `interval_s`."""

    def __init__(
        self,
        log: logging.Logger,
        *,
        burst: int = 1,
        interval_s: float = INTERVAL_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._log, self._interval_s, self._clock = log, interval_s, clock
        self._pace = _Pace(burst, interval_s, clock)

    def say(self, level: int, reason: str, text: str, *args: object) -> bool:
        """Write the line, or count it; returns whether it was written. `text` and `args` as for `logging`."""
        left_out = self._pace.pass_or_count(reason)
        if left_out is None:
            return False
        if left_out:
            self._log.log(level, text + " (and %d more of this kind since the last such line)", *args, left_out)
        else:
            self._log.log(level, text, *args)
        return True


class _Pace:
    def __init__(self, burst: int, interval_s: float, clock: Callable[[], float]) -> None:
        self._burst, self._interval_s, self._clock = burst, interval_s, clock
        self._reasons: dict[str, list[float]] = {}
        """by reason: when its interval began, lines written in it, lines left out"""

    def pass_or_count(self, reason: str) -> int | None:
        """None: one too many. Else how many were left out before this one."""
        now = self._clock()
        found = self._reasons.get(reason)
        if found is None:
            if len(self._reasons) >= REASONS:
                del self._reasons[next(iter(self._reasons))]
            found = self._reasons[reason] = [now, 0, 0]
        began, written, left_out = found
        if now - began >= self._interval_s:
            found[:] = [now, 1, 0]
            return int(left_out)
        if written >= self._burst:
            found[2] += 1
            return None
        found[1] += 1
        return 0

"""A log that says the same thing once a minute: a fault that repeats is one line, with a count, not a thousand.

A line belongs to a `reason`. The first of a reason is written at once; what follows within `interval_s` is counted, and
the next line of that reason says how many were omitted.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

INTERVAL_S = 60.0
"""Seconds in which one reason has its lines: an operator reads a log by the minute, and a day of one standing fault is
1,440 lines."""
REASONS = 256
"""Reasons kept; beyond, the one that was begun first is forgotten."""


@dataclass(slots=True)
class _Written:
    since_s: float
    lines: int = 0
    suppressed: int = 0


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
        self._log, self._burst, self._interval_s, self._clock = log, burst, interval_s, clock
        self._reasons: dict[str, _Written] = {}

    def say(self, level: int, reason: str, text: str, *args: object) -> bool:
        """Write the line, or count it; returns whether it was written. `text` and `args` as for `logging`."""
        now, more = self._clock(), ""
        written = self._reasons.get(reason)
        if written is None or now - written.since_s >= self._interval_s:
            if written is not None and written.suppressed:
                more = f" (and {written.suppressed} more of this kind since the last such line)"
            if written is None and len(self._reasons) >= REASONS:
                del self._reasons[next(iter(self._reasons))]
            written = self._reasons[reason] = _Written(now)
        elif written.lines >= self._burst:
            written.suppressed += 1
            return False
        written.lines += 1
        self._log.log(level, "%s%s", text % args if args else text, more)
        return True

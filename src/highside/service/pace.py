"""The pace of the backlog: an allowance of messages that grows with time, up to what may be under way at once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


class BacklogPace:
    """`allowance` messages may be sent now; who sends one takes it off. While it is not full, `wake` is called in time
    for the sender to look again."""

    def __init__(self, per_s: float, most: float, wake: Callable[[], None]) -> None:
        self.allowance = 0.0
        self._per_s, self._most, self._wake = per_s, most, wake
        self._at_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    def grow(self) -> None:
        """Add what the time since the last call allows."""
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        self.allowance = min(self.allowance + (now_s - self._at_s) * self._per_s, self._most)
        self._at_s = now_s
        if self.allowance < self._most and (self._timer is None or self._timer.when() <= now_s):
            self._timer = loop.call_later(max(0.5 * self._most / self._per_s, 0.005), self._wake)

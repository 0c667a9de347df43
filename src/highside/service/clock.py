"""The machine's clocks: is wall time trustworthy, and how long was the event loop held up?"""

from __future__ import annotations

import asyncio
import ctypes
import time

TIME_ERROR = 5
"""adjtimex(2) state: the clock is not synchronised"""
STA_UNSYNC = 0x0040


def clock_synced() -> bool:
    """Whether the kernel says that wall time follows a reference (adjtimex(2) with nothing to set)."""
    # struct timex is 208 bytes on 64-bit Linux: modes first, status after four longs
    buffer = (ctypes.c_char * 256)()
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(buffer))
    status = ctypes.c_int.from_buffer(buffer, 5 * ctypes.sizeof(ctypes.c_long)).value
    return bool(state not in (-1, TIME_ERROR) and not status & STA_UNSYNC)


class LoopLag:
    """Measures by how much a regular sleep overshoots: the time for which the event loop answered nobody."""

    TICK_S = 0.01

    def __init__(self) -> None:
        # overshoots counted in bins of 0.5 ms up to 1 s, the last bin holds the rest
        self._bins = [0] * 2001
        self._n = 0
        self.max_s = 0.0
        self.last_tick = time.monotonic()

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            due = time.monotonic() + self.TICK_S
            await asyncio.sleep(self.TICK_S)
            now = time.monotonic()
            self.last_tick = now
            lag = max(now - due, 0.0)
            self.max_s = max(self.max_s, lag)
            self._bins[min(int(lag * 2000.0), 2000)] += 1
            self._n += 1

    def quantile_ms(self, q: float) -> float:
        """Upper edge in ms of the bin in which the q-quantile lies; 0 before the first measurement."""
        wanted, seen = q * self._n, 0
        for index, count in enumerate(self._bins):
            seen += count
            if seen and seen >= wanted:
                return (index + 1) * 0.5 if index < 2000 else self.max_s * 1e3
        return 0.0

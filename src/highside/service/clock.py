"""The machine's clocks: which of them tells an age, is wall time trustworthy, was it set, was the event loop held up?

An age is never the difference of two wall times alone: a clock that starts in 1970 or years behind, and is set right
while messages wait, would make them ages old. Within one boot CLOCK_BOOTTIME tells it (nobody can set it, and it counts
while the machine sleeps); across boots the wall clock does if it followed a reference both times; else nothing does.
"""

from __future__ import annotations

import asyncio
import ctypes
import functools
import sys
import time
from pathlib import Path
from typing import NamedTuple, Protocol

TIME_ERROR = 5
"""adjtimex(2) state: the clock is not synchronised"""
STA_UNSYNC = 0x0040
STEP_S = 0.5
"""A change of wall time against the boot clock, between two looks, from which the clock was set. Corrections by slewing
are at most 0.5 ms a second (adjtimex(2)); NTP daemons set a clock that is off by more than 0.128 s (RFC 5905)."""
STEP_ALARM_S = 3600.0
"""How long the alarm `clock_stepped` stands after the last step."""
LOOK_S = 0.01
"""A look at both clocks that took longer (the process was not running) tells nothing about a step."""


class Stamped(Protocol):
    """When something was, by three clocks."""

    @property
    def wall_s(self) -> float: ...
    @property
    def synced(self) -> bool: ...
    @property
    def boot_id(self) -> str: ...
    @property
    def boot_s(self) -> float: ...


class Moment(NamedTuple):
    """A moment by three clocks."""

    wall_s: float
    synced: bool
    boot_id: str
    boot_s: float


def age_s(then: Stamped, now: Stamped) -> float | None:
    """Seconds from `then` to `now`; None where no clock can tell."""
    if then.boot_id and then.boot_id == now.boot_id:
        return max(now.boot_s - then.boot_s, 0.0)
    if then.synced and now.synced and now.wall_s >= then.wall_s:
        return now.wall_s - then.wall_s
    return None


@functools.cache
def boot_id() -> str:
    """Of this run of the machine; empty where it cannot be determined."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def boot_s() -> float:
    """Seconds since the machine was started, sleep included; nobody can set this clock."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


def now(*, synced: bool | None = None) -> Moment:
    """This moment; whether the wall clock is synchronised is asked unless the caller knows."""
    return Moment(time.time(), clock_synced() if synced is None else synced, boot_id(), boot_s())


class StepWatch:
    """Notices that the wall clock was set: it moved against the boot clock."""

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self.steps = 0
        self.last_s = 0.0
        """size of the last step, positive when set forward"""
        self._at_boot_s = 0.0

    def look(self) -> float | None:
        """The size of a step since the last look, None if there was none."""
        before, wall, after = boot_s(), time.time(), boot_s()
        if after - before > LOOK_S:
            return None
        offset = wall - 0.5 * (before + after)
        last, self._offset_s = self._offset_s, offset
        if last is None or abs(offset - last) < STEP_S:
            return None
        self.steps += 1
        self.last_s, self._at_boot_s = offset - last, after
        return self.last_s

    @property
    def alarm(self) -> bool:
        return self.steps > 0 and boot_s() - self._at_boot_s < STEP_ALARM_S

    def as_dict(self) -> dict[str, float | int | None]:
        """For the health message."""
        if not self.steps:
            return {"steps": 0, "last_step_s": None, "last_step_ago_s": None}
        ago = boot_s() - self._at_boot_s
        return {"steps": self.steps, "last_step_s": round(self.last_s, 3), "last_step_ago_s": round(ago, 1)}


def clock_synced() -> bool:
    """Whether the kernel says that wall time follows a reference (adjtimex(2) with nothing to set).

    Elsewhere than on Linux nothing is known of it: it counts as not synchronised.
    """
    if not sys.platform.startswith("linux"):
        return False
    # struct timex is 208 bytes on 64-bit Linux: modes first, status after four longs
    buffer = (ctypes.c_char * 256)()
    state = _libc().adjtimex(ctypes.byref(buffer))
    status = ctypes.c_int.from_buffer(buffer, 5 * ctypes.sizeof(ctypes.c_long)).value
    return bool(state not in (-1, TIME_ERROR) and not status & STA_UNSYNC)


@functools.cache
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


class LoopLag:
    """Measures by how much a regular sleep overshoots: the time for which the event loop answered nobody.

    What of it the process itself has computed meanwhile is counted apart (`own`): the rest is the machine's, which ran
    somebody else.
    """

    TICK_S = 0.1
    """Each tick wakes the loop. A stall of 100 ms is always noticed, one of 20 ms once in five times; the quantiles are
    those of the moments looked at, whatever their number."""

    def __init__(self) -> None:
        self.all = Overshoots()
        self.own = Overshoots()
        self.last_tick = time.monotonic()
        self._due = self._cpu_s = 0.0
        self._timer: asyncio.TimerHandle | None = None

    async def run(self) -> None:
        """Measure until cancelled."""
        self._start()
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            if self._timer is not None:
                self._timer.cancel()

    def _start(self) -> None:
        # a timer of the loop's own: a task that sleeps costs three turns of the loop a tick
        self._due, self._cpu_s = time.monotonic() + self.TICK_S, time.process_time()
        self._timer = asyncio.get_running_loop().call_later(self.TICK_S, self._tick)

    def _tick(self) -> None:
        self.last_tick = time.monotonic()
        lag = max(self.last_tick - self._due, 0.0)
        self.all.add(lag)
        self.own.add(min(lag, time.process_time() - self._cpu_s))
        self._start()

    def as_dict(self) -> dict[str, float]:
        """For the health message."""
        return {
            "lag_p999_ms": round(self.all.quantile_ms(0.999), 3),
            "lag_max_ms": round(self.all.max_s * 1e3, 3),
            "own_p999_ms": round(self.own.quantile_ms(0.999), 3),
        }


class Overshoots:
    """Times counted in bins of 0.5 ms up to 1 s; the last bin holds the rest."""

    def __init__(self) -> None:
        self._bins = [0] * 2001
        self._n = 0
        self.max_s = 0.0

    def add(self, time_s: float) -> None:
        """Count one."""
        self.max_s = max(self.max_s, time_s)
        self._bins[min(int(time_s * 2000.0), 2000)] += 1
        self._n += 1

    def quantile_ms(self, q: float) -> float:
        """Upper edge in ms of the bin in which the q-quantile lies; 0 before the first measurement."""
        wanted, counted = q * self._n, 0
        for index, count in enumerate(self._bins):
            counted += count
            if counted and counted >= wanted:
                return (index + 1) * 0.5 if index < 2000 else self.max_s * 1e3
        return 0.0

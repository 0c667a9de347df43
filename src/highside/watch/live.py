"""The watch on a stream: readings come one after another, and are cut into stretches in which the tool turns or not.

A stretch is what `rows.py` makes of a recording: turning tools give windows, others are searched for rests. Memory is
bounded by the longest stretch. Collecting costs a few appends a reading; the sums over a stretch are made when it
ends, by `LiveWatch.take`, which may run in another thread.

Time is that of the watch: it goes on with the tool's own, and across what is not seen (a gap, a restart of tool or
service) with what is known of it from elsewhere. A tool that was switched off may have another turn-on bias.
"""

from __future__ import annotations

import math
from array import array
from collections import deque
from dataclasses import dataclass
from threading import Lock

import numpy as np

from highside.arrays import Array
from highside.watch.memory import WatchMemory
from highside.watch.monitor import Watch
from highside.watch.result import WatchResult
from highside.watch.rows import REST, Calmest, Rows, stills, turnings
from highside.watch.turning import TURNING, Left

__all__ = ["LIVE", "NO_NUMBERS", "LiveRows", "LiveWatch", "Stretch"]


@dataclass(frozen=True)
class LivePolicy:
    """Of the stream."""

    calm_s: float = 10.0
    """over which the mean rate says whether the tool turns: stick-slip stops for a moment in the midst of a turn"""
    most_rows: int = 65_536
    """of one stretch: 100 readings a second for the longest rest"""


LIVE = LivePolicy()
NO_NUMBERS = "reading without numbers"
"""left out, and why"""
COLUMNS = 11
"""of a reading, as they are collected"""


@dataclass(frozen=True)
class Stretch:
    """Readings in which the tool turned all the time, or did not. `power_up`: it was switched on just before.
    `no_numbers`: readings before its end that were none."""

    rows: Rows
    turning: bool
    power_up: bool = False
    no_numbers: int = 0


class LiveRows:
    """Collects readings and cuts stretches."""

    def __init__(self, t_s: float = 0.0) -> None:
        """`t_s`: the watch's time at which it goes on."""
        self.t_s = t_s
        """of the watch, at the last reading"""
        self._device_s: float | None = None
        self.power_up = False
        """the tool was switched on since the last stretch"""
        self.no_numbers = 0
        """readings since the last stretch whose acceleration is no number"""
        self._columns = [array("d") for _ in range(COLUMNS)]
        """t, c (3), rate (3), temperature, span of the mean, depth, vibration"""
        self._second = 0.0
        self._sum, self._n = 0.0, 0
        self._means: deque[float] = deque(maxlen=max(1, round(LIVE.calm_s)))
        self._turning = False

    def unseen(self, seconds: float) -> Stretch | None:
        """Time passed without readings (a restart of the service); what was begun ends."""
        self._device_s = None
        done = self.cut()
        self.t_s += max(seconds, 0.0)
        return done

    def add(
        self,
        device_s: float,
        c: tuple[float, float, float],
        rate_radps: tuple[float, float, float] | None,
        temp_c: float | None,
        since_last_s: float = 0.0,
        span_s: float = 0.0,
        depth_m: float | None = None,
        vibration_g: float | None = None,
    ) -> Stretch | None:
        """One reading: the tool's own time, corrected acceleration in g, rates. `since_last_s`: by the host's clock,
        for when the tool's began anew; `span_s` of a reading that is a mean: `turning.mean_span`; true vertical depth
        and vibration rms, where known. Returns a stretch that ended before this reading."""
        done: Stretch | None = None
        last = self._device_s
        self._device_s = device_s
        if last is not None:
            step = device_s - last
            if step < 0.0:
                done, step, self.power_up = self.cut(), max(since_last_s, 0.0), True
            elif step > REST.gap_s:
                done = self.cut()
            if done is not None or step > REST.gap_s:
                # what it did before says nothing of what it does now
                self._means.clear()
                self._sum, self._n, self._turning = 0.0, 0, False
            self.t_s += step
        if not math.isfinite(c[0] + c[1] + c[2]):
            self.no_numbers += 1
            return done
        done = self._judged(rate_radps) or done
        nan = math.nan
        rate = (nan, nan, nan) if rate_radps is None else rate_radps
        beside = (nan if value is None else value for value in (depth_m, vibration_g))
        row = (self.t_s, *c, *rate, nan if temp_c is None else temp_c, span_s, *beside)
        for column, value in zip(self._columns, row, strict=True):
            column.append(value)
        return done

    def _judged(self, rate_radps: tuple[float, float, float] | None) -> Stretch | None:
        """Whether it turns, by the last seconds; a stretch that ends because that changes, or has become long."""
        if rate_radps is not None and math.isfinite(rate_radps[2]):
            self._sum += abs(rate_radps[2])
            self._n += 1
        if self.t_s - self._second >= 1.0:
            self._second = self.t_s
            if self._n:
                self._means.append(self._sum / self._n)
            self._sum, self._n = 0.0, 0
        turning = bool(self._means) and sum(self._means) / len(self._means) > math.radians(TURNING.rate_dps)
        times = self._columns[0]
        longest = TURNING.window_s if self._turning else REST.longest_s
        if turning != self._turning or (times and self.t_s - times[0] >= longest) or len(times) >= LIVE.most_rows:
            done = self.cut()
            self._turning = turning
            return done
        return None

    def cut(self) -> Stretch | None:
        """End the stretch under way; None where it is too short to say anything."""
        columns, self._columns = self._columns, [array("d") for _ in range(COLUMNS)]
        t = columns[0]
        if len(t) < 2 or t[-1] - t[0] < REST.shortest_s / 2.0:
            return None
        values = np.array(columns)
        power_up, self.power_up = self.power_up, False
        no_numbers, self.no_numbers = self.no_numbers, 0
        rows = Rows(
            values[0],
            values[1:4],
            _known(values[4:7]),
            _known(values[7]),
            _known(values[9]),
            _known(values[10]),
            values[8],
        )
        return Stretch(rows, self._turning, power_up, no_numbers)


def _known(values: Array) -> Array | None:
    """None for a quantity that no reading had."""
    return values if np.isfinite(values).any() else None


class LiveWatch:
    """A watch with what it needs beside it on a stream. `take` may run in another thread than the rest."""

    def __init__(self, watch: Watch, calmest_g: float | None = None, calmest_s: float = 0.0) -> None:
        self._watch = watch
        self._calmest = Calmest(calmest_g, calmest_s)
        self._lock = Lock()
        self._last: Stretch | None = None

    @property
    def calmest(self) -> tuple[float | None, float]:
        """To be kept beside `memory`."""
        return self._calmest.g, self._calmest.s

    def take(self, stretch: Stretch) -> WatchResult:
        """What a stretch says, and what is said after it."""
        with self._lock:
            watch, self._last = self._watch, stretch
            if stretch.power_up:
                watch.power_up()
            if stretch.no_numbers:
                watch.leave_out(NO_NUMBERS, stretch.no_numbers)
            if stretch.turning:
                for window in turnings(stretch.rows):
                    if isinstance(window, Left):
                        watch.leave_out(window.reason)
                    else:
                        watch.turning(window)
            else:
                self._take_rests(stretch.rows)
            return watch.result(float(stretch.rows.t_s[-1]))

    def _take_rests(self, rows: Rows) -> None:
        for still in stills(rows, self._watch.leave_out):
            (self._watch.shaken if self._calmest.shakes(still) else self._watch.still)(still)

    def result(self, now_s: float | None = None) -> WatchResult:
        """What is said at a time of the watch; None: right after what was last used."""
        with self._lock:
            return self._watch.result(now_s)

    def memory(self) -> WatchMemory:
        """What it knows."""
        return self.memory_and_last()[0]

    def memory_and_last(self) -> tuple[WatchMemory, Stretch | None]:
        """What it knows, and which stretch was the last that this is of."""
        with self._lock:
            return self._watch.memory(), self._last

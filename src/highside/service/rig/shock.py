"""Shock and vibration of the raw stream: rms and peak of each axis, seconds and shocks by level.

Gravity, and a turning tool's share of it, is slow; what two high passes of first order at the corner frequency leave is
shaking (of a turn at 1 Hz, with the corner at 5 Hz, 4 % are left). It is judged in blocks of one second of device time;
a shock is counted once however many readings are above its level, until `shock_gap_s` have passed without one.
Readings that the monitor refuses as out of range count here: a shock is what drives a sensor out of its range.
"""

from __future__ import annotations

import math
from typing import Any

from highside.config.rig import VibrationSettings

AXES = ("x", "y", "z")
BLOCK_S = 1.0
SETTLING = 10.0
"""Time constants that the high pass is given after a gap before it is accepted."""


class ShockMeter:
    """Takes raw readings in g, one at a time, with device time in seconds."""

    def __init__(self, settings: VibrationSettings) -> None:
        self._settings = settings
        self._tau = 1.0 / (2.0 * math.pi * settings.corner_hz)
        self._last: list[float] | None = None
        """the last reading; None: the next one does not follow any"""
        self._once = [0.0, 0.0, 0.0]
        self._twice = [0.0, 0.0, 0.0]
        """after one and after both high passes"""
        self._first_shock_g = settings.shock_levels_g[0] if settings.shock_levels_g else math.inf
        self._t = 0.0
        self._settled = 0.0
        self._block_start = 0.0
        self._n = 0
        self._sum2 = [0.0, 0.0, 0.0]
        self._peak = [0.0, 0.0, 0.0]
        self._shock_level = [-1, -1, -1]
        """highest level that the running shock of an axis has reached; -1: no shock"""
        self._shock_last = [0.0, 0.0, 0.0]
        self.rms_g = [0.0, 0.0, 0.0]
        """of the last whole second"""
        self.peak_g = [0.0, 0.0, 0.0]
        self.max_rms_g = [0.0, 0.0, 0.0]
        self.max_peak_g = [0.0, 0.0, 0.0]
        self.seconds = [[0.0] * len(settings.rms_levels_g) for _ in AXES]
        """at or above each level"""
        self.shocks = [[0] * len(settings.shock_levels_g) for _ in AXES]
        self.since_g = [0.0, 0.0, 0.0]
        """greatest peak since `begin_watch`"""

    def begin_watch(self) -> None:
        """From now on `since_g` tells the greatest peak: the time of a survey."""
        self.since_g = [0.0, 0.0, 0.0]

    def forget(self) -> None:
        """The stream was interrupted: what comes next does not follow."""
        self._last = None

    def add(self, t: float, ax: float, ay: float, az: float) -> None:
        """One reading; a value that is not finite is omitted."""
        if not (ax - ax == 0.0 and ay - ay == 0.0 and az - az == 0.0):
            return
        last = self._last
        step = t - self._t
        self._t = t
        if last is None or step < 0.0 or step > 1.0:
            self._last, self._once, self._twice = [ax, ay, az], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
            self._settled = t + SETTLING * self._tau
            self._restart_block(t)
            return
        # the trapezoidal rule on tau y' + y = tau x', twice
        half = step / (2.0 * self._tau)
        gain, keep = 1.0 / (1.0 + half), (1.0 - half) / (1.0 + half)
        for axis, value in enumerate((ax, ay, az)):
            once = gain * (value - last[axis]) + keep * self._once[axis]
            fast = gain * (once - self._once[axis]) + keep * self._twice[axis]
            last[axis], self._once[axis], self._twice[axis] = value, once, fast
            if t < self._settled:
                continue
            size = abs(fast)
            self._sum2[axis] += fast * fast
            if size > self._peak[axis]:
                self._peak[axis] = size
            if size > self.since_g[axis]:
                self.since_g[axis] = size
            if size >= self._first_shock_g or self._shock_level[axis] >= 0:
                self._watch_shock(axis, size, t)
        if t >= self._settled:
            self._n += 1
        if t - self._block_start >= BLOCK_S:
            self._end_block(t)

    def _watch_shock(self, axis: int, size: float, t: float) -> None:
        levels = self._settings.shock_levels_g
        running = self._shock_level[axis]
        if size >= levels[0]:
            reached = running
            while reached + 1 < len(levels) and size >= levels[reached + 1]:
                reached += 1
                self.shocks[axis][reached] += 1
            self._shock_level[axis] = reached
            self._shock_last[axis] = t
        elif running >= 0 and t - self._shock_last[axis] > self._settings.shock_gap_s:
            self._shock_level[axis] = -1

    def _restart_block(self, t: float) -> None:
        self._block_start = t
        self._n = 0
        self._sum2 = [0.0, 0.0, 0.0]
        self._peak = [0.0, 0.0, 0.0]

    def _end_block(self, t: float) -> None:
        if self._n:
            for axis in range(3):
                rms = math.sqrt(self._sum2[axis] / self._n)
                self.rms_g[axis], self.peak_g[axis] = rms, self._peak[axis]
                self.max_rms_g[axis] = max(self.max_rms_g[axis], rms)
                self.max_peak_g[axis] = max(self.max_peak_g[axis], self._peak[axis])
                for k, level in enumerate(self._settings.rms_levels_g):
                    if rms >= level:
                        self.seconds[axis][k] += t - self._block_start
        self._restart_block(t)

    def as_dict(self) -> dict[str, Any]:
        """What the health message says."""
        return {
            "rms_g": [round(v, 6) for v in self.rms_g],
            "peak_g": [round(v, 6) for v in self.peak_g],
            "max_rms_g": [round(v, 6) for v in self.max_rms_g],
            "max_peak_g": [round(v, 6) for v in self.max_peak_g],
            "rms_levels_g": list(self._settings.rms_levels_g),
            "seconds_at_level": {a: [round(s, 3) for s in self.seconds[i]] for i, a in enumerate(AXES)},
            "shock_levels_g": list(self._settings.shock_levels_g),
            "shocks": {a: list(self.shocks[i]) for i, a in enumerate(AXES)},
        }

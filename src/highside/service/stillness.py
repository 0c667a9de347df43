"""When a tool stands still, and the average of what it showed meanwhile: what a survey is made of."""

from __future__ import annotations

import math
from typing import NamedTuple

from highside.calibration.correction import Vector
from highside.config.settings import SurveySettings
from highside.rotation.live import RotorError, mean_error
from highside.service.window import WindowReading, WindowStatistics

SLOW_S = 2.0
"""of the means whose scatter is kept beside that of readings, as `watch.axis_noise` has them"""
SHAKING = 16.0
"""Variance in a window, in units of the sensor's own, from which the tool shakes or turns."""


class AxisScatter(NamedTuple):
    """Standard deviation by axis within a stop, g, by the differences of neighbours: neither a drift nor the length of
    the stop counts."""

    reading: Vector
    """of one reading"""
    slow: Vector | None
    """of a mean of two seconds; None: the stop was too short for three of them"""


class Cut(NamedTuple):
    """A stop that motion ended: what had been collected until then."""

    duration_s: float
    mean: Vector
    variance: Vector
    """of one reading, g^2"""
    n: int
    temp_c: float | None
    rotor: RotorError | None
    scatter: AxisScatter | None = None
    """None: fewer than three readings"""


class StillnessDetector:
    """Collects readings for as long as window means stay where they were, within their own noise."""

    def __init__(self, settings: SurveySettings) -> None:
        self._settings = settings
        self._restart()

    def _restart(self) -> None:
        self._n = 0
        self._windows = 0
        self._sum = [0.0, 0.0, 0.0]
        self._sum2 = [0.0, 0.0, 0.0]
        self._last = [0.0, 0.0, 0.0]
        self._steps2 = [0.0, 0.0, 0.0]
        self._slow: list[float] = []
        """the last mean of two seconds"""
        self._slow_n = 0
        self._slow_steps2 = [0.0, 0.0, 0.0]
        self._slow_start_s, self._slow_from_n, self._slow_from = 0.0, 0, [0.0, 0.0, 0.0]
        """when the present one began, and number and sums of readings then"""
        self._reference: Vector = (0.0, 0.0, 0.0)
        self._temp_sum, self._temp_n = 0.0, 0
        self._rotor: list[RotorError | None] = []
        """the mean of each window"""
        self._start_s = self._end_s = 0.0
        self.reported = False

    def forget(self) -> None:
        """A gap or a device reset: stillness begins anew."""
        self._restart()

    def again(self) -> None:
        """The stop goes on, but what was collected is not to be used: collect anew."""
        self._restart()

    def cut(self) -> Cut | None:
        """What is collected, to be kept before motion takes it away; None: nothing."""
        if not self._n:
            return None
        return Cut(self._end_s - self._start_s, *self.mean(), mean_error(self._rotor), self.scatter())

    def add(self, window: WindowStatistics, frames: list[WindowReading], own: Vector) -> float:
        """Take a window and the frames that are new in it; returns the seconds of stillness so far (0: it moved).

        `own` is the variance of one reading that is the sensor's own, g^2 an axis. A turning tool whose means stand
        still (a whole turn in a window) betrays itself by more scatter than that.
        """
        settings = self._settings
        floor = settings.floor_g**2
        for scatter, noise in zip(window.scatter, own, strict=True):
            if scatter > max(SHAKING * noise, floor) or scatter > settings.max_noise_g**2:
                self._restart()
                return 0.0
        if self._n:
            n = self._n
            for axis in range(3):
                departure = abs(window.mean[axis] - self._reference[axis] - self._sum[axis] / n)
                sigma = math.sqrt(window.variance[axis] * (1.0 + 1.0 / self._windows))
                if departure > max(settings.sigma * sigma, settings.floor_g):
                    self._restart()
                    return 0.0
        if window.slope_sigmas > settings.sigma and max(abs(s) for s in window.span) > settings.floor_g:
            self._restart()
            return 0.0
        if not frames:
            return 0.0
        if not self._n:
            self._reference = frames[0].a
            self._start_s = self._slow_start_s = frames[0].t
            self._last = [0.0, 0.0, 0.0]
        for frame in frames:
            for axis in range(3):
                d = frame.a[axis] - self._reference[axis]
                self._sum[axis] += d
                self._sum2[axis] += d * d
                step = d - self._last[axis]
                self._steps2[axis] += step * step
                self._last[axis] = d
            if frame.temp_c is not None:
                self._temp_sum += frame.temp_c
                self._temp_n += 1
        self._n += len(frames)
        self._windows += 1
        if frames[-1].rotor is not None:
            self._rotor.append(mean_error(frame.rotor for frame in frames))
        self._end_s = frames[-1].t
        if self._end_s - self._slow_start_s >= SLOW_S:
            self._end_slow()
        return self._end_s - self._start_s

    def _end_slow(self) -> None:
        """A mean of two seconds is complete."""
        count = self._n - self._slow_from_n
        mean = [(now - then) / count for now, then in zip(self._sum, self._slow_from, strict=True)]
        if self._slow:
            for axis in range(3):
                self._slow_steps2[axis] += (mean[axis] - self._slow[axis]) ** 2
        self._slow, self._slow_n = mean, self._slow_n + 1
        self._slow_start_s, self._slow_from_n, self._slow_from = self._end_s, self._n, list(self._sum)

    def scatter(self) -> AxisScatter | None:
        """What single readings and means of two seconds scatter."""
        if self._n < 3:
            return None
        x, y, z = (math.sqrt(steps2 / (2.0 * (self._n - 1))) for steps2 in self._steps2)
        if self._slow_n < 3:
            return AxisScatter((x, y, z), None)
        slow = [math.sqrt(steps2 / (2.0 * (self._slow_n - 1))) for steps2 in self._slow_steps2]
        return AxisScatter((x, y, z), (slow[0], slow[1], slow[2]))

    def mean(self) -> tuple[Vector, Vector, int, float | None]:
        """Mean (g), variance of one reading (g^2), number of readings, mean temperature."""
        n = self._n
        mean = [s / n for s in self._sum]
        variance = [max(s2 / n - m * m, 0.0) * n / max(n - 1, 1) for s2, m in zip(self._sum2, mean, strict=True)]
        temp = self._temp_sum / self._temp_n if self._temp_n else None
        where = [m + r for m, r in zip(mean, self._reference, strict=True)]
        return (where[0], where[1], where[2]), (variance[0], variance[1], variance[2]), n, temp

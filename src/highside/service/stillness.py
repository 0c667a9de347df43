"""When a tool stands still, and the average of what it showed meanwhile: what a survey is made of."""

from __future__ import annotations

import math
from typing import NamedTuple

from highside.calibration.correction import Vector
from highside.config.settings import SurveySettings
from highside.rotation.live import RotorError, mean_error
from highside.service.window import WindowReading, WindowStatistics

SHAKING = 16.0
"""Variance in a window, in units of the sensor's own, from which the tool shakes or turns."""


class Cut(NamedTuple):
    """A stop that motion ended: what had been collected until then."""

    duration_s: float
    mean: Vector
    variance: Vector
    """of one reading, g^2"""
    n: int
    temp_c: float | None
    rotor: RotorError | None


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
        return Cut(self._end_s - self._start_s, *self.mean(), mean_error(self._rotor)) if self._n else None

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
            self._start_s = frames[0].t
        for frame in frames:
            for axis in range(3):
                d = frame.a[axis] - self._reference[axis]
                self._sum[axis] += d
                self._sum2[axis] += d * d
            if frame.temp_c is not None:
                self._temp_sum += frame.temp_c
                self._temp_n += 1
        self._n += len(frames)
        self._windows += 1
        if frames[-1].rotor is not None:
            self._rotor.append(mean_error(frame.rotor for frame in frames))
        self._end_s = frames[-1].t
        return self._end_s - self._start_s

    def mean(self) -> tuple[Vector, Vector, int, float | None]:
        """Mean (g), variance of one reading (g^2), number of readings, mean temperature."""
        n = self._n
        mean = [s / n for s in self._sum]
        variance = [max(s2 / n - m * m, 0.0) * n / max(n - 1, 1) for s2, m in zip(self._sum2, mean, strict=True)]
        temp = self._temp_sum / self._temp_n if self._temp_n else None
        where = [m + r for m, r in zip(mean, self._reference, strict=True)]
        return (where[0], where[1], where[2]), (variance[0], variance[1], variance[2]), n, temp

"""The averaging window: its readings, their mean with its uncertainty, and the running estimate of the noise.

Uncertainty of a mean: the readings of a window are freed of a straight line in time (a turning tool is not noise),
the larger of the scatter that is left and the running estimate of the noise is divided by their number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from highside.calibration.correction import Vector
from highside.rotation.live import RotorError

SMALL_WINDOW = 32
"""Readings up to which plain Python is faster than numpy's calls (12 against 45 us at 10 readings)."""
SETTLED = 20
"""Second differences from which the running estimate of the noise is a measure of it."""
MIN_OWN_SCATTER = 8
"""Readings in a window from which its own scatter is used instead of the running estimate of the noise."""
ROLLING_BIAS_BLOCK_S = 0.0095
"""Readings within this are averaged before the re-balance sees them: 1.1 deg of a turn at 20 rpm."""
QUIET_MEMORY_S = 3600.0
"""In about this time the sensor's own noise may be found to have grown."""
NOISE_MEMORY = 0.02
"""Weight of a new second difference in the running estimate of the noise."""


class WindowReading(NamedTuple):
    """A reading in the window."""

    t: float
    a: Vector
    temp_c: float | None
    rotor: RotorError | None = None


@dataclass(frozen=True, slots=True)
class WindowStatistics:
    """Mean of the readings in a window and the covariance of that mean (diagonal, g^2)."""

    mean: Vector
    variance: Vector
    slope_sigmas: float
    """the steepest axis' change over the window, in units of its own standard deviation"""
    span: Vector
    """change over the window along the fitted line, g"""
    scatter: Vector
    """variance of one reading about that line, g^2"""


class NoiseEstimate:
    """Running variance of one reading, an axis each, from second differences: blind to offsets and steady turns."""

    def __init__(self, known_g: float | None) -> None:
        self._known = known_g
        self._variance = [0.0, 0.0, 0.0]
        self._n = 0
        self._before: Vector | None = None
        self._last: Vector | None = None
        self._quiet: list[float] | None = None
        self._quiet_at = 0.0

    def quiet(self, t: float) -> Vector:
        """The sensor's own share of the variance: the least that was measured, forgotten slowly; ask at rising
        times."""
        now = self.variance
        if self._known is not None or self._n < SETTLED:
            return now
        if self._quiet is None:
            self._quiet, self._quiet_at = list(now), t
        share = min(max(t - self._quiet_at, 0.0) / QUIET_MEMORY_S, 1.0)
        self._quiet_at = t
        for axis in range(3):
            before = self._quiet[axis]
            self._quiet[axis] = min(now[axis], before + share * (now[axis] - before))
        return (self._quiet[0], self._quiet[1], self._quiet[2])

    def add(self, a: Vector) -> None:
        before, last = self._before, self._last
        if before is not None and last is not None:
            self._n += 1
            weight = max(NOISE_MEMORY, 1.0 / self._n)
            for axis in range(3):
                second = a[axis] - 2.0 * last[axis] + before[axis]
                self._variance[axis] += weight * (second * second / 6.0 - self._variance[axis])
        self._before, self._last = last, a

    def forget(self) -> None:
        """The stream was interrupted: the next reading does not follow the last one."""
        self._before = self._last = None

    @property
    def variance(self) -> Vector:
        """Variance of one reading an axis, g^2."""
        if self._known is not None:
            known = self._known * self._known
            return (known, known, known)
        return (self._variance[0], self._variance[1], self._variance[2])


class ReadingBlock:
    """Readings averaged before the re-balance sees them, which needs no more than a hundred a second."""

    def __init__(self) -> None:
        self._n = 0
        self._sum = [0.0, 0.0, 0.0]
        self._t_sum = 0.0
        self.start = self.t = 0.0
        self._temp_c: float | None = None

    def add(self, t: float, a: Vector, temp_c: float | None) -> None:
        if not self._n:
            self.start = self.t if t - self.t < 2.0 * ROLLING_BIAS_BLOCK_S else t
        self.t = t
        self._n += 1
        self._t_sum += t
        self._sum[0] += a[0]
        self._sum[1] += a[1]
        self._sum[2] += a[2]
        self._temp_c = temp_c

    def take(self) -> tuple[float, Vector, float | None]:
        """Mean time, mean reading, last temperature; begins a new block."""
        n, (x, y, z) = self._n, self._sum
        mean = (self._t_sum / n, (x / n, y / n, z / n), self._temp_c)
        self._n, self._t_sum, self._sum = 0, 0.0, [0.0, 0.0, 0.0]
        return mean


def window_statistics(rows: list[WindowReading], noise_variance: Vector) -> WindowStatistics:
    """Mean, variance of the mean, and drift over a window.

    The variance (g^2) of the mean is the scatter about a straight line in time, or `noise_variance` (of one reading)
    if that is larger, divided by n; with fewer than 8 readings it is `noise_variance` divided by n.
    """
    n = len(rows)
    if MIN_OWN_SCATTER <= n <= SMALL_WINDOW:
        return _small_window(rows, noise_variance)
    if n >= MIN_OWN_SCATTER:
        time = np.array([row.t for row in rows])
        time -= time.mean()
        a = np.array([row.a for row in rows]).T
        mean = a.mean(axis=1)
        centred = a - mean[:, None]
        tt = float(time @ time)
        slope = centred @ time / tt if tt > 0.0 else np.zeros(3)
        rest = np.einsum("ij,ij->i", centred, centred) - slope * slope * tt
        scatter = np.maximum(rest, 0.0) / (n - 2)
        # few degrees of freedom may show far too little scatter by chance
        own = [max(float(s), v) for s, v in zip(scatter, noise_variance, strict=True)]
        span = slope * (time[-1] - time[0])
        sigma_slope = np.sqrt(np.maximum(own, 1e-18) / tt) if tt > 0.0 else np.full(3, np.inf)
        return WindowStatistics(
            (float(mean[0]), float(mean[1]), float(mean[2])),
            (own[0] / n, own[1] / n, own[2] / n),
            float(np.max(np.abs(slope) / sigma_slope)) if tt > 0.0 else 0.0,
            (float(span[0]), float(span[1]), float(span[2])),
            (float(scatter[0]), float(scatter[1]), float(scatter[2])),
        )
    mean3 = [sum(row.a[axis] for row in rows) / n for axis in range(3)]
    span3 = [rows[-1].a[axis] - rows[0].a[axis] for axis in range(3)]
    sigmas = max(abs(s) / math.sqrt(2.0 * v) if v > 0.0 else 0.0 for s, v in zip(span3, noise_variance, strict=True))
    return WindowStatistics(
        (mean3[0], mean3[1], mean3[2]),
        (noise_variance[0] / n, noise_variance[1] / n, noise_variance[2] / n),
        sigmas,
        (span3[0], span3[1], span3[2]),
        noise_variance,
    )


def _small_window(rows: list[WindowReading], noise_variance: Vector) -> WindowStatistics:
    """The same without numpy, whose calls cost more than the sums of a few readings."""
    n = len(rows)
    middle = math.fsum(row.t for row in rows) / n
    times = [row.t - middle for row in rows]
    tt = math.fsum([t * t for t in times])
    means, variances, spans, scatters, sigmas = [], [], [], [], 0.0
    for axis in range(3):
        values = [row.a[axis] for row in rows]
        mean = math.fsum(values) / n
        centred = [value - mean for value in values]
        slope = sum([c * t for c, t in zip(centred, times, strict=True)]) / tt if tt > 0.0 else 0.0
        rest = sum([c * c for c in centred]) - slope * slope * tt
        scatter = max(rest, 0.0) / (n - 2)
        # few degrees of freedom may show far too little scatter by chance
        own = max(scatter, noise_variance[axis])
        if tt > 0.0:
            sigmas = max(sigmas, abs(slope) / math.sqrt(max(own, 1e-18) / tt))
        means.append(mean)
        variances.append(own / n)
        spans.append(slope * (times[-1] - times[0]))
        scatters.append(scatter)
    return WindowStatistics(
        (means[0], means[1], means[2]),
        (variances[0], variances[1], variances[2]),
        sigmas,
        (spans[0], spans[1], spans[2]),
        (scatters[0], scatters[1], scatters[2]),
    )

"""Corrections by inclination, blended so that inclination and toolface never jump.

A balance correction holds only near its own inclination. The schedule puts several of them side by side, each with a
weight that is one at its own inclination and falls smoothly to zero at that of its neighbour or, if that is nearer,
at the edge of its zone, and fills what is left of the weight with a global correction. Where there is no global one
and no zone holds, there is no answer: a local matrix taken at 0.6 deg multiplies noise by 94 when it is used at
90 deg.

The weights depend on the inclination that *one* correction, the guide, gives to the raw reading (the global one where
there is one). It is continuous in the reading, so are the weights, and so is the blended vector; there is no memory and
hence no hysteresis.

Covariance of the blend: the zones' errors come from the same bench and tool and are correlated in a way that nobody
knows. Whatever it is, `Cov(sum w x) <= sum w Cov(x)` (as matrices, for weights that sum to one): the right side
is stated, equal to the truth where the errors are the same and never below it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from highside.calibration.correction import (
    ZERO_COVARIANCE,
    BlockCorrected,
    Corrected,
    Covariance,
    FloatArray,
    LinearCorrection,
    Vector,
    refused,
)
from highside.calibration.result import Zone
from highside.errors import InputError

Value = TypeVar("Value", FloatArray, float, FloatArray | float, FloatArray | float | None)

TAPER = 0.5
"""Share of a zone's half-width, at either edge, over which its weight falls from one to zero."""

_EDGE_OF_RANGE = 1e-9


@dataclass(frozen=True, slots=True)
class Window:
    """The weight of one zone by inclination (rad): 0 outside of `low` to `high`, 1 at its own inclination `center`.

    It rises over `rise` from `low` and falls over `fall` towards `high`; a width of 0 means that there is no edge
    on that side (the zone reaches to 0 or 180 deg).
    """

    center: float
    low: float
    high: float
    rise: float
    fall: float

    def weight(self, inc_rad: float) -> float:
        """Weight at one inclination."""
        if inc_rad < self.center:
            return _smooth_step((inc_rad - self.low) / self.rise) if self.rise > 0.0 else 1.0
        return _smooth_step((self.high - inc_rad) / self.fall) if self.fall > 0.0 else 1.0

    def weights(self, inc_rad: FloatArray) -> FloatArray:
        """Weights at inclinations (N,)."""
        out = np.ones_like(inc_rad)
        if self.rise > 0.0:
            below = inc_rad < self.center
            out[below] = _smooth_steps((inc_rad[below] - self.low) / self.rise)
        if self.fall > 0.0:
            above = inc_rad >= self.center
            out[above] = _smooth_steps((self.high - inc_rad[above]) / self.fall)
        out[np.isnan(inc_rad)] = 0.0
        return out


def windows(zones: Sequence[Zone]) -> tuple[Window, ...]:
    """The windows of zones sorted by inclination.

    Between two neighbours one falls while the other rises, the sum being one where both reach far enough.
    """
    centers = [abs(zone.inc_center_rad or 0.0) for zone in zones]
    out = []
    for k, (zone, center) in enumerate(zip(zones, centers, strict=True)):
        low, high = zone.inc_min_rad, zone.inc_max_rad
        rise = 0.0 if low <= _EDGE_OF_RANGE else TAPER * (center - low)
        fall = 0.0 if high >= math.pi - _EDGE_OF_RANGE else TAPER * (high - center)
        if k > 0 and zones[k - 1].inc_max_rad > low:
            low = max(low, centers[k - 1])
            rise = center - low
        if k + 1 < len(zones) and zones[k + 1].inc_min_rad < high:
            high = min(high, centers[k + 1])
            fall = high - center
        out.append(Window(center, low, high, rise, fall))
    return tuple(out)


def _smooth_step(x: float) -> float:
    """0 for x <= 0, 1 for x >= 1, with continuous first and second derivatives between."""
    if x <= 0.0:
        return 0.0
    if x >= 1.0:
        return 1.0
    return x * x * x * (x * (6.0 * x - 15.0) + 10.0)


def _smooth_steps(x: FloatArray) -> FloatArray:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * x * (x * (6.0 * x - 15.0) + 10.0))


@dataclass(frozen=True, slots=True)
class ScheduledCorrection:
    """Local corrections `zones`, a correction `fallback` for everywhere else (None: nothing else), blended.

    `guide` gives the inclination by which the weights are chosen; the fallback where None, else the raw reading.
    """

    zones: tuple[LinearCorrection, ...]
    fallback: LinearCorrection | None = None
    cal_id: str = "none"
    guide: LinearCorrection | None = None
    _guide: LinearCorrection | None = field(init=False, repr=False, compare=False)
    _windows: tuple[Window, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.zones and self.fallback is None:
            raise InputError("a schedule needs at least one correction")
        for part in self.zones:
            zone = part.zone
            if zone.inc_center_rad is None:
                raise InputError(f"zone {zone.name} of a schedule has no inclination of its own")
            if part.guarded or not zone.inc_min_rad <= abs(zone.inc_center_rad) <= zone.inc_max_rad:
                raise InputError(f"zone {zone.name} of a schedule is guarded or does not contain its own inclination")
        ordered = tuple(sorted(self.zones, key=lambda part: abs(part.zone.inc_center_rad or 0.0)))
        object.__setattr__(self, "zones", ordered)
        object.__setattr__(self, "_guide", self.guide or self.fallback)
        object.__setattr__(self, "_windows", windows([part.zone for part in ordered]))

    def weights(self, a: Vector, temp_c: float | None = None) -> list[tuple[LinearCorrection, float]]:
        """The corrections that take part at a raw reading, with weights that sum to one; empty where none holds."""
        if self._guide is not None:
            k = self._guide.coefficients(temp_c)
            c, o = k.c, k.o
            x = c[0] * a[0] + c[1] * a[1] + c[2] * a[2] - o[0]
            y = c[3] * a[0] + c[4] * a[1] + c[5] * a[2] - o[1]
            z = c[6] * a[0] + c[7] * a[1] + c[8] * a[2] - o[2]
        else:
            x, y, z = a
        inc = math.atan2(math.hypot(x, y), z)
        pairs = zip(self.zones, self._windows, strict=True)
        parts = [(part, w) for part, window in pairs if (w := window.weight(inc)) > 0.0]
        total = sum(w for _, w in parts)
        if self.fallback is not None and total < 1.0:
            return [*parts, (self.fallback, 1.0 - total)]
        return [(part, w / total) for part, w in parts]

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        parts = self.weights(a, temp_c)
        if len(parts) == 1:
            return parts[0][0].correct(a, cov, temp_c)
        if not parts:
            return refused()
        x = y = z = 0.0
        total = [0.0] * 6
        flags: dict[str, None] = {}
        for part, w in parts:
            one = part.correct(a, cov, temp_c)
            x, y, z = x + w * one.gx, y + w * one.gy, z + w * one.gz
            for i in range(6):
                total[i] += w * one.cov[i]
            flags.update(dict.fromkeys(one.flags))
        name = " + ".join(part.name for part, _ in parts)
        return Corrected(x, y, z, (total[0], total[1], total[2], total[3], total[4], total[5]), name, tuple(flags))

    def correct_block(self, a: FloatArray, temp_c: FloatArray | float | None = None) -> FloatArray:
        """Corrected vectors (3, N) from raw readings (3, N); NaN where no correction holds.

        `temp_c`: one temperature, or one a reading (N,).
        """
        out = np.zeros_like(a)
        held = np.zeros(a.shape[1], dtype=bool)
        for part, rows, w in self._shares(a, temp_c):
            out[:, rows] += part.correct_block(a[:, rows], _of_rows(temp_c, rows)) * w
            held[rows] = True
        out[:, ~held] = np.nan
        return out

    def corrected_block(
        self, a: FloatArray, noise_g: FloatArray | float, temp_c: FloatArray | float | None = None
    ) -> BlockCorrected:
        """Correct readings `a` (3, N) whose own standard deviation is `noise_g` (one, or (N,)) in each axis."""
        count = a.shape[1]
        g, cov = np.zeros_like(a), np.zeros((6, count))
        zone, most = np.full(count, -1, dtype=np.intp), np.zeros(count)
        outside = np.zeros(count, dtype=bool)
        shares = self._shares(a, temp_c)
        for k, (part, rows, w) in enumerate(shares):
            one = part.corrected_block(a[:, rows], _of_rows(noise_g, rows), _of_rows(temp_c, rows))
            g[:, rows] += one.g * w
            cov[:, rows] += one.cov * w
            outside[rows] |= one.temperature_outside
            more = w > most[rows]
            zone[rows[more]], most[rows[more]] = k, w[more]
        g[:, zone < 0] = np.nan
        cov[:, zone < 0] = np.nan
        return BlockCorrected(g, cov, zone, tuple(part.name for part, _, _ in shares), outside)

    def _shares(
        self, a: FloatArray, temp_c: FloatArray | float | None
    ) -> list[tuple[LinearCorrection, NDArray[np.intp], FloatArray]]:
        """Each correction with the readings (rows) that it takes part in, and its weight there."""
        guided = a if self._guide is None else self._guide.correct_block(a, temp_c)
        inc = np.arctan2(np.sqrt(guided[0] ** 2 + guided[1] ** 2), guided[2])
        parts: list[LinearCorrection] = list(self.zones)
        weights = [window.weights(inc) for window in self._windows]
        total = np.sum(weights, axis=0) if weights else np.zeros_like(inc)
        if self.fallback is not None:
            parts.append(self.fallback)
            weights.append(np.where(np.isnan(inc), 0.0, np.maximum(1.0 - total, 0.0)))
            total = np.maximum(total, 1.0)
        out = []
        for part, w in zip(parts, weights, strict=True):
            rows = np.flatnonzero(w)
            if rows.size:
                out.append((part, rows, w[rows] / total[rows]))
        return out


def _of_rows(value: Value, rows: NDArray[np.intp]) -> Value:
    """A value a reading, of some readings; one value for all stays as it is."""
    return value[rows] if isinstance(value, np.ndarray) and value.ndim else value

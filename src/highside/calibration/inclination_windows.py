"""Weight of each zone of a calibration by inclination: windows that overlap, so that one falls while the next rises."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.calibration.schedule_loop import window_weight
from highside.calibration.zone import Zone

TAPER = 0.5
"""Share of a zone's half-width, at either edge, over which its weight falls from one to zero."""

_EDGE_OF_RANGE = 1e-9


@dataclass(frozen=True, slots=True)
class InclinationWindow:
    """The weight of one zone by the key of a reading (`key_of`): 0 outside of `low` to `high`, 1 at its own `center`.

    The weight rises from `low` to
    `low + rise` and falls from `high - fall` to `high`; a width of 0 means that there is no edge on that side (the
    zone reaches to 0 or 180 deg).
    """

    center: float
    low: float
    high: float
    rise: float
    fall: float

    def weight(self, key: float) -> float:
        """Weight at one key."""
        return window_weight(key, *self.edges)

    @property
    def edges(self) -> tuple[float, float, float, float]:
        """`low`, `high` and the slopes at either edge (0: no edge), for `window_weight`."""
        rise = 1.0 / self.rise if self.rise > 0.0 else 0.0
        return self.low, self.high, rise, 1.0 / self.fall if self.fall > 0.0 else 0.0

    def weights(
        self,
        key: Array,
        out: Array | None = None,
        work: Array | None = None,
        bounds: tuple[float, float] = (0.0, 2.0),
    ) -> Array:
        """Weights at keys (N,); `out` and `work` (N,) may be given. NaN may become 1.

        `bounds` of the keys, where known, spare the sides of the window that do not matter.
        """
        least, most = bounds
        x = np.empty_like(key) if out is None else out
        other = np.empty_like(key) if work is None else work
        rises = self.rise > 0.0 and least < self.low + self.rise
        falls = self.fall > 0.0 and most > self.high - self.fall
        if rises:
            np.subtract(key, self.low, out=x)
            np.multiply(x, 1.0 / self.rise, out=x)
        if falls:
            side = other if rises else x
            np.subtract(self.high, key, out=side)
            np.multiply(side, 1.0 / self.fall, out=side)
            if rises:
                np.minimum(x, side, out=x)
        if not rises and not falls:
            x.fill(1.0)
            return x
        if not self.low <= least or not most <= self.high or (rises and falls):
            np.clip(x, 0.0, 1.0, out=x)
        elif (rises and most > self.low + self.rise) or (falls and least < self.high - self.fall):
            np.minimum(x, 1.0, out=x)
        np.multiply(x, -2.0, out=other)
        np.add(other, 3.0, out=other)
        np.multiply(other, x, out=other)
        return np.multiply(other, x, out=x)

    def touches(self, least: float, most: float) -> bool:
        """Whether the weight is more than zero anywhere in a range."""
        return not (self.rise > 0.0 and most <= self.low) and not (self.fall > 0.0 and least >= self.high)

    def is_full(self, least: float, most: float) -> bool:
        """Whether the weight is one everywhere in a range."""
        rises = self.rise > 0.0 and least < self.low + self.rise
        return not rises and not (self.fall > 0.0 and most > self.high - self.fall)


def key_of_inclination(inc_rad: float) -> float:
    """`key_of` a vector at an inclination in [0, pi]."""
    s2 = math.sin(inc_rad) ** 2
    return s2 if inc_rad <= 0.5 * math.pi else 2.0 - s2


def windows(zones: Sequence[Zone]) -> tuple[InclinationWindow, ...]:
    """The windows of zones sorted by inclination.

    Between two neighbours one falls while the other rises, the sum being one where both reach far enough.
    """
    spans = [(key_of_inclination(zone.inc_min_rad), key_of_inclination(zone.inc_max_rad)) for zone in zones]
    centers = [key_of_inclination(abs(zone.inc_center_rad or 0.0)) for zone in zones]
    out = []
    for k, ((low, high), center) in enumerate(zip(spans, centers, strict=True)):
        rise = 0.0 if zones[k].inc_min_rad <= _EDGE_OF_RANGE else TAPER * (center - low)
        fall = 0.0 if zones[k].inc_max_rad >= math.pi - _EDGE_OF_RANGE else TAPER * (high - center)
        if k > 0 and spans[k - 1][1] > low:
            low = max(low, centers[k - 1])
            rise = center - low
        if k + 1 < len(zones) and spans[k + 1][0] < high:
            high = min(high, centers[k + 1])
            fall = high - center
        out.append(InclinationWindow(center, low, high, rise, fall))
    return tuple(out)

"""What another program predicts, at any time: curves as far as the band that is compared goes, and where they end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.simulation.alignment import filled, in_gap, usual_rate
from highside.diagnosis.simulation.policy import SIMULATION_SESSIONS

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


@dataclass(frozen=True)
class Prediction:
    """What is predicted at any time: each channel's `curves` as far as the common band goes, and where it has gaps."""

    curves: tuple[CubicSpline, ...]
    t_s: Array
    columns: tuple[Array, ...]
    longest_s: float
    settled_s: float
    """from either end; before, a low-pass shows what it was begun with"""
    band_hz: float
    raw_hz: float

    @classmethod
    def of(cls, t_s: Array, columns: Sequence[Array], band_hz: float, raw_hz: float, longest_s: float) -> Self:
        """Columns (N,) at times (N,), no finer than the band that is compared."""
        from scipy.interpolate import CubicSpline

        times, rows = zip(*(smoothed(t_s, values, band_hz, raw_hz) for values in columns), strict=True)
        curves = tuple(CubicSpline(at, row) for at, row in zip(times, rows, strict=True))
        return cls(curves, t_s, tuple(columns), longest_s, settled_s(t_s, band_hz, raw_hz), band_hz, raw_hz)

    def through(self, function: Callable[[Array], Array]) -> Self:
        """What a function of all channels, (C, N) to (K, N), makes of the prediction before it is low-passed."""
        made = function(np.stack(self.columns))
        return self.of(self.t_s, list(made), self.band_hz, self.raw_hz, self.longest_s)

    def at(self, t_s: Array) -> Array:
        """(C, n). Beyond an end the last value: a curve would go on with the slope of the last rows' noise."""
        return np.stack([curve(np.clip(t_s, curve.x[0], curve.x[-1])) for curve in self.curves])

    def slope(self, t_s: Array) -> Array:
        """(C, n) change per second."""
        return np.stack([curve(t_s, 1) for curve in self.curves])

    def lost(self, t_s: Array) -> NDArray[np.bool_]:
        """(n,) whether there is none."""
        return in_gap(t_s, self.t_s, self.columns, self.longest_s) | at_ends(t_s, self.t_s, self.settled_s)


def is_low_passed(t_s: Array, band_hz: float, raw_hz: float) -> bool:
    """Whether a side of these times (N,) is low-passed for a grid of that band."""
    return bool(band_hz < SIMULATION_SESSIONS.no_filter * max(usual_rate(t_s), raw_hz))


def smoothed(t_s: Array, values: Array, band_hz: float, raw_hz: float) -> tuple[Array, Array]:
    """Times that rise and values there, low-passed without delay where the grid is coarser than the rows."""
    from scipy.signal import butter, sosfiltfilt

    own_hz = max(usual_rate(t_s), raw_hz)
    if not is_low_passed(t_s, band_hz, raw_hz):
        times = t_s[np.diff(t_s, prepend=-np.inf) > SIMULATION_SESSIONS.apart / own_hz]
        return times, filled(times, t_s, values)
    times = np.arange(t_s[0], t_s[-1], 1 / own_hz)
    smooth = sosfiltfilt(butter(4, band_hz, fs=own_hz, output="sos"), filled(times, t_s, values))
    return times, np.asarray(smooth)


def settled_s(t_s: Array, band_hz: float, raw_hz: float) -> float:
    """How far from the ends of a side of times (N,) its low-pass has forgotten what it was begun with."""
    return SIMULATION_SESSIONS.settled / band_hz if is_low_passed(t_s, band_hz, raw_hz) else 0.0


def at_ends(grid: Array, t_s: Array, settled_s: float) -> NDArray[np.bool_]:
    """(n,) whether times of the grid lie nearer than that to an end of times (N,)."""
    if settled_s == 0.0:
        return np.zeros(grid.size, dtype=bool)
    return np.asarray((grid < t_s[0] + settled_s) | (grid > t_s[-1] - settled_s))

"""A compensation over the columns of a recording: what `live` does reading by reading, over arrays.

Where nothing can be taken off (rotor angle, rate or attitude unknown, fitted at another inclination) the value is NaN:
a recording says so by an empty cell, the live service by a flag beside the uncompensated value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_positive
from highside.rotation.compensation import Compensation
from highside.rotation.curve import ErrorCurve
from highside.rotation.live import ATTITUDE_CHANNELS, HEADING, LEAST_LEVER_SIN, std_table
from highside.rotation.turntable import ARCMIN, AXIS_CHANNELS

Rows = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class UncompensatedRows:
    """Rows (N,) where the rotor was unknown, the inclination another, or the angle in a gap (there it is a guess)."""

    unknown: Rows
    outside: Rows
    gap: Rows


@dataclass(frozen=True, slots=True)
class Attitudes:
    """Compensated inclination and toolface and the standard deviations of what was taken off, (N,) rad."""

    inc_rad: Array
    tf_rad: Array
    inc_std_rad: Array
    tf_std_rad: Array
    why: UncompensatedRows


@dataclass(frozen=True, slots=True)
class Azimuths:
    """Compensated azimuth and the standard deviation of what was taken off, (N,) rad."""

    azi_rad: Array
    azi_std_rad: Array
    why: UncompensatedRows


class _Rotor:
    """Angles and rates of the rows, and where some curves hold."""

    def __init__(
        self,
        compensation: Compensation,
        names: tuple[str, ...],
        theta_rad: Array,
        rate_radps: Array | None,
        inc_rad: Array,
        *,
        bound: bool,
    ) -> None:
        self.curves = {name: compensation.curves[name] for name in names if name in compensation.curves}
        known = np.isfinite(theta_rad)
        if any(curve.rate is not None for curve in self.curves.values()):
            known &= False if rate_radps is None else np.isfinite(rate_radps)
        centre, within = compensation.validity.inclination_deg, compensation.validity.within_deg
        outside = np.zeros(known.size, dtype=bool)
        if bound and centre is not None:
            outside = known & ~(np.abs(np.degrees(inc_rad) - centre) <= within)
        self.good = known & ~outside
        self.theta = np.where(self.good, theta_rad, 0.0)
        self.rate = None if rate_radps is None else np.where(self.good, rate_radps, 0.0)
        wrapped = wrap_positive(self.theta)
        self._place = (wrapped / TURN * 360.0).astype(np.intp) % 360
        gap = np.zeros(known.size, dtype=bool)
        for curve in self.curves.values():
            if curve.coverage.has_gap:
                gap |= wrap_positive(wrapped - curve.coverage.gap_start_rad) < curve.coverage.largest_gap_rad
        self.why = UncompensatedRows(~known, outside, gap & self.good)

    def error(self, *names: str) -> Array:
        """Sum of the curves of these names, (N,) rad."""
        total = np.zeros(self.theta.size)
        for curve in self._named(names):
            total += curve(self.theta, self.rate) * ARCMIN
        return total

    def std(self, *names: str) -> Array:
        """Standard deviation of that sum, the curves taken for independent, (N,) rad."""
        square = np.zeros(self.theta.size)
        for curve in self._named(names):
            square += np.square(np.array(std_table(curve))[self._place])
        return np.sqrt(square)

    def _named(self, names: tuple[str, ...]) -> list[ErrorCurve]:
        return [self.curves[name] for name in names if name in self.curves]


def attitudes(
    compensation: Compensation, theta_rad: Array, rate_radps: Array | None, inc_rad: Array, tf_rad: Array
) -> Attitudes | None:
    """I and T of rows (N,) with the errors taken off; None for a compensation without a channel of theirs."""
    names = {name for name in compensation.curves if name in ATTITUDE_CHANNELS}
    if not names:
        return None
    bound = not names <= set(AXIS_CHANNELS)
    rotor = _Rotor(compensation, ATTITUDE_CHANNELS, theta_rad, rate_radps, inc_rad, bound=bound)
    sin = np.sin(inc_rad)
    upright = ~(sin > LEAST_LEVER_SIN)
    lever = np.where(upright, 0.0, np.cos(inc_rad) / np.where(upright, 1.0, sin))
    good = rotor.good & np.isfinite(inc_rad)
    tf = tf_rad - rotor.error("toolface", "encoder") + lever * rotor.error("across")
    tf_std = np.hypot(rotor.std("toolface", "encoder"), lever * rotor.std("across"))
    return Attitudes(
        np.where(good, np.abs(inc_rad - rotor.error("inclination", "along")), np.nan),
        np.where(good & np.isfinite(tf), wrap_positive(np.where(np.isfinite(tf), tf, 0.0)), np.nan),
        np.where(good, rotor.std("inclination", "along"), np.nan),
        np.where(good, tf_std, np.nan),
        rotor.why,
    )


def azimuths(
    compensation: Compensation, theta_rad: Array, rate_radps: Array | None, inc_rad: Array, azi_rad: Array
) -> Azimuths | None:
    """Azimuths of rows (N,) with the error taken off; `inc_rad` uncompensated. None without the channel `heading`."""
    if HEADING not in compensation.curves:
        return None
    rotor = _Rotor(compensation, (HEADING,), theta_rad, rate_radps, inc_rad, bound=True)
    good = rotor.good & np.isfinite(azi_rad)
    azi = wrap_positive(np.where(good, azi_rad, 0.0) - rotor.error(HEADING))
    return Azimuths(np.where(good, azi, np.nan), np.where(good, rotor.std(HEADING), np.nan), rotor.why)

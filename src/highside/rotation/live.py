"""A compensation one reading at a time, in plain floats: what the live service subtracts from I, T and the azimuth.

`point` makes of a fitted curve a function of one angle, without numpy (1 to 3 us; an array of one costs 30). The
channels that concern a tool are

    inclination, toolface        fitted at one inclination, and good near it
    encoder, across, along       a turntable in its axis frame (`rotation.turntable`), good at every inclination
    heading                      of the azimuth that gyros give; fitted at one inclination, and good near it

so that with I the measured inclination and t the rotor angle

    I = I measured - inclination(t) - along(t),     T = T measured - toolface(t) - encoder(t) + across(t) cot I,
    azimuth = azimuth measured - heading(t)

The same over arrays, for recordings, is in `rotation.recorded`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from highside.attitude.angles import TURN, wrap_positive
from highside.errors import Refused
from highside.rotation.compensation import Compensation
from highside.rotation.curve import CurveForm, ErrorCurve, NetworkInput
from highside.rotation.turntable import ARCMIN, AXIS_CHANNELS

Point = Callable[[float, float | None], float]
"""(angle rad, rate rad/s or None) -> error in the curve's unit; NaN where the curve needs a rate and gets none."""

ATTITUDE_CHANNELS = ("inclination", "toolface", *AXIS_CHANNELS)
HEADING = "heading"
TOOL_CHANNELS = (*ATTITUDE_CHANNELS, HEADING)
_STD_STEPS = 360
LEAST_LEVER_SIN = 1e-3

ROTOR_UNKNOWN = "rotor_unknown"
ROTATION_OUTSIDE = "rotation_outside"
ROTATION_GAP = "rotation_gap"


class RotorError(NamedTuple):
    """What a compensation says about one reading, or the mean over some; rad. `theta_rad` is that of the last."""

    theta_rad: float
    inclination: float
    toolface: float
    across: float


class CompensatedAttitude(NamedTuple):
    """I and T with the errors taken off (rad), and the standard deviations of what was taken off."""

    inc_rad: float
    tf_rad: float
    inc_std_rad: float
    tf_std_rad: float
    flags: tuple[str, ...]


class CompensatedHeading(NamedTuple):
    """What to take off the azimuth (rad; 0 where it is not known) and its standard deviation."""

    error_rad: float
    std_rad: float
    flags: tuple[str, ...]


def point(curve: ErrorCurve) -> Point:
    """`curve` as a function of one angle in plain floats; equal to the curve to rounding."""
    rate = curve.rate
    count = 0 if rate is None else len(rate.powers)
    values = curve.parameters.tolist()
    of_angle, of_rate = (values[:-count], values[-count:]) if count else (values, [])
    at = _angle_part(curve, of_angle)
    if rate is None:

        def without_rate(theta: float, _rate: float | None) -> float:
            return at(theta)

        return without_rate
    centre, spread, terms = rate.centre_radps, rate.spread_radps, tuple(zip(of_rate, rate.powers, strict=True))

    def with_rate(theta: float, now: float | None) -> float:
        if now is None:
            return math.nan
        u = (now - centre) / spread
        return at(theta) + math.fsum(c * math.pow(u, power) for c, power in terms)

    return with_rate


def _angle_part(curve: ErrorCurve, p: list[float]) -> Callable[[float], float]:
    if curve.form is CurveForm.FOURIER:
        constant = p[0]
        # the highest harmonic first
        last, *others = [complex(b, -a) for a, b in zip(p[1::2], p[2::2], strict=True)][::-1] or [0j]

        def fourier(theta: float) -> float:
            # Horner's rule in e^(it): a sin kt + b cos kt is the real part of (b - i a) e^(ikt)
            z = complex(math.cos(theta), math.sin(theta))
            total = last * z
            for c in others:
                total = (total + c) * z
            return constant + total.real

        return fourier
    if curve.form is CurveForm.CHEBYSHEV:
        high = p[:0:-1]

        def chebyshev(theta: float) -> float:
            # Clenshaw
            x = wrap_positive(theta) / math.pi - 1.0
            one = two = 0.0
            for c in high:
                one, two = 2.0 * x * one - two + c, one
            return p[0] + x * one - two

        return chebyshev
    periodic, h = curve.network_input is NetworkInput.PERIODIC, curve.order
    d = 2 if periodic else 1
    w1, b1 = p[: h * d], p[h * d : h * (d + 1)] if curve.hidden_bias else [0.0] * h
    w2, b2 = p[-h - 1 : -1], p[-1]
    if not periodic:
        w1 = [w for one in w1 for w in (one, 0.0)]
    units = tuple(zip(w1[::2], w1[1::2], b1, w2, strict=True))
    centre, scale = curve.target_centre, curve.target_scale

    def network(theta: float) -> float:
        u, v = (math.sin(theta), math.cos(theta)) if periodic else (wrap_positive(theta) / math.pi - 1.0, 0.0)
        return centre + scale * (b2 + sum(out * math.tanh(wu * u + wv * v + b) for wu, wv, b, out in units))

    return network


class LiveCompensation:
    """A compensation for I, T and azimuth, made ready. Raises Refused for one that has no channel of these."""

    def __init__(self, compensation: Compensation) -> None:
        curves = {name: curve for name, curve in compensation.curves.items() if name in TOOL_CHANNELS}
        if not curves:
            raise Refused(
                f"this compensation is for {', '.join(compensation.curves)}: of inclination, toolface and azimuth it"
                f" says nothing; fit {' or '.join(TOOL_CHANNELS)}"
            )
        self.id = compensation.id
        self.channels = tuple(curves)
        self.unused = tuple(name for name in compensation.curves if name not in curves)
        """channels that a tool has not: roll and pitch of a vehicle"""
        heading = curves.pop(HEADING, None)
        self.corrects_attitude = bool(curves)
        self.corrects_heading = heading is not None
        self._inclination = self._points(curves, "inclination", "along")
        self._toolface = self._points(curves, "toolface", "encoder")
        self._across = self._points(curves, "across")
        self._needs_rate = any(curve.rate is not None for curve in curves.values())
        # a curve in the axis frame knows no inclination; only the others are bound to theirs
        bound = not set(curves) <= set(AXIS_CHANNELS)
        self._centre = compensation.validity.inclination_deg if bound else None
        self._within = compensation.validity.within_deg
        self._std = {name: std_table(curve) for name, curve in curves.items()}
        self._gaps = [_gap(curve) for curve in curves.values() if curve.coverage.has_gap]
        self._heading = None if heading is None else point(heading)
        self._heading_needs_rate = heading is not None and heading.rate is not None
        self._heading_centre = compensation.validity.inclination_deg
        self._heading_std = [] if heading is None else std_table(heading)
        self._heading_gaps = [] if heading is None or not heading.coverage.has_gap else [_gap(heading)]

    @staticmethod
    def _points(curves: dict[str, ErrorCurve], *names: str) -> tuple[Point, ...]:
        return tuple(point(curves[name]) for name in names if name in curves)

    def at(self, rotor_deg: float | None, rate_dps: float | None = None) -> RotorError | None:
        """What it says at one rotor angle; None where the angle, or a rate that it needs, is not known."""
        if rotor_deg is None or not math.isfinite(rotor_deg):
            return None
        rate = None
        if self._needs_rate:
            if rate_dps is None or not math.isfinite(rate_dps):
                return None
            rate = math.radians(rate_dps)
        theta = math.radians(rotor_deg)
        inclination = toolface = across = 0.0
        for one in self._inclination:
            inclination += one(theta, rate)
        for one in self._toolface:
            toolface += one(theta, rate)
        for one in self._across:
            across += one(theta, rate)
        return RotorError(theta, inclination * ARCMIN, toolface * ARCMIN, across * ARCMIN)

    def heading(self, rotor_deg: float | None, rate_dps: float | None, inc_rad: float) -> CompensatedHeading:
        """The azimuth's error at one rotor angle. Nothing where the rotor is unknown or I is another: a flag."""
        if self._heading is None:
            return CompensatedHeading(0.0, 0.0, ())
        if rotor_deg is None or not math.isfinite(rotor_deg):
            return CompensatedHeading(0.0, 0.0, (ROTOR_UNKNOWN,))
        rate = None
        if self._heading_needs_rate:
            if rate_dps is None or not math.isfinite(rate_dps):
                return CompensatedHeading(0.0, 0.0, (ROTOR_UNKNOWN,))
            rate = math.radians(rate_dps)
        # an inclination that is not known is not the one of the fit either
        if self._heading_centre is not None and not abs(math.degrees(inc_rad) - self._heading_centre) <= self._within:
            return CompensatedHeading(0.0, 0.0, (ROTATION_OUTSIDE,))
        angle = math.radians(rotor_deg)
        theta = wrap_positive(angle)
        gap = (ROTATION_GAP,) if _in_gap(theta, self._heading_gaps) else ()
        return CompensatedHeading(self._heading(angle, rate) * ARCMIN, self._heading_std[std_place(theta)], gap)

    def apply(self, inc_rad: float, tf_rad: float, error: RotorError | None) -> CompensatedAttitude:
        """Take `error` off. Nothing is taken off where the rotor is unknown or the inclination is another: a flag."""
        if not self.corrects_attitude:
            return CompensatedAttitude(inc_rad, tf_rad, 0.0, 0.0, ())
        if error is None:
            return CompensatedAttitude(inc_rad, tf_rad, 0.0, 0.0, (ROTOR_UNKNOWN,))
        if self._centre is not None and abs(math.degrees(inc_rad) - self._centre) > self._within:
            return CompensatedAttitude(inc_rad, tf_rad, 0.0, 0.0, (ROTATION_OUTSIDE,))
        theta = wrap_positive(error.theta_rad)
        place = std_place(theta)
        std = {name: table[place] for name, table in self._std.items()}
        toolface, tf_std = error.toolface, math.hypot(std.get("toolface", 0.0), std.get("encoder", 0.0))
        if self._across:
            sin = math.sin(inc_rad)
            # near vertical there is no toolface to speak of, and no lever to divide by
            lever = math.cos(inc_rad) / sin if sin > LEAST_LEVER_SIN else 0.0
            toolface -= lever * error.across
            tf_std = math.hypot(tf_std, lever * std["across"])
        inc = abs(inc_rad - error.inclination)
        gap = (ROTATION_GAP,) if _in_gap(theta, self._gaps) else ()
        inc_std = math.hypot(std.get("inclination", 0.0), std.get("along", 0.0))
        return CompensatedAttitude(inc, wrap_positive(tf_rad - toolface), inc_std, tf_std, gap)


def mean_error(errors: Iterable[RotorError | None]) -> RotorError | None:
    """The mean over the readings of a window whose rotor angle was known; None where none was."""
    known = [error for error in errors if error is not None]
    if not known:
        return None
    n = len(known)
    _, inclination, toolface, across = map(sum, zip(*known, strict=True))
    return RotorError(known[-1].theta_rad, inclination / n, toolface / n, across / n)


def std_table(curve: ErrorCurve) -> list[float]:
    """Standard deviation of the curve, rad, in the middle of each degree (at the rate in the middle of those seen)."""
    theta = np.asarray((np.arange(_STD_STEPS) + 0.5) * (TURN / _STD_STEPS), dtype=float)
    rate = None if curve.rate is None else np.full(theta.size, curve.rate.centre_radps)
    table: list[float] = (curve.std(theta, rate) * ARCMIN).tolist()
    return table


def std_place(theta_rad: float) -> int:
    """Where an angle in [0, 2 pi) stands in `std_table`."""
    # rounding may reach the whole turn
    return int(theta_rad / TURN * _STD_STEPS) % _STD_STEPS


def _gap(curve: ErrorCurve) -> tuple[float, float]:
    return curve.coverage.gap_start_rad, curve.coverage.largest_gap_rad


def _in_gap(theta_rad: float, gaps: list[tuple[float, float]]) -> bool:
    return any(wrap_positive(theta_rad - start) < width for start, width in gaps)

"""Inclination and toolface of single readings, in plain floats: the path of the live service.

For fewer than about 16 readings Python floats are faster than numpy (0.8 us a reading against 10 us), and they are
the oracle of the block path in `attitude.block`.

Theory. With z along the tool axis up-hole and g the gravity direction the sensor reports (`+z` when vertical),

    g = |g| [sin I cos T, sin I sin T, cos I]                                        (1)
    I = atan2(hypot(gx, gy), gz),    T = atan2(gy, gx)                               (2)

T is the gravity toolface: 0 with +x at the high side, increasing clockwise looking down-hole. For a small error dg,
with `dr = dgx cos T + dgy sin T` (radial) and `dt = dgy cos T - dgx sin T` (tangential),

    dI = (dr cos I - dgz sin I) / |g|,    dT = dt / r,    r = hypot(gx, gy)          (3)

Equation 3 fails where r is no longer large against the uncertainty of gx and gy: T is then a poor angle, and none at
r = 0. Both standard deviations below therefore follow the exact law of a two-dimensional Gaussian around the reading
as a function of `s = r / sigma`; they meet (3) for large s, and for s = 0 a uniform angle, pi/sqrt(3) rad = 103.9 deg.

Equation numbers are those of Cheng et al., "Balance correction and verification of IMU posture error".
"""

from __future__ import annotations

import math
from typing import NamedTuple

from highside.attitude.angles import TURN

UNIFORM_ANGLE_STD_RAD = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle of which nothing is known: 103.9 deg."""

UNKNOWN_INCLINATION_STD_RAD = math.sqrt(0.5 * math.pi**2 - 2.0)
"""Root mean square inclination (about 0) of a direction uniform on the sphere: 98.1 deg."""

UNDEFINED_BELOW_SIGMAS = 2.4477
"""A toolface is undefined where vertical lies in the 95 % circle of the cross-axis reading: sqrt(-2 ln 0.05)."""

Covariance6 = tuple[float, float, float, float, float, float]


class Attitude(NamedTuple):
    """Inclination, toolface and what is known of their errors (rad, rad^2 for `inc_tf_cov`).

    The standard deviations describe the true angle given this one reading, all directions being equally likely before.
    """

    inc_rad: float
    tf_rad: float
    inc_std_rad: float
    tf_std_rad: float
    inc_tf_cov_rad2: float
    toolface_undefined: bool


def attitude(gx: float, gy: float, gz: float) -> tuple[float, float]:
    """(inclination in [0, pi], toolface in [0, 2 pi)) in rad of a gravity vector of any length; equation 2.

    A vector along the axis has toolface 0, the zero vector inclination 0: `attitude_with_std` says what they are worth.
    """
    tf = math.atan2(gy, gx)
    if tf < 0.0:
        tf += TURN
        if tf >= TURN:  # an angle of -1e-17 must not become a full turn
            tf = 0.0
    return math.atan2(math.hypot(gx, gy), gz), tf + 0.0  # + 0.0 turns -0.0 into 0.0


def gravity_vector(inc_rad: float, tf_rad: float) -> tuple[float, float, float]:
    """Gravity direction in the tool frame, length 1; equation 1."""
    sin_i = math.sin(inc_rad)
    return sin_i * math.cos(tf_rad), sin_i * math.sin(tf_rad), math.cos(inc_rad)


def toolface_std(offset_in_sigmas: float) -> float:
    """Standard deviation (rad) of the direction of a point at `offset_in_sigmas` >= 0 of a round 2-D Gaussian.

    A rational approximation of the exact law (the second moment of the projected normal distribution): 1.3 % at most
    off, exact at 0 (uniform angle) and for a large argument (1 / s).
    """
    s = offset_in_sigmas
    if s > 1e6:
        return 1.0 / s
    top = 0.3039635509 + s * (-0.05891792 + s * (0.5782321 + s * (-0.55254875 + s * 0.28703004)))
    bottom = 1.0 + s * (-0.58951436 + s * 0.28703004)
    return math.sqrt(bottom / top)


def attitude_with_std(gx: float, gy: float, gz: float, cov: Covariance6) -> Attitude:
    """Inclination and toolface with their uncertainty, by equation 3 and the limits it lacks near vertical.

    `cov` is the covariance of (gx, gy, gz) as the upper triangle (xx, xy, xz, yy, yz, zz), in the unit of g squared.
    """
    inc, tf = attitude(gx, gy, gz)
    xx, xy, xz, yy, yz, zz = cov
    r2 = gx * gx + gy * gy
    n2 = r2 + gz * gz
    if not n2 > 0.0:
        return Attitude(inc, tf, UNKNOWN_INCLINATION_STD_RAD, UNIFORM_ANGLE_STD_RAD, 0.0, True)
    r, n = math.sqrt(r2), math.sqrt(n2)
    if r > 0.0:
        ct, st = gx / r, gy / r
        rr = max(0.0, ct * ct * xx + 2.0 * ct * st * xy + st * st * yy)
        tt = max(0.0, st * st * xx - 2.0 * ct * st * xy + ct * ct * yy)
        rt = ct * st * (yy - xx) + (ct * ct - st * st) * xy
    else:
        # no direction is the radial one: take both cross axes alike
        ct, st, rt = 1.0, 0.0, 0.0
        rr = tt = max(0.0, 0.5 * (xx + yy))
    rz, tz = ct * xz + st * yz, ct * yz - st * xz
    ci, si = gz / n, r / n

    sigma_t, sigma_r = math.sqrt(tt), math.sqrt(rr)
    s_t = r / sigma_t if sigma_t > 0.0 else math.inf
    s_r = r / sigma_r if sigma_r > 0.0 else math.inf
    if r == 0.0:
        s_t = s_r = 0.0
    tf_var = toolface_std(s_t) ** 2
    if s_r < s_t:
        # wider along the toolface than across: vertical may be passed, which turns T by half a turn
        tf_var += math.pi**2 * 0.5 * (math.erfc(s_r * math.sqrt(0.5)) - math.erfc(s_t * math.sqrt(0.5)))
    tf_std = min(math.sqrt(tf_var), UNIFORM_ANGLE_STD_RAD)

    # I is a distance from vertical and cannot be negative: near vertical the tangential error enlarges it too
    # (root 2 sigma at s = 0). The exponential stays within 7 % of the law of Rice.
    folded = tt * math.exp(-3.6 * min(s_t, 100.0))
    inc_var = (ci * ci * (rr + folded) - 2.0 * ci * si * rz + si * si * zz) / n2
    inc_std = min(math.sqrt(max(0.0, inc_var)), UNKNOWN_INCLINATION_STD_RAD)

    # the first-order correlation, carried to the standard deviations published
    first_order_i = math.sqrt(max(0.0, ci * ci * rr - 2.0 * ci * si * rz + si * si * zz))
    scale = first_order_i * sigma_t
    correlation = (ci * rt - si * tz) / scale if scale > 0.0 else 0.0
    covariance = max(-1.0, min(1.0, correlation)) * inc_std * tf_std if r > 0.0 else 0.0
    return Attitude(inc, tf, inc_std, tf_std, covariance, min(s_t, s_r) < UNDEFINED_BELOW_SIGMAS)

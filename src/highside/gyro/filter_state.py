"""State of the error-state Kalman filter: attitude, biases and covariance, and what is read from them.

State (10): attitude error (0 to 2), gyro bias (3 to 5), scale-factor error (6) and, in the last three, the
accelerometers' biases or, of a sensor carried by hand, its velocity.

A block is the vector z (34,) of `blocks.finished`; angles rad, rates rad/s, body frame. `filter` has the theory.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import direction_cosines

Quaternion = tuple[float, float, float, float]

STATES = 10
STILL_S, TURNED, MOVED_S, SHAKEN, GAP_S, NO_GRAVITY, NO_RATE, NO_STOP, ROW_GRAVITY, ROW_RATE = range(10)
"""places in `FilterState.tally`"""
VIBRATING, TURNING, QUIET, STILL = 0, 1, 2, 3
"""as `gates.Motion`"""

IDENTITY, IDENTITY_3 = np.eye(STATES), np.eye(3)

VERTICAL_COS = 0.05
"""|cos theta| below which azimuth and toolface are one (2.9 deg from the vertical)"""


class Constants(NamedTuple):
    """What does not change while the filter runs: numbers alone, for the compiled updates, from `FilterSettings`."""

    earth_e: float
    earth_n: float
    earth_u: float
    unmodelled_rate: float
    """of the Earth's rotation, where latitude or azimuth are missing"""
    arw: float
    rrw: float
    accel_noise_g: float
    accel_floor_g: float
    straight_std: float
    """0: the hole may turn"""
    gravity_while_moving: bool
    detect_stops: bool
    velocity_std: float
    """m/s; 0: accelerations are noise about gravity. Else of a thing carried by hand"""
    gyro_scatter: float
    """errors of the gyros' scale and alignment that are no state, of the angle turned"""


class FilterState(NamedTuple):
    """What the filter knows; arrays that are changed in place."""

    q: Array
    """(4,) body to navigation frame"""
    bias: Array
    """(3,) of the gyros, rad/s"""
    scale: Array
    """(1,) scale-factor error of the gyro along the tool axis"""
    accel_bias: Array
    """(3,) g"""
    velocity: Array
    """(3,) of a sensor carried by hand (`Constants.velocity_std`), m/s; else 0"""
    P: Array
    """(10, 10) covariance of the error state"""
    psi0: Array
    """(1,) azimuth of the last alignment"""
    stop: Array
    """(5,) of the test of a detected stop: fading sums of innovation (3), seconds, squared weights"""
    tally: Array
    """(10,) seconds and counts"""


def quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    return (
        p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
        p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
        p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
    )


def quaternion_exp(x: float, y: float, z: float) -> Quaternion:
    """Quaternion of the rotation vector (x, y, z), rad."""
    h = 0.25 * (x * x + y * y + z * z)
    if h < 1e-4:
        # cos and sin(h)/h of a small angle, to the last bit
        c = 1.0 - h * (1 / 2 - h * (1 / 24 - h * (1 / 720)))
        s = 0.5 * (1.0 - h * (1 / 6 - h * (1 / 120 - h * (1 / 5040))))
    else:
        angle = math.sqrt(h)
        c, s = math.cos(angle), 0.5 * math.sin(angle) / angle
    return c, s * x, s * y, s * z


def cross_matrix(v: Array) -> Array:
    """[v x] (3, 3): its product with u is v x u."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def attitude_of(state: FilterState) -> Quaternion:
    """The quaternion as a tuple."""
    q = state.q
    return q[0], q[1], q[2], q[3]


def set_attitude(state: FilterState, q: Quaternion) -> None:
    """Keep q, normalised."""
    a, b, c, d = q
    size = math.sqrt(a * a + b * b + c * c + d * d)
    state.q[0], state.q[1], state.q[2], state.q[3] = a / size, b / size, c / size, d / size


def earth_in_body(q: Quaternion, c: Constants) -> Array:
    """(3,) the Earth's rotation resolved in the body frame."""
    return np.asarray(direction_cosines(q) @ np.array([c.earth_e, c.earth_n, c.earth_u]))


def azimuth_of(q: Quaternion) -> float:
    """psi of q."""
    a, b, c, d = q
    return math.atan2(2 * (b * c - a * d), a * a - b * b + c * c - d * d)


def azimuth_row(q: Quaternion) -> Array:
    """(3,) d psi / d dth; near the vertical, where psi means nothing, minus the rotation about Up."""
    C = direction_cosines(q)
    square = C[0, 2] * C[0, 2] + C[2, 2] * C[2, 2]
    if square < VERTICAL_COS * VERTICAL_COS:
        return np.array([-C[0, 2], -C[1, 2], -C[2, 2]])
    # [sin phi, 0, -cos phi] / cos theta, with sin phi = -C02 / cos theta and cos phi = C22 / cos theta
    return np.array([-C[0, 2] / square, 0.0, -C[2, 2] / square])


def azimuth_variance(state: FilterState) -> float:
    """Variance of psi (of the rotation about Up near the vertical), rad^2."""
    row = azimuth_row(attitude_of(state))
    return float(row @ state.P[:3, :3] @ row)


def turn_of_errors(bias: Array, scale: float, z: Array) -> Array:
    """(3,) what bias and scale error turn the end of a block by."""
    return np.asarray(-(z[4:13].reshape(3, 3) @ bias + z[13:16] * scale))


def angle_random_walk(z: Array, c: Constants) -> float:
    """Angle random walk of a block, rad/sqrt(s): that of the settings, or what vibration makes of it."""
    seconds, n = z[19], z[20]
    if n < 2.0 or seconds <= 0.0:
        return c.arw
    observed = z[30] * math.sqrt(seconds / n)
    return float(observed) if observed > 1.3 * c.arw else c.arw

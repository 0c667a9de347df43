"""The one place where the tool frame of the product meets the body frame of the gravity-quaternion equations.

Tool frame: z along the tool axis, up-hole; x at the high side at toolface 0. Body frame: y down-hole, z at the high
side at toolface 0, x to its right:

    (x, y, z)_tool = (z, -x, -y)_body,   inclination I = 90 deg + theta,   toolface T = phi.

Earth rate, and the units in which gyros are specified.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import from_angles, to_angles, to_body, to_tool

__all__ = [
    "DEG_PER_HOUR",
    "DEG_PER_SQRT_HOUR",
    "EARTH_RATE_RADPS",
    "attitude",
    "earth_rate",
    "quaternion",
    "std_to_tool",
    "to_body",
    "to_tool",
]


EARTH_RATE_RADPS = 7.292115e-5
DEG_PER_HOUR = np.pi / 180.0 / 3600.0
"""rad/s"""
DEG_PER_SQRT_HOUR = np.pi / 180.0 / 60.0
"""rad/sqrt(s)"""


def std_to_tool(body: Array) -> Array:
    """Standard deviations (3, ...) by axis: as `to_tool` without the signs."""
    return np.stack([body[2], body[0], body[1]])


def attitude(q: Array) -> tuple[Array, Array, Array]:
    """Inclination from vertical in [0, pi], toolface and azimuth in [0, 2 pi) of a body quaternion, rad."""
    theta, phi, psi = to_angles(q)
    turn = 2 * np.pi
    return theta + 0.5 * np.pi, np.mod(phi, turn) % turn, np.mod(psi, turn) % turn


def quaternion(inc_rad: Array | float, tf_rad: Array | float, azi_rad: Array | float) -> Array:
    """Body quaternion of inclination, toolface and azimuth."""
    return from_angles(np.asarray(inc_rad) - 0.5 * np.pi, tf_rad, azi_rad)


def earth_rate(latitude_rad: float | None, *, azimuth_known: bool = True) -> Array:
    """Rotation of the Earth in East, North, Up (3,), rad/s: zero without a latitude.

    Without an azimuth North is nowhere, and only the part along Up is of use.
    """
    if latitude_rad is None:
        return np.zeros(3)
    north = np.cos(latitude_rad) if azimuth_known else 0.0
    return EARTH_RATE_RADPS * np.array([0.0, north, np.sin(latitude_rad)])

"""What deviations do to inclination and toolface at an attitude, and how well the hole alone knows it.

With the error `dc` of a corrected vector, `dI = (cos I cos T, cos I sin T, -sin I) dc` and
`sin I dT = (-sin T, cos T, 0) dc`. Toolface times sin I is judged, since toolface itself is nobody's in a vertical
hole.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.watch.parameters import CALIBRATION, SIZE, B, S
from highside.watch.result import AttitudeError

__all__ = ["error_of", "gradients", "std_of"]

TOOLFACES = 16
"""round the clock, over which the worst is taken where the tool turns"""
_VERTICAL = 0.01
"""sine of the inclination below which toolface is not given (0.6 deg)"""


def gradients(inc_rad: float, tf_rad: float) -> Array:
    """(2, N) of I and of sin I times T, rad, by the state; what only moves with temperature or rate is zero."""
    s, c, st, ct = np.sin(inc_rad), np.cos(inc_rad), np.sin(tf_rad), np.cos(tf_rad)
    f = np.array([s * ct, s * st, c])
    along = np.array([[c * ct, c * st, -s], [-st, ct, 0.0]])
    out = np.zeros((2, SIZE))
    out[:, B : B + 3] = along
    for i in range(3):
        out[:, S + 3 * i : S + 3 * i + 3] = along[:, i : i + 1] * f
    return out


def _over_toolfaces(inc_rad: float, tf_rad: float | None) -> list[Array]:
    if tf_rad is not None:
        return [gradients(inc_rad, tf_rad)]
    return [gradients(inc_rad, tf) for tf in np.linspace(0.0, 2.0 * np.pi, TOOLFACES, endpoint=False)]


def error_of(state: Array, inc_rad: float, tf_rad: float | None) -> AttitudeError:
    """Of a deviation (N,); with no toolface the largest over all of them."""
    found = np.array([rows @ state for rows in _over_toolfaces(inc_rad, tf_rad)])
    worst = found[np.argmax(np.abs(found), axis=0), [0, 1]]
    return _error(worst, inc_rad)


def std_of(covariance: Array, inc_rad: float, tf_rad: float | None, sigmas: float = 1.0) -> AttitudeError:
    """`sigmas` standard deviations by the covariance of the state, or of its first twelve; the largest over all
    toolfaces where there is none."""
    part = covariance[:CALIBRATION, :CALIBRATION]
    found = [
        np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, part, rows), 0.0))
        for rows in (rows[:, :CALIBRATION] for rows in _over_toolfaces(inc_rad, tf_rad))
    ]
    return _error(sigmas * np.max(found, axis=0), inc_rad)


def _error(radians: Array, inc_rad: float) -> AttitudeError:
    sine = float(np.sin(inc_rad))
    inc, across = (float(value) for value in np.rad2deg(radians))
    return AttitudeError(inc, across, across / sine if sine > _VERTICAL else None)

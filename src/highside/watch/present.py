"""What deviations do to inclination and toolface at an attitude, and how well the hole alone knows it.

With the error `dc` of a corrected vector, `dI = (cos I cos T, cos I sin T, -sin I) dc` and
`sin I dT = (-sin T, cos T, 0) dc`. Toolface times sin I is judged, since toolface itself is nobody's in a vertical
hole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.watch.parameters import CALIBRATION, SIZE, B, Prior, S
from highside.watch.result import AttitudeError

__all__ = ["SIGMAS", "Sight", "antisymmetric", "error_of", "gradients", "sight_of", "std_of"]

SIGMAS = 3.0
"""standard deviations of an error that would have been seen"""

TOOLFACES = 16
"""round the clock, over which the worst is taken where the tool turns"""
_VERTICAL = 0.01
"""sine of the inclination below which toolface is not given (0.6 deg)"""


@dataclass(frozen=True, slots=True)
class Sight:
    """What an error of the present attitude may be: that the hole would not have shown yet (three standard deviations),
    that no hole shows (three, of the record and the tool's repeatability), that the record states (one). None: there is
    no attitude."""

    unseen: AttitudeError | None = None
    never: AttitudeError | None = None
    stated: AttitudeError | None = None


def antisymmetric(covariance: Array) -> Array:
    """(12, 12) of the calibration's parameters, of the antisymmetric part of S alone: a rotation of the triad in the
    tool, which neither the length of gravity nor a turn shows. About z it is a toolface offset; about x and y it reads
    like a bent collar."""
    turn = np.zeros((CALIBRATION, CALIBRATION))
    for i in range(3):
        for j in range(3):
            turn[S + 3 * i + j, S + 3 * i + j] += 0.5
            turn[S + 3 * i + j, S + 3 * j + i] -= 0.5
    return np.asarray(turn @ covariance @ turn.T)


def sight_of(inc_rad: float | None, tf_rad: float | None, alone: Array, prior: Prior, grown: float) -> Sight:
    """At an attitude, or of nothing where there is none. `alone`: covariance by what the hole alone says; `grown`: by
    which factor its standard deviations stand wider."""
    if inc_rad is None:
        return Sight()
    own = antisymmetric(prior.covariance[:CALIBRATION, :CALIBRATION])
    return Sight(
        std_of(alone, inc_rad, tf_rad, SIGMAS * grown),
        std_of(own, inc_rad, tf_rad, SIGMAS),
        std_of(prior.stated, inc_rad, tf_rad),
    )


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

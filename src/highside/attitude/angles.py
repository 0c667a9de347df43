"""Angles on the circle: wrapping, differences that never jump at the seam, and means.

An angle is a point on a circle, a number only by convention. Whoever subtracts two toolfaces, or averages them,
must go through this module. Everything here is in radians unless the name says degrees; each function takes a float
or an array and gives back the same kind.
"""

from __future__ import annotations

import math
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from highside.arrays import Array

TURN = 2.0 * math.pi


def _wrap_float(angle: float, period: float) -> float:
    wrapped = math.fmod(angle, period)
    if wrapped < 0.0:
        wrapped += period
    # a tiny negative angle plus the period rounds to the period itself, which is the same point as zero
    return 0.0 if wrapped >= period else wrapped


def _wrap_array(angle: Array, period: float) -> Array:
    wrapped = np.mod(angle, period)
    wrapped[wrapped >= period] = 0.0
    return wrapped


@overload
def wrap_positive(angle: float, period: float = TURN) -> float: ...
@overload
def wrap_positive(angle: Array, period: float = TURN) -> Array: ...
def wrap_positive(angle: float | Array, period: float = TURN) -> float | Array:
    """The same direction in [0, period). `period` is a full turn in the angle's own unit (2 pi, or 360)."""
    if isinstance(angle, np.ndarray):
        return _wrap_array(np.atleast_1d(np.asarray(angle, dtype=np.float64)), period).reshape(angle.shape)
    return _wrap_float(float(angle), period)


@overload
def wrap_signed(angle: float, period: float = TURN) -> float: ...
@overload
def wrap_signed(angle: Array, period: float = TURN) -> Array: ...
def wrap_signed(angle: float | Array, period: float = TURN) -> float | Array:
    """The same direction in (-period/2, period/2]."""
    half = 0.5 * period
    if isinstance(angle, np.ndarray):
        # half - wrap(half - a) closes the interval at its upper end
        return half - wrap_positive(half - np.asarray(angle, dtype=np.float64), period)
    return half - _wrap_float(half - float(angle), period)


@overload
def difference(angle: float, reference: float, period: float = TURN) -> float: ...
@overload
def difference(angle: Array, reference: Array | float, period: float = TURN) -> Array: ...
@overload
def difference(angle: float, reference: Array, period: float = TURN) -> Array: ...
def difference(angle: float | Array, reference: float | Array, period: float = TURN) -> float | Array:
    """The shortest way from `reference` to `angle`, signed, in (-period/2, period/2]."""
    delta = angle - reference
    return wrap_signed(delta, period)


def circular_mean(angles: ArrayLike, weights: ArrayLike | None = None, period: float = TURN) -> float:
    """Direction of the resultant of unit vectors at `angles`, in [0, period).

    Raises ValueError where there is none: no angles, or directions that cancel (two opposite ones).
    Mardia and Jupp, Directional Statistics, section 2.2.
    """
    cosine, sine = _resultant(angles, weights, period)
    if math.hypot(cosine, sine) < 1e-12:
        raise ValueError("these directions cancel: they have no mean")
    return _wrap_float(math.atan2(sine, cosine) * period / TURN, period)


def circular_std(angles: ArrayLike, weights: ArrayLike | None = None, period: float = TURN) -> float:
    """Circular standard deviation `sqrt(-2 ln R)`, in the unit of `period`; infinite where directions cancel.

    It tends to the ordinary standard deviation for a narrow spread. Mardia and Jupp, section 2.3.
    """
    length = min(1.0, math.hypot(*_resultant(angles, weights, period)))
    if length == 0.0:
        return math.inf
    return math.sqrt(-2.0 * math.log(length)) * period / TURN


def _resultant(angles: ArrayLike, weights: ArrayLike | None, period: float) -> tuple[float, float]:
    phase = np.asarray(angles, dtype=np.float64).ravel() * (TURN / period)
    if phase.size == 0:
        raise ValueError("no angles to average")
    weight = np.ones_like(phase) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    if weight.shape != phase.shape or not weight.sum() > 0.0:
        raise ValueError("weights must be one per angle, with a positive sum")
    total = float(weight.sum())
    return float(weight @ np.cos(phase)) / total, float(weight @ np.sin(phase)) / total

"""Inclination, toolface and azimuth from vectors: single frames (`scalar`), blocks (`block`), covariance propagation.

Radians inside; arrays are `(3, N)`. Knows numpy (and scipy's special functions) and nothing else. The paper's own
inverse is kept for comparison in `papers.balance_angles`.
"""

from __future__ import annotations

from highside.attitude.angles import TURN, circular_mean, circular_std, difference, wrap_positive, wrap_signed
from highside.attitude.block import attitude_block, attitude_std_block, correct_and_attitude, toolface_std_block
from highside.attitude.scalar import (
    UNIFORM_ANGLE_STD_RAD,
    Attitude,
    attitude,
    attitude_with_std,
    gravity_vector,
    toolface_std,
)

__all__ = [
    "TURN",
    "UNIFORM_ANGLE_STD_RAD",
    "Attitude",
    "attitude",
    "attitude_block",
    "attitude_std_block",
    "attitude_with_std",
    "circular_mean",
    "circular_std",
    "correct_and_attitude",
    "difference",
    "gravity_vector",
    "toolface_std",
    "toolface_std_block",
    "wrap_positive",
    "wrap_signed",
]

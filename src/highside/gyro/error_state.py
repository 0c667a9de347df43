"""The error-state filter over all blocks of a recording: stop test, time update, measurement updates, and their trace.

`filter` has the theory and takes the blocks of a live tool one by one. A block takes some 0.1 ms.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.gyro.filter_state import MOVED_S, SHAKEN, Constants, FilterState, azimuth_variance
from highside.gyro.measurements import correct
from highside.gyro.stop_test import motion_of
from highside.gyro.time_update import predict


class Trace(NamedTuple):
    """The filter at the end of each of M blocks, arrays. What only a smoother needs is empty without one."""

    q: Array
    """(M, 4)"""
    bias: Array
    """(M, 3)"""
    scale: Array
    """(M,)"""
    accel: Array
    """(M, 3) what the last three states are of: accelerometers' biases, or velocity of what is carried"""
    bias_var: Array
    """(M, 3)"""
    azimuth_var: Array
    """(M,)"""
    motion: Array
    """(M,)"""
    moved_s: Array
    """(M,)"""
    shaken: Array
    """(M,) time integral of the squared vibration while moving, g^2 s"""
    q_before: Array
    """(M or 0, 4) predicted"""
    accel_before: Array
    """(M or 0, 3) predicted"""
    P: Array
    """(M or 0, 10, 10)"""
    P_before: Array
    """(M or 0, 10, 10) predicted"""


def run(
    blocks: Array,
    verdicts: NDArray[np.int64],
    declared: NDArray[np.bool_],
    state: FilterState,
    c: Constants,
    trace: Trace,
) -> None:
    """All blocks (M, 34) in turn; the first was taken by the alignment."""
    kept = len(trace.P) > 0
    accel = state.velocity if c.velocity_std > 0.0 else state.accel_bias
    for i in range(len(blocks)):
        motion = verdicts[i]
        if i > 0:
            motion = motion_of(blocks[i], motion, declared[i], state, c)
            predict(blocks[i], motion, state, c)
        if kept:
            trace.q_before[i] = state.q
            trace.accel_before[i] = accel
            trace.P_before[i] = state.P
        if i > 0:
            correct(blocks[i], motion, declared[i], state, c)
        if kept:
            trace.P[i] = state.P
        trace.q[i] = state.q
        trace.bias[i] = state.bias
        trace.accel[i] = accel
        trace.bias_var[i] = np.diag(state.P)[3:6]
        trace.scale[i] = state.scale[0]
        trace.azimuth_var[i] = azimuth_variance(state)
        trace.motion[i] = motion
        trace.moved_s[i] = state.tally[MOVED_S]
        trace.shaken[i] = state.tally[SHAKEN]

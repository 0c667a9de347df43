"""Whether a detected stop is one: the gyros' mean rate at it is tested against the bias as it is known."""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.gyro.filter_state import (
    NO_STOP,
    QUIET,
    STILL,
    TURNING,
    Constants,
    FilterState,
    angle_random_walk,
    attitude_of,
    earth_in_body,
)

_STOP_SIGMAS = 4.0
"""of the mean rate at a detected stop"""
_STOP_MEMORY_S = 20.0
"""time constant of that mean"""


def stop_agrees(stop: Array, innovation: Array, seconds: float, variance: Array, arw: float) -> bool:
    """Whether what the gyros show at a detected stop agrees with the bias as it is known.

    The mean over the last 20 s (fading) of the rate less bias and Earth rate is compared with its standard deviation;
    beyond four in any axis the tool is taken to move slowly, and goes on being so until the mean agrees again. What
    stays below is the bound of the error: a slower motion would be taken for bias. `stop` (5,) is changed; `innovation`
    and `variance` (3,) in rad/s and its square, the Earth rate's uncertainty included; `arw` rad/sqrt(s).
    """
    if seconds <= 0.0:
        return True
    fade = math.exp(-seconds / _STOP_MEMORY_S)
    stop[3] = stop[3] * fade + seconds
    stop[4] = stop[4] * fade * fade + seconds
    noise = arw * arw * stop[4] / (stop[3] * stop[3])
    agreed = True
    for i in range(3):
        stop[i] = stop[i] * fade + innovation[i] * seconds
        if abs(stop[i] / stop[3]) > _STOP_SIGMAS * math.sqrt(variance[i] + noise):
            agreed = False
    return agreed


def motion_of(z: Array, verdict: int, declared: bool, state: FilterState, c: Constants) -> int:
    """The gate's verdict on a block, a detected stop being doubted."""
    motion = verdict
    if verdict == STILL and not declared:
        if not c.detect_stops:
            motion = QUIET
        else:
            innovation = z[24:27] - earth_in_body(attitude_of(state), c) - state.bias
            variance = np.diag(state.P)[3:6] + c.unmodelled_rate * c.unmodelled_rate
            if not stop_agrees(state.stop, innovation, z[19], variance, angle_random_walk(z, c)):
                state.tally[NO_STOP] += 1.0
                motion = QUIET
    if motion <= TURNING:
        # a refused stop stays refused until the tool has really moved
        state.stop[:] = 0.0
    return motion

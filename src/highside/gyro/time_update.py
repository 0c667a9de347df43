"""Time update of the error-state filter: attitude, velocity and covariance carried over one block."""

from __future__ import annotations

import math

from highside.arrays import Array
from highside.attitude.quaternion import direction_cosines
from highside.gyro.filter_state import (
    GAP_S,
    IDENTITY,
    IDENTITY_3,
    MOVED_S,
    SHAKEN,
    STATES,
    STILL,
    STILL_S,
    TURNED,
    TURNING,
    Constants,
    FilterState,
    angle_random_walk,
    attitude_of,
    cross_matrix,
    quaternion_exp,
    quaternion_product,
    set_attitude,
    turn_of_errors,
)
from highside.gyro.measurements import reading_at_end, reading_variance
from highside.units import STANDARD_GRAVITY_MPS2

_ZERO_VELOCITY_MPS = 0.01
"""standard deviation of the velocity of a carried sensor at rest"""
_GAP_RATE_RADPS = 0.02
"""added to the last rate for the turn that a gap may hide"""


def transition(R: Array, z: Array) -> Array:
    """F (10, 10) of the errors over a block that turned by R (3, 3): dth' = R dth - J db - S ds."""
    F = IDENTITY.copy()
    F[:3, :3] = R
    F[:3, 3:6] = -z[4:13].reshape(3, 3)
    F[:3, 6] = -z[13:16]
    return F


def add_velocity(F: Array, push: float, up: Array) -> None:
    """The velocity's rows of a transition: dv' = R dv - push [p x] dth', `push` = g t and Up p as predicted."""
    R = F[:3, :3].copy()
    F[7:] = -push * cross_matrix(up) @ F[:3]
    F[7:, 7:] = R


def zero_velocity_update(state: FilterState, std: float) -> None:
    """The velocity is none, within `std` (m/s), whatever it was."""
    state.velocity[:] = 0.0
    state.P[7:, :] = 0.0
    state.P[:, 7:] = 0.0
    for i in range(7, STATES):
        state.P[i, i] = std * std


def predict(z: Array, motion: int, state: FilterState, c: Constants) -> None:
    """Carry attitude and covariance over a block."""
    seconds, gap_s = z[19], z[31]
    state.tally[GAP_S] += gap_s
    bias_var = c.rrw * c.rrw * (seconds + gap_s)
    if motion == STILL:
        # the tool stands: its attitude is not propagated, the gyro is a measurement (`zero_rate`)
        state.tally[STILL_S] += seconds
        if c.velocity_std > 0.0:
            zero_velocity_update(state, _ZERO_VELOCITY_MPS)
    else:
        turned = c.unmodelled_rate * 2.0 * math.atan2(math.sqrt(z[1:4] @ z[1:4]), abs(z[0]))
        bias_var += turned * turned
        propagate(z, state, c)
        if motion == TURNING:
            state.tally[TURNED] += abs(z[25]) * seconds
        state.tally[MOVED_S] += seconds
        state.tally[SHAKEN] += z[23] * z[23] * seconds
    for i in range(3, 6):
        state.P[i, i] += bias_var


def propagate(z: Array, state: FilterState, c: Constants) -> None:
    """Attitude, velocity and covariance of a tool that moves."""
    seconds, gap_s = z[19], z[31]
    # a bias of 15 deg/h is as large as the Earth's rotation: what turns the error is the rate without it
    turn = turn_of_errors(state.bias, state.scale[0], z)
    rotated = quaternion_product((z[0], z[1], z[2], z[3]), quaternion_exp(turn[0], turn[1], turn[2]))
    R = direction_cosines(rotated)
    F = transition(R, z)
    earth = quaternion_exp(-c.earth_e * seconds, -c.earth_n * seconds, -c.earth_u * seconds)
    set_attitude(state, quaternion_product(quaternion_product(earth, attitude_of(state)), rotated))
    carried = c.velocity_std > 0.0 and gap_s == 0.0
    push = STANDARD_GRAVITY_MPS2 * seconds
    if carried:
        up = direction_cosines(attitude_of(state))[:, 2]
        state.velocity[:] = R @ state.velocity + push * (reading_at_end(z, state, c) - up)
        add_velocity(F, push, up)
    attitude_var = attitude_variance(z, c)
    P = F @ state.P @ F.T
    noise = attitude_var * IDENTITY_3
    P[:3, :3] += noise
    if carried:
        # the attitude's noise of the block has moved the velocity too
        U = -push * cross_matrix(up)
        P[7:, :3] += U @ noise
        P[:3, 7:] += noise @ U.T
        P[7:, 7:] += U @ noise @ U.T + push * push * reading_variance(z, c) * IDENTITY_3
    state.P[:] = 0.5 * (P + P.T)
    if c.velocity_std > 0.0 and gap_s > 0.0:
        zero_velocity_update(state, c.velocity_std)


def attitude_variance(z: Array, c: Constants) -> float:
    """Variance that a block adds to each axis of the attitude, rad^2: gyro noise, scatter, and what a gap may hide."""
    seconds, gap_s = z[19], z[31]
    arw = angle_random_walk(z, c)
    variance = arw * arw * seconds
    if c.gyro_scatter > 0.0:
        # all that it turned, forth and back
        squares = z[24] * z[24] + z[25] * z[25] + z[26] * z[26] + z[27] * z[27] + z[28] * z[28] + z[29] * z[29]
        variance += c.gyro_scatter * c.gyro_scatter * squares * seconds * seconds
    if gap_s > 0.0:
        # where the tool went in a gap is anybody's guess within the rate it had, and some
        rate = math.sqrt(z[24] * z[24] + z[25] * z[25] + z[26] * z[26])
        lost = min((rate + _GAP_RATE_RADPS) * gap_s, math.pi)
        variance += lost * lost
    return float(variance)

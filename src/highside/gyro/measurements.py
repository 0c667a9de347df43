"""Measurement updates of the error-state filter: gravity, zero rate, zero velocity and a straight hole.

Each is gated by its normalised innovation squared and applied in Joseph's form.
"""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import direction_cosines
from highside.gyro.filter_state import (
    IDENTITY,
    IDENTITY_3,
    NO_GRAVITY,
    NO_RATE,
    ROW_GRAVITY,
    ROW_RATE,
    STATES,
    STILL,
    TURNING,
    VERTICAL_COS,
    Constants,
    FilterState,
    angle_random_walk,
    attitude_of,
    azimuth_of,
    azimuth_row,
    cross_matrix,
    earth_in_body,
    quaternion_exp,
    quaternion_product,
    set_attitude,
    turn_of_errors,
)

PATIENCE = 10
"""refused blocks in a row after which a measurement is believed again: the filter, not gravity, is then wrong"""
_GATE_GRAVITY = 30.0
_GATE_RATE = 25.0
"""bounds of the normalised innovation squared (3 degrees of freedom): chances of 1.4e-6 and 1.5e-5"""


def correct(z: Array, motion: int, declared: bool, state: FilterState, c: Constants) -> None:
    """Use what may be measured in a block."""
    if motion == STILL or c.velocity_std == 0.0:
        if motion >= TURNING or c.gravity_while_moving:
            gravity_update(z, motion, state, c)
    else:
        velocity_update(z, state, c)
    if motion == STILL:
        zero_rate_update(z, declared, state, c)
    if c.straight_std > 0.0:
        straight_hole_update(state, c)


def reading_at_end(z: Array, state: FilterState, c: Constants) -> Array:
    """(3,) mean reading of a moving tool in the frame of the block's end, g."""
    # the sum was turned with the raw rates; readings are half a block old on average
    turn = turn_of_errors(state.bias, state.scale[0], z) - earth_in_body(attitude_of(state), c) * z[19]
    return z[16:19] - cross_matrix(0.5 * turn) @ z[16:19]


def reading_variance(z: Array, c: Constants) -> float:
    """Variance of a block's mean reading, g^2."""
    noise = max(z[23], c.accel_noise_g)
    return float(noise * noise / max(z[20], 1.0) + c.accel_floor_g * c.accel_floor_g)


def gravity_update(z: Array, motion: int, state: FilterState, c: Constants) -> None:
    """The mean reading of a block as the direction of Up."""
    up = direction_cosines(attitude_of(state))[:, 2]
    reading = z[16:19] if motion == STILL else reading_at_end(z, state, c)
    H = np.zeros((3, STATES))
    H[:, :3] = cross_matrix(up)
    if c.velocity_std == 0.0:
        reading = reading - state.accel_bias
        H[:, 7:] = IDENTITY_3 - up[:, None] * up
    size = math.sqrt(reading @ reading)
    if not 0.5 < size < 2.0:
        state.tally[NO_GRAVITY] += 1.0
        return
    measurement_update(state, c, H, reading / size - up, reading_variance(z, c), _GATE_GRAVITY, NO_GRAVITY, ROW_GRAVITY)


def velocity_update(z: Array, state: FilterState, c: Constants) -> None:
    """What is carried by hand goes forth and back: its velocity is none, give or take `velocity_std` in a second."""
    H = np.zeros((3, STATES))
    H[:, 7:] = IDENTITY_3
    variance = c.velocity_std * c.velocity_std / max(z[19], 1e-3)
    measurement_update(state, c, H, -state.velocity, variance, math.inf, NO_GRAVITY, ROW_GRAVITY)


def zero_rate_update(z: Array, believed: bool, state: FilterState, c: Constants) -> None:
    """A tool that stands: its gyros show their bias and the Earth's rotation."""
    earth = earth_in_body(attitude_of(state), c)
    arw = angle_random_walk(z, c)
    H = np.zeros((3, STATES))
    H[:, :3] = cross_matrix(earth)
    H[:, 3:6] = IDENTITY_3
    gate = math.inf if believed else _GATE_RATE
    r = z[24:27] - state.bias - earth
    measurement_update(state, c, H, r, arw * arw / max(z[19], 1e-3), gate, NO_RATE, ROW_RATE)


def straight_hole_update(state: FilterState, c: Constants) -> None:
    """The assertion that the azimuth is that of the alignment, in every block anew."""
    q = attitude_of(state)
    C = direction_cosines(q)
    if C[0, 2] * C[0, 2] + C[2, 2] * C[2, 2] < VERTICAL_COS * VERTICAL_COS:
        return
    H = np.zeros((1, STATES))
    H[0, :3] = azimuth_row(q)
    r = state.psi0[0] - azimuth_of(q)
    r -= 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)
    measurement_update(state, c, H, np.array([r]), c.straight_std * c.straight_std, math.inf, NO_RATE, ROW_RATE)


def measurement_update(
    state: FilterState, c: Constants, H: Array, r: Array, variance: float, gate: float, refused: int, in_a_row: int
) -> None:
    """A measurement r (k,) = H (k, 10) dx + noise of this variance an axis; not believed where its innovation is beyond
    the gate. The covariance in Joseph's form, which keeps it symmetric and positive."""
    cross = state.P @ H.T
    inverse = np.linalg.inv(H @ cross + variance * IDENTITY_3[: r.size, : r.size])
    if gate < math.inf:
        if r @ (inverse @ r) > gate and state.tally[in_a_row] < PATIENCE:
            state.tally[in_a_row] += 1.0
            state.tally[refused] += 1.0
            return
        state.tally[in_a_row] = 0.0
    gain = cross @ inverse
    kept = IDENTITY - gain @ H
    P = kept @ state.P @ kept.T + variance * (gain @ gain.T)
    dx = gain @ r
    set_attitude(state, quaternion_product(attitude_of(state), quaternion_exp(dx[0], dx[1], dx[2])))
    turn_with_up(P, dx[:3], direction_cosines(attitude_of(state))[:, 2])
    state.P[:] = 0.5 * (P + P.T)
    state.bias[:] += dx[3:6]
    state.scale[0] += dx[6]
    if c.velocity_std > 0.0:
        state.velocity[:] += dx[7:]
    else:
        state.accel_bias[:] += dx[7:]


def turn_with_up(P: Array, correction: Array, up: Array) -> None:
    """Turn P (in place) with Up when the tilt is corrected by the rotation vector `correction` (3,).

    What gravity does not show is a rotation about Up, and Up has moved in the body: without this a great uncertainty of
    the azimuth would leak into the tilt, be "measured" there by gravity, and vanish. A correction of the azimuth turns
    nothing: what is known of the tilt was measured in the body, as the accelerometers' biases were.
    """
    tilt = correction - (correction @ up) * up
    R = direction_cosines(quaternion_exp(tilt[0], tilt[1], tilt[2]))
    P[:3] = R @ P[:3]
    P[:, :3] = P[:, :3] @ R.T

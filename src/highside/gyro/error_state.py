"""The error-state filter on one block: gate, prediction and corrections, in matrices. `filter` tells the theory.

State (10): attitude error (0 to 2), gyro bias (3 to 5), scale-factor error (6) and, in the last three, the
accelerometers' biases or, of a sensor carried by hand, its velocity.

A block is the vector z (34,) of `blocks.finished`; angles rad, rates rad/s, body frame. A block takes some 0.1 ms.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.units import STANDARD_GRAVITY_MPS2

Quaternion = tuple[float, float, float, float]

STATES = 10
STILL_S, TURNED, MOVED_S, SHAKEN, GAP_S, NO_GRAVITY, NO_RATE, NO_STOP, ROW_GRAVITY, ROW_RATE = range(10)
"""places in `FilterState.tally`"""
VIBRATING, TURNING, QUIET, STILL = 0, 1, 2, 3
"""as `gates.Motion`"""

_IDENTITY, _IDENTITY_3 = np.eye(STATES), np.eye(3)

VERTICAL_COS = 0.05
"""|cos theta| below which azimuth and toolface are one (2.9 deg from the vertical)"""
_PATIENCE = 10
"""refused blocks in a row after which a measurement is believed again: the filter, not gravity, is then wrong"""
_GATE_GRAVITY = 30.0
_GATE_RATE = 25.0
"""bounds of the normalised innovation squared (3 degrees of freedom): chances of 1.4e-6 and 1.5e-5"""
_STOP_SIGMAS = 4.0
"""of the mean rate at a detected stop"""
_STOP_MEMORY_S = 20.0
"""time constant of that mean"""
_ZERO_VELOCITY_MPS = 0.01
"""standard deviation of the velocity of a carried sensor at rest"""
_GAP_RATE_RADPS = 0.02
"""added to the last rate for the turn that a gap may hide"""


class Constants(NamedTuple):
    """What does not change while the filter runs."""

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


def direction_cosines(q: Quaternion) -> Array:
    """Cnb (3, 3): a vector of the navigation frame seen from the body. Its last column is Up."""
    a, b, c, d = q
    return np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)],
            [2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * (c * d + a * b)],
            [2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d],
        ]
    )


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
    """(3,) the Earth's rotation seen from the tool."""
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


def random_walk_of(z: Array, c: Constants) -> float:
    """Angle random walk of a block, rad/sqrt(s): that of the settings, or what vibration makes of it."""
    seconds, n = z[19], z[20]
    if n < 2.0 or seconds <= 0.0:
        return c.arw
    seen = z[30] * math.sqrt(seconds / n)
    return float(seen) if seen > 1.3 * c.arw else c.arw


def transition(R: Array, z: Array) -> Array:
    """F (10, 10) of the errors over a block that turned by R (3, 3): dth' = R dth - J db - S ds."""
    F = _IDENTITY.copy()
    F[:3, :3] = R
    F[:3, 3:6] = -z[4:13].reshape(3, 3)
    F[:3, 6] = -z[13:16]
    return F


def add_velocity(F: Array, push: float, up: Array) -> None:
    """The velocity's rows of a transition: dv' = R dv - push [p x] dth', `push` = g t and Up p as predicted."""
    R = F[:3, :3].copy()
    F[7:] = -push * cross_matrix(up) @ F[:3]
    F[7:, 7:] = R


def zero_velocity(state: FilterState, std: float) -> None:
    """The velocity is none, within `std` (m/s), whatever it was."""
    state.velocity[:] = 0.0
    state.P[7:, :] = 0.0
    state.P[:, 7:] = 0.0
    for i in range(7, STATES):
        state.P[i, i] = std * std


def agrees(stop: Array, innovation: Array, seconds: float, variance: Array, arw: float) -> bool:
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
            if not agrees(state.stop, innovation, z[19], variance, random_walk_of(z, c)):
                state.tally[NO_STOP] += 1.0
                motion = QUIET
    if motion <= TURNING:
        # a refused stop stays refused until the tool has really moved
        state.stop[:] = 0.0
    return motion


def predict(z: Array, motion: int, state: FilterState, c: Constants) -> None:
    """Carry attitude and covariance over a block."""
    seconds, gap_s = z[19], z[31]
    state.tally[GAP_S] += gap_s
    bias_var = c.rrw * c.rrw * (seconds + gap_s)
    if motion == STILL:
        # the tool stands: its attitude is not propagated, the gyro is a measurement (`zero_rate`)
        state.tally[STILL_S] += seconds
        if c.velocity_std > 0.0:
            zero_velocity(state, _ZERO_VELOCITY_MPS)
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
    noise = attitude_var * _IDENTITY_3
    P[:3, :3] += noise
    if carried:
        # the attitude's noise of the block has moved the velocity too
        U = -push * cross_matrix(up)
        P[7:, :3] += U @ noise
        P[:3, 7:] += noise @ U.T
        P[7:, 7:] += U @ noise @ U.T + push * push * reading_variance(z, c) * _IDENTITY_3
    state.P[:] = 0.5 * (P + P.T)
    if c.velocity_std > 0.0 and gap_s > 0.0:
        zero_velocity(state, c.velocity_std)


def attitude_variance(z: Array, c: Constants) -> float:
    """Variance that a block adds to each axis of the attitude, rad^2: gyro noise, scatter, and what a gap may hide."""
    seconds, gap_s = z[19], z[31]
    arw = random_walk_of(z, c)
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


def correct(z: Array, motion: int, declared: bool, state: FilterState, c: Constants) -> None:
    """Use what may be measured in a block."""
    if motion == STILL or c.velocity_std == 0.0:
        if motion >= TURNING or c.gravity_while_moving:
            gravity(z, motion, state, c)
    else:
        bounded_velocity(z, state, c)
    if motion == STILL:
        zero_rate(z, declared, state, c)
    if c.straight_std > 0.0:
        straight(state, c)


def reading_at_end(z: Array, state: FilterState, c: Constants) -> Array:
    """(3,) mean reading of a moving tool in the frame of the block's end, g."""
    # the sum was turned with the raw rates; readings are half a block old on average
    turn = turn_of_errors(state.bias, state.scale[0], z) - earth_in_body(attitude_of(state), c) * z[19]
    return z[16:19] - cross_matrix(0.5 * turn) @ z[16:19]


def reading_variance(z: Array, c: Constants) -> float:
    """Variance of a block's mean reading, g^2."""
    noise = max(z[23], c.accel_noise_g)
    return float(noise * noise / max(z[20], 1.0) + c.accel_floor_g * c.accel_floor_g)


def gravity(z: Array, motion: int, state: FilterState, c: Constants) -> None:
    """The mean reading of a block as the direction of Up."""
    up = direction_cosines(attitude_of(state))[:, 2]
    reading = z[16:19] if motion == STILL else reading_at_end(z, state, c)
    H = np.zeros((3, STATES))
    H[:, :3] = cross_matrix(up)
    if c.velocity_std == 0.0:
        reading = reading - state.accel_bias
        H[:, 7:] = _IDENTITY_3 - up[:, None] * up
    size = math.sqrt(reading @ reading)
    if not 0.5 < size < 2.0:
        state.tally[NO_GRAVITY] += 1.0
        return
    measurement_update(state, c, H, reading / size - up, reading_variance(z, c), _GATE_GRAVITY, NO_GRAVITY, ROW_GRAVITY)


def bounded_velocity(z: Array, state: FilterState, c: Constants) -> None:
    """What is carried by hand goes forth and back: its velocity is none, give or take `velocity_std` in a second."""
    H = np.zeros((3, STATES))
    H[:, 7:] = _IDENTITY_3
    variance = c.velocity_std * c.velocity_std / max(z[19], 1e-3)
    measurement_update(state, c, H, -state.velocity, variance, math.inf, NO_GRAVITY, ROW_GRAVITY)


def zero_rate(z: Array, believed: bool, state: FilterState, c: Constants) -> None:
    """A tool that stands: its gyros show their bias and the Earth's rotation."""
    earth = earth_in_body(attitude_of(state), c)
    arw = random_walk_of(z, c)
    H = np.zeros((3, STATES))
    H[:, :3] = cross_matrix(earth)
    H[:, 3:6] = _IDENTITY_3
    gate = math.inf if believed else _GATE_RATE
    r = z[24:27] - state.bias - earth
    measurement_update(state, c, H, r, arw * arw / max(z[19], 1e-3), gate, NO_RATE, ROW_RATE)


def straight(state: FilterState, c: Constants) -> None:
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
    inverse = np.linalg.inv(H @ cross + variance * _IDENTITY_3[: r.size, : r.size])
    if gate < math.inf:
        if r @ (inverse @ r) > gate and state.tally[in_a_row] < _PATIENCE:
            state.tally[in_a_row] += 1.0
            state.tally[refused] += 1.0
            return
        state.tally[in_a_row] = 0.0
    gain = cross @ inverse
    kept = _IDENTITY - gain @ H
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

"""What the error-state filter knows, and the algebra on it: quaternions, the covariance, one measurement taken in.

In the subset of Python that a compiler can take (`core` tells why): functions on sequences of floats and named tuples.
A block is the vector of `blocks.finished`; angles rad, rates rad/s, body frame.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

Numbers = Any
"""a list of floats or a one-dimensional array of them"""
Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

STATES = 10
STANDARD_GRAVITY = 9.80665
# places in `Memory.tally`
STILL_S, TURNED, MOVED_S, SHAKEN, GAP_S, NO_GRAVITY, NO_RATE, NO_STOP, ROW_GRAVITY, ROW_RATE = range(10)

VERTICAL_COS = 0.05
"""|cos theta| below which azimuth and toolface are one"""
_PATIENCE = 10
"""refused blocks in a row after which a measurement is believed again: the filter, not gravity, is then wrong"""


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


class Memory(NamedTuple):
    """What the filter knows; changed in place."""

    q: Numbers
    """(4,)"""
    bias: Numbers
    """(3,)"""
    scale: Numbers
    """(1,)"""
    accel_bias: Numbers
    """(3,) of the accelerometers, g; of a thing carried by hand (`velocity_std`) its velocity in their places, m/s"""
    P: Numbers
    """(100,) covariance of attitude error, bias, scale, accelerometer bias or velocity, by rows"""
    psi0: Numbers
    """(1,) azimuth of the last alignment"""
    stop: Numbers
    """(5,) of the test of a detected stop: fading sums of innovation (3), seconds, squared weights"""
    tally: Numbers
    """(10,) seconds and counts"""
    work: Numbers
    """(120,) scratch: 3 x 10 by rows, four times"""


def times(p: Quaternion, q: Quaternion) -> Quaternion:
    """Hamilton product."""
    p0, p1, p2, p3 = p
    q0, q1, q2, q3 = q
    return (
        p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
        p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
        p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
        p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
    )


def turning(x: float, y: float, z: float) -> Quaternion:
    """exp of the rotation vector (x, y, z)."""
    h = 0.25 * (x * x + y * y + z * z)
    if h < 1e-4:
        # cos and sin(h)/h of a small angle, to the last bit
        c = 1.0 - h * (1 / 2 - h * (1 / 24 - h * (1 / 720)))
        s = 0.5 * (1.0 - h * (1 / 6 - h * (1 / 120 - h * (1 / 5040))))
    else:
        angle = math.sqrt(h)
        c, s = math.cos(angle), 0.5 * math.sin(angle) / angle
    return c, s * x, s * y, s * z


def cosines(q: Quaternion) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Cnb of q by rows."""
    a, b, c, d = q
    return (
        a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c),
        2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * (c * d + a * b),
        2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d,
    )  # fmt: skip


def attitude_of(m: Memory) -> Quaternion:
    """The quaternion as a tuple."""
    return m.q[0], m.q[1], m.q[2], m.q[3]


def store(m: Memory, q: Quaternion) -> None:
    """Keep q, normalised."""
    a, b, c, d = q
    size = math.sqrt(a * a + b * b + c * c + d * d)
    m.q[0], m.q[1], m.q[2], m.q[3] = a / size, b / size, c / size, d / size


def earth_in_body(q: Quaternion, c: Constants) -> Vector:
    """The Earth's rotation seen from the tool."""
    C = cosines(q)
    e, n, u = c.earth_e, c.earth_n, c.earth_u
    return C[0] * e + C[1] * n + C[2] * u, C[3] * e + C[4] * n + C[5] * u, C[6] * e + C[7] * n + C[8] * u


def azimuth_of(q: Quaternion) -> float:
    """psi of q."""
    a, b, c, d = q
    return math.atan2(2 * (b * c - a * d), a * a - b * b + c * c - d * d)


def azimuth_row(q: Quaternion) -> Vector:
    """d psi / d dth; near the vertical, where psi means nothing, minus the rotation about Up."""
    C = cosines(q)
    square = C[2] * C[2] + C[8] * C[8]
    if square < VERTICAL_COS * VERTICAL_COS:
        return -C[2], -C[5], -C[8]
    # [sin phi, 0, -cos phi] / cos theta, with sin phi = -C02 / cos theta and cos phi = C22 / cos theta
    return -C[2] / square, 0.0, -C[8] / square


def azimuth_variance(m: Memory) -> float:
    """Variance of psi (of the rotation about Up near the vertical), rad^2."""
    x, y, z = azimuth_row(attitude_of(m))
    P = m.P
    return float(
        x * x * P[0] + y * y * P[11] + z * z * P[22] + 2.0 * (x * y * P[1] + x * z * P[2] + y * z * P[12])
    )  # fmt: skip


def turn_left(m: Memory, z: Numbers) -> Vector:
    """What bias and scale error turn the end of a block by."""
    b0, b1, b2, s = m.bias[0], m.bias[1], m.bias[2], m.scale[0]
    return (
        -(z[4] * b0 + z[5] * b1 + z[6] * b2 + z[13] * s),
        -(z[7] * b0 + z[8] * b1 + z[9] * b2 + z[14] * s),
        -(z[10] * b0 + z[11] * b1 + z[12] * b2 + z[15] * s),
    )


def random_walk_of(z: Numbers, c: Constants) -> float:
    """Angle random walk of a block, rad/sqrt(s): that of the settings, or what vibration makes of it."""
    seconds, n = z[19], z[20]
    if n < 2.0 or seconds <= 0.0:
        return c.arw
    seen = z[30] * math.sqrt(seconds / n)
    return float(seen) if seen > 1.3 * c.arw else c.arw


def spread(m: Memory, R: Numbers, z: Numbers, attitude_var: float) -> None:
    """P <- F P F' + attitude noise, with F = [R, -J, -S, 0] in its first three rows and the identity below."""
    P, top = m.P, m.work
    for i in range(3):
        r0, r1, r2, s = R[3 * i], R[3 * i + 1], R[3 * i + 2], z[13 + i]
        j0, j1, j2 = z[4 + 3 * i], z[5 + 3 * i], z[6 + 3 * i]
        for k in range(STATES):
            top[10 * i + k] = (
                r0 * P[k] + r1 * P[10 + k] + r2 * P[20 + k]
                - j0 * P[30 + k] - j1 * P[40 + k] - j2 * P[50 + k] - s * P[60 + k]
            )  # fmt: skip
    for i in range(3):
        at = 10 * i
        for k in range(i, 3):
            value = (
                top[at] * R[3 * k] + top[at + 1] * R[3 * k + 1] + top[at + 2] * R[3 * k + 2]
                - top[at + 3] * z[4 + 3 * k] - top[at + 4] * z[5 + 3 * k] - top[at + 5] * z[6 + 3 * k]
                - top[at + 6] * z[13 + k]
            )  # fmt: skip
            if i == k:
                value += attitude_var
            P[at + k] = value
            P[10 * k + i] = value
        for k in range(3, STATES):
            P[at + k] = top[at + k]
            P[10 * k + i] = top[at + k]


def carry(m: Memory, R: Numbers, reading: Vector, seconds: float, variance: float) -> None:
    """Velocity and its errors over a block, after `spread`: v' = R v + g t (a - p),  dv' = R dv - g t [p x] dth'.

    `reading` a (g) and Up p in the body at the block's end, R (9,) its rotation; `variance` of a, g^2.
    """
    P, top, v = m.P, m.work, m.accel_bias
    C = cosines(attitude_of(m))
    px, py, pz = C[2], C[5], C[8]
    push = STANDARD_GRAVITY * seconds
    x, y, w = v[0], v[1], v[2]
    v[0] = R[0] * x + R[1] * y + R[2] * w + push * (reading[0] - px)
    v[1] = R[3] * x + R[4] * y + R[5] * w + push * (reading[1] - py)
    v[2] = R[6] * x + R[7] * y + R[8] * w + push * (reading[2] - pz)
    U = (0.0, push * pz, -push * py, -push * pz, 0.0, push * px, push * py, -push * px, 0.0)
    for i in range(3):
        r0, r1, r2, u0, u1, u2 = R[3 * i], R[3 * i + 1], R[3 * i + 2], U[3 * i], U[3 * i + 1], U[3 * i + 2]
        for k in range(STATES):
            top[10 * i + k] = (
                r0 * P[70 + k] + r1 * P[80 + k] + r2 * P[90 + k] + u0 * P[k] + u1 * P[10 + k] + u2 * P[20 + k]
            )
    for i in range(3):
        at, row = 10 * i, 10 * (7 + i)
        for k in range(7):
            P[row + k] = top[at + k]
            P[10 * k + 7 + i] = top[at + k]
        for k in range(i, 3):
            value = (
                top[at + 7] * R[3 * k] + top[at + 8] * R[3 * k + 1] + top[at + 9] * R[3 * k + 2]
                + top[at] * U[3 * k] + top[at + 1] * U[3 * k + 1] + top[at + 2] * U[3 * k + 2]
            )  # fmt: skip
            if i == k:
                value += push * push * variance
            P[row + 7 + k] = value
            P[10 * (7 + k) + 7 + i] = value


def standing(m: Memory, std: float) -> None:
    """The velocity is none, within `std` (m/s), whatever it was."""
    for i in range(3):
        m.accel_bias[i] = 0.0
        for k in range(STATES):
            m.P[10 * (7 + i) + k] = 0.0
            m.P[10 * k + 7 + i] = 0.0
    for i in range(3):
        m.P[77 + 11 * i] = std * std


def take(
    m: Memory, at: Numbers, H: Numbers, r: Vector, variance: float, gate: float, refused: int, in_a_row: int
) -> None:
    """A measurement r = H dx + noise of this variance an axis; refused where its innovation is beyond the gate.

    H (3, 6) stands at the six states `at`. The covariance in Joseph's form, multiplied out:
    (I - K H) P (I - K H)' + K R K' = P - K W - W' K',  W = (P H')' - S K' / 2.
    """
    P, work = m.P, m.work
    for k in range(3):
        h = H[k]
        for i in range(STATES):
            row = 10 * i
            work[10 * k + i] = (
                P[row + at[0]] * h[0] + P[row + at[1]] * h[1] + P[row + at[2]] * h[2]
                + P[row + at[3]] * h[3] + P[row + at[4]] * h[4] + P[row + at[5]] * h[5]
            )  # fmt: skip
    a, b, c = innovation_row(work, at, H[0])
    a += variance
    _, d, e = innovation_row(work, at, H[1])
    d += variance
    _, _, f = innovation_row(work, at, H[2])
    f += variance
    # the inverse of S by cofactors
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    A, B, C, D, E, F = A / det, B / det, C / det, (a * f - c * c) / det, (b * c - a * e) / det, (a * d - b * b) / det
    x, y, z = r
    if gate < math.inf:
        size = x * (A * x + B * y + C * z) + y * (B * x + D * y + E * z) + z * (C * x + E * y + F * z)
        if size > gate and m.tally[in_a_row] < _PATIENCE:
            m.tally[in_a_row] += 1.0
            m.tally[refused] += 1.0
            return
        m.tally[in_a_row] = 0.0
    for i in range(STATES):
        u, v, w = work[i], work[10 + i], work[20 + i]
        k0, k1, k2 = u * A + v * B + w * C, u * B + v * D + w * E, u * C + v * E + w * F
        work[30 + i], work[40 + i], work[50 + i] = k0, k1, k2
        work[60 + i] = u - 0.5 * (a * k0 + b * k1 + c * k2)
        work[70 + i] = v - 0.5 * (b * k0 + d * k1 + e * k2)
        work[80 + i] = w - 0.5 * (c * k0 + e * k1 + f * k2)
        work[90 + i] = k0 * x + k1 * y + k2 * z
    for i in range(STATES):
        k0, k1, k2 = work[30 + i], work[40 + i], work[50 + i]
        w0, w1, w2 = work[60 + i], work[70 + i], work[80 + i]
        for j in range(i, STATES):
            value = P[10 * i + j] - (
                k0 * work[60 + j] + k1 * work[70 + j] + k2 * work[80 + j]
                + w0 * work[30 + j] + w1 * work[40 + j] + w2 * work[50 + j]
            )  # fmt: skip
            P[10 * i + j] = value
            P[10 * j + i] = value
    q = attitude_of(m)
    store(m, times(q, turning(work[90], work[91], work[92])))
    rows = cosines(q)
    up_x, up_y, up_z = rows[2], rows[5], rows[8]
    about = work[90] * up_x + work[91] * up_y + work[92] * up_z
    tilted = turning(work[90] - about * up_x, work[91] - about * up_y, work[92] - about * up_z)
    follow_up(m, cosines(tilted))
    for i in range(3):
        m.bias[i] += work[93 + i]
        m.accel_bias[i] += work[97 + i]
    m.scale[0] += work[96]


def follow_up(m: Memory, R: Numbers) -> None:
    """Turn the covariance with Up when the tilt is corrected: P <- R P R' in the attitude's part.

    What gravity does not show is a rotation about Up, and Up has moved in the body: without this a great uncertainty of
    the azimuth would leak into the tilt, be "measured" there by gravity, and vanish. A correction of the azimuth turns
    nothing: what is known of the tilt was measured in the body, as the accelerometers' biases were.
    """
    P, top = m.P, m.work
    for i in range(3):
        for k in range(STATES):
            top[10 * i + k] = R[3 * i] * P[k] + R[3 * i + 1] * P[10 + k] + R[3 * i + 2] * P[20 + k]
    for i in range(3):
        at = 10 * i
        for k in range(i, 3):
            value = top[at] * R[3 * k] + top[at + 1] * R[3 * k + 1] + top[at + 2] * R[3 * k + 2]
            P[at + k] = value
            P[10 * k + i] = value
        for k in range(3, STATES):
            P[at + k] = top[at + k]
            P[10 * k + i] = top[at + k]


def innovation_row(work: Numbers, at: Numbers, h: Numbers) -> Vector:
    """One row of H P H'."""
    x, y, z = 0.0, 0.0, 0.0
    for i in range(6):
        x += h[i] * work[at[i]]
        y += h[i] * work[10 + at[i]]
        z += h[i] * work[20 + at[i]]
    return x, y, z

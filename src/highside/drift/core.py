"""The arithmetic of the error-state filter on one block, in the subset of Python that a compiler can take.

Plain functions on sequences of floats and two named tuples, no objects and no arrays: interpreted as they stand (on
lists: the online form, or where nothing compiles), or compiled together with all they call (on arrays: `compiled`). One
source and IEEE arithmetic in one order: the same bits. `filter` tells the theory; here are its lines. A block is the
vector of `blocks.finished`; angles rad, rates rad/s, body frame.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

Numbers = Any
"""a list of floats or a one-dimensional array of them"""
Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

STATES = 10
VIBRATING, TURNING, QUIET, STILL = 0, 1, 2, 3
"""as `gates.Motion`, which a compiler does not know"""

# places in `Memory.tally`
STILL_S, TURNED, MOVED_S, SHAKEN, GAP_S, NO_GRAVITY, NO_RATE, NO_STOP, ROW_GRAVITY, ROW_RATE = range(10)

_VERTICAL_COS = 0.05
"""|cos theta| below which azimuth and toolface are one"""
_GATE_GRAVITY = 30.0
_GATE_RATE = 25.0
"""bounds of the normalised squared innovation (3 degrees of freedom)"""
_PATIENCE = 10
"""refused blocks in a row after which a measurement is believed again: the filter, not gravity, is then wrong"""
_STOP_SIGMAS = 4.0
_STOP_MEMORY_S = 20.0
_TILT_AND_BIAS = (0, 1, 2, 3, 4, 5)
_TILT_AND_ACCEL = (0, 1, 2, 7, 8, 9)


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


class Memory(NamedTuple):
    """What the filter knows; changed in place."""

    q: Numbers
    """(4,)"""
    bias: Numbers
    """(3,)"""
    scale: Numbers
    """(1,)"""
    accel_bias: Numbers
    """(3,)"""
    P: Numbers
    """(100,) covariance of attitude error, bias, scale, accelerometer bias, by rows"""
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
    if square < _VERTICAL_COS * _VERTICAL_COS:
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


def agrees(stop: Numbers, innovation: Vector, seconds: float, variance: Vector, arw: float) -> bool:
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


def motion_of(z: Numbers, verdict: int, declared: bool, m: Memory, c: Constants) -> int:
    """The gate's verdict on a block, a detected stop being doubted."""
    motion = verdict
    if verdict == STILL and not declared:
        if not c.detect_stops:
            motion = QUIET
        else:
            e = earth_in_body(attitude_of(m), c)
            innovation = (z[24] - e[0] - m.bias[0], z[25] - e[1] - m.bias[1], z[26] - e[2] - m.bias[2])
            unmodelled = c.unmodelled_rate * c.unmodelled_rate
            variance = (m.P[33] + unmodelled, m.P[44] + unmodelled, m.P[55] + unmodelled)
            if not agrees(m.stop, innovation, z[19], variance, random_walk_of(z, c)):
                m.tally[NO_STOP] += 1.0
                motion = QUIET
    if motion <= TURNING:
        # a refused stop stays refused until the tool has really moved
        for i in range(5):
            m.stop[i] = 0.0
    return motion


def predict(z: Numbers, motion: int, m: Memory, c: Constants) -> None:
    """Carry attitude and covariance over a block."""
    seconds, gap_s = z[19], z[31]
    m.tally[GAP_S] += gap_s
    bias_var = c.rrw * c.rrw * (seconds + gap_s)
    if motion == STILL:
        # the tool stands: its attitude is not propagated, the gyro is a measurement (`zero_rate`)
        m.tally[STILL_S] += seconds
    else:
        half = math.sqrt(z[1] * z[1] + z[2] * z[2] + z[3] * z[3])
        turned = c.unmodelled_rate * 2.0 * math.atan2(half, abs(z[0]))
        bias_var += turned * turned
        arw = random_walk_of(z, c)
        attitude_var = arw * arw * seconds
        if gap_s > 0.0:
            # where the tool went in a gap is anybody's guess within the rate it had, and some
            rate = math.sqrt(z[24] * z[24] + z[25] * z[25] + z[26] * z[26])
            lost = min((rate + 0.02) * gap_s, math.pi)
            attitude_var += lost * lost
        # a bias of 15 deg/h is as large as the Earth's rotation: what turns the error is the rate without it
        x, y, w = turn_left(m, z)
        rotated = times((z[0], z[1], z[2], z[3]), turning(x, y, w))
        spread(m, cosines(rotated), z, attitude_var)
        earth = turning(-c.earth_e * seconds, -c.earth_n * seconds, -c.earth_u * seconds)
        store(m, times(times(earth, attitude_of(m)), rotated))
        if motion == TURNING:
            m.tally[TURNED] += abs(z[25]) * seconds
        m.tally[MOVED_S] += seconds
        m.tally[SHAKEN] += z[23] * z[23] * seconds
    m.P[33] += bias_var
    m.P[44] += bias_var
    m.P[55] += bias_var


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


def correct(z: Numbers, motion: int, declared: bool, m: Memory, c: Constants) -> None:
    """Use what may be measured in a block."""
    if motion >= TURNING or c.gravity_while_moving:
        gravity(z, motion, m, c)
    if motion == STILL:
        zero_rate(z, declared, m, c)
    if c.straight_std > 0.0:
        straight(m, c.straight_std)


def gravity(z: Numbers, motion: int, m: Memory, c: Constants) -> None:
    """The mean reading of a block as the direction of Up."""
    q = attitude_of(m)
    C = cosines(q)
    px, py, pz = C[2], C[5], C[8]
    ax, ay, az = z[16], z[17], z[18]
    if motion != STILL:
        # the sum was turned with the raw rates; readings are half a block old on average
        e, t = earth_in_body(q, c), turn_left(m, z)
        tx, ty, tz = 0.5 * (t[0] - e[0] * z[19]), 0.5 * (t[1] - e[1] * z[19]), 0.5 * (t[2] - e[2] * z[19])
        ax, ay, az = ax - (ty * az - tz * ay), ay - (tz * ax - tx * az), az - (tx * ay - ty * ax)
    ax, ay, az = ax - m.accel_bias[0], ay - m.accel_bias[1], az - m.accel_bias[2]
    size = math.sqrt(ax * ax + ay * ay + az * az)
    if not 0.5 < size < 2.0:
        m.tally[NO_GRAVITY] += 1.0
        return
    noise = max(z[23], c.accel_noise_g)
    variance = noise * noise / max(z[20], 1.0) + c.accel_floor_g * c.accel_floor_g
    H = (
        (0.0, -pz, py, 1.0 - px * px, -px * py, -px * pz),
        (pz, 0.0, -px, -py * px, 1.0 - py * py, -py * pz),
        (-py, px, 0.0, -pz * px, -pz * py, 1.0 - pz * pz),
    )
    r = (ax / size - px, ay / size - py, az / size - pz)
    take(m, _TILT_AND_ACCEL, H, r, variance, _GATE_GRAVITY, NO_GRAVITY, ROW_GRAVITY)


def zero_rate(z: Numbers, believed: bool, m: Memory, c: Constants) -> None:
    """A tool that stands: its gyros show their bias and the Earth's rotation."""
    x, y, w = earth_in_body(attitude_of(m), c)
    arw = random_walk_of(z, c)
    H = ((0.0, -w, y, 1.0, 0.0, 0.0), (w, 0.0, -x, 0.0, 1.0, 0.0), (-y, x, 0.0, 0.0, 0.0, 1.0))
    r = (z[24] - m.bias[0] - x, z[25] - m.bias[1] - y, z[26] - m.bias[2] - w)
    gate = math.inf if believed else _GATE_RATE
    take(m, _TILT_AND_BIAS, H, r, arw * arw / max(z[19], 1e-3), gate, NO_RATE, ROW_RATE)


def straight(m: Memory, std: float) -> None:
    """The assertion that the azimuth is that of the alignment, in every block anew."""
    q = attitude_of(m)
    C = cosines(q)
    if C[2] * C[2] + C[8] * C[8] < _VERTICAL_COS * _VERTICAL_COS:
        return
    x, y, w = azimuth_row(q)
    r = m.psi0[0] - azimuth_of(q)
    r -= 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    H = ((x, y, w, 0.0, 0.0, 0.0), nothing, nothing)
    take(m, _TILT_AND_BIAS, H, (r, 0.0, 0.0), std * std, math.inf, NO_RATE, ROW_RATE)


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


class Trace(NamedTuple):
    """The filter at the end of each of M blocks, arrays. What only a smoother needs is empty without one."""

    q: Numbers
    """(M, 4)"""
    bias: Numbers
    """(M, 3)"""
    scale: Numbers
    """(M,)"""
    accel_bias: Numbers
    """(M, 3)"""
    bias_var: Numbers
    """(M, 3)"""
    azimuth_var: Numbers
    """(M,)"""
    motion: Numbers
    """(M,)"""
    moved_s: Numbers
    """(M,)"""
    shaken: Numbers
    """(M,) time integral of the squared vibration while moving, g^2 s"""
    q_before: Numbers
    """(M or 0, 4) predicted"""
    P: Numbers
    """(M or 0, 100)"""
    P_before: Numbers
    """(M or 0, 100) predicted"""


def run(blocks: Numbers, verdicts: Numbers, declared: Numbers, m: Memory, c: Constants, trace: Trace) -> None:
    """All blocks (M, 34) in turn; the first was taken by the alignment."""
    kept = len(trace.P) > 0
    for i in range(len(blocks)):
        motion = verdicts[i]
        if i > 0:
            motion = motion_of(blocks[i], motion, declared[i], m, c)
            predict(blocks[i], motion, m, c)
        if kept:
            for j in range(4):
                trace.q_before[i, j] = m.q[j]
            for j in range(100):
                trace.P_before[i, j] = m.P[j]
        if i > 0:
            correct(blocks[i], motion, declared[i], m, c)
        if kept:
            for j in range(100):
                trace.P[i, j] = m.P[j]
        for j in range(4):
            trace.q[i, j] = m.q[j]
        for j in range(3):
            trace.bias[i, j] = m.bias[j]
            trace.accel_bias[i, j] = m.accel_bias[j]
            trace.bias_var[i, j] = m.P[33 + 11 * j]
        trace.scale[i] = m.scale[0]
        trace.azimuth_var[i] = azimuth_variance(m)
        trace.motion[i] = motion
        trace.moved_s[i] = m.tally[MOVED_S]
        trace.shaken[i] = m.tally[SHAKEN]

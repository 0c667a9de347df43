"""The error-state filter on one block (gate, prediction, corrections), in the subset of Python that a compiler takes.

Plain functions on sequences of floats and two named tuples, no objects and no arrays: interpreted as they stand (on
lists: the online form, or where nothing compiles), or compiled together with all they call (on arrays: `compiled`). One
source and IEEE arithmetic in one order: the same bits. `filter` tells the theory; here are its lines. A block is the
vector of `blocks.finished`; angles rad, rates rad/s, body frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from highside.gyro.algebra import (
    GAP_S,
    MOVED_S,
    NO_GRAVITY,
    NO_RATE,
    NO_STOP,
    ROW_GRAVITY,
    ROW_RATE,
    SHAKEN,
    STATES,
    STILL_S,
    TURNED,
    VERTICAL_COS,
    Constants,
    Memory,
    Numbers,
    Quaternion,
    Vector,
    attitude_of,
    azimuth_of,
    azimuth_row,
    azimuth_variance,
    carry,
    cosines,
    earth_in_body,
    follow_up,
    innovation_row,
    random_walk_of,
    spread,
    standing,
    store,
    take,
    times,
    turn_left,
    turning,
)

__all__ = [
    "GAP_S",
    "MOVED_S",
    "NO_GRAVITY",
    "NO_RATE",
    "NO_STOP",
    "QUIET",
    "ROW_GRAVITY",
    "ROW_RATE",
    "SHAKEN",
    "STATES",
    "STILL",
    "STILL_S",
    "TURNED",
    "TURNING",
    "VERTICAL_COS",
    "VIBRATING",
    "Constants",
    "Memory",
    "Numbers",
    "Quaternion",
    "Trace",
    "Vector",
    "agrees",
    "attitude_of",
    "azimuth_of",
    "azimuth_row",
    "azimuth_variance",
    "bounded",
    "carry",
    "correct",
    "cosines",
    "earth_in_body",
    "follow_up",
    "gravity",
    "innovation_row",
    "motion_of",
    "predict",
    "random_walk_of",
    "run",
    "spread",
    "standing",
    "store",
    "straight",
    "take",
    "times",
    "turn_left",
    "turning",
    "zero_rate",
]

VIBRATING, TURNING, QUIET, STILL = 0, 1, 2, 3
"""as `gates.Motion`, which a compiler does not know"""

_GATE_GRAVITY = 30.0
_GATE_RATE = 25.0
"""bounds of the normalised squared innovation (3 degrees of freedom)"""
_STOP_SIGMAS = 4.0
_STOP_MEMORY_S = 20.0
_STANDING_MPS = 0.01
_TILT_AND_BIAS = (0, 1, 2, 3, 4, 5)
_TILT_AND_ACCEL = (0, 1, 2, 7, 8, 9)


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
        if c.velocity_std > 0.0:
            standing(m, _STANDING_MPS)
    else:
        half = math.sqrt(z[1] * z[1] + z[2] * z[2] + z[3] * z[3])
        turned = c.unmodelled_rate * 2.0 * math.atan2(half, abs(z[0]))
        bias_var += turned * turned
        arw = random_walk_of(z, c)
        attitude_var = arw * arw * seconds
        if c.gyro_scatter > 0.0:
            # all that it turned, forth and back
            squares = z[24] * z[24] + z[25] * z[25] + z[26] * z[26] + z[27] * z[27] + z[28] * z[28] + z[29] * z[29]
            attitude_var += c.gyro_scatter * c.gyro_scatter * squares * seconds * seconds
        if gap_s > 0.0:
            # where the tool went in a gap is anybody's guess within the rate it had, and some
            rate = math.sqrt(z[24] * z[24] + z[25] * z[25] + z[26] * z[26])
            lost = min((rate + 0.02) * gap_s, math.pi)
            attitude_var += lost * lost
        # a bias of 15 deg/h is as large as the Earth's rotation: what turns the error is the rate without it
        x, y, w = turn_left(m, z)
        rotated = times((z[0], z[1], z[2], z[3]), turning(x, y, w))
        R = cosines(rotated)
        spread(m, R, z, attitude_var)
        earth = turning(-c.earth_e * seconds, -c.earth_n * seconds, -c.earth_u * seconds)
        store(m, times(times(earth, attitude_of(m)), rotated))
        if c.velocity_std > 0.0:
            if gap_s > 0.0:
                standing(m, c.velocity_std)
            else:
                carry(m, R, reading_at_end(z, m, c), seconds, reading_variance(z, c))
        if motion == TURNING:
            m.tally[TURNED] += abs(z[25]) * seconds
        m.tally[MOVED_S] += seconds
        m.tally[SHAKEN] += z[23] * z[23] * seconds
    m.P[33] += bias_var
    m.P[44] += bias_var
    m.P[55] += bias_var


def correct(z: Numbers, motion: int, declared: bool, m: Memory, c: Constants) -> None:
    """Use what may be measured in a block."""
    if motion == STILL or c.velocity_std == 0.0:
        if motion >= TURNING or c.gravity_while_moving:
            gravity(z, motion, m, c)
    else:
        bounded(z, m, c)
    if motion == STILL:
        zero_rate(z, declared, m, c)
    if c.straight_std > 0.0:
        straight(m, c.straight_std)


def reading_at_end(z: Numbers, m: Memory, c: Constants) -> Vector:
    """Mean reading of a moving tool in the frame of the block's end, g."""
    ax, ay, az = z[16], z[17], z[18]
    # the sum was turned with the raw rates; readings are half a block old on average
    e, t = earth_in_body(attitude_of(m), c), turn_left(m, z)
    tx, ty, tz = 0.5 * (t[0] - e[0] * z[19]), 0.5 * (t[1] - e[1] * z[19]), 0.5 * (t[2] - e[2] * z[19])
    return ax - (ty * az - tz * ay), ay - (tz * ax - tx * az), az - (tx * ay - ty * ax)


def reading_variance(z: Numbers, c: Constants) -> float:
    """Variance of a block's mean reading, g^2."""
    noise = max(z[23], c.accel_noise_g)
    return float(noise * noise / max(z[20], 1.0) + c.accel_floor_g * c.accel_floor_g)


def bounded(z: Numbers, m: Memory, c: Constants) -> None:
    """What is carried by hand goes forth and back: its velocity is none, give or take `velocity_std` in a second."""
    v = m.accel_bias
    unit = ((0.0, 0.0, 0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    variance = c.velocity_std * c.velocity_std / max(z[19], 1e-3)
    take(m, _TILT_AND_ACCEL, unit, (-v[0], -v[1], -v[2]), variance, math.inf, NO_GRAVITY, ROW_GRAVITY)


def gravity(z: Numbers, motion: int, m: Memory, c: Constants) -> None:
    """The mean reading of a block as the direction of Up."""
    q = attitude_of(m)
    C = cosines(q)
    px, py, pz = C[2], C[5], C[8]
    ax, ay, az = z[16], z[17], z[18]
    if motion != STILL:
        ax, ay, az = reading_at_end(z, m, c)
    known = 1.0
    if c.velocity_std > 0.0:
        known = 0.0
    else:
        ax, ay, az = ax - m.accel_bias[0], ay - m.accel_bias[1], az - m.accel_bias[2]
    size = math.sqrt(ax * ax + ay * ay + az * az)
    if not 0.5 < size < 2.0:
        m.tally[NO_GRAVITY] += 1.0
        return
    H = (
        (0.0, -pz, py, known * (1.0 - px * px), -known * px * py, -known * px * pz),
        (pz, 0.0, -px, -known * py * px, known * (1.0 - py * py), -known * py * pz),
        (-py, px, 0.0, -known * pz * px, -known * pz * py, known * (1.0 - pz * pz)),
    )
    r = (ax / size - px, ay / size - py, az / size - pz)
    take(m, _TILT_AND_ACCEL, H, r, reading_variance(z, c), _GATE_GRAVITY, NO_GRAVITY, ROW_GRAVITY)


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
    if C[2] * C[2] + C[8] * C[8] < VERTICAL_COS * VERTICAL_COS:
        return
    x, y, w = azimuth_row(q)
    r = m.psi0[0] - azimuth_of(q)
    r -= 2.0 * math.pi * math.floor(r / (2.0 * math.pi) + 0.5)
    nothing = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    H = ((x, y, w, 0.0, 0.0, 0.0), nothing, nothing)
    take(m, _TILT_AND_BIAS, H, (r, 0.0, 0.0), std * std, math.inf, NO_RATE, ROW_RATE)


class Trace(NamedTuple):
    """The filter at the end of each of M blocks, arrays. What only a smoother needs is empty without one."""

    q: Numbers
    """(M, 4)"""
    bias: Numbers
    """(M, 3)"""
    scale: Numbers
    """(M,)"""
    accel_bias: Numbers
    """(M, 3); velocity of what is carried, as in `Memory`"""
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
    accel_bias_before: Numbers
    """(M or 0, 3) predicted"""
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
            for j in range(3):
                trace.accel_bias_before[i, j] = m.accel_bias[j]
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

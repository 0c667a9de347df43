"""The paper's algorithm to the letter, equations (7) to (12), sample by sample; and its average over a stop.

    (9)   q_gyro = q + T/2 Omega(w) q
    (11)  w0 = 2/T Xi(q)^T (q_gyro - q_a)
    (12)  q <- q_gyro - T/2 Xi(q) w0, renormalised

Since Xi Xi^T = I - q q^T, equation (12) gives q_a again, to second order of the correction: the step filters nothing.
The attitude has the noise of one accelerometer reading and w0 is that noise differentiated (sqrt(2) sigma_a / T for
each level axis). What stands in q_a for the azimuth, which gravity does not show, is the `AzimuthPolicy`.

`literal_block` averages w0 over each stop, leaving out the first sample, whose step re-aligns the attitude, and holds
the average while the tool moves. `literal` itself holds the last single w0, as the equations say.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.quaternion import from_angles
from highside.gyro.blocks import MAX_GAP_S
from highside.gyro.frames import attitude, to_body, to_tool
from highside.gyro.result import AzimuthBasis, DriftResult

Quaternion = tuple[float, float, float, float]
Vector = tuple[float, float, float]

_STEEP = math.sin(math.radians(87.0))
"""beyond this |sin theta| toolface and azimuth are one, and `hold` falls back to the smallest rotation"""


class AzimuthPolicy(Enum):
    """Where the azimuth of q_a comes from, and what each asserts."""

    GYRO = "gyro"
    """Smallest rotation of q_gyro that fits gravity. Asserts nothing: the azimuth stays uncorrected."""
    PREV = "prev"
    """Smallest rotation of the previous estimate. Asserts that nothing turns about Up: wrong when the tool turns."""
    HOLD = "hold"
    """Azimuth of the previous estimate. Asserts a straight hole: any real change of azimuth is reported as none."""


def tilt_to(q: Quaternion, g: Vector) -> Quaternion:
    """The quaternion nearest to q whose Up is the unit vector g."""
    a, b, c, d = q
    x, y, z = g
    px, py, pz = 2 * (b * d - a * c), 2 * (c * d + a * b), a * a - b * b - c * c + d * d
    # half of the rotation from p to g, without angles: (1 + g.p, g x p)
    w = 1.0 + x * px + y * py + z * pz
    rx, ry, rz = y * pz - z * py, z * px - x * pz, x * py - y * px
    size = math.sqrt(w * w + rx * rx + ry * ry + rz * rz)
    if size < 1e-9:
        # upside down: every rotation by half a turn is as near
        return q
    w, rx, ry, rz = w / size, rx / size, ry / size, rz / size
    return (
        a * w - b * rx - c * ry - d * rz,
        a * rx + b * w + c * rz - d * ry,
        a * ry - b * rz + c * w + d * rx,
        a * rz + b * ry - c * rx + d * w,
    )


def _hold(q: Quaternion, g: Vector) -> Quaternion:
    """q(theta, phi) of gravity with the azimuth of q."""
    a, b, c, d = q
    psi = math.atan2(2 * (b * c - a * d), a * a - b * b + c * c - d * d)
    theta = math.asin(min(max(g[1], -1.0), 1.0))
    phi = math.atan2(-g[0], g[2])
    ct, st, cf, sf = math.cos(theta / 2), math.sin(theta / 2), math.cos(phi / 2), math.sin(phi / 2)
    cp, sp = math.cos(psi / 2), -math.sin(psi / 2)
    # q_x(theta) (x) q_y(phi), then q_z(-psi) from the left
    w, x, y, z = ct * cf, st * cf, ct * sf, st * sf
    return cp * w - sp * z, cp * x - sp * y, cp * y + sp * x, cp * z + sp * w


def gravity_quaternion(policy: AzimuthPolicy, q: Quaternion, q_gyro: Quaternion, g: Vector) -> Quaternion:
    """q_a: the attitude that the unit vector g shows, its azimuth by the policy, its sign that of q_gyro."""
    if policy is AzimuthPolicy.GYRO or (policy is AzimuthPolicy.HOLD and abs(g[1]) > _STEEP):
        q_a = tilt_to(q_gyro, g)
    elif policy is AzimuthPolicy.PREV:
        q_a = tilt_to(q, g)
    else:
        q_a = _hold(q, g)
    if q_a[0] * q_gyro[0] + q_a[1] * q_gyro[1] + q_a[2] * q_gyro[2] + q_a[3] * q_gyro[3] < 0.0:
        return -q_a[0], -q_a[1], -q_a[2], -q_a[3]
    return q_a


class Literal:
    """The recursion, one sample of the body frame at a time; batch and online are the same call."""

    def __init__(self, policy: AzimuthPolicy, q: Quaternion, *, average: bool = False, hold_drift: bool = True) -> None:
        """`average`: mean w0 of each stop. `hold_drift`: subtract w0 while the tool moves."""
        self.policy, self.average, self.hold_drift = policy, average, hold_drift
        self.q = q
        self.drift: Vector = (0.0, 0.0, 0.0)
        self._stop = False
        self._sum = [0.0, 0.0, 0.0]
        self._count = 0

    def update(self, T: float, w: Vector, a: Vector, quiet: bool) -> None:
        """A sample: rate w (rad/s) over the interval T (s), reading a (g), and whether gravity may be believed."""
        x, y, z = w
        if not quiet and self.hold_drift:
            x, y, z = x - self.drift[0], y - self.drift[1], z - self.drift[2]
        q0, q1, q2, q3 = self.q
        k = 0.5 * T
        g0 = q0 - k * (q1 * x + q2 * y + q3 * z)
        g1 = q1 + k * (q0 * x + q2 * z - q3 * y)
        g2 = q2 + k * (q0 * y - q1 * z + q3 * x)
        g3 = q3 + k * (q0 * z + q1 * y - q2 * x)
        norm = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
        if quiet and T > 0.0 and norm > 0.0:
            size = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2 + g3 * g3)
            gyro = (g0 / size, g1 / size, g2 / size, g3 / size)
            a0, a1, a2, a3 = gravity_quaternion(self.policy, self.q, gyro, (a[0] / norm, a[1] / norm, a[2] / norm))
            d0, d1, d2, d3 = g0 - a0, g1 - a1, g2 - a2, g3 - a3
            # Xi(q)^T d
            u0 = -q1 * d0 + q0 * d1 + q3 * d2 - q2 * d3
            u1 = -q2 * d0 - q3 * d1 + q0 * d2 + q1 * d3
            u2 = -q3 * d0 + q2 * d1 - q1 * d2 + q0 * d3
            g0 += q1 * u0 + q2 * u1 + q3 * u2
            g1 -= q0 * u0 - q3 * u1 + q2 * u2
            g2 -= q3 * u0 + q0 * u1 - q1 * u2
            g3 -= -q2 * u0 + q1 * u1 + q0 * u2
            self._drift((u0 / k, u1 / k, u2 / k))
        self._stop = quiet
        size = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2 + g3 * g3)
        self.q = (g0 / size, g1 / size, g2 / size, g3 / size)

    def _drift(self, w0: Vector) -> None:
        if not self.average:
            self.drift = w0
            return
        if not self._stop:
            # the first step of a stop absorbs the tilt of the whole leg: it is no drift
            self._sum, self._count = [0.0, 0.0, 0.0], 0
            return
        for i in range(3):
            self._sum[i] += w0[i]
        self._count += 1
        n = self._count
        self.drift = (self._sum[0] / n, self._sum[1] / n, self._sum[2] / n)


def aligned(a: Array, azimuth_rad: float) -> Quaternion:
    """Quaternion of the reading a (3,), body frame, with this azimuth."""
    g = a / math.sqrt(float(a @ a))
    q = from_angles(math.asin(min(max(float(g[1]), -1.0), 1.0)), math.atan2(-float(g[0]), float(g[2])), azimuth_rad)
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])


def literal(
    t_s: Array,
    rate: Array,
    accel: Array,
    *,
    policy: AzimuthPolicy = AzimuthPolicy.HOLD,
    quiet: NDArray[np.bool_] | None = None,
    azimuth_rad: float = 0.0,
    average: bool = False,
    hold_drift: bool = True,
    correct: bool = True,
    start_s: float = 1.0,
) -> DriftResult:
    """Equations (7) to (12) over a recording: t_s (N,), rate (3, N) rad/s, accel (3, N) g, tool frame.

    `quiet` (N,): where gravity may be believed (None: everywhere). `average`: `literal_block`. `correct` False: the
    gyro alone, aligned once. The tilt of the start is that of the mean reading of the first `start_s`.
    """
    n = t_s.size
    w_body, a_body = to_body(rate), to_body(accel)
    first = a_body[:, t_s <= t_s[0] + start_s].mean(axis=1)
    engine = Literal(policy, aligned(first, azimuth_rad), average=average, hold_drift=hold_drift and correct)
    steps = np.diff(t_s, prepend=t_s[:1])
    steps = np.where((steps > MAX_GAP_S) | (steps < 0.0), 0.0, steps)
    believed = np.zeros(n, dtype=bool) if not correct else np.ones(n, dtype=bool) if quiet is None else quiet
    q = np.empty((n, 4))
    drift = np.empty((n, 3))
    samples = zip(steps.tolist(), zip(*w_body.tolist()), zip(*a_body.tolist()), believed.tolist(), strict=True)  # noqa: B905
    for i, (T, w, a, trusted) in enumerate(samples):
        engine.update(T, w, a, trusted)
        q[i] = engine.q
        drift[i] = engine.drift
    inc, tf, azi = attitude(q.T)
    unknown = np.full(n, np.nan)
    constraint = correct and policy is not AzimuthPolicy.GYRO
    notes = ["the Earth's rotation is lumped into the drift, as in the paper"] if correct else ["the gyro alone"]
    if correct:
        notes.append("this method states no uncertainty")
    if correct and policy is AzimuthPolicy.PREV:
        notes.append("policy prev: wrong by any angle while the tool turns")
    return DriftResult(
        t_s=t_s,
        inc_rad=inc,
        tf_rad=tf,
        azi_rad=azi,
        azi_std_rad=unknown,
        bias_radps=to_tool(np.ascontiguousarray(drift.T)),
        bias_std_radps=np.full((3, n), np.nan),
        basis=(AzimuthBasis.CONSTRAINT if constraint else AzimuthBasis.NOTHING,),
        notes=tuple(notes),
    )

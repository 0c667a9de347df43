"""The light filter: tilt and bias error with one scalar covariance for all axes: a PI loop whose gains are derived.

    predict   w = w_meas - b - C w_ie;   p11 += -2 T p12 + T^2 p22 + N^2 T,  p12 -= T p22,  p22 += K^2 T
    update    e = g x p (+ the azimuth held, along Up);  k = p11/(p11 + s^2), kb = -p12/(p11 + s^2)
              q <- q (x) exp(k e),  b <- b - kb e

In the steady state it is Mahony's filter with kP = sqrt((N^2 + 2 K sqrt(r))/r), kI = K/sqrt(r), r = s^2 T. The prior of
the bias is finite: a growing-memory start would leak accelerometer noise into the bias along Up, which gravity does
not show at rest. A scalar gain knows no directions: on a turning tool the error-state filter is the better one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import (
    direction_cosines,
    from_rotation_vector,
    multiply,
    normalised,
    to_angles,
    up_direction,
)
from highside.gyro.blocks import Batch, Block, Gatherer
from highside.gyro.filter import FilterSettings, predicted
from highside.gyro.frames import EARTH_RATE_RADPS, attitude, earth_rate, to_body, to_tool
from highside.gyro.literal import aligned
from highside.gyro.recording_filter import declared_blocks
from highside.gyro.result import AzimuthBasis, DriftResult

_STEEP_COS = 0.05


def steady_gains(accel_std: float, interval_s: float, arw: float, rrw: float) -> tuple[float, float]:
    """kP (1/s) and kI (1/s^2) of the filter after a long time, in closed form."""
    r = accel_std**2 * interval_s
    return math.sqrt((arw**2 + 2.0 * rrw * math.sqrt(r)) / r), rrw / math.sqrt(r)


@dataclass(slots=True)
class ScalarFilter:
    """The covariance of tilt and bias error, the same for every axis."""

    p11: float
    p12: float
    p22: float

    def predict(self, T: float, arw: float, rrw: float) -> None:
        self.p11 += -2.0 * T * self.p12 + T * T * self.p22 + arw * arw * T
        self.p12 -= T * self.p22
        self.p22 += rrw * rrw * T

    def update(self, variance: float) -> tuple[float, float]:
        """Gains of the tilt and of the bias for a measurement of this variance."""
        total = self.p11 + variance
        kt, kb = self.p11 / total, -self.p12 / total
        self.p22 -= self.p12 * self.p12 / total
        self.p12 *= 1.0 - kt
        self.p11 *= 1.0 - kt
        return kt, kb


class ComplementaryFilter:
    """One step a block of the body frame; `believe` says whether gravity counts."""

    def __init__(self, settings: FilterSettings, *, hold: bool) -> None:
        self.settings, self.hold = settings, hold
        self.earth = earth_rate(settings.latitude_rad, azimuth_known=settings.azimuth_rad is not None)
        self._psi0 = settings.azimuth_rad or 0.0
        self._gatherer = Gatherer(settings.block_s)
        tilt, bias = math.radians(0.3) ** 2, settings.bias_std_radps**2
        self.level = ScalarFilter(tilt, 0.0, bias)
        # what nothing measures: the rotation about Up, unless the azimuth is held
        self.about_up = ScalarFilter(settings.azimuth_std_rad**2, 0.0, bias)
        self.q: Array | None = None
        """at the end of the last block; set it to begin at a known attitude"""
        self.bias = np.zeros(3)
        self.followed_s = 0.0

    def attitude_now(self) -> Array:
        """Quaternion (4,) at the newest sample, predicted from the last block. Raises ValueError before the first."""
        if self.q is None:
            raise ValueError("no block is closed yet")
        return predicted(self.q, self.bias, 0.0, self.earth, np.array(self._gatherer.sums[:20]))

    @property
    def azimuth_std_rad(self) -> float:
        """At the end of the last block."""
        return float(azimuth_std(self.about_up.p11, self.followed_s, self.settings, hold=self.hold))

    def update(
        self, t_s: float, rate: tuple[float, float, float], accel: tuple[float, float, float], *, believe: bool = True
    ) -> bool:
        """One sample; whether it closed a block (`believe` is about that block)."""
        block = self._gatherer.add(t_s, rate, accel)
        if block is not None:
            self.step(block, believe=believe)
        return block is not None

    def finish(self, *, believe: bool = True) -> None:
        """Close the block under way."""
        block = self._gatherer.finish()
        if block is not None:
            self.step(block, believe=believe)

    def step(self, block: Block, *, believe: bool) -> None:
        """Take a block in."""
        s = self.settings
        if self.q is None:
            self.q = np.array(aligned(block.accel, self._psi0))
            return
        sums = block.vector[:20]
        self.q = normalised(predicted(self.q, self.bias, 0.0, self.earth, sums))
        self.followed_s += block.seconds
        arw = max(s.arw, block.rate_noise * math.sqrt(block.seconds / max(block.n, 1)))
        self.level.predict(block.seconds, arw, s.rrw)
        self.about_up.predict(block.seconds, arw, s.rrw)
        size = math.sqrt(float(block.accel @ block.accel))
        if not believe or not 0.5 < size < 2.0:
            return
        p = up_direction(self.q)
        turn = -block.J @ self.bias - direction_cosines(self.q) @ self.earth * block.seconds
        g = block.accel - 0.5 * np.cross(turn, block.accel)
        e = np.cross(g / size, p)
        if self.hold:
            theta, _, psi = to_angles(self.q)
            if math.cos(float(theta)) > _STEEP_COS:
                e = e - wrap_signed(self._psi0 - float(psi)) * p
                self.about_up = self.level
        variance = max(block.accel_std, s.accel_noise_g) ** 2 / max(block.n, 1)
        kt, kb = self.level.update(variance)
        if self.hold:
            self.about_up = ScalarFilter(self.level.p11, self.level.p12, self.level.p22)
        self.q = normalised(multiply(self.q, from_rotation_vector(kt * e)))
        self.bias = self.bias - kb * e


def azimuth_std(variance: Array | float, followed_s: Array | float, settings: FilterSettings, *, hold: bool) -> Array:
    """Standard deviation of the azimuth, rad, for the variance about Up after so many seconds."""
    unmodelled = 0.0 if settings.latitude_rad is not None else EARTH_RATE_RADPS
    # what is asserted is no better than the assertion
    beyond = math.radians(0.1) if hold else unmodelled * followed_s
    return np.asarray(np.minimum(np.sqrt(variance + np.square(beyond)), math.pi / math.sqrt(3.0)))


def complementary(
    t_s: Array,
    rate: Array,
    accel: Array,
    settings: FilterSettings,
    *,
    hold: bool = False,
    rest: Array | None = None,
) -> DriftResult:
    """The light filter over a recording, tool frame: t_s (N,), rate (3, N) rad/s, accel (3, N) g.

    `hold` asserts that the azimuth is that of the start. `rest` (K, 2): gravity counts there alone (None: everywhere,
    by its scatter).
    """
    batch = Batch.of(t_s, to_body(rate), to_body(accel), settings.block_s)
    blocks = batch.blocks()
    believe = np.ones(len(blocks), dtype=bool) if rest is None else declared_blocks(batch.starts, batch.ends, rest)
    engine = ComplementaryFilter(settings, hold=hold)
    q_end, bias = np.empty((4, len(blocks))), np.empty((3, len(blocks)))
    level_var, up_var, bias_var, up_bias_var = np.empty((4, len(blocks)))
    for i, (block, trusted) in enumerate(zip(blocks, believe.tolist(), strict=True)):
        engine.step(block, believe=trusted)
        assert engine.q is not None
        q_end[:, i], bias[:, i] = engine.q, engine.bias
        level_var[i], up_var[i] = engine.level.p11, engine.about_up.p11
        bias_var[i], up_bias_var[i] = engine.level.p22, engine.about_up.p22
    before = np.maximum(np.arange(len(blocks)) - 1, 0)
    q = np.empty((4, *batch.dt.shape))
    for j, sums in enumerate(batch.steps()):
        q[:, j] = predicted(q_end[:, before], bias[:, before], 0.0, engine.earth, np.array(sums[:20]))
    q[:, :, 0] = q_end[:, :1]
    rows = q[:, batch.place, batch.number]
    last = np.append(np.flatnonzero(np.diff(batch.number)), t_s.size - 1)
    rows[:, last] = q_end
    known = batch.number - 1
    known[last] += 1
    known = np.maximum(known, 0)
    inc, tf, azi = attitude(rows)
    up = up_direction(q_end)
    # along Up the bias is as uncertain as that direction is uncorrected
    axes = to_tool(np.sqrt(bias_var * (1.0 - up * up) + up_bias_var * up * up))
    std = azimuth_std(up_var, batch.ends - t_s[0], settings, hold=hold)
    notes = []
    if settings.latitude_rad is None:
        notes.append("no latitude: the Earth's rotation (15 deg/h) is not modelled and counts as gyro bias")
    if settings.azimuth_rad is None:
        notes.append("no azimuth at the start: azimuths are relative to it")
    return DriftResult(
        t_s=t_s,
        inc_rad=inc,
        tf_rad=tf,
        azi_rad=azi,
        azi_std_rad=std[known],
        bias_radps=to_tool(bias)[:, known],
        bias_std_radps=np.abs(axes)[:, known],
        basis=(AzimuthBasis.CONSTRAINT if hold else AzimuthBasis.NOTHING,),
        notes=tuple(notes),
    )

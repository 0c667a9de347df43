"""The error-state filter on gravity kinematics: attitude, gyro biases, axial scale factor, accelerometer biases.

State (10): attitude error dth in the body frame (q_true = q (x) [1, dth/2]), gyro bias b, scale error s of the gyro
along the tool axis (w_true = w (1 - s) - b there), accelerometer bias a. From block to block

    dth' = R^T dth - J db - S ds          (R, J, S of `blocks`: the Rodrigues transition, for any motion)

with the *inertial* rate in R: that term is what lets a turning tool, or an hour at rest, see the Earth's rotation. What
is measured, as far as the tool's motion allows it:

    gravity     g = A/|A|;  g - p = [p x] dth + (I - p p^T) a,  p = Up as predicted. Nothing about a rotation around
                Up. At rest a is one with the tilt, which stays as uncertain as it; on a turning tool a bias fixed to
                the tool looks like a rate of a * w, and without its state the gyro biases would take it up.
    zero rate   a tool at rest: mean(w) - b - C w_ie = [C w_ie x] dth + db. The attitude is then not propagated: one
                noise must not count twice.
    straight    optional: azimuth = azimuth at the start. A constraint, not a measurement; its weight never
                exceeds its own standard deviation.

Each update is gated by its innovation and applied in Joseph's form. Causal: a row knows nothing of later ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from highside.attitude.angles import wrap_signed
from highside.attitude.quaternion import (
    direction_cosines,
    from_angles,
    from_rotation_vector,
    multiply,
    normalised,
    to_angles,
    up_direction,
)
from highside.drift.blocks import Batch, Block, Gatherer
from highside.drift.frames import (
    DEG_PER_HOUR,
    DEG_PER_SQRT_HOUR,
    EARTH_RATE_RADPS,
    attitude,
    earth_rate,
    std_to_tool,
    to_body,
    to_tool,
)
from highside.drift.gates import Gate, Motion, StopTest
from highside.drift.result import AzimuthBasis, DriftResult

FloatArray = NDArray[np.float64]

_STATES = 10
_VERTICAL_COS = 0.05
"""|cos theta| below which azimuth and toolface are one"""
_GATE_GRAVITY = 30.0
_GATE_RATE = 25.0
"""bounds of the normalised squared innovation (3 degrees of freedom)"""
_PATIENCE = 10
"""refused blocks in a row after which a measurement is believed again: the filter, not gravity, is then wrong"""


@dataclass(frozen=True, slots=True)
class Settings:
    """Priors and noise of the filter. Defaults are those of a tactical gyro (0.1 deg/sqrt(h), 0.1 deg/h/sqrt(h))."""

    latitude_rad: float | None = None
    azimuth_rad: float | None = None
    """azimuth at the start; None: unknown, azimuths are relative to the start"""
    azimuth_std_rad: float = math.radians(0.1)
    tilt_std_rad: float = math.radians(2.0)
    """of the start beyond what its gravity says: wide, so that gravity with its own errors decides"""
    bias_std_radps: float = 20.0 * DEG_PER_HOUR
    arw: float = 0.1 * DEG_PER_SQRT_HOUR
    """angle random walk, rad/sqrt(s)"""
    rrw: float = 0.1 * DEG_PER_HOUR / 60.0
    """rate random walk, rad/s/sqrt(s)"""
    accel_noise_g: float = 1e-3
    """standard deviation of one reading at rest; the scatter within a block counts where it is greater"""
    accel_floor_g: float = 5e-4
    """error of a block's mean reading that does not average out within it (correlated vibration)"""
    accel_bias_std_g: float = 3.2e-3
    """of each accelerometer, constant"""
    scale_std: float = 1e-3
    """prior of the axial scale-factor error; 0 leaves the state out"""
    rectification_std: float = 0.2 * DEG_PER_HOUR
    """bias that vibration makes, rad/s per g^2: no state, but it widens the azimuth's uncertainty"""
    straight_hole_std_rad: float | None = None
    """standard deviation of "the azimuth is that of the start"; None: the hole may turn"""
    gravity_while_moving: bool = True
    detect_stops: bool = True
    block_s: float = 1.0


@dataclass(slots=True)
class State:
    """The filter at the end of a block."""

    q: FloatArray
    bias: FloatArray
    scale: float
    accel_bias: FloatArray
    P: FloatArray
    time_s: float
    motion: Motion
    still_s: float = 0.0
    turned_rad: float = 0.0
    moved_s: float = 0.0
    shaken_g2s: float = 0.0
    """time integral of the squared vibration while moving"""
    gap_s: float = 0.0
    refused: dict[str, int] = field(default_factory=lambda: {"gravity": 0, "zero rate": 0, "stop": 0})

    @property
    def azimuth_variance(self) -> float:
        """Variance of psi (of the rotation about Up near the vertical, where psi means nothing), rad^2."""
        row = azimuth_row(self.q)
        return float(row @ self.P[:3, :3] @ row)


def azimuth_row(q: FloatArray) -> FloatArray:
    """d psi / d dth, (3,); near the vertical minus the rotation about Up."""
    theta, phi, _ = to_angles(q)
    cosine = float(np.cos(theta))
    if abs(cosine) < _VERTICAL_COS:
        return -up_direction(q)
    return np.array([math.sin(phi) / cosine, 0.0, -math.cos(phi) / cosine])


def cross_matrix(v: FloatArray) -> FloatArray:
    """[v x], (3, 3)."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


class KinematicFilter:
    """The filter; `step` takes one block. `update` is the online form on single samples."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.earth = earth_rate(settings.latitude_rad, azimuth_known=settings.azimuth_rad is not None)
        self.state: State | None = None
        self._gatherer = Gatherer(settings.block_s)
        self._gate = Gate()
        self._stop = StopTest()
        self._refused_in_a_row = {"gravity": 0, "zero rate": 0}
        self._psi0 = 0.0 if settings.azimuth_rad is None else settings.azimuth_rad

    def update(self, t_s: float, rate: tuple[float, float, float], accel: tuple[float, float, float],
               *, declared_still: bool = False) -> State | None:  # fmt: skip
        """One sample in the *body* frame (rad/s, g); the state if this sample closed a block.

        `declared_still` is the operator's word on the block that this sample closes.
        """
        block = self._gatherer.add(t_s, rate, accel)
        return None if block is None else self.step(block, declared_still=declared_still)

    def finish(self, *, declared_still: bool = False) -> State | None:
        """Close the block under way (end of the data)."""
        block = self._gatherer.finish()
        return self.state if block is None else self.step(block, declared_still=declared_still)

    def attitude_now(self) -> FloatArray:
        """Quaternion (4,) at the newest sample, predicted from the last closed block."""
        if self.state is None:
            raise ValueError("no block is closed yet")
        if self.state.motion is Motion.STILL:
            return self.state.q
        sums = self._gatherer.sums
        return predicted(self.state.q, self.state.bias, self.state.scale, self.earth, np.array(sums[:20]))

    def align(self, block: Block) -> State:
        """The first state: tilt from the block's mean gravity, azimuth from the settings."""
        s = self.settings
        g = block.accel / math.sqrt(float(block.accel @ block.accel))
        theta = math.asin(min(max(float(g[1]), -1.0), 1.0))
        phi = math.atan2(-float(g[0]), float(g[2]))
        q = from_angles(theta, phi, self._psi0)
        tilt_std = math.hypot(s.tilt_std_rad, max(block.accel_std, s.accel_noise_g) / math.sqrt(max(block.n, 1)))
        P = np.zeros((_STATES, _STATES))
        # elevation, toolface and azimuth are what is known independently; an error of the toolface is a rotation
        # about the tool axis and so, in part, about Up
        axes = np.array(
            [
                [math.cos(phi), 0.0, math.sin(phi) * math.cos(theta)],
                [0.0, 1.0, -math.sin(theta)],
                [math.sin(phi), 0.0, -math.cos(phi) * math.cos(theta)],
            ]
        ) * np.array([tilt_std, tilt_std / max(math.cos(theta), _VERTICAL_COS), s.azimuth_std_rad])
        P[:3, :3] = axes @ axes.T
        bias_var = s.bias_std_radps**2
        if s.latitude_rad is None or s.azimuth_rad is None:
            # what is not modelled of the Earth's rotation is a bias of its own
            bias_var += EARTH_RATE_RADPS**2
        P[3:6, 3:6] = bias_var * np.eye(3)
        P[6, 6] = s.scale_std**2
        P[7:, 7:] = s.accel_bias_std_g**2 * np.eye(3)
        return State(q, np.zeros(3), 0.0, np.zeros(3), P, block.end_s, Motion.VIBRATING)

    def step(self, block: Block, *, declared_still: bool = False) -> State:
        """Take a block in; returns (and keeps) the state at its end."""
        if self.state is None:
            self.state = self.align(block)
            # the first block gave the tilt: its motion is not integrated, its gravity is not used twice
            self.state.motion = self._gate.verdict(block, declared=declared_still)
            if declared_still:
                self._zero_rate(self.state, block, believed=True)
            return self.state
        before = self.state
        motion = self._gate.verdict(block, declared=declared_still)
        if motion is Motion.STILL and not declared_still and not self._believes(before, block):
            motion = Motion.QUIET
        if motion is not Motion.STILL or declared_still:
            self._keep_or_reset(motion)
        state = replace(
            before, motion=motion, time_s=block.end_s, P=before.P.copy(), gap_s=before.gap_s + block.gap_s,
            refused=before.refused,
        )  # fmt: skip
        if motion is Motion.STILL:
            state.P[3:6, 3:6] += self.settings.rrw**2 * block.seconds * np.eye(3)
            state.still_s += block.seconds
        else:
            self._propagate(state, block)
        if motion >= Motion.TURNING or self.settings.gravity_while_moving:
            self._gravity(state, block)
        if motion is Motion.STILL:
            self._zero_rate(state, block, believed=declared_still)
        if self.settings.straight_hole_std_rad is not None:
            self._straight(state, self.settings.straight_hole_std_rad)
        self.state = state
        return state

    def _keep_or_reset(self, motion: Motion) -> None:
        # a refused stop stays refused until the tool has really moved
        if motion in (Motion.VIBRATING, Motion.TURNING):
            self._stop.reset()

    def _believes(self, state: State, block: Block) -> bool:
        if not self.settings.detect_stops:
            return False
        C = direction_cosines(state.q)
        variance = np.diag(state.P)[3:6] + self._unmodelled_rate() ** 2
        innovation = block.rate - C @ self.earth - state.bias
        believed = self._stop.agrees(innovation, block.seconds, variance, self._arw(block))
        if not believed:
            state.refused["stop"] += 1
        return believed

    def _unmodelled_rate(self) -> float:
        s = self.settings
        return EARTH_RATE_RADPS if s.latitude_rad is None or s.azimuth_rad is None else 0.0

    def _arw(self, block: Block) -> float:
        """Angle random walk of this block, rad/sqrt(s): that of the settings, or what vibration makes of it."""
        if block.n < 2 or block.seconds <= 0.0:
            return self.settings.arw
        seen = block.rate_noise * math.sqrt(block.seconds / block.n)
        return seen if seen > 1.3 * self.settings.arw else self.settings.arw

    def _propagate(self, state: State, block: Block) -> None:
        s = self.settings
        # a bias of 15 deg/h is as large as the Earth's rotation: what turns the error is the rate without it
        unbiased = from_rotation_vector(-(block.J @ state.bias + block.S * state.scale))
        C = direction_cosines(multiply(block.q, unbiased))
        F = np.eye(_STATES)
        F[:3, :3] = C
        F[:3, 3:6] = -block.J
        F[:3, 6] = -block.S
        P = F @ state.P @ F.T
        turned = 2.0 * math.atan2(math.sqrt(float(block.q[1:] @ block.q[1:])), abs(float(block.q[0])))
        attitude_var = self._arw(block) ** 2 * block.seconds
        bias_var = s.rrw**2 * block.seconds + (self._unmodelled_rate() * turned) ** 2
        if block.gap_s > 0.0:
            # where the tool went in a gap is anybody's guess within the rate it had, and some
            attitude_var += min((math.sqrt(float(block.rate @ block.rate)) + 0.02) * block.gap_s, math.pi) ** 2
            bias_var += s.rrw**2 * block.gap_s
        P[:3, :3] += attitude_var * np.eye(3)
        P[3:6, 3:6] += bias_var * np.eye(3)
        state.P = P
        state.q = normalised(predicted(state.q, state.bias, state.scale, self.earth, _as_sums(block)))
        state.turned_rad += abs(float(block.rate[1])) * block.seconds if state.motion is Motion.TURNING else 0.0
        state.moved_s += block.seconds
        state.shaken_g2s += block.accel_std**2 * block.seconds

    def _gravity(self, state: State, block: Block) -> None:
        s = self.settings
        C = direction_cosines(state.q)
        p = C[:, 2]
        a = block.accel
        if state.motion is not Motion.STILL:
            # the sum was turned with the raw rates; readings are half a block old on average
            turn = -(block.J @ state.bias + block.S * state.scale) - C @ self.earth * block.seconds
            a = a - 0.5 * (cross_matrix(turn) @ a)
        a = a - state.accel_bias
        size = math.sqrt(float(a @ a))
        if not 0.5 < size < 2.0:
            state.refused["gravity"] += 1
            return
        variance = max(block.accel_std, s.accel_noise_g) ** 2 / max(block.n, 1) + s.accel_floor_g**2
        H = np.zeros((3, _STATES))
        level = np.eye(3) - p[:, None] * p
        H[:, :3] = cross_matrix(p)
        H[:, 7:] = level
        self._update(state, "gravity", H, a / size - p, variance, _GATE_GRAVITY)

    def _zero_rate(self, state: State, block: Block, *, believed: bool) -> None:
        rate = direction_cosines(state.q) @ self.earth
        H = np.zeros((3, _STATES))
        H[:, :3] = cross_matrix(rate)
        H[:, 3:6] = np.eye(3)
        variance = self._arw(block) ** 2 / max(block.seconds, 1e-3)
        self._update(
            state, "zero rate", H, block.rate - state.bias - rate, variance, math.inf if believed else _GATE_RATE
        )

    def _straight(self, state: State, std_rad: float) -> None:
        theta, _, psi = to_angles(state.q)
        if abs(math.cos(float(theta))) < _VERTICAL_COS or state.azimuth_variance <= std_rad**2:
            return
        H = np.zeros((1, _STATES))
        H[0, :3] = azimuth_row(state.q)
        self._update(state, "straight", H, np.array([wrap_signed(self._psi0 - float(psi))]), std_rad**2, math.inf)

    def _update(self, state: State, kind: str, H: FloatArray, r: FloatArray, variance: float, gate: float) -> None:
        """Joseph's form; refuses an innovation beyond the gate."""
        PH = state.P @ H.T
        S = H @ PH + variance * np.eye(len(r))
        inverse = np.linalg.inv(S)
        if float(r @ inverse @ r) > gate and self._refused_in_a_row[kind] < _PATIENCE:
            self._refused_in_a_row[kind] += 1
            state.refused[kind] += 1
            return
        if kind in self._refused_in_a_row:
            self._refused_in_a_row[kind] = 0
        K = PH @ inverse
        A = np.eye(_STATES) - K @ H
        P = A @ state.P @ A.T + variance * (K @ K.T)
        state.P = 0.5 * (P + P.T)
        dx = K @ r
        state.q = normalised(multiply(state.q, from_rotation_vector(dx[:3])))
        state.bias = state.bias + dx[3:6]
        state.scale = state.scale + float(dx[6])
        state.accel_bias = state.accel_bias + dx[7:]


def _as_sums(block: Block) -> FloatArray:
    return np.concatenate([block.q, block.J.ravel(), block.S, block.accel, [block.seconds]])


def predicted(
    q: FloatArray, bias: FloatArray, scale: FloatArray | float, earth: FloatArray, sums: FloatArray
) -> FloatArray:
    """Attitude (4,) or (4, M) after part of a block: exp(-w_ie t) (x) q (x) raw (x) exp(-J b - S s).

    `sums` (20, ...) are the first twenty of `blocks.Sums`, `earth` (3,) in East, North, Up.
    """
    J, S = sums[4:13], sums[13:16]
    dx = -(J[0] * bias[0] + J[1] * bias[1] + J[2] * bias[2] + S[0] * scale)
    dy = -(J[3] * bias[0] + J[4] * bias[1] + J[5] * bias[2] + S[1] * scale)
    dz = -(J[6] * bias[0] + J[7] * bias[1] + J[8] * bias[2] + S[2] * scale)
    small = from_rotation_vector(np.stack([dx, dy, dz]))
    t = sums[19]
    turned = from_rotation_vector(np.stack([-earth[0] * t, -earth[1] * t, -earth[2] * t]))
    return multiply(multiply(turned, q), multiply(sums[:4], small))


def kinematic(
    t_s: FloatArray, rate: FloatArray, accel: FloatArray, settings: Settings, *, rest: FloatArray | None = None
) -> DriftResult:
    """The filter over a recording: t_s (N,), rate (3, N) rad/s and accel (3, N) g in the *tool* frame.

    `rest` (K, 2): intervals (s) in which the tool is declared to stand. Without any, stops are detected.
    """
    batch = Batch.of(t_s, to_body(rate), to_body(accel), settings.block_s)
    blocks = batch.blocks()
    intervals = np.zeros((0, 2)) if rest is None else rest
    declared = declared_blocks(batch.starts, batch.ends, intervals)
    settings = replace(settings, detect_stops=settings.detect_stops and not intervals.size)
    engine = KinematicFilter(settings)
    states = [engine.step(block, declared_still=bool(flag)) for block, flag in zip(blocks, declared, strict=True)]
    return _rows(t_s, batch, states, engine)


def declared_blocks(starts: FloatArray, ends: FloatArray, rest: FloatArray) -> NDArray[np.bool_]:
    """Which blocks lie within a declared interval (with a tolerance of a millisecond)."""
    inside = np.zeros(starts.size, dtype=bool)
    for begin, end in rest:
        inside |= (starts >= begin - 1e-3) & (ends <= end + 1e-3)
    return inside


def _rows(t_s: FloatArray, batch: Batch, states: list[State], engine: KinematicFilter) -> DriftResult:
    """States of blocks become rows: predicted within a block, updated at its end."""
    count = len(states)
    q_end = np.array([state.q for state in states]).T
    bias = np.array([state.bias for state in states]).T
    scale = np.array([state.scale for state in states])
    azi_var = np.array([state.azimuth_variance for state in states])
    bias_std = np.sqrt(np.array([np.diag(state.P)[3:6] for state in states])).T
    motion = np.array([int(state.motion) for state in states], dtype=np.int8)
    before = np.maximum(np.arange(count) - 1, 0)
    q_start, b_start, s_start = q_end[:, before], bias[:, before], scale[before]
    # what the tool does in a block is known at its end; until then it goes on as before
    frozen = motion[before] == Motion.STILL
    q = np.empty((4, *batch.dt.shape))
    for j, sums in enumerate(batch.steps()):
        q[:, j] = np.where(frozen, q_start, predicted(q_start, b_start, s_start, engine.earth, np.array(sums[:20])))
    q[:, :, 0] = q_end[:, :1]
    rows = q[:, batch.place, batch.number]
    last = np.append(np.flatnonzero(np.diff(batch.number)), t_s.size - 1)
    rows[:, last] = q_end
    inc, tf, azi = attitude(rows)
    known = batch.number - 1
    known[last] += 1
    known = np.maximum(known, 0)
    moved = np.array([state.moved_s for state in states])
    unmodelled = EARTH_RATE_RADPS if engine.settings.latitude_rad is None else 0.0
    shaken = engine.settings.rectification_std * np.array([state.shaken_g2s for state in states])
    if engine.settings.straight_hole_std_rad is not None:
        shaken = np.zeros(count)
    azi_std = np.sqrt(azi_var + (unmodelled * moved) ** 2 + shaken**2)
    final = states[-1]
    return DriftResult(
        t_s=t_s,
        inc_rad=inc,
        tf_rad=tf,
        azi_rad=azi,
        azi_std_rad=np.minimum(azi_std, math.pi / math.sqrt(3.0))[known],
        bias_radps=to_tool(bias)[:, known],
        bias_std_radps=std_to_tool(bias_std)[:, known],
        basis=_basis(final, engine.settings),
        notes=_notes(final, engine.settings),
        scale=final.scale,
        motion=motion[batch.number],
    )


def _basis(state: State, settings: Settings) -> tuple[AzimuthBasis, ...]:
    found = []
    if settings.straight_hole_std_rad is not None:
        found.append(AzimuthBasis.CONSTRAINT)
    if state.still_s > 0.0:
        found.append(AzimuthBasis.ZERO_RATE)
    if state.turned_rad > 2.0 * math.pi:
        found.append(AzimuthBasis.ROTATION)
    return tuple(found) or (AzimuthBasis.NOTHING,)


def _notes(state: State, settings: Settings) -> tuple[str, ...]:
    notes = []
    if settings.latitude_rad is None:
        notes.append("no latitude: the Earth's rotation (15 deg/h) is not modelled and counts as gyro bias")
    if settings.azimuth_rad is None:
        notes.append("no azimuth at the start: azimuths are relative to it")
        if settings.latitude_rad is not None:
            notes.append("the level part of the Earth's rotation needs the azimuth and counts as gyro bias")
    if state.gap_s > 0.0:
        notes.append(
            f"{state.gap_s:.1f} s in gaps were not integrated; the azimuth is uncertain by what may have happened"
        )
    for kind, count in state.refused.items():
        if count:
            what = (
                "detected stops refused as real, slow motion"
                if kind == "stop"
                else f"{kind} updates refused by their innovation"
            )
            notes.append(f"{count} s of {what}" if settings.block_s == 1.0 else f"{count} blocks of {what}")
    return tuple(notes)

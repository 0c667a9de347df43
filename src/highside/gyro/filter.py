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
    straight    optional: azimuth = azimuth at the start, asserted in every block. A constraint, not a measurement: a
                real change is taken for gyro bias. What is stated never is less than its own deviation.

    velocity    instead of gravity, for a sensor that is carried: what a hand does to it is no noise that averages out
                with the square root of time, but goes forth and back. Velocity v is a state (in the place of a), moved
                by the readings, v' = v + g (A - p) t, and measured as none, give or take what a hand does: the mean
                acceleration over a time T then errs by v / T.

Each update is gated by its innovation and applied in Joseph's form (`error_state`). Causal: a row knows nothing of
later ones.

How well it can do at best: a gyro noise of N turns the azimuth about Up by N sqrt(t), and gravity never shows it. On a
table that turns about its axis at elevation theta the bias along the axis is known to N / (cos(theta) sqrt(t)) and acts
with sin(theta), together N sqrt(t) / cos(theta): 0.10 deg in an hour at 0, 0.13 at 30, 0.24 at 60 deg for 0.1
deg/sqrt(h). As a rate it falls with the root of the time: 0.10 deg/h at 30 deg take two hours. `papers.drift_bound`
computes it for any motion; the filter reaches it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import from_angles, from_rotation_vector, multiply, up_direction
from highside.gyro import filter_state, measurements, stop_test, time_update
from highside.gyro.blocks import Block, Gatherer
from highside.gyro.frames import DEG_PER_HOUR, DEG_PER_SQRT_HOUR, EARTH_RATE_RADPS, earth_rate
from highside.gyro.gates import Gate, MotionState
from highside.gyro.result import AzimuthBasis

_LEAST_COS = 0.05


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Priors and noise of the filter, SI. Defaults: a tactical gyro's (0.1 deg/sqrt(h), 0.1 deg/h/sqrt(h)).

    The table `[drift]` (`config.drift.DriftSettings`) gives some of them in an engineer's units, beside what the filter
    does not know (how long a state is kept). `filter_state.Constants` are what follows from these for the updates.
    """

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
    velocity_std_mps: float = 0.0
    """0: what accelerates a tool is vibration, and averages out as noise does. Else it is carried or waved by hand:
    accelerations of any size for as long as its velocity stays near this, an independent one each second. The velocity
    then is a state, in place of the accelerometers' biases"""
    gyro_scatter: float = 0.0
    """errors of scale and alignment of the gyros that are no state, as a part of the angle turned"""
    block_s: float = 1.0

    @property
    def earth_known(self) -> bool:
        """Whether all of the Earth's rotation can be modelled."""
        return self.latitude_rad is not None and self.azimuth_rad is not None


def carried(settings: FilterSettings) -> FilterSettings:
    """The settings for a sensor that is carried or waved by hand, and not mounted in a tool.

    Velocities of a hand, gyros true to some parts in a thousand, accelerometers to 5 mg; blocks short enough to follow.
    Twice or half of each changes little.
    """
    return replace(settings, velocity_std_mps=0.3, gyro_scatter=3e-3, accel_floor_g=5e-3, block_s=0.25)


@dataclass(frozen=True, slots=True)
class FilterEstimate:
    """The filter at the end of a block."""

    q: Array
    bias: Array
    """(3,) rad/s, body frame"""
    scale: float
    accel_bias: Array
    """(3,) g, body frame"""
    P: Array
    time_s: float
    motion: MotionState
    azimuth_std_rad: float
    still_s: float
    turned_rad: float
    moved_s: float
    gap_s: float
    refused: dict[str, int]
    """blocks in which a measurement was not believed: gravity, zero rate, stop"""

    @property
    def bias_std(self) -> Array:
        """(3,) rad/s"""
        return np.sqrt(np.diag(self.P)[3:6])


def azimuth_std(variance: Array, moved_s: Array, shaken: Array, settings: FilterSettings) -> Array:
    """Standard deviation of the azimuth: what the filter knows, and what it does not model."""
    # turning an unknown East-North part away is in the filter; the part about Up is integrated
    unmodelled = EARTH_RATE_RADPS if settings.latitude_rad is None else 0.0
    if settings.straight_hole_std_rad is not None:
        return np.asarray(np.sqrt(variance + settings.straight_hole_std_rad**2))
    total = np.sqrt(variance + (unmodelled * moved_s) ** 2 + (settings.rectification_std * shaken) ** 2)
    return np.asarray(np.minimum(total, math.pi / math.sqrt(3.0)))


def azimuth_basis(settings: FilterSettings, still_s: float, turned_rad: float) -> tuple[AzimuthBasis, ...]:
    """Where an azimuth comes from that was reached by these settings, so long a rest and so much of a turn."""
    found = []
    if settings.straight_hole_std_rad is not None:
        found.append(AzimuthBasis.CONSTRAINT)
    if still_s > 0.0:
        found.append(AzimuthBasis.ZERO_RATE)
    if turned_rad > 2.0 * math.pi:
        found.append(AzimuthBasis.ROTATION)
    return tuple(found) or (AzimuthBasis.NOTHING,)


def constants_of(settings: FilterSettings) -> filter_state.Constants:
    """The settings as the arithmetic takes them."""
    east, north, up = earth_rate(settings.latitude_rad, azimuth_known=settings.azimuth_rad is not None).tolist()
    return filter_state.Constants(
        earth_e=east,
        earth_n=north,
        earth_u=up,
        unmodelled_rate=0.0 if settings.earth_known else EARTH_RATE_RADPS,
        arw=settings.arw,
        rrw=settings.rrw,
        accel_noise_g=settings.accel_noise_g,
        accel_floor_g=settings.accel_floor_g,
        straight_std=settings.straight_hole_std_rad or 0.0,
        gravity_while_moving=settings.gravity_while_moving,
        detect_stops=settings.detect_stops,
        velocity_std=settings.velocity_std_mps,
        gyro_scatter=settings.gyro_scatter,
    )


def aligned(block: Block, settings: FilterSettings) -> filter_state.FilterState:
    """The first state: tilt from the block's mean gravity, azimuth from the settings."""
    s = settings
    g = block.accel / math.sqrt(float(block.accel @ block.accel))
    theta = math.asin(min(max(float(g[1]), -1.0), 1.0))
    phi = math.atan2(-float(g[0]), float(g[2]))
    psi = s.azimuth_rad or 0.0
    P = np.zeros((filter_state.STATES, filter_state.STATES))
    tilt_std = math.hypot(s.tilt_std_rad, max(block.accel_std, s.accel_noise_g) / math.sqrt(max(block.n, 1)))
    # elevation, toolface and azimuth are what is known independently; an error of the toolface is a rotation about the
    # tool axis and so, in part, about Up
    axes = np.array(
        [
            [math.cos(phi), 0.0, math.sin(phi) * math.cos(theta)],
            [0.0, 1.0, -math.sin(theta)],
            [math.sin(phi), 0.0, -math.cos(phi) * math.cos(theta)],
        ]
    ) * np.array([tilt_std, tilt_std / max(math.cos(theta), _LEAST_COS), s.azimuth_std_rad])
    P[:3, :3] = axes @ axes.T
    # what is not modelled of the Earth's rotation is a bias of its own
    bias_var = s.bias_std_radps**2 + (0.0 if s.earth_known else EARTH_RATE_RADPS**2)
    P[3:6, 3:6] = bias_var * np.eye(3)
    P[6, 6] = s.scale_std**2
    P[7:, 7:] = (s.velocity_std_mps or s.accel_bias_std_g) ** 2 * np.eye(3)
    return filter_state.FilterState(
        q=from_angles(theta, phi, psi),
        bias=np.zeros(3),
        scale=np.zeros(1),
        accel_bias=np.zeros(3),
        velocity=np.zeros(3),
        P=P,
        psi0=np.array([psi]),
        stop=np.zeros(5),
        tally=np.zeros(10),
    )


class ErrorStateFilter:
    """The filter; `step` takes one block, `update` single samples: the online form."""

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self.constants = constants_of(settings)
        self.estimate: filter_state.FilterState | None = None
        self.gate = Gate()
        self.motion = MotionState.VIBRATING
        self.time_s = math.nan
        self._gatherer = Gatherer(settings.block_s)

    def gather(self, t_s: float, rate: tuple[float, float, float], accel: tuple[float, float, float]) -> Block | None:
        """One sample in the *body* frame (rad/s, g); the block that it closed, which is for `add_block`."""
        return self._gatherer.add(t_s, rate, accel)

    def update(
        self,
        t_s: float,
        rate: tuple[float, float, float],
        accel: tuple[float, float, float],
        *,
        declared_still: bool = False,
    ) -> FilterEstimate | None:
        """One sample in the *body* frame (rad/s, g); the state if this sample closed a block.

        `declared_still` is the operator's word on the block that this sample closes.
        """
        block = self._gatherer.add(t_s, rate, accel)
        return None if block is None else self.step(block, declared_still=declared_still)

    def finish(self, *, declared_still: bool = False) -> FilterEstimate | None:
        """Close the block under way (end of the data)."""
        block = self._gatherer.finish()
        return self.state if block is None else self.step(block, declared_still=declared_still)

    def step(self, block: Block, *, declared_still: bool = False) -> FilterEstimate:
        """Take a block in; returns the state at its end."""
        self.add_block(block, declared_still=declared_still)
        state = self.state
        if state is None:
            raise ValueError("the first block shows no gravity")
        return state

    def add_block(self, block: Block, *, declared_still: bool = False) -> None:
        """`step` without the state as an object."""
        verdict = int(self.gate.verdict(block, declared=declared_still))
        self.time_s = block.end_s
        if self.estimate is None:
            if not float(block.accel @ block.accel) > 0.25:
                # no gravity to begin with
                return
            # the first block gives the tilt: its motion is not integrated, its gravity is not used twice
            self.estimate = aligned(block, self.settings)
            self.motion = MotionState(verdict)
            if declared_still:
                measurements.zero_rate_update(block.vector, True, self.estimate, self.constants)
            return
        z, m, c = block.vector, self.estimate, self.constants
        motion = stop_test.motion_of(z, verdict, declared_still, m, c)
        time_update.predict(z, motion, m, c)
        measurements.correct(z, motion, declared_still, m, c)
        self.motion = MotionState(motion)

    @property
    def state(self) -> FilterEstimate | None:
        """What is known at the end of the last block."""
        m = self.estimate
        if m is None:
            return None
        tally = m.tally
        return FilterEstimate(
            q=m.q.copy(),
            bias=m.bias.copy(),
            scale=float(m.scale[0]),
            accel_bias=m.accel_bias.copy(),
            P=m.P.copy(),
            time_s=self.time_s,
            motion=self.motion,
            azimuth_std_rad=self.azimuth_std_rad,
            still_s=float(tally[filter_state.STILL_S]),
            turned_rad=float(tally[filter_state.TURNED]),
            moved_s=float(tally[filter_state.MOVED_S]),
            gap_s=float(tally[filter_state.GAP_S]),
            refused=refused(tally),
        )

    @property
    def azimuth_std_rad(self) -> float:
        """At the end of the last block. Raises ValueError before the first."""
        m = self._begun()
        variance = np.array(filter_state.azimuth_variance(m))
        return float(azimuth_std(variance, m.tally[filter_state.MOVED_S], m.tally[filter_state.SHAKEN], self.settings))

    def _begun(self) -> filter_state.FilterState:
        if self.estimate is None:
            raise ValueError("no block is closed yet")
        return self.estimate

    def attitude_now(self) -> Array:
        """Quaternion (4,) at the newest sample, predicted from the last closed block."""
        m = self._begun()
        if self.motion is MotionState.STILL:
            return m.q.copy()
        c, sums = self.constants, self._gatherer.sums
        t = sums[19]
        turned = filter_state.quaternion_exp(-c.earth_e * t, -c.earth_n * t, -c.earth_u * t)
        raw = filter_state.quaternion_product(
            sums[:4], filter_state.quaternion_exp(*filter_state.turn_of_errors(m.bias, m.scale[0], np.array(sums)))
        )
        return np.array(
            filter_state.quaternion_product(filter_state.quaternion_product(turned, filter_state.attitude_of(m)), raw)
        )

    def know_azimuth(self, azimuth_rad: float, std_rad: float) -> None:
        """The azimuth that the state has is a true one: the level part of the Earth's rotation is modelled from now."""
        self.settings = replace(self.settings, azimuth_rad=azimuth_rad, azimuth_std_rad=std_rad)
        self.constants = constants_of(self.settings)

    def set_azimuth(self, azimuth_rad: float, std_rad: float, *, biases_hold: bool = False) -> None:
        """The azimuth is this from now on: turned about Up, so that tilt, toolface and biases stay.

        The error of the old azimuth leaves the covariance. Biases found under another azimuth hold as much of the
        Earth's rotation as that was wrong by, and become as uncertain, unless they were found under this one
        (`biases_hold`). Raises ValueError before the first block.
        """
        m = self._begun()
        q = filter_state.attitude_of(m)
        # now, within a block that may turn
        a, b, c, d = self.attitude_now().tolist()
        turn = azimuth_rad - filter_state.azimuth_of((a, b, c, d))
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        filter_state.set_attitude(m, filter_state.quaternion_product(filter_state.quaternion_exp(0.0, 0.0, -turn), q))
        up, row = up_direction(m.q), filter_state.azimuth_row(filter_state.attitude_of(m))
        # the part of dth that is an azimuth error, taken out of attitude and of what goes with it
        T = np.eye(filter_state.STATES)
        T[:3, :3] += np.outer(up, row)
        P = T @ m.P @ T.T
        P[:3, :3] += std_rad**2 * np.outer(up, up)
        if self.settings.latitude_rad is not None and not biases_hold:
            level = EARTH_RATE_RADPS * math.cos(self.settings.latitude_rad)
            wrong = 1.0 if self.settings.azimuth_rad is None else min(2.0 * math.sin(0.5 * abs(turn)), 1.0)
            P[3:6, 3:6] += (wrong * level) ** 2 * np.eye(3)
        m.P[:] = 0.5 * (P + P.T)
        m.psi0[0] = azimuth_rad
        m.tally[filter_state.MOVED_S] = m.tally[filter_state.SHAKEN] = 0.0
        if self.settings.azimuth_rad is None:
            self.know_azimuth(azimuth_rad, std_rad)


def refused(tally: Array) -> dict[str, int]:
    """Blocks in which a measurement was not believed."""
    places = {"gravity": filter_state.NO_GRAVITY, "zero rate": filter_state.NO_RATE, "stop": filter_state.NO_STOP}
    return {name: int(tally[place]) for name, place in places.items()}


def predicted(q: Array, bias: Array, scale: Array | float, earth: Array, sums: Array) -> Array:
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

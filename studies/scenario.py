"""Simulated instruments on simulated benches, drawn at random: the common ground of Monte-Carlo studies.

`reference_scenario(seed)` is the reference scenario of the calibration specification: a sensor with scale +-0.5 %,
misalignment +-0.2 deg and bias +-2 mg, noise of 50 ug/sqrt(Hz), 10 s a calibration pose and 1 s a later reading, a
bench of 0.018 deg steps (pose errors uniform +-0.009 deg) that is out of level by up to +-0.03 deg on two axes, and 44
poses: the eleven inclinations of the published tables times four toolfaces. Benches whose errors are common to an
inclination or repeat by station, non-linear sensors, and sensors with a structure that no model has are options.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Effect, Parameter, Stage
from highside.physics.effects.cross_product import EFFECT as CROSS_PRODUCT
from highside.physics.effects.misalignment import EFFECT as MISALIGNMENT
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.noise import std_of_average
from highside.physics.plan import BALANCE_TOOLFACES_DEG, PUBLISHED_INCLINATIONS_DEG, pose_grid
from highside.physics.state import ChainState


class MultiSine(Effect):
    """A non-linearity outside of the library: three sines of the load on each axis, with a peak near `amplitude`."""

    id = "multi_sine"
    title = "Multi-sine structure"
    stage = Stage.SENSOR
    formula = "amplitude/2 * sum over j of w_ij sin(k_j f_i + phase_ij)"
    story = "A sensor with ripples in its characteristic that no model of the library describes."
    parameters = (Parameter("amplitude", "g", 1e-3, (0.0, 0.02)),)
    waves = np.array([4.0, 7.0, 11.0])

    def __init__(self, rng: np.random.Generator) -> None:
        self.weights = rng.uniform(0.5, 1.0, (3, 3))
        self.phases = rng.uniform(0, 2 * np.pi, (3, 3))

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        ripple = np.sin(self.waves[:, None, None] * x + self.phases[:, :, None])
        return 0.5 * p[0] * np.sum(self.weights[:, :, None] * ripple, axis=0)


class DirectionSine(Effect):
    """A structure over direction: on each axis three plane waves, each along a direction of its own."""

    id = "direction_sine"
    title = "Waves over direction"
    stage = Stage.SENSOR
    formula = "amplitude/2 * sum over j of w_ij sin(k_j n_ij . f + phase_ij)"
    story = "A sensor whose error follows the attitude in a way that no model of the library describes."
    parameters = MultiSine.parameters
    waves = np.array([2.0, 3.5, 5.0])

    def __init__(self, rng: np.random.Generator) -> None:
        along = rng.standard_normal((3, 3, 3))
        self.vectors = along / np.linalg.norm(along, axis=2, keepdims=True) * self.waves[:, None]
        self.weights = rng.uniform(0.5, 1.0, (3, 3))
        self.phases = rng.uniform(0, 2 * np.pi, (3, 3))

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        waves = np.sin(self.vectors @ x + self.phases[:, :, None])
        return 0.5 * p[0] * np.sum(self.weights[:, :, None] * waves, axis=1)


@dataclass(frozen=True)
class PoseData:
    """A measured pose table with its truth; N poses. Angles in rad, accelerations in g."""

    inc_ref: AnyArray
    """(N,) as read on the bench"""
    tf_ref: AnyArray
    mean: AnyArray
    """(3, N) mean of the readings of each pose"""
    n: AnyArray
    """(N,) readings averaged"""
    std: AnyArray
    """(3, N) sample standard deviation of one reading in each pose"""
    inc_true: AnyArray
    """(N,) where gravity truly was"""
    tf_true: AnyArray


@dataclass(frozen=True)
class Scenario:
    """One instrument on one bench, and what was measured in the calibration session."""

    sensor: ForwardModel
    """the instrument alone: what a reading in the field goes through"""
    bench: ForwardModel
    """the bench alone: tilt and random pose errors"""
    poses: PoseData
    density_g: float
    pose_seconds: float
    reading_seconds: float

    @property
    def pose_sigma_g(self) -> float:
        """Standard deviation of the mean of one pose on each axis."""
        return std_of_average(self.density_g, self.pose_seconds)

    @property
    def reading_sigma_g(self) -> float:
        """Standard deviation of one later reading on each axis."""
        return std_of_average(self.density_g, self.reading_seconds)

    def measure(
        self, inc_ref: AnyArray, tf_ref: AnyArray, rng: np.random.Generator, *, direction: AnyArray | float = 1.0
    ) -> PoseData:
        """A session of other poses on the same bench with the same instrument.

        Errors common to an inclination or a station are common within the call: measure in one call what belongs
        together.
        """
        return _measure(
            self.sensor,
            self.bench,
            inc_ref,
            tf_ref,
            direction,
            self.pose_seconds,
            self.reading_seconds,
            self.reading_sigma_g,
            rng,
        )

    def read(self, inc_true: AnyArray, tf_true: AnyArray, rng: np.random.Generator | None = None) -> AnyArray:
        """(3, N) readings in the field at true attitudes, with the noise of one reading (without noise if no `rng`)."""
        state = ChainState.build(inc_true, tf_true, row_seconds=self.reading_seconds)
        reading = self.sensor.predict(state)
        return reading if rng is None else reading + self.reading_sigma_g * rng.standard_normal(reading.shape)


def random_sensor(
    rng: np.random.Generator,
    *,
    scale: float = 5e-3,
    misalignment_deg: float = 0.2,
    bias_g: float = 2e-3,
    nonlinearity_g: float = 0.0,
    structure_g: float = 0.0,
    structure: type[MultiSine] | type[DirectionSine] = MultiSine,
) -> ForwardModel:
    """An instrument whose parameters are uniform within +- the given sizes."""

    def named(prefix: str, limit: float) -> dict[str, float]:
        return {f"{prefix}_{axis}": float(rng.uniform(-limit, limit)) for axis in "xyz"}

    turn = np.radians(misalignment_deg)
    effects = {
        "bias": named("b", bias_g),
        "scale": named("s", scale),
        "misalignment": {p.name: float(rng.uniform(-turn, turn)) for p in MISALIGNMENT.parameters},
    }
    if nonlinearity_g:
        effects["quadratic"] = named("k2", nonlinearity_g)
        effects["cubic"] = named("k3", nonlinearity_g)
        effects["cross_product"] = {
            p.name: float(rng.uniform(-nonlinearity_g, nonlinearity_g)) for p in CROSS_PRODUCT.parameters
        }
    sensor = ForwardModel.of(effects)
    if structure_g:
        sensor = ForwardModel((*sensor.effects, (structure(rng), np.array([structure_g]))))
    return sensor


def random_bench(
    rng: np.random.Generator,
    *,
    tilt_deg: float = 0.03,
    pose_error_deg: float = 0.009,
    inc_station_error_deg: float = 0.0,
    tf_station_error_deg: float = 0.0,
) -> ForwardModel:
    """A bench with a tilt uniform within +-`tilt_deg` on each axis and uniform pose errors of the given half-widths.

    `inc_station_error_deg` is an inclination error common to an inclination, `tf_station_error_deg` a toolface error
    common to a station.
    """
    tilt, pose, inclination, station = np.radians(
        [tilt_deg, pose_error_deg, inc_station_error_deg, tf_station_error_deg]
    )
    return ForwardModel.of(
        {
            "base_tilt": {"tilt_x": float(rng.uniform(-tilt, tilt)), "tilt_y": float(rng.uniform(-tilt, tilt))},
            "pose_error": {
                "inc_pose": float(pose),
                "tf_pose": float(pose),
                "inc_station": float(inclination),
                "tf_station": float(station),
            },
        }
    )


def reference_scenario(
    seed: int,
    *,
    inclinations_deg: Sequence[float] = PUBLISHED_INCLINATIONS_DEG,
    toolfaces_deg: Sequence[float] = BALANCE_TOOLFACES_DEG,
    poses_rad: tuple[AnyArray, AnyArray] | None = None,
    direction: AnyArray | float = 1.0,
    scale: float = 5e-3,
    misalignment_deg: float = 0.2,
    bias_g: float = 2e-3,
    nonlinearity_g: float = 0.0,
    structure_g: float = 0.0,
    structure: type[MultiSine] | type[DirectionSine] = MultiSine,
    density_g: float = 50e-6,
    pose_seconds: float = 10.0,
    reading_seconds: float = 1.0,
    tilt_deg: float = 0.03,
    pose_error_deg: float = 0.009,
    inc_station_error_deg: float = 0.0,
    tf_station_error_deg: float = 0.0,
) -> Scenario:
    """One draw of the reference scenario; see the module's text. Sizes are half-widths of uniform distributions.

    `poses_rad` (inclinations, toolfaces), (N,) each, replaces the grid of `inclinations_deg` x `toolfaces_deg`. The
    sensor, the bench and the session draw from streams of their own: another plan of poses, or another kind of bench,
    leaves the sensor of a seed as it was.
    """
    for_sensor, for_bench, for_session = (np.random.default_rng([seed, stream]) for stream in range(3))
    sensor = random_sensor(
        for_sensor,
        scale=scale,
        misalignment_deg=misalignment_deg,
        bias_g=bias_g,
        nonlinearity_g=nonlinearity_g,
        structure_g=structure_g,
        structure=structure,
    )
    bench = random_bench(
        for_bench,
        tilt_deg=tilt_deg,
        pose_error_deg=pose_error_deg,
        inc_station_error_deg=inc_station_error_deg,
        tf_station_error_deg=tf_station_error_deg,
    )
    inc_ref, tf_ref = pose_grid(inclinations_deg, toolfaces_deg) if poses_rad is None else poses_rad
    sigma = std_of_average(density_g, reading_seconds)
    poses = _measure(sensor, bench, inc_ref, tf_ref, direction, pose_seconds, reading_seconds, sigma, for_session)
    return Scenario(sensor, bench, poses, density_g, pose_seconds, reading_seconds)


def _measure(
    sensor: ForwardModel,
    bench: ForwardModel,
    inc_ref: AnyArray,
    tf_ref: AnyArray,
    direction: AnyArray | float,
    pose_seconds: float,
    reading_seconds: float,
    reading_sigma_g: float,
    rng: np.random.Generator,
) -> PoseData:
    state = ChainState.build(inc_ref, tf_ref, direction=direction, row_seconds=pose_seconds)
    inc_true, tf_true = bench.truth(state, bench.draw(state, rng))
    readings = max(1, round(pose_seconds / reading_seconds))
    clean = sensor.predict(ChainState.build(inc_true, tf_true, row_seconds=pose_seconds))
    mean = clean + reading_sigma_g / np.sqrt(readings) * rng.standard_normal(clean.shape)
    freedom = max(1, readings - 1)
    std = reading_sigma_g * np.sqrt(rng.chisquare(freedom, clean.shape) / freedom)
    return PoseData(state.inc_rad, state.tf_rad, mean, np.full(state.n, readings), std, inc_true, tf_true)


def true_gravity(poses: PoseData) -> AnyArray:
    """(3, N) true gravity direction of each pose in the tool frame."""
    return gravity_direction(poses.inc_true, poses.tf_true)

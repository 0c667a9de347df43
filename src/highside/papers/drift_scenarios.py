"""Experiments on gyro drift: turntable, vibration table, drilling with connections, rotating table, curved hole, rod.

Each is a true motion (elevation, toolface and azimuth against time), the rates that ideal gyros average over each
sample interval on a rotating Earth, and the imperfections of a tactical triad: constant bias, rate random walk, angle
random walk, a scale error along the tool axis, and under vibration white noise and the rectified bias. The three
experiments of Yang and Yang (2017) are described by their text only: durations, the inclination of 45 deg, the stops
every 1800 s. Attitude, latitude, noise, vibration level and stop length are ours; the constant biases are chosen so
that the uncorrected gyro ends at the published drift "before", which is therefore matched by construction.

Vectors leave this module in the tool frame of the product; angles inside are those of `attitude.quaternion`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.quaternion import (
    conjugate,
    from_angles,
    from_rotation_vector,
    multiply,
    to_rotation_vector,
    to_tool,
    up_direction,
)
from highside.physics.gravity import EARTH_RATE_RADPS
from highside.physics.noise import random_walk

LATITUDE_RAD = float(np.radians(35.2))
DEG_PER_HOUR = np.pi / 180 / 3600
SAMPLE_RATE_HZ = 100.0


@dataclass(frozen=True, slots=True)
class Triad:
    """Imperfections of gyros and accelerometers (1 sigma where random)."""

    bias_dph: tuple[float, float, float] = (6.0, -7.0, 8.0)
    """constant gyro bias in the body frame, deg/h"""
    arw_deg_sqrt_h: float = 0.1
    rrw_dph_sqrt_h: float = 0.1
    axial_scale_ppm: float = 0.0
    accel_noise_g: float = 1e-3
    accel_bias_g: float = 3.2e-3
    vibration_rms_g: float = 0.0
    """white, each axis, each sample, while vibrating"""
    gyro_vibration_dps: float = 0.0
    rectification_dph_g2: float = 0.0
    """bias that vibration makes, on the gyro across the tool (x of the body frame)"""


PERFECT = Triad((0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class DriftExperiment:
    """A true motion at N sample times. Angles rad; `vibrating` (N,); `rest` (K, 2) s, when the tool stands."""

    name: str
    t_s: Array
    theta: Array
    phi: Array
    psi: Array
    vibrating: NDArray[np.bool_]
    rest: Array
    triad: Triad
    latitude_rad: float = LATITUDE_RAD

    @property
    def hours(self) -> float:
        return float(self.t_s[-1] - self.t_s[0]) / 3600.0


@dataclass(frozen=True, slots=True)
class DriftData:
    """What the tool recorded, tool frame: `rate` (3, N) rad/s, `accel` (3, N) g; and the biases at the end."""

    experiment: DriftExperiment
    rate: Array
    accel: Array
    bias_end: Array
    """(3,) true gyro bias at the end, tool frame, rad/s"""

    def columns(self) -> dict[str, Array]:
        """What the tool recorded, by the names of a Recording: (N,) each, g and deg/s."""
        readings = {f"a{axis}_g": row for axis, row in zip("xyz", self.accel, strict=True)}
        rates = {f"g{axis}_dps": row for axis, row in zip("xyz", np.degrees(self.rate), strict=True)}
        return {"t_s": self.experiment.t_s, **readings, **rates}

    def true_columns(self) -> dict[str, Array]:
        """Where the tool truly was, row by row: (N,) each, deg."""
        e = self.experiment
        return {
            "t_s": e.t_s,
            "inc_true_deg": np.degrees(e.theta) + 90.0,
            "tf_true_deg": np.degrees(e.phi) % 360.0,
            "azi_true_deg": np.degrees(e.psi) % 360.0,
        }

    def about(self) -> dict[str, Any]:
        """Place, imperfections, and when the tool stood, as plain values."""
        e = self.experiment
        return {
            "latitude_deg": float(np.degrees(e.latitude_rad)),
            "azimuth_deg": float(np.degrees(e.psi[0])),
            "rest_s": e.rest.tolist(),
            # of the body frame: across, along the tool, and the third
            "imperfections": asdict(e.triad),
            "bias_end_dps": np.degrees(self.bias_end).tolist(),
        }


def _times(seconds: float, rate_hz: float) -> Array:
    return np.arange(round(seconds * rate_hz) + 1) / rate_hz


def _steady(
    name: str, seconds: float, angles_deg: tuple[float, float, float], triad: Triad, rest: Array, rate_hz: float
) -> DriftExperiment:
    t = _times(seconds, rate_hz)
    theta, phi, psi = (np.full(t.size, np.radians(angle)) for angle in angles_deg)
    return DriftExperiment(name, t, theta, phi, psi, np.zeros(t.size, dtype=bool), rest, triad)


def turntable(seconds: float = 3600.0, rate_hz: float = SAMPLE_RATE_HZ, triad: Triad | None = None) -> DriftExperiment:
    """S1: standing at elevation 30, toolface 20, azimuth 60 deg."""
    own = triad or Triad((23.415, -6.016, -4.085))
    return _steady("turntable", seconds, (30.0, 20.0, 60.0), own, np.array([[0.0, seconds]]), rate_hz)


def vibration_table(seconds: float = 3600.0, rate_hz: float = SAMPLE_RATE_HZ) -> DriftExperiment:
    """S2: standing at elevation 45 deg, shaken all the time by 0.5 g rms."""
    triad = Triad((24.049, -10.205, -0.616), vibration_rms_g=0.5, gyro_vibration_dps=0.025, rectification_dph_g2=0.3)
    still = _steady("vibration table", seconds, (45.0, 20.0, 60.0), triad, np.array([[0.0, seconds]]), rate_hz)
    return _shaken(still, np.ones(still.t_s.size, dtype=bool))


def _shaken(experiment: DriftExperiment, vibrating: NDArray[np.bool_]) -> DriftExperiment:
    return replace(experiment, vibrating=vibrating)


def drilling(
    seconds: float = 10800.0,
    rate_hz: float = SAMPLE_RATE_HZ,
    *,
    stop_s: float = 120.0,
    leg_s: float = 1800.0,
    start_s: float = 50.0,
    turning_dps: float = 0.0,
    triad: Triad | None = None,
    vibration_rms_g: float = 1.0,
) -> DriftExperiment:
    """S3: a still start, then a stop of `stop_s` every `leg_s` to add a pipe; 1 g rms of vibration between.

    `turning_dps`: the rod turns at this rate while drilling (60 deg/s are 10 turns a minute).
    """
    own = triad or Triad(
        (22.319, -11.827, 3.567),
        vibration_rms_g=vibration_rms_g,
        gyro_vibration_dps=0.05 * vibration_rms_g,
        rectification_dph_g2=0.3,
    )
    stops = np.arange(leg_s, seconds - 1.0, leg_s)
    rest = np.vstack([[0.0, start_s], np.column_stack([stops, stops + stop_s])])
    still = _steady("drilling", seconds, (45.0, 20.0, 60.0), own, rest, rate_hz)
    moving = np.ones(still.t_s.size, dtype=bool)
    for begin, end in rest:
        moving &= ~((still.t_s > begin) & (still.t_s <= end))
    moving[0] = False
    turned = np.concatenate([[0.0], np.cumsum(np.diff(still.t_s) * moving[1:])]) * np.radians(turning_dps)
    return replace(_shaken(still, moving), phi=still.phi + turned)


def rotating_rod(seconds: float = 10800.0, rate_hz: float = SAMPLE_RATE_HZ) -> DriftExperiment:
    """Drilling with the rod turning at 60 deg/s and a gyro scale error of 200 ppm along the tool axis."""
    triad = Triad(
        (22.319, -11.827, 3.567),
        axial_scale_ppm=200.0,
        vibration_rms_g=1.0,
        gyro_vibration_dps=0.05,
        rectification_dph_g2=0.3,
    )
    return drilling(seconds, rate_hz, turning_dps=60.0, triad=triad)


def rotating_table(
    theta_deg: float,
    seconds: float = 3600.0,
    rate_hz: float = SAMPLE_RATE_HZ,
    *,
    rate_dps: float = 10.0,
    triad: Triad | None = None,
) -> DriftExperiment:
    """S1r: turning about the tool axis at a constant rate, at this elevation, without vibration."""
    still = _steady("rotating table", seconds, (theta_deg, 20.0, 60.0), triad or Triad(), np.zeros((0, 2)), rate_hz)
    return replace(still, phi=still.phi + np.radians(rate_dps) * still.t_s)


def curved_hole(
    turn_deg: float = 5.0,
    seconds: float = 600.0,
    rate_hz: float = SAMPLE_RATE_HZ,
    *,
    start_s: float = 300.0,
    triad: Triad | None = None,
) -> DriftExperiment:
    """At rest for `start_s`, then the azimuth turns by `turn_deg` evenly over `seconds` at constant toolface."""
    still = _steady(
        "curved hole", start_s + seconds, (30.0, 20.0, 60.0), triad or Triad(), np.array([[0.0, start_s]]), rate_hz
    )
    turned = np.radians(turn_deg) * np.clip((still.t_s - start_s) / seconds, 0.0, 1.0)
    return replace(still, psi=still.psi + turned)


def true_rates(experiment: DriftExperiment) -> tuple[Array, Array]:
    """Inertial rates averaged over the interval that ends with each sample (3, N) rad/s, and Up (3, N); body frame."""
    e = experiment
    q = from_angles(e.theta, e.phi, e.psi)
    lat = e.latitude_rad
    earth = EARTH_RATE_RADPS * np.array([[0.0], [np.cos(lat)], [np.sin(lat)]])
    inertial = multiply(from_rotation_vector(earth * e.t_s), q)
    steps = to_rotation_vector(multiply(conjugate(inertial[:, :-1]), inertial[:, 1:])) / np.diff(e.t_s)
    return np.concatenate([steps[:, :1], steps], axis=1), up_direction(q)


def record(experiment: DriftExperiment, seed: int) -> DriftData:
    """The readings of one triad; the same seed gives the same numbers."""
    rng = np.random.default_rng(seed)
    e, triad = experiment, experiment.triad
    rate, up = true_rates(e)
    n = e.t_s.size
    interval = float(np.median(np.diff(e.t_s)))
    bias = np.array(triad.bias_dph)[:, None] * DEG_PER_HOUR
    bias_change = random_walk(e.t_s, triad.rrw_dph_sqrt_h * DEG_PER_HOUR / 60.0, rng)
    rate[1] *= 1.0 + triad.axial_scale_ppm * 1e-6
    noise = np.full(n, triad.arw_deg_sqrt_h * np.pi / 180 / 60 / np.sqrt(interval))
    noise = np.hypot(noise, np.radians(triad.gyro_vibration_dps) * e.vibrating)
    rate[0] += triad.rectification_dph_g2 * DEG_PER_HOUR * triad.vibration_rms_g**2 * e.vibrating
    rate = rate + bias + bias_change + noise * rng.standard_normal((3, n))
    shake = np.hypot(triad.accel_noise_g, triad.vibration_rms_g * e.vibrating)
    offset = triad.accel_bias_g * rng.standard_normal((3, 1))
    accel = up + offset + shake * rng.standard_normal((3, n))
    return DriftData(e, to_tool(rate), to_tool(accel), to_tool(bias[:, 0] + bias_change[:, -1]))

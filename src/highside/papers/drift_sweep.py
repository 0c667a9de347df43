"""Where and why gravity's hold on the azimuth weakens with the inclination: the bound and the filter, side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.attitude.quaternion import conjugate, from_angles, multiply
from highside.gyro.filter import FilterSettings
from highside.gyro.recording_filter import error_state_filter
from highside.gyro.result import DriftResult
from highside.papers.drift_bound import azimuth_bound
from highside.papers.drift_scenarios import DriftExperiment, Triad, record, rotating_table, turntable

ELEVATIONS_DEG = (0.0, 1.0, 3.0, 10.0, 30.0, 45.0, 60.0, 75.0, 80.0, 85.0, 87.0, 89.0)
RATE_HZ = 20.0

WHY = (
    "Gravity shows a rotation only where it is not about the vertical. On a tool that turns about its axis the biases "
    "across the axis are swept through all directions and average out of the azimuth; the bias along the axis is seen "
    "in the toolface, whose rate it changes by cos(theta) of itself, and turns the azimuth by sin(theta): together "
    "N sqrt(t) / cos(theta) for a gyro noise N.",
    "So the correction weakens towards the vertical: at theta = 60 deg (30 or 150 deg from the vertical) the "
    "azimuth is twice as uncertain as level, at 87 deg (3 deg from the vertical) twelve times, and there azimuth and "
    "toolface also become one angle. Within a degree of the vertical the rotation about the vertical is nearly the "
    "rotation of the tool itself, and the Earth's rotation, not gravity, bounds it.",
    "Towards the horizontal (theta below 3 deg) nothing weakens. The paper finds its correction weaker below 3 deg and "
    "near 90 deg of inclination and does not say from where it counts: counted from the vertical, the first is what is "
    "seen here and the second is not; counted from the horizontal it is the other way round.",
    "A tool that does not turn is equally badly off at every inclination: the drift about the vertical is not seen at "
    "all but for the Earth's rotation, which a wrong azimuth tilts (1.7 deg after an hour).",
)


@dataclass(frozen=True, slots=True)
class Point:
    """One elevation; standard deviations of the rotation about the vertical after an hour, deg."""

    theta_deg: float
    rotating_bound_deg: float
    rotating_deg: float
    """of the filter: rms over the seeds"""
    rotating_stated_deg: float
    at_rest_bound_deg: float
    seeds: int


def about_up_deg(result: DriftResult, experiment: DriftExperiment) -> float:
    """Error of the last row as a rotation about the vertical (minus that of the azimuth away from the vertical)."""
    e = experiment
    ours = from_angles(result.inc_rad[-1] - 0.5 * np.pi, result.tf_rad[-1], result.azi_rad[-1])
    error = multiply(from_angles(e.theta[-1], e.phi[-1], e.psi[-1]), conjugate(ours))
    turn = 2.0 * np.arctan2(error[3], error[0])
    return float(np.degrees((turn + np.pi) % (2.0 * np.pi) - np.pi))


def sweep(seeds: int = 6, seconds: float = 3600.0, elevations: tuple[float, ...] = ELEVATIONS_DEG) -> list[Point]:
    """The table that turns at 10 deg/s, gravity alone, and the table at rest, at each elevation."""
    points = []
    for index, theta in enumerate(elevations):
        turning = rotating_table(theta, seconds, RATE_HZ)
        standing = _at(theta, seconds)
        settings = FilterSettings(
            latitude_rad=turning.latitude_rad,
            azimuth_rad=float(turning.psi[0]),
            azimuth_std_rad=1e-5,
            detect_stops=False,
        )
        errors, stated = [], 0.0
        for seed in range(seeds):
            data = record(turning, 1000 * index + seed)
            result = error_state_filter(turning.t_s, data.rate, data.accel, settings)
            errors.append(about_up_deg(result, turning))
            stated = float(np.degrees(result.azi_std_rad[-1]))
        points.append(
            Point(
                theta_deg=theta,
                rotating_bound_deg=float(np.degrees(azimuth_bound(turning)[-1])),
                rotating_deg=float(np.sqrt(np.mean(np.square(errors)))),
                rotating_stated_deg=stated,
                at_rest_bound_deg=float(np.degrees(azimuth_bound(standing)[-1])),
                seeds=seeds,
            )
        )
    return points


def _at(theta_deg: float, seconds: float) -> DriftExperiment:
    """The turntable of the first experiment, at another elevation."""
    level = turntable(seconds, RATE_HZ, Triad())
    return DriftExperiment(
        level.name,
        level.t_s,
        np.full(level.t_s.size, np.radians(theta_deg)),
        level.phi,
        level.psi,
        level.vibrating,
        level.rest,
        level.triad,
        level.latitude_rad,
    )

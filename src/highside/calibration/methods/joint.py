"""The method `joint`: all poses at once, sensor and bench separated; with |g| alone, the sensor without a bench."""

from __future__ import annotations

from highside.calibration.joint import joint
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.magnitude import magnitude
from highside.calibration.method import Method, Solution, SolveRequest
from highside.calibration.poses import PoseSet
from highside.calibration.refinement import refine
from highside.calibration.temperature import joint_over_temperature
from highside.words import said_later


def _solve(poses: PoseSet, request: SolveRequest, bench: BenchAccuracy) -> Solution:
    """With temperature where the poses have it, and structure where they show any."""
    result = joint(poses, bench=bench) if poses.temp_c is None else joint_over_temperature(poses, bench=bench)
    return Solution(refine(result, poses, bench=bench))


def _by_magnitude(poses: PoseSet) -> Solution:
    return Solution(magnitude(poses))


METHOD = Method(
    "joint",
    described=said_later("joint estimate of sensor and bench"),
    colour="#2f7fd1",
    solve=_solve,
    by_magnitude=_by_magnitude,
    order=3,
)

"""The method `conventional`: every axis in turn along gravity, the bench taken as exact."""

from __future__ import annotations

from highside.calibration.conventional import conventional
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.method import Method, Solution, SolveRequest
from highside.calibration.poses import PoseSet
from highside.words import said_later


def _solve(poses: PoseSet, request: SolveRequest, bench: BenchAccuracy) -> Solution:
    return Solution(conventional(poses, bench=bench))


METHOD = Method("conventional", described=said_later("conventional positions"), colour="#c2691c", solve=_solve, order=1)

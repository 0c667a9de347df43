"""A pose against the others: outlier, and closure of its inclination."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.bench.session.plans import Limits, SessionPlan
from highside.calibration.balance import CLOSURE_P, closures_of, quadrant_poses
from highside.calibration.departures import departures
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.result import Closure
from highside.errors import InputError

MIN_POSES_FOR_FIT = 6
MEDIAN_DEPARTURE = 1.538
"""median of chi with three degrees of freedom"""


def bench_of(limits: Limits) -> BenchAccuracy:
    return BenchAccuracy(pose_rad=float(np.deg2rad(limits.pose_sigma_deg)))


@dataclass(frozen=True, slots=True)
class Agreement:
    """How the newest pose agrees: its departure in standard deviations (None: too few poses to say), whether it is the
    one that departs most, and the pose that does."""

    sigmas: float | None
    is_worst: bool
    worst: str | None
    worst_sigmas: float | None = None


def agreement(poses: PoseSet, newest: str, limits: Limits) -> Agreement:
    """Leave-one-out departure of pose `newest` from what the others predict by the joint fit.

    A session that scatters more than was stated is measured by its own scatter, that of the poses before.
    """
    if not poses.has_reference or len(poses) < MIN_POSES_FOR_FIT:
        return Agreement(None, False, None)
    index = poses.ids.index(newest)
    try:
        before = departures(poses.subset(np.arange(len(poses)) != index), bench_of(limits))
        away = departures(poses, bench_of(limits))
    except (InputError, np.linalg.LinAlgError):
        return Agreement(None, False, None)  # the end of the session says what is wrong with all of them together
    away = away / max(1.0, float(np.median(before)) / MEDIAN_DEPARTURE)
    worst = int(np.argmax(away))
    return Agreement(float(away[index]), worst == index, poses.ids[worst], float(away[worst]))


def all_departures(poses: PoseSet, limits: Limits) -> dict[str, float]:
    """Departure of each pose from what the others predict, in standard deviations; empty with too few to say. The first
    poses of a session get theirs only when the later ones are there."""
    if not poses.has_reference or len(poses) < MIN_POSES_FOR_FIT:
        return {}
    try:
        away = departures(poses, bench_of(limits))
    except (InputError, np.linalg.LinAlgError):
        return {}
    away = away / max(1.0, float(np.median(away)) / MEDIAN_DEPARTURE)
    return {pose: float(sigmas) for pose, sigmas in zip(poses.ids, away, strict=True)}


def inclination_closures(poses: PoseSet, limits: Limits) -> list[Closure]:
    """The closures of all inclinations that have their four poses."""
    if not poses.has_reference or len(poses) < 4:
        return []
    fours = quadrant_poses(poses)
    return closures_of(poses, fours, [np.eye(3)] * len(fours), pose_rad=bench_of(limits).pose_rad)


def closure_limit(plan: SessionPlan) -> float:
    """Probability below which one closure of this plan is not chance."""
    inclinations = len({(pose.inc_deg, pose.stage) for pose in plan.poses})
    return CLOSURE_P / max(1, inclinations)

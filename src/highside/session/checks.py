"""A pose against the others: outlier, closure of its ring, and how good the calibration would be by now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.calibration.advice import bound_of_angles, plan_information, split_equally
from highside.calibration.balance import CLOSURE_P, closures_of, rings_of_four
from highside.calibration.forward import BASE_NAMES
from highside.calibration.joint import joint
from highside.calibration.poses import Array, PoseSet
from highside.calibration.result import BenchAccuracy, CalibrationRefused, Closure
from highside.errors import InputError
from highside.session.ledger import Ledger
from highside.session.plans import Limits, Plan
from highside.session.snapshot import Uncertainty

MIN_POSES_FOR_FIT = 6
MEDIAN_DEPARTURE = 1.538
"""median of chi with three degrees of freedom"""
DEFAULT_USE_DEG = (1.0, 5.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0)


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
        before = _departures(poses.subset(np.arange(len(poses)) != index), limits)
        away = _departures(poses, limits)
    except (CalibrationRefused, InputError, np.linalg.LinAlgError):
        return Agreement(None, False, None)  # the end of the session says what is wrong with all of them together
    away = away / max(1.0, float(np.median(before)) / MEDIAN_DEPARTURE)
    worst = int(np.argmax(away))
    return Agreement(float(away[index]), worst == index, poses.ids[worst], float(away[worst]))


def _departures(poses: PoseSet, limits: Limits) -> Array:
    """Standard deviations (N,) of each pose from what the others predict."""
    fit = joint(poses, bench=bench_of(limits), nonlinear="none", encoder="none", estimate_variances=False)
    return fit.poses.studentised


def ring_closures(poses: PoseSet, limits: Limits) -> list[Closure]:
    """The closures of all rings that have their four poses."""
    if not poses.has_reference or len(poses) < 4:
        return []
    fours = rings_of_four(poses)
    return closures_of(poses, fours, [np.eye(3)] * len(fours), pose_rad=bench_of(limits).pose_rad)


def closure_limit(plan: Plan) -> float:
    """Probability below which one closure of this plan is not chance."""
    rings = len({(pose.inc_deg, pose.stage) for pose in plan.poses})
    return CLOSURE_P / max(1, rings)


def uncertainty_so_far(ledger: Ledger) -> Uncertainty | None:
    """What a joint solution of the poses taken so far would leave (Cramer-Rao bound, priors in it)."""
    plan = ledger.plan
    lines = [(line, line.readings) for line in ledger.done]
    if plan.reference != "pose" or not lines:
        return None
    inc = np.deg2rad([float(line.inc_deg or 0.0) for line, _ in lines])
    tf = np.deg2rad([float(line.tf_deg or 0.0) for line, _ in lines])
    noise = np.array([r.std_error_g if r is not None else (1e-3,) * 3 for _, r in lines]).T
    bench = bench_of(plan.limits)
    information = plan_information(inc, tf, noise_g=noise, variances=split_equally(bench), bench=bench)
    covariance = np.linalg.inv(information)
    use = use_inclinations_deg(plan)
    around = np.deg2rad(np.arange(0.0, 360.0, 45.0))
    inc_std, tf_std = [], []
    for value in use:
        one_inc, one_tf = bound_of_angles(
            np.asarray(covariance), BASE_NAMES, np.full(around.size, np.deg2rad(value)), around
        )
        inc_std.append(float(np.rad2deg(np.sqrt(np.mean(one_inc**2)))))
        tf_std.append(float(np.rad2deg(np.sqrt(np.mean(one_tf**2)))))
    return Uncertainty(
        inc_deg=list(use),
        inc_std_deg=inc_std,
        tf_std_deg=tf_std,
        rms_inc_std_deg=float(np.sqrt(np.mean(np.square(inc_std)))),
        rms_tf_std_deg=float(np.sqrt(np.mean(np.square(tf_std)))),
    )


def use_inclinations_deg(plan: Plan) -> tuple[float, ...]:
    """Where the calibration will be used: at its own rings for a local method, else over the usual range."""
    if plan.method == "balance":
        return tuple(sorted({abs(pose.inc_deg) for pose in plan.poses}))
    return DEFAULT_USE_DEG

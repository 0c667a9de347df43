"""The result of a joint estimate: zone, variances, closures, and the remarks its user needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.advice import next_best_poses
from highside.calibration.balance import closure_remarks, closures_of, quadrant_poses
from highside.calibration.forward import (
    BASE_NAMES,
    GROUPS,
    Variances,
    pose_covariance,
)
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.mixed_model import (
    MixedModelFit,
    PoseRegression,
)
from highside.calibration.pose_rejection import swapped_pairs
from highside.calibration.poses import Indices
from highside.calibration.remark import Reason, Remark
from highside.calibration.result import CalibrationResult, PoseFit
from highside.calibration.sensor import OFFSET_NAMES, sensor_of
from highside.calibration.zone import Parameters, Zone
from highside.physics.effect import AXES


def result_of(
    session: PoseRegression,
    fit: MixedModelFit,
    variances: Variances,
    used: NDArray[np.bool_],
    away: Array,
    bench: BenchAccuracy,
    toolface_zero_rad: float,
    toolface_zero_std_rad: float,
    covariance: Array,
    student: Array | None,
) -> CalibrationResult:
    """The result of a fit: `away` (N,) departures of the poses, the covariance (P, P) of the parameters and its
    widening."""
    poses = session.poses
    bad = np.flatnonzero(~used)
    remarks = _pose_remarks(session, fit, variances, bad, away)
    remarks += _observability_remarks(session, fit)
    remarks += _scatter_remarks(variances, bench)
    per_pose = pose_covariance(
        session.noise,
        fit.by_inc,
        fit.by_tf,
        Variances(variances.pose_inc, variances.pose_tf + variances.station_tf, 0.0, 0.0, variances.reading),
    )
    sensor = sensor_of(fit.names, fit.theta)
    fours = [four for four in quadrant_poses(poses) if used[four].all()]
    # the closure is a property of an affine sensor: what is known of the other terms is taken out first
    affine = poses if sensor.is_linear else replace(poses, a=poses.a - sensor.nonlinear(sensor.correct(poses.a)))
    closures = closures_of(affine, fours, [sensor.A] * len(fours), pose_covariance=per_pose)
    misfit = _misfit(fit, variances, used)
    index = [fit.names.index(name) for name in OFFSET_NAMES]
    covariance = covariance.copy()
    covariance[index, index] += misfit**2
    parameters = Parameters(fit.names, fit.theta, covariance, student)
    zone = Zone("global", None, 0.0, float(np.pi), parameters, _root_condition(fit))
    return CalibrationResult(
        method="joint",
        options={
            "admitted": " ".join(group for group, names in GROUPS.items() if names[0] in fit.names) or "none",
            "pose_sigma_deg": float(np.rad2deg(bench.pose_rad)),
            "tilt_sigma_deg": float(np.rad2deg(bench.tilt_rad)),
        },
        frame="gravity",
        zones=(zone,),
        poses=PoseFit(poses.ids, fit.left_over, away, used),
        closures=tuple(closures),
        variance={
            "reading_g": _reading_noise(session, variances),
            "pose_inc_rad": float(np.sqrt(variances.pose_inc)),
            "pose_tf_rad": float(np.sqrt(variances.pose_tf)),
            "station_inc_rad": float(np.sqrt(variances.station_inc)),
            "station_tf_rad": float(np.sqrt(variances.station_tf)),
            **{f"misfit_{axis}_g": float(size) for axis, size in zip(AXES, misfit, strict=True)},
        },
        remarks=tuple(remarks + closure_remarks(closures)),
        toolface_zero_rad=toolface_zero_rad,
        toolface_zero_std_rad=toolface_zero_std_rad,
    )


def _misfit(fit: MixedModelFit, variances: Variances, used: NDArray[np.bool_]) -> Array:
    """(3,) structure that no term describes, g; zero where the reading noise explains the residuals.

    It follows the attitude: it does not average out, and every later reading has it. Its size is that of the residuals,
    of which the bench's part cannot be separated.
    """
    if variances.reading <= MAX_READING_FACTOR**2:
        return np.zeros(3)
    return np.asarray(np.sqrt(np.mean(fit.left_over[:, used] ** 2, axis=1)))


def _pose_remarks(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, bad: Indices, away: Array
) -> list[Remark]:
    poses = session.poses
    remarks = []
    pairs = swapped_pairs(session, fit, variances, bad)
    for i, j in pairs:
        remarks.append(
            Remark(
                Reason.SWAPPED_POSES,
                f"{poses.label(i)} and {poses.label(j)} are swapped: each reading fits the other's setting; "
                "both rejected",
                (poses.ids[i], poses.ids[j]),
                refused=True,
            )
        )
    explained = {k for pair in pairs for k in pair}
    alone = [int(i) for i in bad if int(i) not in explained]
    return remarks + [
        Remark(
            Reason.BAD_POSE,
            f"{poses.label(i)} lies {away[i]:.3g} standard deviations from what the other poses predict; "
            "left out: measure it again",
            (poses.ids[i],),
            refused=True,
        )
        for i in alone
    ]


def _observability_remarks(session: PoseRegression, fit: MixedModelFit) -> list[Remark]:
    """What the poses cannot separate: parameters about which they say little more than was known before."""
    share = np.sqrt(np.diag(fit.covariance)) / fit.prior
    base = [i for i, name in enumerate(fit.names) if name in BASE_NAMES]
    undetermined = [i for i in base if share[i] > UNDETERMINED_SHARE]
    if not undetermined:
        return []
    std = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(std, std)
    phrases = []
    named: set[int] = set()
    for i in undetermined:
        partners = [j for j in base if j != i and abs(correlation[i, j]) > 0.5]
        if i in named:
            continue
        named.update({i, *partners})
        if partners:
            phrases.append(f"{fit.names[i]} from {', '.join(fit.names[j] for j in partners)}")
        else:
            phrases.append(f"{fit.names[i]} at all")
    best = next_best_poses(session.poses, bench=session.bench, count=1)[0]
    return [
        Remark(
            Reason.UNOBSERVABLE,
            f"these poses cannot tell {'; '.join(phrases)}; the stated uncertainty says so. The pose that "
            f"would help most: inclination {np.rad2deg(best.inc_rad):.1f}, toolface {np.rad2deg(best.tf_rad):.0f} deg",
            refused=True,
        )
    ]


MAX_READING_FACTOR = 3.0
UNDETERMINED_SHARE = 0.5
"""A parameter whose standard deviation is still above this share of its prior's has not been measured."""


def _scatter_remarks(variances: Variances, bench: BenchAccuracy) -> list[Remark]:
    remarks = []
    if variances.reading > MAX_READING_FACTOR**2:
        remarks.append(
            Remark(
                Reason.MISFIT,
                f"the poses scatter {np.sqrt(variances.reading):.1f} times as much as their reading noise explains, "
                "along gravity too, where the bench cannot: noise that is not white, or physics that is not modelled",
            )
        )
    for name, total in (
        ("inclination", variances.pose_inc + variances.station_inc),
        ("toolface", variances.pose_tf + variances.station_tf),
    ):
        if total > 9.0 * bench.pose_rad**2:
            remarks.append(
                Remark(
                    Reason.BENCH_SCATTER,
                    f"the bench repeats in {name} to {np.rad2deg(np.sqrt(total)):.4f} deg only, against "
                    f"{np.rad2deg(bench.pose_rad):.4f} deg stated; or physics that is not modelled looks like it",
                )
            )
    return remarks


def _root_condition(fit: MixedModelFit) -> float:
    """Condition number of the whitened design, each parameter in units of its prior."""
    sizes = np.linalg.eigvalsh(fit.covariance / np.outer(fit.prior, fit.prior))
    return float(np.sqrt(sizes[-1] / sizes[0]))


def _reading_noise(session: PoseRegression, variances: Variances) -> float:
    """Noise of one reading: as measured, or where it was not, as the residuals say."""
    stated = float(np.mean(session.noise**2 * session.poses.n))
    return float(np.sqrt(stated if session.poses.std_known else stated * variances.reading))

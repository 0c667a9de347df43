"""Calibration by the magnitude of gravity alone: many still poses by hand, no turntable.

Whatever the attitude, a calibrated sensor at rest reads one g. In the language of the joint estimator this is the
limit of pose errors that are not known at all: a reading tells nothing about the two directions across gravity, and
what is left of each pose is one number, `|C (m - b)| - 1`, weighted by its noise. The noise of a pose is that of its
readings plus a part `tau` that does not average away (flicker noise, a hand, a floor), found by restricted maximum
likelihood.

|g| alone cannot see a rotation of the triad, so three of the nine elements of A are fixed by a *gauge*: "symmetric"
(no net rotation; the default) or "upper" (A upper triangular: the sensor's x axis is exactly the tool's). The gauge is
part of the result, and the unknown rotation part of its covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.forward import GROUPS
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused, Reason, Remark
from highside.calibration.result import CalibrationResult, PoseFit
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES, SensorModel, sensor_columns, sensor_of
from highside.calibration.zone import Parameters, Zone
from highside.physics.effect import AXES

Gauge = Literal["symmetric", "upper"]

PRIOR_SCALE = 0.2
PRIOR_OFFSET_G = 0.3
PRIOR_NONLINEAR_G = 5e-3
"""Wide: sensors of hand sessions are uncalibrated MEMS as often as not."""
ADMIT_LOG_BAYES = 5.0
BAD_POSE_SIGMA = 5.0
DEFAULT_MOUNTING_STD_RAD = float(np.deg2rad(0.2))
MIN_POSES = 10
"""Nine unknowns and one to judge them by."""


def magnitude(
    poses: PoseSet,
    *,
    gauge: Gauge = "symmetric",
    mounting_std_rad: float = DEFAULT_MOUNTING_STD_RAD,
    nonlinear: Literal["auto", "none"] = "auto",
    reject_outlying: bool = True,
) -> CalibrationResult:
    """Solve for matrix (in a gauge) and offset from N still poses of any attitude, all of them if they agree.

    `mounting_std_rad`: how far the triad may be rotated against the tool, about each axis; it enters the covariance,
    since |g| does not show it. Quadratic terms are admitted only if the evidence favours them and if they predict
    omitted poses better. Raises CalibrationRefused for too few poses, or poses that do not cover the sphere.
    """
    if len(poses) < MIN_POSES:
        raise CalibrationRefused(
            Reason.TOO_FEW_POSES,
            f"{len(poses)} poses for nine unknowns by |g| alone; hold the tool still in at least {MIN_POSES} different "
            "attitudes, better twenty",
        )
    used = np.ones(len(poses), dtype=bool)
    fit = _fit(poses, used, gauge, ())
    if reject_outlying:
        used, fit = _leave_out_bad(poses, used, gauge, fit)
    _require_coverage(fit, poses)
    log_bayes = 0.0
    if nonlinear == "auto" and int(used.sum()) >= MIN_POSES + 3:
        wide = _fit(poses, used, gauge, GROUPS["quadratic"])
        log_bayes = _log_bayes(wide, 3)
        if log_bayes > ADMIT_LOG_BAYES and _held_out_rms(wide, used) < _held_out_rms(fit, used):
            fit = wide
    return _result(poses, used, gauge, fit, mounting_std_rad, log_bayes)


def leave_one_out_errors(poses: PoseSet, *, gauge: Gauge = "symmetric", nonlinear: bool = False) -> Array:
    """`|a| - 1` (N,) in g of each pose, corrected by a calibration from all others."""
    extra = GROUPS["quadratic"] if nonlinear else ()
    out = np.empty(len(poses))
    for i in range(len(poses)):
        used = np.ones(len(poses), dtype=bool)
        used[i] = False
        fit = _fit(poses, used, gauge, extra)
        out[i] = np.linalg.norm(sensor_of(fit.names, fit.theta).correct(poses.a[:, i])) - 1.0
    return out


@dataclass(frozen=True, slots=True)
class _MagnitudeFit:
    names: tuple[str, ...]
    theta: Array
    """(P,) all parameters, gauge applied"""
    free_covariance: Array
    """(F, F) of the free ones"""
    expand: Array
    """(P, F): free to all"""
    residual: Array
    """(N,) |g| - 1 of all poses"""
    std: Array
    """(N,) of the residuals by reading noise and tau"""
    leverage: Array
    """(N,)"""
    tau_g: float
    free: Array
    prior: Array


def _expansion(gauge: Gauge, extra: tuple[str, ...]) -> Array:
    """How the elements of A, b and the extra terms (P,) follow from the free parameters (F,)."""
    columns = []
    for i in range(3):
        for j in range(i, 3):
            column = np.zeros(9)
            column[3 * i + j] = 1.0
            if gauge == "symmetric":
                column[3 * j + i] = 1.0
            columns.append(column)
    affine = np.zeros((12, 9))
    affine[:9, :6] = np.array(columns).T
    affine[9:, 6:] = np.eye(3)
    out = np.zeros((12 + len(extra), 9 + len(extra)))
    out[:12, :9] = affine
    out[12:, 9:] = np.eye(len(extra))
    return out


def _fit(poses: PoseSet, used: NDArray[np.bool_], gauge: Gauge, extra: tuple[str, ...]) -> _MagnitudeFit:
    """Gauss-Newton on `|g| - 1` with weights; a few passes over tau."""
    names = MATRIX_NAMES + OFFSET_NAMES + extra
    expand = _expansion(gauge, extra)
    # start: offset at the middle of the range covered, scale by the mean magnitude about it
    middle = 0.5 * (poses.a.max(axis=1) + poses.a.min(axis=1)) if len(poses) >= 6 else np.zeros(3)
    scale = float(np.median(np.linalg.norm(poses.a - middle[:, None], axis=0)))
    mean = np.zeros(expand.shape[1])
    mean[[0, 3, 5]] = 1.0
    free = mean.copy()
    free[[0, 3, 5]] = scale
    free[6:9] = middle
    prior = np.concatenate(
        [np.full(6, PRIOR_SCALE), np.full(3, PRIOR_OFFSET_G), np.full(len(extra), PRIOR_NONLINEAR_G)]
    )
    noise = poses.noise_of_mean()
    tau2 = float(np.mean(noise**2))
    for _ in range(_MAX_PASSES):
        sensor = sensor_of(names, expand @ free)
        residual, jacobian, reading_var = _linearise(poses, sensor, names, expand, noise)
        tau2 = _tau(residual[used], jacobian[used], reading_var[used], free - mean, prior, tau2)
        weight = np.where(used, 1.0 / (reading_var + tau2), 0.0)
        normal = (jacobian.T * weight) @ jacobian + np.diag(1.0 / prior**2)
        target = residual - jacobian @ (free - mean)
        after = mean + np.linalg.solve(normal, -(jacobian.T * weight) @ target)
        moved = float(np.max(np.abs(after - free)))
        free = after
        if moved < 1e-10:
            break
    sensor = sensor_of(names, expand @ free)
    residual, jacobian, reading_var = _linearise(poses, sensor, names, expand, noise)
    variance = reading_var + tau2
    covariance: Array = np.asarray(
        np.linalg.inv((jacobian.T * np.where(used, 1.0 / variance, 0.0)) @ jacobian + np.diag(1.0 / prior**2)),
        dtype=np.float64,
    )
    leverage = np.einsum("nf,fg,ng->n", jacobian, covariance, jacobian) / variance
    return _MagnitudeFit(
        names,
        expand @ free,
        covariance,
        expand,
        residual,
        np.sqrt(variance),
        leverage,
        float(np.sqrt(tau2)),
        free,
        prior,
    )


_MAX_PASSES = 60


def _linearise(
    poses: PoseSet, sensor: SensorModel, names: tuple[str, ...], expand: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Residuals `|g| - 1` (N,), derivatives by the free parameters (N, F), variance by reading noise (N,)."""
    g = sensor.correct(poses.a)
    size = np.linalg.norm(g, axis=0)
    along = sensor.C.T @ (g / size)
    jacobian = -np.sum(along * sensor_columns(names, g), axis=1).T @ expand
    return size - 1.0, jacobian, np.sum((along * noise) ** 2, axis=0)


def _tau(residual: Array, jacobian: Array, reading_var: Array, away: Array, prior: Array, start: float) -> float:
    """Variance (g^2) of a pose beyond its reading noise: restricted maximum likelihood, Fisher scoring in its
    logarithm.
    """
    y = residual - jacobian @ away
    log_tau = float(np.log(max(start, 1e-16)))
    for _ in range(30):
        tau2 = float(np.exp(log_tau))
        weight = 1.0 / (reading_var + tau2)
        inverse = np.linalg.inv((jacobian.T * weight) @ jacobian + np.diag(1.0 / prior**2))
        P = np.diag(weight) - (weight[:, None] * jacobian) @ inverse @ (jacobian.T * weight)
        py = P @ y
        gradient = tau2 * (np.trace(P) - py @ py)
        step = -gradient / (tau2**2 * float(np.sum(P * P)) + 1e-12)
        log_tau = max(log_tau + float(np.clip(step, -2.0, 2.0)), float(np.log(1e-16)))
        if abs(step) < 1e-3:
            break
    return float(np.exp(log_tau))


def _studentised(fit: _MagnitudeFit, used: NDArray[np.bool_]) -> Array:
    """Departure (N,) of each pose from what the others predict, in standard deviations."""
    inside = np.abs(fit.residual) / (fit.std * np.sqrt(np.maximum(1.0 - fit.leverage, 1e-9)))
    outside = np.abs(fit.residual) / (fit.std * np.sqrt(1.0 + fit.leverage))
    return np.where(used, inside, outside)


def _held_out_rms(fit: _MagnitudeFit, used: NDArray[np.bool_]) -> float:
    held_out = fit.residual[used] / np.maximum(1.0 - fit.leverage[used], 1e-9)
    return float(np.sqrt(np.mean(held_out**2)))


def _leave_out_bad(
    poses: PoseSet, used: NDArray[np.bool_], gauge: Gauge, fit: _MagnitudeFit
) -> tuple[NDArray[np.bool_], _MagnitudeFit]:
    """Reject poses that the others contradict, one at a time. tau is estimated without the suspect, so that a
    bad pose cannot hide behind the scatter that it makes itself."""
    limit = max(1, len(poses) // 5)
    used = used.copy()
    while len(poses) - int(used.sum()) < limit:
        worst = int(np.argmax(np.where(used, _studentised(fit, used), 0.0)))
        trial = used.copy()
        trial[worst] = False
        without = _fit(poses, trial, gauge, ())
        if _studentised(without, trial)[worst] <= BAD_POSE_SIGMA:
            break
        used, fit = trial, without
    return used, fit


def _require_coverage(fit: _MagnitudeFit, poses: PoseSet) -> None:
    """Refuse attitudes that leave a parameter where its prior put it."""
    share = np.sqrt(np.diag(fit.free_covariance)) / fit.prior
    if np.max(share) > 0.5:
        direction = AXES[int(np.argmin(np.ptp(poses.a, axis=1)))]
        raise CalibrationRefused(
            Reason.UNOBSERVABLE,
            "the attitudes do not cover the sphere: offset and scale cannot be separated; "
            f"add poses with the {direction} axis up, and down",
        )


def _log_bayes(fit: _MagnitudeFit, count: int) -> float:
    """Log Bayes factor (Savage-Dickey) for the last `count` parameters."""
    theta = fit.free[-count:]
    covariance = fit.free_covariance[-count:, -count:]
    squared = float(theta @ np.linalg.solve(covariance, theta))
    return 0.5 * squared + 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(fit.prior[-count:]).sum())


def _result(
    poses: PoseSet, used: NDArray[np.bool_], gauge: Gauge, fit: _MagnitudeFit, mounting_std_rad: float, log_bayes: float
) -> CalibrationResult:
    covariance = fit.expand @ fit.free_covariance @ fit.expand.T
    A = sensor_of(fit.names, fit.theta).A
    for i, j in ((0, 1), (0, 2), (1, 2)):  # an unobservable rotation of the triad about each axis
        rotation = np.zeros((3, 3))
        rotation[i, j], rotation[j, i] = 1.0, -1.0
        turned = np.zeros(len(fit.names))
        turned[:9] = (A @ rotation).ravel() * mounting_std_rad
        covariance = covariance + np.outer(turned, turned)
    away = _studentised(fit, used)
    remarks = [
        Remark(
            Reason.GAUGE,
            f"|g| does not show a rotation of the triad: A is {gauge}; the axes may be turned by "
            f"{np.rad2deg(mounting_std_rad):.2g} deg against the tool (1 sigma, in the stated uncertainty)",
        )
    ]
    remarks += [
        Remark(
            Reason.BAD_POSE,
            f"{poses.label(int(i))} lies {away[i]:.3g} standard deviations from what the other poses predict; rejected",
            (poses.ids[int(i)],),
            refused=True,
        )
        for i in np.flatnonzero(~used)
    ]
    residual = np.zeros((3, len(poses)))
    g = sensor_of(fit.names, fit.theta).correct(poses.a)
    residual[:] = (A @ (g / np.linalg.norm(g, axis=0))) * fit.residual
    zone = Zone(
        "global",
        None,
        0.0,
        float(np.pi),
        Parameters(fit.names, fit.theta, covariance),
        float(np.sqrt(np.linalg.cond(fit.free_covariance / np.outer(fit.prior, fit.prior)))),
    )
    return CalibrationResult(
        method="magnitude",
        options={
            "gauge": gauge,
            "admitted": "quadratic" if len(fit.names) > 12 else "none",
            "log_bayes_quadratic": log_bayes,
            "held_out_rms_g": _held_out_rms(fit, used),
            "mounting_std_deg": float(np.rad2deg(mounting_std_rad)),
        },
        frame="gravity",
        zones=(zone,),
        poses=PoseFit(poses.ids, residual, away, used),
        variance={"reading_g": float(np.sqrt(np.mean(poses.noise_of_one() ** 2))), "pose_g": fit.tau_g},
        remarks=tuple(remarks),
    )

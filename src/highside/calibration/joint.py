"""The joint estimator: sensor and bench together, from all poses at all inclinations.

Forward model of a pose at the bench's setting (I, T):

    m = A w(I + tx + dI, T + dT; ty) + b + K2 f^2 + K3 f^3 + KX (products) + noise

The bench's tilt (tx, ty) is estimated beside the sensor; without it, weighting poses by their errors makes toolface
worse than plain least squares. The pose errors dI and dT are not parameters but part of the weights, and they are not
independent: the inclination stage does not move between the poses of an inclination, and the toolface encoder repeats
by station. So

    dI = inclination part + pose part,   dT = station part + pose part,

four variances (five where the reading noise is not known), found by restricted maximum likelihood: Newton steps with
the average-information matrix (Gilmour, Thompson and Cullis, Biometrics 51, 1995, 1440) in the logarithms of the
variances. Inclination and station parts are carried as random columns, so that a session of N poses costs N blocks of 3
x 3 and one symmetric system of some dozens of unknowns.

Every parameter has a prior (A 5 %, b 50 mg, tilt 0.05 deg, K 1 mg), wide against what a session tells. Nonlinear terms
and encoder harmonics enter by evidence only: the Bayes factor of each group by the Savage-Dickey ratio of its
posterior to its prior density at zero. A pose more than five standard deviations from what all others predict is named
and omitted.

What no pose can tell is said: with one inclination only, the offset is a third column of the matrix, `tx` a scale and
`ty` a rotation about the tool axis. The chuck's toolface zero is always such a rotation, hence a convention that is
kept apart.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from highside.arrays import Array
from highside.calibration.forward import (
    BASE_NAMES,
    GROUPS,
    PRIOR_MATRIX,
    PRIOR_OFFSET_G,
    Variances,
)
from highside.calibration.joint_result import result_of
from highside.calibration.linear_errors import NOMINAL_BENCH, BenchAccuracy
from highside.calibration.mixed_model import (
    MixedModelFit,
    PoseRegression,
    ThermalTerms,
    covariance_over_station_errors,
    covariance_with_variances,
    evaluate,
    initial_variances,
    reml_variances,
    rough_start,
    solve,
)
from highside.calibration.pose_rejection import poses_reconsidered, reject_outlying
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused, Reason
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor import sensor_of
from highside.physics.effect import AXES

ADMIT_LOG_BAYES = 5.0
"""A group is admitted when the data favour it by more than e^5, about 150 to 1."""
MAX_DEPARTURE = 6.0
"""Elements of A and b may lie this many prior standard deviations from nominal."""
MAX_SCATTER_RAD = float(np.deg2rad(0.5))
"""A session whose poses scatter by more than this is no calibration."""
FEW_INCLINATIONS = 3
"""Below this the covariance is averaged over what errors an inclination may have in common."""
MIN_ENCODER_STATIONS = 8
MIN_NONLINEAR_POSES = 20
Selection = Literal["auto", "none", "all"]


def joint(
    poses: PoseSet,
    *,
    bench: BenchAccuracy = NOMINAL_BENCH,
    nonlinear: Selection = "auto",
    encoder: Selection = "auto",
    estimate_variances: bool = True,
    toolface_zero_rad: float = 0.0,
    toolface_zero_std_rad: float = 0.0,
    thermal: ThermalTerms | None = None,
) -> CalibrationResult:
    """Estimate sensor and bench together; see the module's docstring.

    `nonlinear`, `encoder`: "auto" admits each group by evidence, "none" and "all" force. `toolface_zero_rad` is added
    to the toolfaces of the bench. `thermal` adds terms in temperature (see
    `highside.calibration.temperature`). Raises CalibrationRefused if there are fewer poses than needed or too many of
    them are bad; a request that the poses cannot answer in full is answered, with a remark marked `refused`.
    """
    _require_enough(poses)
    session = PoseRegression.of(poses, bench, toolface_zero_rad, thermal)
    forced = tuple(
        name
        for group, names in GROUPS.items()
        for name in names
        if (encoder if group == "encoder" else nonlinear) == "all"
    )
    used = np.ones(len(poses), dtype=bool)
    start = initial_variances(session, bench)
    names = BASE_NAMES + forced + (thermal.names if thermal else ())
    optional = _optional_groups(session, nonlinear, encoder)
    # bad poses are sought with every term that may be admitted, lest a missing term pass for bad poses
    wide_names = names + tuple(name for group in optional for name in GROUPS[group])
    fit = solve(session, wide_names, start, used, rough_start(session, wide_names))
    used, fit = reject_outlying(session, fit, start, used)
    admitted = [group for group in optional if log_bayes(fit, GROUPS[group]) > ADMIT_LOG_BAYES]
    names = names + tuple(name for group in admitted for name in GROUPS[group])
    if names != wide_names:
        fit = solve(session, names, start, used, fit.take(names))
        used, fit = reject_outlying(session, fit, start, used)
    variances = start
    if estimate_variances:
        variances = reml_variances(session, fit, start, bench)
        fit = solve(session, names, variances, used, fit.theta)
        dropped = [group for group in admitted if log_bayes(fit, GROUPS[group]) < ADMIT_LOG_BAYES]
        if dropped:
            names = tuple(name for name in names if not any(name in GROUPS[group] for group in dropped))
            fit = solve(session, names, variances, used, fit.take(names))
            variances = reml_variances(session, fit, variances, bench)
            fit = solve(session, names, variances, used, fit.theta)
    _require_agreement(session, fit, variances)
    _require_nominal(fit)
    used, fit, away = poses_reconsidered(session, fit, variances, used)
    covariance, student = fit.covariance, None
    if estimate_variances:
        covariance, student = covariance_with_variances(session, fit, variances, bench)
        if session.inclination_indicator.shape[1] < FEW_INCLINATIONS:
            covariance = covariance - fit.covariance + covariance_over_station_errors(session, fit, bench, variances)
    return result_of(
        session, fit, variances, used, away, bench, toolface_zero_rad, toolface_zero_std_rad, covariance, student
    )


def deviance_of(poses: PoseSet, thermal: ThermalTerms | None, bench: BenchAccuracy = NOMINAL_BENCH) -> float:
    """Minus twice the log evidence (but for a constant) of the affine sensor with these terms in temperature, the bench
    as stated. The terms' priors are proper, so that evidences of different sets of terms compare."""
    session = PoseRegression.of(poses, bench, 0.0, thermal)
    names = BASE_NAMES + (thermal.names if thermal else ())
    used = np.ones(len(poses), dtype=bool)
    start = initial_variances(session, bench)
    fit = solve(session, names, start, used, rough_start(session, names))
    return evaluate(session, fit.equations, fit.prior, start).deviance


def _require_enough(poses: PoseSet) -> None:
    poses.reference()
    if len(poses) < 5:
        raise CalibrationRefused(
            Reason.TOO_FEW_POSES,
            f"{len(poses)} poses are fewer than the 14 unknowns of sensor and bench need (three readings a pose); "
            "measure at least five poses, better four toolfaces at each of three inclinations",
        )


def _optional_groups(session: PoseRegression, nonlinear: Selection, encoder: Selection) -> list[str]:
    """Groups that are left to the evidence and that the number of poses and stations allows."""
    out = []
    if nonlinear == "auto" and len(session.poses) >= MIN_NONLINEAR_POSES:
        out += ["quadratic", "cubic", "cross"]
    if encoder == "auto" and session.toolface_indicator.shape[1] >= MIN_ENCODER_STATIONS:
        out.append("encoder")
    return out


def log_bayes(fit: MixedModelFit, group: tuple[str, ...]) -> float:
    """Log of the Bayes factor for a group of terms against their absence (Savage-Dickey density ratio at zero)."""
    index = [fit.names.index(name) for name in group]
    theta, covariance, prior = fit.theta[index], fit.covariance[np.ix_(index, index)], fit.prior[index]
    squared = float(theta @ np.linalg.solve(covariance, theta))
    return 0.5 * squared + 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(prior).sum())


def _require_agreement(session: PoseRegression, fit: MixedModelFit, variances: Variances) -> None:
    """Refuse poses that scatter as if their settings had nothing to do with their readings."""
    bench = max(variances.pose_inc + variances.station_inc, variances.pose_tf + variances.station_tf)
    reading = variances.reading * float(np.mean(session.noise**2))
    scatter = float(np.sqrt(max(bench, reading)))
    if scatter > MAX_SCATTER_RAD:
        worst = tuple(session.poses.ids[i] for i in np.argsort(-np.abs(fit.left_over).max(axis=0))[:3])
        raise CalibrationRefused(
            Reason.TOO_MANY_BAD,
            f"the poses contradict one another by {np.rad2deg(scatter):.2g} deg (worst: {', '.join(worst)}); "
            "check that readings and settings belong together, and measure again",
            worst,
        )


def _require_nominal(fit: MixedModelFit) -> None:
    """Refuse a matrix or offset that no sensor of nominal scale has: axes, signs or units are confused."""
    sensor = sensor_of(fit.names, fit.theta)
    A, b = sensor.A, sensor.b
    if np.abs(A - np.eye(3)).max() > MAX_DEPARTURE * PRIOR_MATRIX:
        rows = [f"{AXES[i]} reads {_axis_of(row)}" for i, row in enumerate(A)]
        raise CalibrationRefused(
            Reason.NOT_NOMINAL,
            f"this is not a sensor of nominal axes and scale: {', '.join(rows)}, elements up to "
            f"{np.abs(A - np.eye(3)).max():.2f} from nominal; check axes, signs, units and the toolface zero",
        )
    if np.abs(b).max() > MAX_DEPARTURE * PRIOR_OFFSET_G:
        raise CalibrationRefused(
            Reason.NOT_NOMINAL, f"an offset of {np.abs(b).max():.2f} g is no accelerometer in order; check the units"
        )


def _axis_of(row: Array) -> str:
    """Which axis of the tool a row of A mainly reads, with its sign."""
    largest = int(np.argmax(np.abs(row)))
    return ("-" if row[largest] < 0 else "+") + AXES[largest]

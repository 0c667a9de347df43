"""The joint estimator: sensor and bench together, from all poses at all inclinations.

Forward model of a pose at the bench's setting (I, T):

    m = A w(I + tx + dI, T + dT; ty) + b + K2 f^2 + K3 f^3 + KX (products) + noise

The bench's tilt (tx, ty) is estimated beside the sensor; without it, weighting poses by their errors makes toolface
worse than plain least squares. The pose errors dI and dT are not parameters but part of the weights, and they are not
independent: the inclination stage does not move within a ring, and the toolface encoder repeats by station. So

    dI = ring part + pose part,   dT = station part + pose part,

four variances (five where the reading noise is not known), found by restricted maximum likelihood: Newton steps with
the average-information matrix (Gilmour, Thompson and Cullis, Biometrics 51, 1995, 1440) in the logarithms of the
variances. Ring and station parts are carried as random columns, so that a session of N poses costs N blocks of 3 x 3
and one symmetric system of some dozens of unknowns.

Every parameter has a prior (A 5 %, b 50 mg, tilt 0.05 deg, K 1 mg), wide against what a session tells. Nonlinear terms
and encoder harmonics enter by evidence only: the Bayes factor of each group by the Savage-Dickey ratio of its
posterior to its prior density at zero. A pose more than five standard deviations from what all others predict is named
and left out.

What no pose can tell is said: with one inclination only, the offset is a third column of the matrix, `tx` a scale and
`ty` a rotation about the tool axis. The chuck's toolface zero is always such a rotation, hence a convention that is
kept apart.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.balance import closure_remarks, closures_of, rings_of_four
from highside.calibration.forward import (
    BASE_NAMES,
    GROUPS,
    PRIOR_MATRIX,
    PRIOR_OFFSET_G,
    Variances,
    linearise,
    pose_covariance,
)
from highside.calibration.mixed_model import (
    Fit,
    Session,
    ThermalTerms,
    covariance_over_ring_errors,
    covariance_with_variances,
    evaluate,
    initial_variances,
    reml_variances,
    rough_start,
    solve,
    studentised,
)
from highside.calibration.poses import Indices, PoseSet
from highside.calibration.result import (
    NOMINAL_BENCH,
    BenchAccuracy,
    CalibrationRefused,
    CalibrationResult,
    Parameters,
    PoseFit,
    Reason,
    Remark,
    Zone,
)
from highside.calibration.sensor import OFFSET_NAMES, sensor_of
from highside.physics.effect import AXES

ADMIT_LOG_BAYES = 5.0
"""A group is admitted when the data favour it by more than e^5, about 150 to 1."""
BAD_POSE_SIGMA = 5.0
MAX_BAD_SHARE = 0.1
MAX_DEPARTURE = 6.0
"""Elements of A and b may lie this many prior standard deviations from nominal."""
MAX_SCATTER_RAD = float(np.deg2rad(0.5))
"""A session whose poses scatter by more than this is no calibration."""
FEW_RINGS = 3
"""Below this the covariance is averaged over what errors a ring may have in common."""
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
    session = Session.of(poses, bench, toolface_zero_rad, thermal)
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
    used, fit = leave_out_bad(session, fit, start, used)
    admitted = [group for group in optional if log_bayes(fit, GROUPS[group]) > ADMIT_LOG_BAYES]
    names = names + tuple(name for group in admitted for name in GROUPS[group])
    if names != wide_names:
        fit = solve(session, names, start, used, fit.take(names))
        used, fit = leave_out_bad(session, fit, start, used)
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
        if session.ring_of.shape[1] < FEW_RINGS:
            covariance = covariance - fit.covariance + covariance_over_ring_errors(session, fit, bench, variances)
    return result_of(
        session, fit, variances, used, away, bench, toolface_zero_rad, toolface_zero_std_rad, covariance, student
    )


def deviance_of(poses: PoseSet, thermal: ThermalTerms | None, bench: BenchAccuracy = NOMINAL_BENCH) -> float:
    """Minus twice the log evidence (but for a constant) of the affine sensor with these terms in temperature, the bench
    as stated. The terms' priors are proper, so that evidences of different sets of terms compare."""
    session = Session.of(poses, bench, 0.0, thermal)
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


def leave_out_bad(
    session: Session, fit: Fit, variances: Variances, used: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Fit]:
    """Leave out, one at a time, the pose that departs most, while it departs by more than five standard deviations.

    Where the whole session scatters more than was stated the measure is the session's own: the median departure. If
    more than a tenth of the poses would have to go it is not the poses but the model, and none goes: the variances
    will say how badly it fits."""
    count = len(session.poses)
    limit = max(2, int(MAX_BAD_SHARE * count))
    keep, trial = used.copy(), fit
    while True:
        away = studentised(trial, keep)
        worst = int(np.argmax(away))
        typical = np.sort(away[keep])[int(keep.sum()) // 2]
        scale = max(1.0, float(typical) / _MEDIAN_DEPARTURE)
        if away[worst] <= BAD_POSE_SIGMA * scale:
            return keep, trial
        keep[worst] = False
        if count - int(keep.sum()) > limit:
            return used, fit
        trial = solve(session, trial.names, variances, keep, trial.theta)
        trial = solve(session, trial.names, variances, keep, trial.theta)


_MEDIAN_DEPARTURE = 1.538
"""Root of the median of chi-square with three degrees of freedom."""


def _optional_groups(session: Session, nonlinear: Selection, encoder: Selection) -> list[str]:
    """Groups that are left to the evidence and that the number of poses and stations allows."""
    out = []
    if nonlinear == "auto" and len(session.poses) >= MIN_NONLINEAR_POSES:
        out += ["quadratic", "cubic", "cross"]
    if encoder == "auto" and session.station_of.shape[1] >= MIN_ENCODER_STATIONS:
        out.append("encoder")
    return out


def log_bayes(fit: Fit, group: tuple[str, ...]) -> float:
    """Log of the Bayes factor for a group of terms against their absence (Savage-Dickey density ratio at zero)."""
    index = [fit.names.index(name) for name in group]
    theta, covariance, prior = fit.theta[index], fit.covariance[np.ix_(index, index)], fit.prior[index]
    squared = float(theta @ np.linalg.solve(covariance, theta))
    return 0.5 * squared + 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(prior).sum())


def _require_agreement(session: Session, fit: Fit, variances: Variances) -> None:
    """Refuse poses that scatter as if their settings had nothing to do with their readings."""
    bench = max(variances.pose_inc + variances.ring_inc, variances.pose_tf + variances.station_tf)
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


def _require_nominal(fit: Fit) -> None:
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


def poses_reconsidered(
    session: Session, fit: Fit, variances: Variances, used: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Fit, Array]:
    """Which poses are used (N,), the solution by these, and each pose's `departure` (N,), all three of the final
    variances: a pose left out under others may agree now, one that was used may not."""
    away = departure(session, fit, variances, used)
    again = used | (away <= BAD_POSE_SIGMA)
    if not np.array_equal(again, used) or away[used].max() > BAD_POSE_SIGMA:
        fit = solve(session, fit.names, variances, again, fit.theta)
        used, fit = leave_out_bad(session, fit, variances, again)
        away = departure(session, fit, variances, used)
    return used, fit, away


def departure(session: Session, fit: Fit, variances: Variances, used: NDArray[np.bool_]) -> Array:
    """Departure of every pose (N,) from what the others predict, in standard deviations: `studentised` for poses used;
    for those left out the distance of their reading from its prediction, all variances counted."""
    out = studentised(fit, used)
    for i in np.flatnonzero(~used):
        columns, own = _raw_columns(session, fit, variances, int(i), int(i))
        random = columns[:, fit.theta.size :]
        misfit = fit.left_over[:, i] - random @ fit.effects
        covariance = own + columns @ fit.inverse @ columns.T
        out[i] = np.sqrt(misfit @ np.linalg.solve(covariance, misfit))
    return out


def _raw_columns(session: Session, fit: Fit, variances: Variances, i: int, noise_of: int) -> tuple[Array, Array]:
    """Columns (3, P + R + S) of pose `i` and its own covariance (3, 3), with the reading noise of pose `noise_of`."""
    one = slice(i, i + 1)
    u, leg = (None, None) if session.thermal is None else (session.thermal.u[one], session.thermal.leg[one])
    design, by_inc, by_tf = linearise(fit.names, fit.theta, session.state.rows(one), u, leg)[1:]
    columns = np.concatenate([design[:, 0], by_inc * session.ring_of[i], by_tf * session.station_of[i]], axis=1)
    return columns, pose_covariance(session.noise[:, [noise_of]], by_inc, by_tf, variances)[0]


def _swapped_pairs(session: Session, fit: Fit, variances: Variances, bad: Indices) -> list[tuple[int, int]]:
    """Pairs among the poses left out whose readings fit each other's setting."""
    if bad.size < 2:
        return []
    predicted = session.poses.a - fit.left_over

    def fits(reading: int, setting: int) -> bool:
        columns, own = _raw_columns(session, fit, variances, setting, reading)
        misfit = session.poses.a[:, reading] - predicted[:, setting] - columns[:, fit.theta.size :] @ fit.effects
        return bool(misfit @ np.linalg.solve(own + columns @ fit.inverse @ columns.T, misfit) < BAD_POSE_SIGMA**2)

    return [(int(i), int(j)) for k, i in enumerate(bad) for j in bad[k + 1 :] if fits(i, j) and fits(j, i)]


def result_of(
    session: Session,
    fit: Fit,
    variances: Variances,
    used: NDArray[np.bool_],
    away: Array,
    bench: BenchAccuracy,
    toolface_zero_rad: float,
    toolface_zero_std_rad: float,
    covariance: Array,
    student: Array | None,
) -> CalibrationResult:
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
    fours = [four for four in rings_of_four(poses) if used[four].all()]
    # the closure is a property of an affine sensor: what is known of the other terms is taken out first
    affine = poses if sensor.is_linear else replace(poses, a=poses.a - sensor.nonlinear(sensor.correct(poses.a)))
    closures = closures_of(affine, fours, [sensor.A] * len(fours), pose_covariance=per_pose)
    misfit = np.zeros(3)
    if variances.reading > MAX_READING_FACTOR**2:
        # structure that no term has follows the attitude: it does not average out, and every later reading has it;
        # its size is that of the residuals, of which the bench's part cannot be told apart
        misfit = np.sqrt(np.mean(fit.left_over[:, used] ** 2, axis=1))
        index = [fit.names.index(name) for name in OFFSET_NAMES]
        covariance = covariance.copy()
        covariance[index, index] += misfit**2
    zone = Zone(
        "global",
        None,
        0.0,
        float(np.pi),
        Parameters(fit.names, fit.theta, covariance, student),
        _root_condition(fit),
    )
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
            "ring_inc_rad": float(np.sqrt(variances.ring_inc)),
            "station_tf_rad": float(np.sqrt(variances.station_tf)),
            **{f"misfit_{axis}_g": float(size) for axis, size in zip(AXES, misfit, strict=True)},
        },
        remarks=tuple(remarks + closure_remarks(closures)),
        toolface_zero_rad=toolface_zero_rad,
        toolface_zero_std_rad=toolface_zero_std_rad,
    )


def _pose_remarks(session: Session, fit: Fit, variances: Variances, bad: Indices, away: Array) -> list[Remark]:
    poses = session.poses
    remarks = []
    pairs = _swapped_pairs(session, fit, variances, bad)
    for i, j in pairs:
        remarks.append(
            Remark(
                Reason.SWAPPED_POSES,
                f"{poses.label(i)} and {poses.label(j)} are swapped: each reading fits the other's setting; "
                "both left out",
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


def _observability_remarks(session: Session, fit: Fit) -> list[Remark]:
    """What the poses cannot tell apart: parameters about which they say little more than was known before."""
    share = np.sqrt(np.diag(fit.covariance)) / fit.prior
    base = [i for i, name in enumerate(fit.names) if name in BASE_NAMES]
    blind = [i for i in base if share[i] > UNDETERMINED_SHARE]
    if not blind:
        return []
    std = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(std, std)
    phrases = []
    told: set[int] = set()
    for i in blind:
        partners = [j for j in base if j != i and abs(correlation[i, j]) > 0.5]
        if i in told:
            continue
        told.update({i, *partners})
        if partners:
            phrases.append(f"{fit.names[i]} from {', '.join(fit.names[j] for j in partners)}")
        else:
            phrases.append(f"{fit.names[i]} at all")
    from highside.calibration.advice import next_best_poses

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
        ("inclination", variances.pose_inc + variances.ring_inc),
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


def _root_condition(fit: Fit) -> float:
    """Condition number of the whitened design, each parameter in units of its prior."""
    sizes = np.linalg.eigvalsh(fit.covariance / np.outer(fit.prior, fit.prior))
    return float(np.sqrt(sizes[-1] / sizes[0]))


def _reading_noise(session: Session, variances: Variances) -> float:
    """Noise of one reading: as measured, or where it was not, as the residuals say."""
    stated = float(np.mean(session.noise**2 * session.poses.n))
    return float(np.sqrt(stated if session.poses.std_known else stated * variances.reading))

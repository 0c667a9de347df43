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

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from highside.calibration.balance import closure_of, closure_remarks, rings_of_four
from highside.calibration.forward import (
    BASE_NAMES,
    GROUPS,
    Variances,
    linearise,
    pose_covariance,
    prior_mean,
    prior_std,
    sensor_of,
    whiten,
)
from highside.calibration.poses import Array, Indices, PoseSet
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

ADMIT_LOG_BAYES = 5.0
"""A group is admitted when the data favour it by more than e^5, about 150 to 1."""
BAD_POSE_SIGMA = 5.0
MAX_BAD_SHARE = 0.2
MIN_ENCODER_STATIONS = 8
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
) -> CalibrationResult:
    """Estimate sensor and bench together; see the module's docstring.

    `nonlinear`, `encoder`: "auto" admits each group by evidence, "none" and "all" force. `toolface_zero_rad` is added
    to the toolfaces of the bench. Raises CalibrationRefused if there are fewer poses than needed or too many of them
    are bad; a request that the poses cannot answer in full is answered, with a remark marked `refused`.
    """
    _require_enough(poses)
    session = _Session.of(poses, bench, toolface_zero_rad)
    forced = tuple(
        name
        for group, names in GROUPS.items()
        for name in names
        if (encoder if group == "encoder" else nonlinear) == "all"
    )
    used = np.ones(len(poses), dtype=bool)
    start = _initial_variances(session, bench)
    names = BASE_NAMES + forced
    fit = _solve(session, names, start, used, prior_mean(names))
    fit = _solve(session, names, start, used, fit.theta)
    used, fit = _leave_out_bad(session, fit, start, used)
    optional = _optional_groups(session, nonlinear, encoder, used)
    if optional:
        wide_names = names + tuple(name for group in optional for name in GROUPS[group])
        wide = _solve(session, wide_names, start, used, _extended(fit, wide_names))
        admitted = [group for group in optional if _log_bayes(wide, GROUPS[group]) > ADMIT_LOG_BAYES]
        if admitted:
            names = names + tuple(name for group in admitted for name in GROUPS[group])
            fit = _solve(session, names, start, used, _extended(fit, names))
            # terms that were missing may have passed for bad poses
            used, fit = _leave_out_bad(session, fit, start, np.ones(len(poses), dtype=bool))
    variances = start
    if estimate_variances:
        variances = _estimate_variances(session, fit, start, bench)
        fit = _solve(session, names, variances, used, fit.theta)
        dropped = [
            group
            for group in optional
            if GROUPS[group][0] in names and _log_bayes(fit, GROUPS[group]) < ADMIT_LOG_BAYES
        ]
        if dropped:
            names = tuple(name for name in names if not any(name in GROUPS[group] for group in dropped))
            fit = _solve(session, names, variances, used, fit.take(names))
            variances = _estimate_variances(session, fit, variances, bench)
            fit = _solve(session, names, variances, used, fit.theta)
        again = used | (_departure(session, fit, variances, used) <= BAD_POSE_SIGMA)
        if not np.array_equal(again, used):
            fit = _solve(session, names, variances, again, fit.theta)
        used, fit = _leave_out_bad(session, fit, variances, again)
    return _result(session, fit, variances, used, bench, toolface_zero_rad, toolface_zero_std_rad)


@dataclass(frozen=True, slots=True)
class _Session:
    """What of a session does not change between solutions: N poses with R rings and S stations."""

    poses: PoseSet
    inc: Array
    tf: Array
    noise: Array
    """(3, N) of the means"""
    ring_of: Array
    """(N, R), 0 or 1"""
    station_of: Array
    """(N, S), 0 or 1"""
    bench: BenchAccuracy

    @classmethod
    def of(cls, poses: PoseSet, bench: BenchAccuracy, toolface_zero_rad: float) -> _Session:
        inc, tf = poses.reference()
        return cls(
            poses=poses,
            inc=inc,
            tf=tf + toolface_zero_rad,
            noise=poses.noise_of_mean(),
            ring_of=_indicator(poses.rings()),
            station_of=_indicator(poses.stations()),
            bench=bench,
        )


def _indicator(groups: Indices) -> Array:
    return np.asarray(groups[:, None] == np.arange(int(groups.max()) + 1), dtype=float)


def _initial_variances(session: _Session, bench: BenchAccuracy) -> Variances:
    half = 0.5 * bench.pose_rad**2
    return Variances(half, half, half, half)


def _require_enough(poses: PoseSet) -> None:
    poses.reference()
    if len(poses) < 5:
        raise CalibrationRefused(
            Reason.TOO_FEW_POSES,
            f"{len(poses)} poses are fewer than the 14 unknowns of sensor and bench need (three readings a pose); "
            "measure at least five poses, better four toolfaces at each of three inclinations",
        )


@dataclass(frozen=True, slots=True)
class _Fit:
    """A solution: parameters `theta` (P,) with their covariance, and what is needed to judge its poses."""

    names: tuple[str, ...]
    theta: Array
    covariance: Array
    prior: Array
    """(P,) standard deviations"""
    whitened: Array
    """(N, 3, P + R + S) columns: design, rings, stations"""
    inverse: Array
    """(P + R + S, P + R + S) inverse of the penalised normal matrix"""
    residual: Array
    """(N, 3) whitened, of the poses used; ring and station parts taken out"""
    left_over: Array
    """(3, N) raw residual of all poses, in g, random parts not taken out"""
    by_inc: Array
    by_tf: Array
    """(3, N) derivatives of a reading by the pose's inclination and toolface"""

    def take(self, names: tuple[str, ...]) -> Array:
        return self.theta[[self.names.index(name) for name in names]]


def _extended(fit: _Fit, names: tuple[str, ...]) -> Array:
    known = dict(zip(fit.names, fit.theta.tolist(), strict=True))
    return np.array([known.get(name, 0.0) for name in names])


def _solve(session: _Session, names: tuple[str, ...], variances: Variances, used: NDArray[np.bool_], at: Array) -> _Fit:
    """One Gauss-Newton step from `at` with given variances: penalised generalised least squares."""
    reading, design, by_inc, by_tf = linearise(names, at, session.inc, session.tf)
    prior = prior_std(names, session.bench)
    mean = prior_mean(names)
    misfit = session.poses.a - reading
    y = misfit + design @ (at - mean)
    stacked = np.concatenate([design, by_inc[:, :, None], by_tf[:, :, None], y[:, :, None]], axis=2)
    white = whiten(stacked.transpose(1, 0, 2), session.noise, by_inc, by_tf, variances)
    white[~used] = 0.0
    size = len(names)
    columns = _with_random_columns(white, size, session)
    penalty = _penalty(prior, variances, session)
    flat = columns.reshape(-1, columns.shape[2])
    normal = flat.T @ flat
    normal[np.diag_indices_from(normal)] += penalty
    inverse = np.linalg.inv(normal)
    yw = white[:, :, size + 2].reshape(-1)
    solution = inverse @ (flat.T @ yw)
    residual = (yw - flat @ solution).reshape(-1, 3)
    theta = mean + solution[:size]
    return _Fit(
        names=names,
        theta=theta,
        covariance=inverse[:size, :size],
        prior=prior,
        whitened=columns,
        inverse=inverse,
        residual=residual,
        left_over=y - design @ solution[:size],
        by_inc=by_inc,
        by_tf=by_tf,
    )


def _with_random_columns(white: Array, size: int, session: _Session) -> Array:
    """The whitened design followed by a column for each ring and each station."""
    rings = white[:, :, size, None] * session.ring_of[:, None, :]
    stations = white[:, :, size + 1, None] * session.station_of[:, None, :]
    return np.concatenate([white[:, :, :size], rings, stations], axis=2)


def _penalty(prior: Array, variances: Variances, session: _Session) -> Array:
    return np.concatenate(
        [
            1.0 / prior**2,
            np.full(session.ring_of.shape[1], 1.0 / variances.ring_inc),
            np.full(session.station_of.shape[1], 1.0 / variances.station_tf),
        ]
    )


def _estimate_variances(session: _Session, fit: _Fit, start: Variances, bench: BenchAccuracy) -> Variances:
    """Restricted maximum likelihood of the variance components, with weak priors that keep them off zero.

    Minimises `log|V| + y' V^-1 y` (V with the parameters' priors in it, so that their number is accounted for) plus,
    for each component, `_VARIANCE_PRIOR` pseudo-observations of the size stated for the bench.
    """
    used = np.any(fit.whitened != 0, axis=(1, 2))
    reading, design, by_inc, by_tf = linearise(fit.names, fit.theta, session.inc, session.tf)
    y = session.poses.a - reading + design @ (fit.theta - prior_mean(fit.names))
    size = len(fit.names)
    estimated = [0, 1, 2, 3] if session.poses.std_known else [0, 1, 2, 3, 4]
    axes = [np.zeros_like(y) for _ in range(3)]
    for k in range(3):
        axes[k][k] = session.noise[k]
    extra = [] if session.poses.std_known else axes
    stacked = np.stack([*np.moveaxis(design, 2, 0), by_inc, by_tf, y, *extra], axis=2).transpose(1, 0, 2)[used]
    ring_of, station_of = session.ring_of[used], session.station_of[used]
    part = _Session(
        session.poses, session.inc[used], session.tf[used], session.noise[:, used], ring_of, station_of, session.bench
    )
    rings, stations = ring_of.shape[1], station_of.shape[1]
    stated = bench.pose_rad**2
    log_v = np.log(start.as_array()[estimated])
    previous = np.inf
    damping = 0.0
    best = log_v
    state: tuple[Array, Array] | None = None
    for _ in range(_MAX_REML_STEPS):
        v = np.exp(log_v)
        now = Variances(*v) if len(v) == 5 else Variances(v[0], v[1], v[2], v[3], start.reading)
        white = whiten(stacked, part.noise, by_inc[:, used], by_tf[:, used], now)
        columns = _with_random_columns(white, size, part)
        flat = columns.reshape(-1, columns.shape[2])
        normal = flat.T @ flat
        penalty = _penalty(fit.prior, now, part)
        normal[np.diag_indices_from(normal)] += penalty
        factor = np.linalg.cholesky(normal)
        inverse = np.linalg.inv(normal)
        yw = white[:, :, size + 2].reshape(-1)
        solution = inverse @ (flat.T @ yw)
        py = yw - flat @ solution
        log_det = (
            2.0 * np.log(np.diagonal(factor)).sum()
            - np.log(penalty).sum()
            + _log_det(part, by_inc[:, used], by_tf[:, used], now)
        )
        objective = log_det + float(yw @ py) + _variance_penalty(v, stated)
        if objective > previous + 1e-9:
            # overshot: go back half of the way
            log_v = 0.5 * (log_v + best)
            damping += 1.0
            if damping > 6:
                break
            continue
        improvement = previous - objective
        previous, best = objective, log_v
        state = _information(white, flat, inverse, solution, py, size, rings, stations, part, v)
        if improvement < 1e-3:
            break
        gradient, hessian = state
        prior_gradient, prior_hessian = _variance_penalty_derivatives(v, stated)
        gradient = gradient + prior_gradient
        hessian = hessian + prior_hessian + 1e-6 * np.eye(len(v))
        step = -np.linalg.solve(hessian, gradient)
        step *= min(1.0, 2.0 / float(np.max(np.abs(step)) + 1e-300))
        log_v = np.clip(log_v + step, np.log(stated * 1e-6), None)
        if len(v) == 5:
            log_v[4] = best[4] + step[4]
    v = np.exp(best)
    return Variances(*v) if len(v) == 5 else Variances(v[0], v[1], v[2], v[3], start.reading)


_MAX_REML_STEPS = 25
_TOTAL_PRIOR = 10.0
_SPLIT_PRIOR = 0.5
_SMALL_SHARE = 0.05


def _variance_penalty(v: Array, stated: float) -> float:
    """Minus twice the log density of the priors on the bench's components.

    What is stated of a bench is the size of one setting's error, hence the *sum* of its own and its common part: scaled
    inverse chi-square about `stated` with `_TOTAL_PRIOR` degrees of freedom. How it splits is left to the data, but for a
    weak term that keeps each part off zero. With four stations no session could estimate the station part by itself, the
    mean of the four being a rotation of the tool; the sum and the pose part give it.
    """
    totals = v[:2] + v[2:4]
    split = np.log(v[:4]) + _SMALL_SHARE * stated / v[:4]
    return float(_TOTAL_PRIOR * np.sum(np.log(totals) + stated / totals) + _SPLIT_PRIOR * np.sum(split))


def _variance_penalty_derivatives(v: Array, stated: float) -> tuple[Array, Array]:
    """Gradient and (positive) second derivative of `_variance_penalty` by the logarithms of the variances."""
    gradient = np.zeros_like(v)
    hessian = np.zeros((v.size, v.size))
    small = _SMALL_SHARE * stated / v[:4]
    gradient[:4] = _SPLIT_PRIOR * (1.0 - small)
    hessian[range(4), range(4)] = _SPLIT_PRIOR * small
    for pair in ([0, 2], [1, 3]):
        total = v[pair].sum()
        share = v[pair] / total
        gradient[pair] += _TOTAL_PRIOR * (1.0 - stated / total) * share
        hessian[np.ix_(pair, pair)] += _TOTAL_PRIOR * np.outer(share, share)
    return gradient, hessian


def _log_det(session: _Session, by_inc: Array, by_tf: Array, variances: Variances) -> float:
    covariance = pose_covariance(session.noise, by_inc, by_tf, variances)
    return float(np.linalg.slogdet(covariance)[1].sum())


def _information(
    white: Array,
    flat: Array,
    inverse: Array,
    solution: Array,
    py: Array,
    size: int,
    rings: int,
    stations: int,
    session: _Session,
    v: Array,
) -> tuple[Array, Array]:
    """Gradient and average-information matrix of the likelihood by the logarithms of the variances `v`."""
    residual = py.reshape(-1, 3)
    inc_w, tf_w = white[:, :, size], white[:, :, size + 1]
    ring = slice(size, size + rings)
    station = slice(size + rings, size + rings + stations)
    diagonal = np.diagonal(inverse)
    gradient = np.empty(len(v))
    spread = []
    for k, column in enumerate((inc_w, tf_w)):
        projection = np.einsum("nij,ni->nj", flat.reshape(-1, 3, flat.shape[1]), column)
        trace = np.sum(column**2) - np.sum((projection @ inverse) * projection)
        t = np.sum(column * residual, axis=1)
        gradient[k] = v[k] * (trace - np.sum(t**2))
        spread.append(column * t[:, None])
    for k, (where, groups, column) in enumerate(
        ((ring, session.ring_of, inc_w), (station, session.station_of, tf_w)), start=2
    ):
        count = where.stop - where.start
        t = solution[where] / v[k]
        trace = (count - np.sum(diagonal[where]) / v[k]) / v[k]
        gradient[k] = v[k] * (trace - np.sum(t**2))
        spread.append(column * (groups @ t)[:, None])
    if len(v) == 5:
        total = np.zeros_like(residual)
        trace = 0.0
        for k in range(3):
            column = white[:, :, size + 3 + k]
            projection = np.einsum("nij,ni->nj", flat.reshape(-1, 3, flat.shape[1]), column)
            trace += np.sum(column**2) - np.sum((projection @ inverse) * projection)
            total += column * np.sum(column * residual, axis=1)[:, None]
        gradient[4] = v[4] * (trace - np.sum(total * residual))
        spread.append(total)
    S = np.stack([s.reshape(-1) for s in spread], axis=1)
    FS = flat.T @ S
    hessian = (S.T @ S - FS.T @ inverse @ FS) * np.outer(v, v)
    return gradient, hessian


def _studentised(fit: _Fit, used: NDArray[np.bool_]) -> Array:
    """How many standard deviations each pose used lies from what all the others predict (N,); 0 for those not used.

    In whitened form the residual e of a pose with hat block H has the leave-one-out square `e' (1 - H)^-1 e`,
    chi-square with three degrees of freedom; its root is returned.
    """
    hat = np.einsum("nik,kl,njl->nij", fit.whitened, fit.inverse, fit.whitened, optimize=True)
    left = np.eye(3) - hat
    out = np.einsum("ni,nij,nj->n", fit.residual, np.linalg.inv(left + 1e-12 * np.eye(3)), fit.residual)
    return np.where(used, np.sqrt(np.maximum(out, 0.0)), 0.0)


def _leave_out_bad(
    session: _Session, fit: _Fit, variances: Variances, used: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], _Fit]:
    """Leave out, one at a time, the pose that departs most, while it departs by more than five standard deviations.

    Where the whole session scatters more than was stated the measure is the session's own: the median departure."""
    count = len(session.poses)
    limit = max(1, int(MAX_BAD_SHARE * count))
    used = used.copy()
    while True:
        away = _studentised(fit, used)
        worst = int(np.argmax(away))
        scale = max(1.0, float(np.median(away[used])) / _MEDIAN_DEPARTURE)
        if away[worst] <= BAD_POSE_SIGMA * scale:
            return used, fit
        used[worst] = False
        if count - int(used.sum()) > limit:
            raise CalibrationRefused(
                Reason.TOO_MANY_BAD,
                f"more than {limit} of {count} poses contradict the others; check the toolface zero, the sign of the axes and "
                "the units, and measure again",
                tuple(session.poses.ids[i] for i in np.flatnonzero(~used)),
            )
        fit = _solve(session, fit.names, variances, used, fit.theta)
        fit = _solve(session, fit.names, variances, used, fit.theta)


_MEDIAN_DEPARTURE = 1.538
"""Root of the median of chi-square with three degrees of freedom."""


def _optional_groups(session: _Session, nonlinear: Selection, encoder: Selection, used: NDArray[np.bool_]) -> list[str]:
    """Groups that are left to the evidence and that the number of poses and stations allows."""
    out = []
    readings = 3 * int(used.sum())
    if nonlinear == "auto" and readings >= 60:
        out += ["quadratic", "cubic", "cross"]
    if encoder == "auto" and session.station_of.shape[1] >= MIN_ENCODER_STATIONS:
        out.append("encoder")
    return out


def _log_bayes(fit: _Fit, group: tuple[str, ...]) -> float:
    """Log of the Bayes factor for a group of terms against their absence (Savage-Dickey density ratio at zero)."""
    index = [fit.names.index(name) for name in group]
    theta, covariance, prior = fit.theta[index], fit.covariance[np.ix_(index, index)], fit.prior[index]
    squared = float(theta @ np.linalg.solve(covariance, theta))
    return 0.5 * squared + 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.log(prior).sum())


def _departure(session: _Session, fit: _Fit, variances: Variances, used: NDArray[np.bool_]) -> Array:
    """Departure of every pose (N,) from what the others predict, in standard deviations: `_studentised` for poses used;
    for those left out the distance of their reading from its prediction, all variances counted."""
    out = _studentised(fit, used)
    left = np.flatnonzero(~used)
    if left.size:
        covariance = _prediction_covariance(session, fit, variances)[left]
        misfit = fit.left_over[:, left].T
        out[left] = np.sqrt(np.einsum("ni,nij,nj->n", misfit, np.linalg.inv(covariance), misfit))
    return out


def _prediction_covariance(session: _Session, fit: _Fit, variances: Variances) -> Array:
    """Covariance (N, 3, 3) of a fresh reading at each pose about its prediction."""
    design = linearise(fit.names, fit.theta, session.inc, session.tf)[1].transpose(1, 0, 2)
    total = Variances(
        variances.pose_inc + variances.ring_inc,
        variances.pose_tf + variances.station_tf,
        0.0,
        0.0,
        variances.reading,
    )
    own = pose_covariance(session.noise, fit.by_inc, fit.by_tf, total)
    return np.asarray(own + design @ fit.covariance @ design.transpose(0, 2, 1))


def _swapped_pairs(session: _Session, fit: _Fit, variances: Variances, bad: Indices) -> list[tuple[int, int]]:
    """Pairs among the poses left out whose readings fit each other's setting."""
    if bad.size < 2:
        return []
    predicted = session.poses.a - fit.left_over
    inverse = np.linalg.inv(_prediction_covariance(session, fit, variances))

    def fits(reading: int, setting: int) -> bool:
        misfit = session.poses.a[:, reading] - predicted[:, setting]
        return bool(misfit @ inverse[setting] @ misfit < BAD_POSE_SIGMA**2)

    return [(int(i), int(j)) for k, i in enumerate(bad) for j in bad[k + 1 :] if fits(i, j) and fits(j, i)]


def _result(
    session: _Session,
    fit: _Fit,
    variances: Variances,
    used: NDArray[np.bool_],
    bench: BenchAccuracy,
    toolface_zero_rad: float,
    toolface_zero_std_rad: float,
) -> CalibrationResult:
    poses = session.poses
    bad = np.flatnonzero(~used)
    away = _departure(session, fit, variances, used)
    remarks = _pose_remarks(session, fit, variances, bad, away)
    remarks += _observability_remarks(session, fit)
    remarks += _scatter_remarks(variances, bench)
    scaled = fit.covariance / np.outer(fit.prior, fit.prior)
    per_pose = pose_covariance(
        session.noise,
        fit.by_inc,
        fit.by_tf,
        Variances(variances.pose_inc, variances.pose_tf + variances.station_tf, 0.0, 0.0, variances.reading),
    )
    A = sensor_of(fit.names, fit.theta).A
    closures = [
        closure_of(poses, four, A, pose_covariance=per_pose) for four in rings_of_four(poses) if used[four].all()
    ]
    zone = Zone(
        "global",
        None,
        0.0,
        float(np.pi),
        Parameters(fit.names, fit.theta, fit.covariance),
        float(np.sqrt(np.linalg.cond(scaled))),
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
            "reading_g": float(np.sqrt(variances.reading * np.mean(poses.noise_of_one() ** 2))),
            "pose_inc_rad": float(np.sqrt(variances.pose_inc)),
            "pose_tf_rad": float(np.sqrt(variances.pose_tf)),
            "ring_inc_rad": float(np.sqrt(variances.ring_inc)),
            "station_tf_rad": float(np.sqrt(variances.station_tf)),
        },
        remarks=tuple(remarks + closure_remarks(closures)),
        toolface_zero_rad=toolface_zero_rad,
        toolface_zero_std_rad=toolface_zero_std_rad,
    )


def _pose_remarks(session: _Session, fit: _Fit, variances: Variances, bad: Indices, away: Array) -> list[Remark]:
    poses = session.poses
    remarks = []
    pairs = _swapped_pairs(session, fit, variances, bad)
    for i, j in pairs:
        remarks.append(
            Remark(
                Reason.SWAPPED_POSES,
                f"{poses.label(i)} and {poses.label(j)} are swapped: each reading fits the other's setting; both left out",
                (poses.ids[i], poses.ids[j]),
                refused=True,
            )
        )
    explained = {k for pair in pairs for k in pair}
    for i in bad:
        if int(i) not in explained:
            remarks.append(
                Remark(
                    Reason.BAD_POSE,
                    f"{poses.label(int(i))} lies {away[i]:.3g} standard deviations from what the other poses predict; "
                    "left out: measure it again",
                    (poses.ids[int(i)],),
                    refused=True,
                )
            )
    return remarks


def _observability_remarks(session: _Session, fit: _Fit) -> list[Remark]:
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
            f"these poses cannot tell {'; '.join(phrases)}; the stated uncertainty says so. The pose that would help most: "
            f"inclination {np.rad2deg(best.inc_rad):.1f}, toolface {np.rad2deg(best.tf_rad):.0f} deg",
            refused=True,
        )
    ]


UNDETERMINED_SHARE = 0.5
"""A parameter whose standard deviation is still above this share of its prior's has not been measured."""


def _scatter_remarks(variances: Variances, bench: BenchAccuracy) -> list[Remark]:
    remarks = []
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

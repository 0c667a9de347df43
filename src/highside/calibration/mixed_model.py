"""The mixed model behind the joint estimator: parameters with priors, errors of the bench with variances.

A session of N poses, linearised, is `y = design (theta - prior mean) + errors`. The errors of a pose by reading noise
and by its own dI and dT are one block of 3 x 3; what an inclination or a station has in common is carried as random
columns, so that a session costs N blocks and one symmetric system of some dozens of unknowns.

The variances are found by restricted maximum likelihood: Newton steps with the average-information matrix (Gilmour,
Thompson and Cullis, Biometrics 51, 1995, 1440) in their logarithms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.forward import StructureSize, Variances, linearise, pose_parts, prior_mean, prior_std, whiten
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import Indices, PoseSet
from highside.calibration.student import widened
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState


@dataclass(frozen=True, slots=True)
class ThermalTerms:
    """Terms in temperature: their names (`b_x@1`, `A_xx@1`, `hyst_x`), reduced temperature `u` and `leg` (+1 up, -1
    down) of each pose (N,)."""

    names: tuple[str, ...]
    u: Array
    leg: Array


@dataclass(frozen=True, slots=True)
class PoseRegression:
    """What of a session does not change between solutions: N poses with R inclinations and S stations."""

    poses: PoseSet
    state: ChainState
    """the bench's settings"""
    noise: Array
    """(3, N) of the means"""
    inclination_indicator: Array
    """(N, R), 0 or 1"""
    toolface_indicator: Array
    """(N, S), 0 or 1"""
    bench: BenchAccuracy
    thermal: ThermalTerms | None
    structure: StructureSize | None = None

    @classmethod
    def of(
        cls, poses: PoseSet, bench: BenchAccuracy, toolface_zero_rad: float, thermal: ThermalTerms | None = None
    ) -> PoseRegression:
        inc, tf = poses.reference()
        return cls(
            poses=poses,
            state=ChainState.build(inc, tf + toolface_zero_rad),
            noise=poses.noise_of_mean(),
            inclination_indicator=_indicator(poses.inclination_stations()),
            toolface_indicator=_indicator(poses.toolface_stations()),
            bench=bench,
            thermal=thermal,
        )

    def linearise(self, names: tuple[str, ...], theta: Array) -> tuple[Array, Array, Array, Array]:
        """`forward.linearise` at the poses of the session."""
        if self.thermal is None:
            return linearise(names, theta, self.state)
        return linearise(names, theta, self.state, self.thermal.u, self.thermal.leg)


def _indicator(groups: Indices) -> Array:
    return np.asarray(groups[:, None] == np.arange(int(groups.max()) + 1), dtype=float)


def initial_variances(session: PoseRegression, bench: BenchAccuracy) -> Variances:
    half = 0.5 * bench.pose_rad**2
    return Variances(half, half, half, half)


@dataclass(frozen=True, slots=True)
class Equations:
    """A session linearised: `y = design (theta - prior mean)` and errors, before anything is weighted."""

    stacked: Array
    """(N, 3, P + 6): design, directions of dI and of dT, those of the three axes' reading noise, and y"""
    parts: Array
    """(3, N, 9), see `forward.pose_parts`"""
    used: NDArray[np.bool_]
    """(N,)"""

    @classmethod
    def of(
        cls, session: PoseRegression, design: Array, by_inc: Array, by_tf: Array, y: Array, used: NDArray[np.bool_]
    ) -> Equations:
        """From the derivatives (3, N, P), (3, N), (3, N) of the readings and the linearised readings `y` (3, N)."""
        count, size = y.shape[1], design.shape[2]
        stacked = np.zeros((count, 3, size + 6))
        stacked[:, :, :size] = design.transpose(1, 0, 2)
        stacked[:, :, size] = by_inc.T
        stacked[:, :, size + 1] = by_tf.T
        stacked.reshape(count, -1)[:, size + 2 :: size + 7] = session.noise.T
        stacked[:, :, size + 5] = y.T
        return cls(stacked, pose_parts(session.noise, by_inc, by_tf), used)

    @property
    def size(self) -> int:
        """Number of parameters, P."""
        return int(self.stacked.shape[2]) - 6


@dataclass(frozen=True, slots=True)
class MixedModelFit:
    """A solution: parameters `theta` (P,) with their covariance, and what is needed to judge its poses."""

    names: tuple[str, ...]
    theta: Array
    covariance: Array
    prior: Array
    """(P,) standard deviations"""
    system: System
    left_over: Array
    """(3, N) raw residual of all poses, in g, random parts not taken out"""
    design: Array
    """(3, N, P) derivatives of a reading by the parameters, where the model was linearised"""
    equations: Equations
    by_inc: Array
    by_tf: Array
    """(3, N) derivatives of a reading by the pose's inclination and toolface"""

    @property
    def inverse(self) -> Array:
        """(P + R + S, P + R + S) inverse of the penalised normal matrix."""
        return self.system.inverse

    @property
    def effects(self) -> Array:
        """(R + S,) estimated errors of the inclinations and stations, rad."""
        return self.system.solution[self.theta.size :]

    def take(self, names: tuple[str, ...]) -> Array:
        return self.theta[[self.names.index(name) for name in names]]


def rough_start(session: PoseRegression, names: tuple[str, ...]) -> Array:
    """Where to linearise first: matrix and offset by plain least squares, drawn a little to the nominal sensor."""
    rows = np.vstack([gravity_direction(session.state.inc_rad, session.state.tf_rad), np.ones(len(session.poses))])
    nominal = np.eye(3, 4)
    normal = rows @ rows.T + 1e-3 * np.eye(4)
    estimate = nominal + np.linalg.solve(normal, rows @ (session.poses.a - nominal @ rows).T).T
    theta = prior_mean(names)
    theta[:9] = estimate[:, :3].ravel()
    theta[9:12] = estimate[:, 3]
    return theta


def solve(
    session: PoseRegression, names: tuple[str, ...], variances: Variances, used: NDArray[np.bool_], at: Array
) -> MixedModelFit:
    """One Gauss-Newton step from `at` with given variances: penalised generalised least squares."""
    reading, design, by_inc, by_tf = session.linearise(names, at)
    prior, mean = prior_std(names, session.bench, session.structure), prior_mean(names)
    y = session.poses.a - reading + design @ (at - mean)
    equations = Equations.of(session, design, by_inc, by_tf, y, used)
    system = evaluate(session, equations, prior, variances)
    size = len(names)
    return MixedModelFit(
        names=names,
        theta=mean + system.solution[:size],
        covariance=system.inverse[:size, :size],
        prior=prior,
        system=system,
        left_over=y - design @ system.solution[:size],
        design=design,
        equations=equations,
        by_inc=by_inc,
        by_tf=by_tf,
    )


@dataclass(frozen=True, slots=True)
class System:
    """The penalised, whitened system at given variances, solved."""

    columns: Array
    """(N, 3, P + R + S): design, inclinations, stations; zero for poses not used"""
    pose_columns: Array
    """(N, 3, 5): directions of dI, dT and of the reading noise of the three axes"""
    inverse: Array
    solution: Array
    residual: Array
    """(N, 3)"""
    deviance: float
    """`log|V| + y' V^-1 y` but for a constant"""


def whitened(session: PoseRegression, equations: Equations, variances: Variances) -> tuple[Array, Array, Array, float]:
    """Design, inclinations and stations (N, 3, P + R + S), directions of dI, dT and of the three axes' noise (N, 3, 5),
    and readings (3 N,), each pose by its own covariance, zero where not used; the logarithm of the determinant."""
    stacked, parts, used, size = equations.stacked, equations.parts, equations.used, equations.size
    if used.all():
        white, log_det = whiten(stacked, parts, variances)
    else:
        white = np.zeros_like(stacked)
        white[used], log_det = whiten(stacked[used], parts[:, used], variances)
    inclinations = session.inclination_indicator.shape[1]
    columns = np.empty((white.shape[0], 3, size + inclinations + session.toolface_indicator.shape[1]))
    columns[:, :, :size] = white[:, :, :size]
    np.multiply(
        white[:, :, size, None],
        session.inclination_indicator[:, None, :],
        out=columns[:, :, size : size + inclinations],
    )
    np.multiply(
        white[:, :, size + 1, None], session.toolface_indicator[:, None, :], out=columns[:, :, size + inclinations :]
    )
    yw = np.ascontiguousarray(white[:, :, size + 5]).reshape(-1)
    return columns, white[:, :, size : size + 5], yw, log_det


def evaluate(session: PoseRegression, equations: Equations, prior: Array, variances: Variances) -> System:
    """The system of the equations at given variances, the parameters' priors `prior` (P,) in it."""
    columns, pose_columns, yw, log_det = whitened(session, equations, variances)
    count = columns.shape[0]
    flat = columns.reshape(3 * count, -1)
    penalty = _penalty(prior, variances, session)
    normal = flat.T @ flat
    normal.flat[:: normal.shape[0] + 1] += penalty
    inverse: Array = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    solution = inverse @ (flat.T @ yw)
    residual = yw - flat @ solution
    log_det += 2.0 * float(np.log(np.linalg.cholesky(normal).diagonal()).sum()) - float(np.log(penalty).sum())
    return System(
        columns=columns,
        pose_columns=pose_columns,
        inverse=inverse,
        solution=solution,
        residual=residual.reshape(count, 3),
        deviance=log_det + float(yw @ residual),
    )


def _penalty(prior: Array, variances: Variances, session: PoseRegression) -> Array:
    return np.concatenate(
        [
            1.0 / prior**2,
            np.full(session.inclination_indicator.shape[1], 1.0 / variances.station_inc),
            np.full(session.toolface_indicator.shape[1], 1.0 / variances.station_tf),
        ]
    )


def reml_variances(session: PoseRegression, fit: MixedModelFit, start: Variances, bench: BenchAccuracy) -> Variances:
    """Restricted maximum likelihood of the variance components: minimises `log|V| + y' V^-1 y`, V with the parameters'
    priors in it (which accounts for their number), plus `_variance_penalty`."""
    prior = VariancePrior.of(session, bench)
    best = log_v = np.log(start.as_array())
    lowest = np.inf
    for _ in range(_MAX_REML_STEPS):
        v = np.exp(log_v)
        system = evaluate(session, fit.equations, fit.prior, Variances(*v.tolist()))
        objective = system.deviance + prior.penalty(v)
        if objective > lowest + 1e-9:  # overshot
            log_v = 0.5 * (log_v + best)
            if np.max(np.abs(log_v - best)) < 0.01:
                break
            continue
        lowest, best = objective, log_v
        gradient, information, _ = _information(session, system, len(fit.names), v)
        prior_gradient, prior_information = prior.derivatives(v)
        slope = gradient + prior_gradient
        step = -np.linalg.solve(information + prior_information + _RIDGE, slope)
        step *= min(1.0, 2.0 / (float(np.max(np.abs(step))) + 1e-300))
        promised = -0.5 * float(slope @ step)
        log_v = np.maximum(log_v + step, np.log(bench.pose_rad**2) - 14.0)
        if promised < _REML_TOLERANCE:
            best = log_v
            break
    return Variances(*np.exp(best).tolist())


_EYE = np.eye(3)
_RIDGE = 1e-6 * np.eye(5)
_MAX_REML_STEPS = 25
_REML_TOLERANCE = 0.02
"""Twice the log-likelihood; 0.02 is far below what the data can tell."""
_TOTAL_PRIOR = 10.0
_SPLIT_PRIOR = 0.5
_SMALL_SHARE = 0.05
_READING_PRIOR_KNOWN = 30.0
_READING_PRIOR_ASSUMED = 0.1


@dataclass(frozen=True, slots=True)
class VariancePrior:
    """Priors of the variance components.

    What is stated of a bench is the size of one setting's error (`stated`, rad^2), hence the *sum* of its own and its
    common part: scaled inverse chi-square with `_TOTAL_PRIOR` degrees of freedom. How it splits is left to the data,
    but for a weak term that keeps each part off zero. With four stations no session could estimate the station part by
    itself, the mean of the four being a rotation of the tool; the sum and the pose part give it. The factor on the
    reading noise is near one by `reading` degrees of freedom (means scatter by more than `std / sqrt(n)` where noise
    is not white).
    """

    stated: float
    reading: float

    @classmethod
    def of(cls, session: PoseRegression, bench: BenchAccuracy) -> VariancePrior:
        """What is known of the variances of a session beforehand."""
        return cls(bench.pose_rad**2, _READING_PRIOR_KNOWN if session.poses.std_known else _READING_PRIOR_ASSUMED)

    def penalty(self, v: Array) -> float:
        """Minus twice the log density of `v` (5,) in its logarithms."""
        inc, tf, inclination, station, reading = map(float, v)
        totals = [log(total) + self.stated / total for total in (inc + inclination, tf + station)]
        split = [log(one) + _SMALL_SHARE * self.stated / one for one in (inc, tf, inclination, station)]
        return _TOTAL_PRIOR * sum(totals) + _SPLIT_PRIOR * sum(split) + self.reading * (log(reading) + 1.0 / reading)

    def derivatives(self, v: Array) -> tuple[Array, Array]:
        """Gradient and (positive) second derivative of `penalty` by the logarithms of the variances."""
        each = v.tolist()
        gradient = [0.0] * 4 + [self.reading * (1.0 - 1.0 / each[4])]
        curvature = [[0.0] * 5 for _ in range(5)]
        curvature[4][4] = self.reading / each[4]
        for pair in ((0, 2), (1, 3)):
            total = each[pair[0]] + each[pair[1]]
            for k in pair:
                small, share = _SMALL_SHARE * self.stated / each[k], each[k] / total
                gradient[k] = _SPLIT_PRIOR * (1.0 - small) + _TOTAL_PRIOR * (1.0 - self.stated / total) * share
                for m in pair:
                    curvature[k][m] = _TOTAL_PRIOR * share * each[m] / total
                curvature[k][k] += _SPLIT_PRIOR * small
        return np.array(gradient), np.array(curvature)


def _information(session: PoseRegression, system: System, size: int, v: Array) -> tuple[Array, Array, Array]:
    """Gradient and average-information matrix of `deviance` by the logarithms of the variances `v` (5,).

    With P the projected inverse of V and Z the columns that share a variance: `d/dv = tr(Z' P Z) - |Z' P y|^2`; the
    average information of two components is `(Z Z' P y)' P (Z Z' P y)`. Third, the columns' products (P + R + S, 5)
    with `Z Z' P y`, of which the change of the solution with each variance follows.
    """
    inclinations, stations = session.inclination_indicator.shape[1], session.toolface_indicator.shape[1]
    count = system.residual.shape[0]
    columns, inverse, residual = system.columns, system.inverse, system.residual
    # per pose: dI, dT and the three axes of reading noise; `left` is what the solution leaves of a pose's own error
    Z = system.pose_columns
    flat = columns.reshape(3 * count, -1)
    left = _EYE - (flat @ inverse).reshape(columns.shape) @ columns.transpose(0, 2, 1)
    trace = np.einsum("nik,nik->k", Z, left @ Z)
    t = (residual[:, None, :] @ Z)[:, 0]
    square = np.einsum("nk,nk->k", t, t)
    pulled = Z * t[:, None, :]
    gradient = np.empty(5)
    spread = np.empty((count, 3, 5))
    gradient[:2] = trace[:2] - square[:2]
    gradient[4] = trace[2:].sum() - square[2:].sum()
    spread[:, :, :2] = pulled[:, :, :2]
    spread[:, :, 4] = pulled[:, :, 2:].sum(axis=2)
    # common to an inclination or a station: the effects are part of the solution
    diagonal = np.diagonal(inverse)
    for k, first, number, groups in (
        (2, size, inclinations, session.inclination_indicator),
        (3, size + inclinations, stations, session.toolface_indicator),
    ):
        effect = system.solution[first : first + number] / v[k]
        gradient[k] = (number - diagonal[first : first + number].sum() / v[k]) / v[k] - effect @ effect
        spread[:, :, k] = Z[:, :, k - 2] * (groups @ effect)[:, None]
    S = spread.reshape(-1, 5)
    FS = flat.T @ S
    return gradient * v, (S.T @ S - FS.T @ inverse @ FS) * np.outer(v, v), FS * v


def covariance_with_variances(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, bench: BenchAccuracy
) -> tuple[Array, Array]:
    """Covariance (P, P) of the parameters, the variance components being estimated and not known, and its widening.

    With W the covariance of the estimated logarithms of the variances (inverse of the information, priors included):

        cov = Phi + sum W_kl (d_k theta) (d_l theta)',  S = (z^2 + 1) / 4 sum W_kl (d_k Phi) Phi^-1 (d_l Phi).

    The solution moves with the weights, and a variance that is estimated makes intervals of Student's kind; see
    `highside.calibration.student`.
    """
    v, size, system = variances.as_array(), fit.theta.size, fit.system
    _, information, moved = _information(session, system, size, v)
    _, prior_information = VariancePrior.of(session, bench).derivatives(v)
    W: Array = np.asarray(2.0 * np.linalg.inv(information + prior_information + _RIDGE), dtype=np.float64)
    by_variance = system.inverse[:size] @ moved
    count, _, width = system.columns.shape
    # how an error of each pose, and of each axis of its reading, moves the parameters
    products = (system.columns.transpose(0, 2, 1) @ system.pose_columns).transpose(1, 0, 2).reshape(width, -1)
    levers = (system.inverse[:size] @ products).reshape(size, count, 5)
    inclinations = session.inclination_indicator.shape[1]
    common = system.inverse[:size, size:]
    parts = [
        levers[:, :, 0] * np.sqrt(v[0]),
        levers[:, :, 1] * np.sqrt(v[1]),
        common[:, :inclinations] / np.sqrt(v[2]),
        common[:, inclinations:] / np.sqrt(v[3]),
        levers[:, :, 2:].reshape(size, -1) * np.sqrt(v[4]),
    ]
    return widened(fit.covariance, W, by_variance, np.stack([part @ part.T for part in parts]))


def covariance_over_station_errors(
    session: PoseRegression, fit: MixedModelFit, bench: BenchAccuracy, variances: Variances
) -> Array:
    """Covariance (P, P) of the parameters about `fit.theta`, over what errors an inclination may have in common.

    Two inclinations hold a single difference of theirs: where it happens to be small the most likely variance is next
    to nothing, and a covariance at that place, even with its slope, is far too small for a calibration that is used at
    other inclinations. Here the sum of a setting's own and its inclination's variance, and the inclination's share in
    it, run over a grid in their logarithm and log-odds, each place weighted by its restricted likelihood and prior; the
    other variances stay. Parameters and covariances of all places make the mixture's second moment.
    """
    prior, size = VariancePrior.of(session, bench), fit.theta.size
    objective, second = [], []
    for total in bench.pose_rad**2 * np.exp(np.linspace(-1.6, 1.6, 7)):
        for share in 1.0 / (1.0 + np.exp(np.linspace(4.0, -4.0, 9))):
            at = replace(variances, pose_inc=float(total * (1.0 - share)), station_inc=float(total * share))
            system = evaluate(session, fit.equations, fit.prior, at)
            away = system.solution[:size] - fit.system.solution[:size]
            objective.append(system.deviance + prior.penalty(at.as_array()))
            second.append(system.inverse[:size, :size] + np.outer(away, away))
    weight = np.exp(-0.5 * (np.array(objective) - min(objective)))
    return np.asarray(np.tensordot(weight / weight.sum(), np.stack(second), 1), dtype=np.float64)


def studentised(fit: MixedModelFit, used: NDArray[np.bool_]) -> Array:
    """How many standard deviations each pose used lies from what all the others predict (N,); 0 for those not used.

    In whitened form the residual e of a pose with hat block H has the leave-one-out square `e' (1 - H)^-1 e`,
    chi-square with three degrees of freedom; its root is returned.
    """
    count, _, size = fit.system.columns.shape
    carried = (fit.system.columns.reshape(-1, size) @ fit.inverse).reshape(count, 3, size)
    left = (1.0 + 1e-12) * _EYE - carried @ fit.system.columns.transpose(0, 2, 1)
    out = np.sum(fit.system.residual * np.linalg.solve(left, fit.system.residual[:, :, None])[:, :, 0], axis=1)
    return np.where(used, np.sqrt(np.maximum(out, 0.0)), 0.0)

"""Refinement: what the joint estimator's model leaves over, as smooth unknown functions with a size of their own.

A sensor may have structure that no term describes. Left alone it passes for errors of the bench and of the readings:
the poses lose their weight against one another, toolface suffers, and between the poses nobody knows what is missing.
Here it becomes part of the model: for each channel a function of its own load and a field over direction
(`physics.structure`), Gaussian processes whose sizes and lengths are found by maximum marginal likelihood (of size,
length and the bench's variances together: restricted maximum likelihood). Sensor, bench and structure are then solved
together. The posterior mean corrects, shrunken where the poses say little; the posterior covariance grows away from
the poses, so that the stated intervals widen where nothing was measured.

Evidence decides: where structure of any size gains less than `ADMIT_LOG_LIKELIHOOD` the estimate is returned unchanged,
to the last digit. Stations too few to tell structure from bench make wide intervals, not a refusal.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.forward import BASE_NAMES, GROUPS, StructureSize, Variances, prior_mean, prior_std
from highside.calibration.joint_result import result_of
from highside.calibration.linear_errors import NOMINAL_BENCH, BenchAccuracy
from highside.calibration.mixed_model import (
    Equations,
    MixedModelFit,
    PoseRegression,
    VariancePrior,
    covariance_with_variances,
    evaluate,
    initial_variances,
    reml_variances,
    solve,
    whitened,
)
from highside.calibration.pose_rejection import BAD_POSE_SIGMA, departure, reject_outlying
from highside.calibration.poses import PoseSet
from highside.calibration.remark import Reason
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor import DIRECTION_NAMES, OWN_LOAD_NAMES
from highside.calibration.student import widened

ADMIT_LOG_LIKELIHOOD = 8.0
"""Gain in log likelihood for four numbers before structure is believed."""
MIN_POSES = 20
NEGLIGIBLE_SHARE = 1e-6
"""Coefficients with a smaller share of the variance of all are omitted from the result."""

_NOTHING_G = 1e-9
_IRRELEVANT_G = 1e-8
"""A coefficient that is known to be smaller need not be estimated."""
_SIZES_G = (1e-7, 2e-2)
_OWN_LENGTHS_G = (0.13, 1.0)
_FIELD_LENGTHS_RAD = (0.4, 1.2)
_TRIAL_SIZES_G = (1e-4, 5e-4)
_TRIAL_LENGTHS = (0.25, 0.6)
_MAX_TRIALS = 160
_ROUNDS = 2
_HARDLY_G = 2e-6
_STEP = 0.1
"""In the logarithm of a size or length, for derivatives."""
_VAGUE = 1.0
"""Standard deviation of the logarithm of a size or length of which the likelihood says nothing."""


def refine(result: CalibrationResult, poses: PoseSet, *, bench: BenchAccuracy = NOMINAL_BENCH) -> CalibrationResult:
    """The joint `result` of the same `poses` with structure in its model, if the poses show any at all.

    The options `structure_own_g` and `structure_field_g` tell its sizes (0 where there is none).
    """
    untouched = replace(result, options=dict(result.options) | {"structure_own_g": 0.0, "structure_field_g": 0.0})
    names = result.main.parameters.names
    if len(poses) < MIN_POSES or not set(names) <= _KNOWN:
        return untouched  # few poses, or terms in temperature
    session = PoseRegression.of(poses, bench, result.toolface_zero_rad)
    used = result.poses.used
    stated = initial_variances(session, bench)
    at = result.main.parameters.block(names)
    plain = solve(session, names, stated, used, at)
    settled = reml_variances(session, plain, stated, bench)
    likelihood = _Likelihood(session, solve(session, names, settled, used, at), bench, used)
    without = likelihood.of_plain(settled)
    trials = [
        StructureSize(*(pair if own else (_NOTHING_G, 0.5)), *((_NOTHING_G, 0.5) if own else pair))
        for own, pair in product((True, False), product(_TRIAL_SIZES_G, _TRIAL_LENGTHS))
    ]
    found = [(likelihood.at(v, trial), trial, v) for v in (stated, settled) for trial in trials]
    lowest, size, variances = min(found, key=lambda one: one[0])
    if without - lowest < 2.0 * ADMIT_LOG_LIKELIHOOD:
        return untouched
    for _ in range(_ROUNDS):
        size = likelihood.best(variances, size)
        kept = _worth_keeping(names, size)
        session = replace(session, structure=size)
        theta = np.concatenate([at, np.zeros(len(kept) - len(names))])
        fit = solve(session, kept, variances, used, theta)
        variances = reml_variances(session, fit, variances, bench)
    fit = solve(session, kept, variances, used, fit.theta)
    # what departed from a model without structure may fit one with it
    used = used | (departure(session, fit, variances, used) <= BAD_POSE_SIGMA)
    fit = solve(session, kept, variances, used, fit.theta)
    used, fit = reject_outlying(session, fit, variances, used)
    away = departure(session, fit, variances, used)
    refined = result_of(
        session,
        fit,
        variances,
        used,
        away,
        bench,
        result.toolface_zero_rad,
        result.toolface_zero_std_rad,
        *_with_sizes(
            session, fit, variances, size, likelihood, *covariance_with_variances(session, fit, variances, bench)
        ),
    )
    sizes = {"structure_own_g": size.own_g, "structure_field_g": size.field_g}
    return replace(
        refined,
        zones=(replace(refined.main, temperature=result.main.temperature),),
        remarks=refined.remarks + tuple(r for r in result.remarks if r.reason is Reason.TEMPERATURE_SPAN),
        options=dict(result.options) | dict(refined.options) | sizes,
    )


_KNOWN = {*BASE_NAMES, *(name for group in GROUPS.values() for name in group)}


def _worth_keeping(names: tuple[str, ...], size: StructureSize) -> tuple[str, ...]:
    """The names with those coefficients of structure that its size gives any weight."""
    own, field = size.variances()
    floor = NEGLIGIBLE_SHARE * (own.sum() + field.sum())
    waves = tuple(name for name, v in zip(OWN_LOAD_NAMES, np.tile(own, 3), strict=True) if v > floor)
    harmonics = tuple(name for name, v in zip(DIRECTION_NAMES, np.tile(field, 3), strict=True) if v > floor)
    return names + waves + harmonics


def _with_sizes(
    session: PoseRegression,
    fit: MixedModelFit,
    variances: Variances,
    size: StructureSize,
    likelihood: _Likelihood,
    covariance: Array,
    student: Array,
) -> tuple[Array, Array]:
    """`covariance` and its widening `student` (P, P), sizes and lengths of the structure being estimated too
    (derivatives by differences)."""
    at = np.log(np.array([size.own_g, size.own_length_g, size.field_g, size.field_length_rad]))
    # of what is hardly there neither size nor length matters
    active = [k for k in range(4) if np.exp(at[k - k % 2]) > _HARDLY_G]

    def moved(*steps: tuple[int, float]) -> StructureSize:
        x = at.copy()
        for k, step in steps:
            x[k] += step
        return StructureSize(*np.exp(x).tolist())

    def solved(trial: StructureSize) -> tuple[Array, Array]:
        prior = prior_std(fit.names, session.bench, trial)
        system = evaluate(session, fit.equations, prior, variances)
        return system.solution[: prior.size], system.inverse[: prior.size, : prior.size]

    h = _STEP
    bent = np.empty((len(active), len(active)))
    for i, k in enumerate(active):
        for j, m in enumerate(active):
            corners = [
                a * b * likelihood.at(variances, moved((k, a * h), (m, b * h)))
                for a in (1.0, -1.0)
                for b in (1.0, -1.0)
            ]
            bent[i, j] = sum(corners) / (4.0 * h**2)
    sizes, turns = np.linalg.eigh(0.5 * (bent + bent.T))
    W = (turns * (2.0 / np.maximum(sizes, 2.0 / _VAGUE**2))) @ turns.T
    pairs = [(solved(moved((k, h))), solved(moved((k, -h)))) for k in active]
    theta = np.stack([(up[0] - down[0]) / (2.0 * h) for up, down in pairs], axis=1)
    changes = np.stack([(up[1] - down[1]) / (2.0 * h) for up, down in pairs])
    covariance, more = widened(covariance, W, theta, changes)
    return covariance, student + more


class _Likelihood:
    """Marginal likelihood of sizes and lengths; twice its negative logarithm, but for a constant."""

    def __init__(
        self, session: PoseRegression, fit: MixedModelFit, bench: BenchAccuracy, used: NDArray[np.bool_]
    ) -> None:
        self._session, self._bench, self._plain = session, bench, fit
        self._prior = VariancePrior.of(session, bench)
        self._names = fit.names + OWN_LOAD_NAMES + DIRECTION_NAMES
        theta = np.concatenate([fit.theta, np.zeros(len(self._names) - len(fit.names))])
        reading, design, by_inc, by_tf = session.linearise(self._names, theta)
        y = session.poses.a - reading + design @ (theta - prior_mean(self._names))
        self._equations = Equations.of(session, design, by_inc, by_tf, y, used)
        self._held: tuple[Variances, Array, Array, float] | None = None

    def of_plain(self, variances: Variances) -> float:
        """Without structure."""
        fit = self._plain
        system = evaluate(self._session, fit.equations, fit.prior, variances)
        return system.deviance + self._prior.penalty(variances.as_array())

    def at(self, variances: Variances, size: StructureSize) -> float:
        """With structure of a size. The whitened system is held for one set of variances; only the penalty changes."""
        if self._held is None or self._held[0] != variances:
            self._held = (variances, *self._reduced(variances))
        _, normal, right, rest = self._held
        prior = prior_std(self._names, self._bench, size)
        keep = np.concatenate([prior > _IRRELEVANT_G, np.ones(right.size - prior.size, dtype=bool)])
        M = normal[np.ix_(keep, keep)]
        count = int(keep[: prior.size].sum())
        M[range(count), range(count)] += 1.0 / prior[keep[: prior.size]] ** 2
        lower = np.linalg.cholesky(M)
        half = np.linalg.solve(lower, right[keep])
        log_det = 2.0 * float(np.log(np.diagonal(lower)).sum() + np.log(prior[keep[: prior.size]]).sum())
        return log_det - float(half @ half) + rest

    def best(self, variances: Variances, start: StructureSize) -> StructureSize:
        """The likeliest size, from `start` and from as much of the other kind."""
        from scipy.optimize import minimize

        bounds = np.log(np.array([_SIZES_G, _OWN_LENGTHS_G, _SIZES_G, _FIELD_LENGTHS_RAD]))

        def loss(x: Array) -> float:
            outside = float(np.sum(np.maximum(bounds[:, 0] - x, 0.0) + np.maximum(x - bounds[:, 1], 0.0)))
            inside = np.exp(np.clip(x, bounds[:, 0], bounds[:, 1]))
            return self.at(variances, StructureSize(*inside.tolist())) + 100.0 * outside

        own, field = max(start.own_g, 1e-6), max(start.field_g, 1e-6)
        most = max(own, field)
        starts = [
            (own, start.own_length_g, field, start.field_length_rad),
            (most, 0.25, 1e-6, 0.6),
            (1e-6, 0.25, most, 0.6),
        ]
        fits = [
            minimize(
                loss,
                np.log(np.array(s)),
                method="Nelder-Mead",
                options={"xatol": 0.02, "fatol": 0.05, "maxfev": _MAX_TRIALS},
            )
            for s in starts
        ]
        best = min(fits, key=lambda fit: float(fit.fun)).x
        return StructureSize(*np.exp(np.clip(best, bounds[:, 0], bounds[:, 1])).tolist())

    def _reduced(self, variances: Variances) -> tuple[Array, Array, float]:
        """Normal matrix (parameters without their priors, inclinations and stations with theirs), right side, and the
        rest of the deviance."""
        session = self._session
        columns, _, y, log_det = whitened(session, self._equations, variances)
        flat = columns.reshape(y.size, -1)
        normal = flat.T @ flat
        inclinations, stations = session.inclination_indicator.shape[1], session.toolface_indicator.shape[1]
        common = np.repeat([variances.station_inc, variances.station_tf], [inclinations, stations])
        last = range(normal.shape[0] - common.size, normal.shape[0])
        normal[last, last] += 1.0 / common
        rest = log_det + float(np.log(common).sum() + y @ y) + self._prior.penalty(variances.as_array())
        return normal, flat.T @ y, rest

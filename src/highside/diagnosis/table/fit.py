"""Fitting effects to a published error table: likelihood, fit and score of one set of effects.

Cells are normal about what the simulated chain predicts, with the covariance of chance (drawn) and one more scatter
`tau`, of the direction of gravity from row to row, that stands for whatever the set does not explain: it moves a
toolface by tau / sin I. `tau` is found by maximum likelihood, so a set is better where it leaves less of it. Sizes
have heavy-tailed priors about the library's typical ones: forty numbers alone would prefer an absurd size of one
effect to usual sizes of two. A set's score is its deviance with those priors and BIC's price for each parameter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Variant
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.table.chain import Draws, Linear, Sessions, draw, errors_in_common, predict_cells, through
from highside.diagnosis.table.policy import TABLE_FITS
from highside.physics.forward import ForwardModel

PEAK = float(np.sqrt(2.0))
"""Two extremes scatter more than a mean."""


@dataclass(frozen=True, slots=True, eq=False)
class Option:
    """An effect that a set may hold: `field` (k, 3, R, S) is what typical amplitudes do to the corrected gravity."""

    effect: str
    shape: tuple[tuple[str, float], ...]
    amplitudes: tuple[str, ...]
    typical: Array
    field: Array
    tries: int

    @property
    def name(self) -> str:
        """For people: the effect and, where only some of its amplitudes act, which."""
        return f"{self.effect}({', '.join(self.amplitudes)})"


def options_of(sessions: Sessions, clean: Array, candidate: Candidate) -> list[Option]:
    """The variants of a candidate that leave a trace after the correction, in units of its typical sizes."""
    found: list[Option] = []
    shapes = len({tuple(v.shape.items()) for v in candidate.variants})
    for variant in candidate.variants:
        whole = next(v for v in candidate.variants if v.whole and v.shape == variant.shape)
        which = _which(variant, whole)
        unit = candidate.unit()[which]
        moved = through(sessions, clean, variant.columns) * unit[:, None, None, None]
        before = np.mean((variant.columns * unit[:, None, None]) ** 2, axis=(1, 2))
        visible = np.mean(moved**2, axis=(1, 2, 3)) > REGRESSION.independent * before
        kept = [k for k, sees in zip(which, visible, strict=True) if sees]
        if kept and len(kept) <= TABLE_FITS.max_amplitudes:
            names = tuple(candidate.amplitudes[k] for k in kept)
            found.append(
                Option(candidate.id, tuple(variant.shape.items()), names, unit[visible], moved[visible], shapes)
            )
    unique = {(o.shape, o.amplitudes): o for o in found}
    return list(unique.values())


def _which(variant: Variant, whole: Variant) -> list[int]:
    """Places of a variant's columns among those of the whole effect."""
    return [next(k for k, column in enumerate(whole.columns) if np.array_equal(column, own)) for own in variant.columns]


@dataclass(frozen=True)
class ErrorTable:
    """What is to be explained: `published` (R, 4) deg with NaN where lost, and how it was measured.

    `base` (P, 3, R, S) are the fields of what is fitted anyway: what may be refitted, in typical units, and behind it
    the errors of the correction's poses; `known` (P,) is the standard deviation of each beforehand. `use` (R,) are rows
    believed.
    """

    sessions: Sessions
    published: Array
    start: Array
    base: Array
    known: Array
    noise_g: float | None
    draws: Draws
    many: Draws
    use: NDArray[np.bool_]

    @classmethod
    def of(
        cls, sessions: Sessions, published: Array, model: ForwardModel, base: Array, noise_g: float | None, seed: int
    ) -> ErrorTable:
        """At a model whose random effects say how the bench stops; `base` (P, 3, N) columns of its free parameters."""
        clean = np.asarray(model.predict(sessions.state), dtype=float)
        size = noise_g or TABLE_FITS.noise_g
        errors = errors_in_common(sessions, model, size)
        own = not len(errors)
        return cls(
            sessions,
            published,
            sessions.corrected(clean),
            through(sessions, clean, np.concatenate([base, errors])),
            np.concatenate([np.full(len(base), TABLE_FITS.wide), np.ones(len(errors))]),
            noise_g,
            draw(sessions, model, TABLE_FITS.fit_draws, seed, size, own=own),
            draw(sessions, model, TABLE_FITS.chance_draws, seed + 1, size, own=own),
            np.ones(len(published), dtype=bool),
        )

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(4 R,) cells that count."""
        usable = np.isfinite(self.published)
        usable[self.sessions.degenerate(), :2] = False
        return np.asarray((usable & self.use[:, None]).reshape(-1))

    def precision(self, size: int) -> Array:
        """(size,) what is known beforehand of values (and of the logarithm of the noise behind them)."""
        known = np.full(size, TABLE_FITS.wide)
        known[: self.known.size] = self.known
        return np.asarray(known**-2.0)

    def without_row(self, row: int) -> ErrorTable:
        """The same with one more row left out."""
        use = self.use.copy()
        use[row] = False
        return replace(self, use=use)

    @property
    def spread(self) -> Array:
        """(4 R,) deg that one radian of unexplained scatter moves each cell."""
        sin = np.sin(self.sessions.inc_rad)
        one = np.ones_like(sin)
        return np.asarray(np.degrees(np.stack([one, PEAK * one, one / sin, PEAK / sin], axis=1))).reshape(-1)


@dataclass(frozen=True)
class Fitted:
    """A set of effects fitted: `values` (P,) in typical units (base first), noise in g, unexplained scatter in rad."""

    options: tuple[Option, ...]
    values: Array
    noise_g: float
    tau_rad: float
    deviance: float
    score: float
    cells: Array
    """(R, 4) deg predicted"""
    chance: Array
    """(4 R, 4 R) covariance of chance alone"""
    jacobian: Array = field(repr=False)
    """(P + 1, 4 R): by the values and by the logarithm of the noise"""

    def covariance(self, table: ErrorTable) -> Array:
        """(4 R, 4 R) of chance and what is unexplained."""
        return np.asarray(self.chance + np.diag((self.tau_rad * table.spread) ** 2))

    def sigma(self, table: ErrorTable) -> Array:
        """(R, 4) deg."""
        return np.asarray(np.sqrt(np.diag(self.covariance(table))).reshape(-1, 4))

    @property
    def effects(self) -> frozenset[str]:
        """Ids of the effects."""
        return frozenset(option.effect for option in self.options)

    def own(self, index: int) -> slice:
        """Where the amplitudes of one option stand among the values."""
        sizes = [len(option.amplitudes) for option in self.options]
        start = self.values.size - sum(sizes) + sum(sizes[:index])
        return slice(start, start + sizes[index])


def covariance_of_values(table: ErrorTable, fitted: Fitted) -> Array:
    """(P + 1, P + 1) covariance of the values (typical units) and the logarithm of the noise."""
    mask = table.mask
    cov = fitted.covariance(table)[np.ix_(mask, mask)]
    slope = fitted.jacobian[:, mask]
    inner = slope @ np.linalg.solve(cov, slope.T) + np.diag(table.precision(len(slope)))
    return np.asarray(np.linalg.inv(inner))


def chance_of(table: ErrorTable, linear: Linear, values: Array, noise_g: float) -> Array:
    """Covariance (4 R, 4 R) in deg^2 of what chance does to the cells; that of the prediction's own mean included."""
    cells = predict_cells(linear, values, noise_g, table.many, slopes=False).cells.reshape(TABLE_FITS.chance_draws, -1)
    cov = np.cov(cells.T) * (1.0 + 1.0 / TABLE_FITS.fit_draws)
    # few draws know correlations only so far
    return np.asarray(cov + np.diag(TABLE_FITS.ridge * np.diag(cov)))


def fit_set(
    table: ErrorTable,
    options: Sequence[Option],
    start: Fitted | None = None,
    *,
    chance: Array | None = None,
    rounds: int = 2,
) -> Fitted:
    """Fit a set by Gauss-Newton with damping, from another fit of fewer effects; tau is found between rounds."""
    options = tuple(options)
    fields = [table.base, *(option.field for option in options)]
    linear = Linear(table.sessions, table.start, np.concatenate(fields))
    first = _start_values(table, options, start)
    fresh = np.isnan(first)
    tau = start.tau_rad if start else TABLE_FITS.start_tau_rad
    noise = np.log(start.noise_g if start else table.noise_g or TABLE_FITS.noise_g)
    if chance is None:
        chance = start.chance if start else chance_of(table, linear, np.nan_to_num(first), float(np.exp(noise)))
    starts = [np.append(np.where(fresh, guess, first), noise) for guess in _guesses(fresh)]
    if len(starts) > 1:
        # a peak-to-peak hardly knows signs, and a fit does not cross zero: a few steps from several sides first
        starts = [
            min(
                (_descend(table, linear, s, chance, tau, steps=TABLE_FITS.first_steps) for s in starts),
                key=lambda f: f[0],
            )[1]
        ]
    theta = starts[0]
    for _ in range(rounds):
        tau, _ = _most_likely_tau(table, linear, theta, chance)
        theta = _descend(table, linear, theta, chance, tau)[1]
    return _finished(table, linear, options, theta, chance)


def _guesses(fresh: NDArray[np.bool_]) -> list[Array]:
    """Values to start what is new from, in typical units."""
    alternate = np.where(np.cumsum(fresh) % 2 == 0, -1.0, 1.0)
    if not fresh.any():
        return [np.zeros(fresh.size)]
    if fresh.sum() == 1:
        return [TABLE_FITS.guess * alternate, -TABLE_FITS.guess * alternate]
    return [alternate, np.ones(fresh.size)]


def _start_values(table: ErrorTable, options: Sequence[Option], start: Fitted | None) -> Array:
    """Values to start from; NaN for what is new."""
    values = [np.zeros(len(table.base)) if start is None else start.values[: len(table.base)]]
    known = {} if start is None else {(o.effect, o.shape, o.amplitudes): i for i, o in enumerate(start.options)}
    for option in options:
        key = (option.effect, option.shape, option.amplitudes)
        if start is not None and key in known:
            values.append(start.values[start.own(known[key])])
        else:
            values.append(np.full(len(option.amplitudes), np.nan))
    return np.concatenate(values)


def _descend(
    table: ErrorTable, linear: Linear, theta: Array, chance: Array, tau: float, steps: int = TABLE_FITS.steps
) -> tuple[float, Array]:
    mask, base = table.mask, len(table.base)
    lower = np.linalg.cholesky((chance + np.diag((tau * table.spread) ** 2))[np.ix_(mask, mask)])
    published = table.published.reshape(-1)[mask]
    sizes = theta.size - 1

    def residual(at: Array) -> tuple[float, Array, Array]:
        predicted = predict_cells(linear, at[:-1], float(np.exp(at[-1])), table.draws)
        slope = predicted.slope.reshape(sizes + 1, -1)[:, mask].copy()
        slope[-1] *= np.exp(at[-1])
        left = np.linalg.solve(
            lower, np.column_stack([published - predicted.cells.mean(axis=0).reshape(-1)[mask], slope.T])
        )
        gram, pull = left[:, 1:].T @ left[:, 1:], left[:, 1:].T @ left[:, 0]
        cost = float(left[:, 0] @ left[:, 0])
        cost += float(np.sum((at[:base] / table.known) ** 2))
        gram[np.arange(base), np.arange(base)] += table.known**-2
        pull[:base] -= at[:base] / table.known**2
        for k in range(base, sizes):
            # heavy-tailed: 2 log(1 + (x / s)^2), with the curvature of its majorant
            weight = 2.0 / (TABLE_FITS.heavy**2 + at[k] ** 2)
            cost += 2.0 * float(np.log1p((at[k] / TABLE_FITS.heavy) ** 2))
            gram[k, k] += weight
            pull[k] -= weight * at[k]
        if table.noise_g is None:
            off = (at[-1] - np.log(TABLE_FITS.noise_g)) / TABLE_FITS.noise_log_std
            cost += float(off**2)
            gram[-1, -1] += TABLE_FITS.noise_log_std**-2
            pull[-1] -= off / TABLE_FITS.noise_log_std
        else:
            gram[-1, :] = gram[:, -1] = pull[-1] = 0.0
            gram[-1, -1] = 1.0
        return cost, gram, pull

    cost, gram, pull = residual(theta)
    damping = TABLE_FITS.damping
    for _ in range(steps):
        moved = theta + np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-9), pull)
        moved[-1] = np.clip(moved[-1], np.log(TABLE_FITS.noise_range_g[0]), np.log(TABLE_FITS.noise_range_g[1]))
        new = residual(moved)
        if new[0] < cost:
            done = cost - new[0] < TABLE_FITS.settled
            theta, (cost, gram, pull) = moved, new
            damping = max(damping / TABLE_FITS.damping_factor, TABLE_FITS.least_damping)
            if done:
                break
        else:
            damping *= TABLE_FITS.damping_factor
            if damping > TABLE_FITS.most_damping:
                break
    return cost, theta


def deviance_at(tau: float, chance: Array, spread: Array, left: Array) -> float:
    """-2 log likelihood of residuals (n,) but for a constant."""
    cov = chance + np.diag((tau * spread) ** 2)
    return float(left @ np.linalg.solve(cov, left) + np.linalg.slogdet(cov)[1])


def _most_likely_tau(table: ErrorTable, linear: Linear, theta: Array, chance: Array) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar

    mask = table.mask
    cells = predict_cells(linear, theta[:-1], float(np.exp(theta[-1])), table.draws, slopes=False).cells.mean(axis=0)
    left = (table.published - cells).reshape(-1)[mask]
    part = chance[np.ix_(mask, mask)]
    spread = table.spread[mask]
    found = minimize_scalar(
        lambda log_tau: deviance_at(float(np.exp(log_tau)), part, spread, left),
        bounds=(np.log(TABLE_FITS.tau_range_rad[0]), np.log(TABLE_FITS.tau_range_rad[1])),
        method="bounded",
    )
    return float(np.exp(found.x)), float(found.fun)


def _finished(table: ErrorTable, linear: Linear, options: tuple[Option, ...], theta: Array, chance: Array) -> Fitted:
    tau, deviance = _most_likely_tau(table, linear, theta, chance)
    predicted = predict_cells(linear, theta[:-1], float(np.exp(theta[-1])), table.draws)
    slope = predicted.slope.reshape(theta.size, -1).copy()
    slope[-1] *= np.exp(theta[-1])
    extra = theta[len(table.base) : -1]
    price = extra.size * np.log(table.mask.sum()) + sum(2 * np.log(option.tries) for option in options)
    score = deviance + price + 2.0 * float(np.sum(np.log1p((extra / TABLE_FITS.heavy) ** 2)))
    score += float(np.sum((theta[: len(table.base)] / table.known) ** 2))
    return Fitted(
        options,
        theta[:-1],
        float(np.exp(theta[-1])),
        tau,
        deviance,
        float(score),
        predicted.cells.mean(axis=0),
        chance,
        slope,
    )


def rechanced(table: ErrorTable, fitted: Fitted) -> Fitted:
    """The same set fitted with the covariance of chance at its own parameters."""
    fields = [table.base, *(option.field for option in fitted.options)]
    linear = Linear(table.sessions, table.start, np.concatenate(fields))
    return fit_set(
        table, fitted.options, fitted, chance=chance_of(table, linear, fitted.values, fitted.noise_g), rounds=2
    )

"""Instruments that a published table allows: draws from all explanations that were found, by their probability.

A few dozen cells are explained by several sets of effects, each with sizes and signs that they leave open, and effects
too small to show may be there as well. An *explanation* is a set of effects; its probability is the evidence of the
table for it, the integral of likelihood times prior over its sizes, times how likely such a set is beforehand
(`POSTERIOR.there`). Sizes have heavy-tailed priors about the library's typical ones (`POSTERIOR.size`), the scatter
beyond chance that of a bench step.

The search asks that an effect pays for itself before it is named; here sets with one effect more count by their
evidence. So the likeliest sets are grown once more, from each of their modes (a peak-to-peak hardly knows signs). The
integral is done by importance sampling: the modes of a set propose sizes from Student distributions of their own
covariance, and each proposal is weighted by what the table says of it. Draws are taken by weight and then moved about
by a few Metropolis steps, so that they need no weights and do not repeat one another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.table.chain import Linear, errors_in_common, predict_cells
from highside.diagnosis.table.explained import Explained, Progress
from highside.diagnosis.table.fit import ErrorTable, Fitted, Option, chance_of, fit_set
from highside.diagnosis.table.instrument import instrument
from highside.diagnosis.table.policy import POSTERIOR, TABLE_FITS
from highside.diagnosis.table.priors import covariance_with_priors, log_prior_of_scatter, log_prior_of_set, log_share
from highside.physics.forward import ForwardModel


@dataclass(frozen=True)
class Explanation:
    """A set of effects that explains the table, and its probability among all that were tried."""

    effects: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class Drawn:
    """One instrument that the table allows: the model, the noise of a reading in g, and `own_g` (3, K), what chance did
    to the K poses of the correction behind the table."""

    model: ForwardModel
    noise_g: float
    own_g: Array
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Posterior:
    """Explanations by probability, draws, and `effective`: how many independent ones they are worth."""

    explanations: tuple[Explanation, ...]
    draws: tuple[Drawn, ...]
    effective: float


@dataclass(frozen=True)
class _Mode:
    """A mode of a set, and the proposals about it.

    What noise there is decides how well all else is known, so the noise is proposed first (logarithm, `spread`), and
    the values then about `centre` moved along with it (`gain`), with the covariance of the mode (`lower`, its Cholesky
    factor) grown or shrunk by the noise.
    """

    fitted: Fitted
    centre: Array
    """(P + 1,) values and logarithm of the noise"""
    spread: float
    gain: Array
    lower: Array
    log_mass: float
    """Laplace's approximation of the evidence, prior of the set included"""

    def at(self, z: Array) -> Array:
        """(n, P + 1) proposals from standard numbers of that shape, the noise's last."""
        step = POSTERIOR.wider * self.spread * z[:, -1:]
        values = self.centre[:-1] + step * self.gain + np.exp(np.clip(step, -1, 1)) * (z[:, :-1] @ self.lower.T)
        return np.concatenate([values, self.centre[-1] + step], axis=1)

    def density(self, at: Array) -> Array:
        """(n,) logarithm of the proposal's density but for a constant of the dimension, at (n, P + 1)."""
        step = at[:, -1:] - self.centre[-1]
        scale = np.clip(step, -1, 1)
        rest = (at[:, :-1] - self.centre[:-1] - step * self.gain) * np.exp(-scale)
        z = np.linalg.solve(self.lower, rest.T)
        square = np.sum(z**2, axis=0) + (step[:, 0] / (POSTERIOR.wider * self.spread)) ** 2
        size = self.centre.size
        tail = -(POSTERIOR.freedom + size) / 2 * np.log1p(square / POSTERIOR.freedom)
        tail -= np.log(POSTERIOR.wider * self.spread) + np.sum(np.log(np.diag(self.lower)))
        return np.asarray(tail - (size - 1) * scale[:, 0])

    def step(self, z: Array) -> Array:
        """(P + 1,) a step of the mode's covariance from standard numbers."""
        by_noise = self.spread * z[-1]
        return np.append(by_noise * self.gain + self.lower @ z[:-1], by_noise)

    def away(self, other: Array) -> float:
        """How many sigma a point is off in the nearest direction."""
        rest = other[:-1] - self.centre[:-1] - (other[-1] - self.centre[-1]) * self.gain
        return float(np.sqrt(np.sum(np.linalg.solve(self.lower, rest) ** 2)))


@dataclass(frozen=True)
class _Chance:
    """Covariance (n, n) in deg^2 of what chance does to the cells that count: of the bench, and of a noise of 1 g."""

    bench: Array
    reading: Array

    @classmethod
    def of(cls, table: ErrorTable, fitted: Fitted) -> _Chance:
        linear = Linear(
            table.sessions, table.start, np.concatenate([table.base, *(option.field for option in fitted.options)])
        )
        where = np.ix_(table.mask, table.mask)
        bench = chance_of(table, linear, fitted.values, POSTERIOR.quiet_g)[where]
        whole = chance_of(table, linear, fitted.values, fitted.noise_g)[where]
        extra, directions = np.linalg.eigh(whole - bench)
        return cls(bench, (directions * np.maximum(extra, 0.0)) @ directions.T / fitted.noise_g**2)


@dataclass(frozen=True)
class _Evidence:
    """What the table says of values of one set."""

    table: ErrorTable
    chance: _Chance
    linear: Linear
    log_prior_of_set: float

    @classmethod
    def of(cls, explained: Explained, fitted: Fitted, chance: _Chance) -> _Evidence:
        table = explained.problem.table
        fields = [table.base, *(option.field for option in fitted.options)]
        linear = Linear(table.sessions, table.start, np.concatenate(fields))
        return cls(table, chance, linear, log_prior_of_set(explained.problem.options, fitted))

    def left(self, at: Array) -> Array:
        """(n,) what the cells that count are off by, at values and logarithm of the noise."""
        predicted = predict_cells(self.linear, at[:-1], self.noise_g(at), self.table.draws, slopes=False).cells.mean(
            axis=0
        )
        return np.asarray((self.table.published - predicted).reshape(-1)[self.table.mask])

    def noise_g(self, at: Array) -> float:
        return self.table.noise_g or float(np.exp(at[-1]))

    def likelihood(self, left: Array, noise_g: float, tau: float) -> float:
        """Logarithm, with a scatter beyond chance."""
        cov = self.chance.bench + noise_g**2 * self.chance.reading
        cov = cov + np.diag((tau * self.table.spread[self.table.mask]) ** 2)
        lower = np.linalg.cholesky(cov)
        z = np.linalg.solve(lower, left)
        return float(-0.5 * z @ z - np.sum(np.log(np.diag(lower))))

    def prior(self, at: Array) -> float:
        """Logarithm of the normalised prior of values and noise, and of the set."""
        known = self.table.known
        base, extra = at[: known.size], at[known.size : -1]
        value = -0.5 * np.sum((base / known) ** 2)
        value -= np.sum(np.log1p((extra / POSTERIOR.size) ** 2) + np.log(np.pi * POSTERIOR.size))
        value -= 0.5 * ((at[-1] - np.log(TABLE_FITS.noise_g)) / TABLE_FITS.noise_log_std) ** 2
        return float(value + self.log_prior_of_set)

    def posterior(self, at: Array, tau: float) -> float:
        """Logarithm of the evidence at values, noise and scatter."""
        likely = self.likelihood(self.left(at), self.noise_g(at), tau)
        return likely + self.prior(at) + float(log_prior_of_scatter(np.array(tau)))


def _mode(explained: Explained, fitted: Fitted) -> _Mode:
    table = explained.problem.table
    cov = covariance_with_priors(table, fitted)
    spread = float(np.sqrt(cov[-1, -1]))
    gain = cov[:-1, -1] / cov[-1, -1]
    lower = np.linalg.cholesky(cov[:-1, :-1] - np.outer(gain, gain) * cov[-1, -1])
    centre = np.append(fitted.values, np.log(fitted.noise_g))
    known = table.known
    base, extra = centre[: known.size], centre[known.size : -1]
    mass = -0.5 * fitted.deviance - 0.5 * np.sum((base / known) ** 2)
    mass -= np.sum(np.log1p((extra / POSTERIOR.size) ** 2) + np.log(np.pi * POSTERIOR.size))
    mass -= 0.5 * ((centre[-1] - np.log(TABLE_FITS.noise_g)) / TABLE_FITS.noise_log_std) ** 2
    mass += np.sum(np.log(np.diag(lower))) + np.log(spread) + 0.5 * centre.size * np.log(2 * np.pi)
    return _Mode(fitted, centre, spread, gain, lower, float(mass) + log_prior_of_set(explained.problem.options, fitted))


def instruments(explained: Explained, count: int, seed: int, progress: Progress | None = None) -> Posterior:
    """`count` instruments that the table allows. The same seed gives the same instruments."""
    report = progress or (lambda share, words: None)
    table = explained.problem.table
    sets = _likely_sets(explained, report)
    report(0.5, "sizes that the table allows")
    common = _Chance.of(table, sets[0][0].fitted)
    top = max(m.log_mass for group in sets for m in group)
    # the square root: what looks unlikely is looked at all the same
    wish = np.array([sum(np.exp(0.5 * (m.log_mass - top)) for m in group) for group in sets])
    rng = np.random.default_rng([seed, POSTERIOR.stream])
    found: list[_Particle] = []
    for k, group in enumerate(sets):
        own = common if k == 0 or k >= POSTERIOR.searched_sets else _Chance.of(table, group[0].fitted)
        evidence = _Evidence.of(explained, group[0].fitted, own)
        if k < POSTERIOR.searched_sets and table.noise_g is None:
            group = [mode for each in group[: POSTERIOR.signs_kept] for mode in _by_noise(evidence, each)]
        found += _proposals(
            evidence, group, max(POSTERIOR.least_proposals, int(POSTERIOR.proposals * wish[k] / wish.sum())), rng
        )
        report(POSTERIOR.progress[0] + POSTERIOR.progress[1] * (k + 1) / len(sets), "sizes that the table allows")
    logs = np.array([particle.log_weight for particle in found])
    weight = np.exp(logs - logs.max())
    # no single proposal may stand for more than it can know
    weight = np.minimum(weight / weight.sum(), 1.0 / np.sqrt(weight.size))
    weight /= weight.sum()
    places = np.searchsorted(np.cumsum(weight), (np.arange(count) + rng.uniform()) / count)
    places = rng.permutation(np.minimum(places, weight.size - 1))
    own_poses = errors_in_common(table.sessions, explained.problem.model, table.noise_g or TABLE_FITS.noise_g)
    draws = []
    for n, place in enumerate(places):
        particle = found[place]
        values = _moved(particle, rng)
        draws.append(_drawn(explained, particle.mode.fitted, values, own_poses[:, :, table.sessions.turns :]))
        if n % POSTERIOR.report_every == 0:
            report(sum(POSTERIOR.progress) + POSTERIOR.progress[1] * n / count, "sizes that the table allows")
    probability: dict[tuple[str, ...], float] = {}
    for particle, part in zip(found, weight.tolist(), strict=True):
        names = tuple(sorted(o.effect for o in particle.mode.fitted.options))
        probability[names] = probability.get(names, 0.0) + part
    explanations = tuple(Explanation(n, p) for n, p in sorted(probability.items(), key=lambda item: -item[1]))
    return Posterior(explanations, tuple(draws), float(1.0 / np.sum(weight**2)))


def _likely_sets(explained: Explained, report: Progress) -> list[list[_Mode]]:
    """The modes of the likeliest sets, likeliest set first."""
    table = explained.problem.table
    every = {frozenset(f.options): [_mode(explained, f)] for f in (*explained.tried, explained.best)}
    searched: set[frozenset[Option]] = set()
    grown: set[frozenset[Option]] = set()

    def ranked() -> list[frozenset[Option]]:
        return sorted(every, key=lambda key: -max(m.log_mass for m in every[key]))

    def with_signs(most: int) -> None:
        for key in ranked()[:most]:
            if key not in searched:
                every[key] = _signs(explained, every[key][0])
                searched.add(key)

    for turn, number in enumerate(POSTERIOR.grown_sets):
        report(0.5 * turn / len(POSTERIOR.grown_sets), "other explanations")
        with_signs(POSTERIOR.searched_sets)
        for key in [key for key in ranked() if key not in grown][:number]:
            grown.add(key)
            parent = max(every[key], key=lambda m: m.log_mass).fitted
            for option in _helpful(explained, parent):
                larger = key | {option}
                mode = _mode(explained, fit_set(table, (*parent.options, option), parent, rounds=0))
                if larger not in every or mode.log_mass > every[larger][0].log_mass:
                    every[larger] = [mode]
                    searched.discard(larger)
    with_signs(POSTERIOR.searched_sets)
    order = ranked()[: POSTERIOR.most_sets]
    share = np.exp([max(m.log_mass for m in every[key]) for key in order])
    share = np.cumsum(share / share.sum())
    return [
        sorted(every[key], key=lambda m: -m.log_mass)
        for key, s in zip(order, share, strict=True)
        if s < POSTERIOR.kept or key == order[0]
    ]


def _helpful(explained: Explained, parent: Fitted) -> list[Option]:
    """The options whose addition promises most evidence, by one linear step from a fitted set."""
    table = explained.problem.table
    options = [o for o in explained.problem.options if o.effect not in parent.effects]
    linear = Linear(
        table.sessions,
        table.start,
        np.concatenate([table.base, *(o.field for o in parent.options), *(o.field for o in options)]),
    )
    sizes = [len(o.amplitudes) for o in options]
    values = np.append(parent.values, np.zeros(sum(sizes)))
    predicted = predict_cells(linear, values, parent.noise_g, table.draws)
    mask = table.mask
    slope = predicted.slope.reshape(values.size + 1, -1)[:, mask]
    left = (table.published - predicted.cells.mean(axis=0)).reshape(-1)[mask]
    inverse = np.linalg.inv(parent.covariance(table)[np.ix_(mask, mask)])
    known = np.append(slope[: parent.values.size], slope[-1:] * parent.noise_g, axis=0)
    inner = np.linalg.inv(known @ inverse @ known.T + np.diag(table.precision(len(known))))
    # what the set does not take up itself
    rest = inverse - inverse @ known.T @ inner @ known @ inverse
    promise = []
    start = parent.values.size
    for option, size in zip(options, sizes, strict=True):
        own = slope[start : start + size]
        start += size
        curve = own @ rest @ own.T + np.eye(size) / POSTERIOR.size**2
        pull = own @ rest @ left
        gain = 0.5 * float(pull @ np.linalg.solve(curve, pull)) - 0.5 * float(
            np.linalg.slogdet(curve * POSTERIOR.size**2)[1]
        )
        promise.append(gain + log_share(explained.problem.options, option))
    order = np.argsort(promise)[::-1][: POSTERIOR.helpful]
    return [options[k] for k in order]


def _signs(explained: Explained, first: _Mode) -> list[_Mode]:
    """The modes of a set: fitted again with each amplitude, and with each effect, turned around."""
    table = explained.problem.table
    modes = [first]
    for k in range(len(first.fitted.options)):
        own = first.fitted.own(k)
        turned = [np.arange(own.start, own.stop)]
        turned += [np.array([j]) for j in range(own.start, own.stop)] if own.stop - own.start > 1 else []
        for which in turned:
            values = first.fitted.values.copy()
            values[which] *= -1.0
            fitted = fit_set(table, first.fitted.options, replace(first.fitted, values=values), rounds=0)
            mode = _mode(explained, fitted)
            near = any(other.away(mode.centre) < POSTERIOR.apart for other in modes)
            if not near and mode.log_mass > first.log_mass - POSTERIOR.worth / 2:
                modes.append(mode)
    return modes


def _by_noise(evidence: _Evidence, mode: _Mode) -> list[_Mode]:
    """A mode fitted again at several noises: the less of it, the better all else is known, and the other way."""
    table = evidence.table
    start = mode.centre.copy()
    tau = max(mode.fitted.tau_rad, float(POSTERIOR.taus[0]))
    found = []
    for factor in POSTERIOR.noises:
        at = start.copy()
        at[-1] += np.log(factor)
        cov = evidence.chance.bench + evidence.noise_g(at) ** 2 * evidence.chance.reading
        inverse = np.linalg.inv(cov + np.diag((tau * table.spread[table.mask]) ** 2))
        for _ in range(3):
            precision = table.precision(at.size)[:-1].copy()
            precision[table.known.size :] = 2.0 / (POSTERIOR.size**2 + at[table.known.size : -1] ** 2)
            predicted = predict_cells(evidence.linear, at[:-1], evidence.noise_g(at), table.draws)
            slope = predicted.slope.reshape(at.size, -1)[:-1, table.mask]
            left = (table.published - predicted.cells.mean(axis=0)).reshape(-1)[table.mask]
            inner = np.linalg.inv(slope @ inverse @ slope.T + np.diag(precision))
            # peak-to-peaks are nonlinear: no long steps
            at[:-1] += np.clip(inner @ (slope @ inverse @ left - precision * at[:-1]), -1.0, 1.0)
        lower = np.linalg.cholesky(inner)
        mass = evidence.posterior(at, tau) + float(np.sum(np.log(np.diag(lower))))
        found.append(_Mode(mode.fitted, at, POSTERIOR.between, np.zeros(at.size - 1), lower, mass))
    return sorted(found, key=lambda m: -m.log_mass)


@dataclass(frozen=True)
class _Particle:
    """Values of a set, with the scatter beyond chance, and the logarithm of their weight (part of the evidence)."""

    evidence: _Evidence
    mode: _Mode
    at: Array
    tau: float
    log_posterior: float
    log_weight: float


def _proposals(evidence: _Evidence, group: list[_Mode], number: int, rng: np.random.Generator) -> list[_Particle]:
    """Values proposed by the modes of one set."""
    size = group[0].centre.size
    mass = np.exp([m.log_mass - group[0].log_mass for m in group])
    mass /= mass.sum()
    which = rng.choice(len(group), number, p=mass)
    z = rng.standard_normal((number, size)) / np.sqrt(rng.chisquare(POSTERIOR.freedom, (number, 1)) / POSTERIOR.freedom)
    at = np.stack([group[m].at(z[k : k + 1])[0] for k, m in enumerate(which)])
    proposed = np.logaddexp.reduce([np.log(m) + mode.density(at) for m, mode in zip(mass, group, strict=True)], axis=0)
    # the scatter beyond chance: proposed from what the first mode says of it
    centre = group[0].centre
    left, noise_g = evidence.left(centre), evidence.noise_g(centre)
    of_tau = np.array([evidence.likelihood(left, noise_g, float(t)) for t in POSTERIOR.taus]) + log_prior_of_scatter(
        POSTERIOR.taus
    )
    of_tau = np.exp(0.5 * (of_tau - of_tau.max()))
    of_tau /= of_tau.sum()
    chosen = rng.choice(POSTERIOR.taus.size, number, p=of_tau)
    found = []
    for k in range(number):
        tau = float(POSTERIOR.taus[chosen[k]])
        log = evidence.posterior(at[k], tau)
        weight = log - np.log(of_tau[chosen[k]]) - proposed[k] - np.log(number) + _constant(size)
        found.append(_Particle(evidence, group[which[k]], at[k], tau, log, float(weight)))
    return found


def _moved(particle: _Particle, rng: np.random.Generator) -> Array:
    """Values after some Metropolis steps."""
    at, tau, log = particle.at, particle.tau, particle.log_posterior
    for _ in range(POSTERIOR.moves):
        to = at + POSTERIOR.move * particle.mode.step(rng.standard_normal(at.size))
        to_tau = float(
            np.clip(tau * np.exp(POSTERIOR.tau_move * rng.standard_normal()), POSTERIOR.taus[0], POSTERIOR.taus[-1])
        )
        new = particle.evidence.posterior(to, to_tau)
        if np.log(rng.uniform()) < new - log:
            at, tau, log = to, to_tau, new
    return at


def _constant(size: int) -> float:
    """What the density of a Student distribution of this dimension leaves out (negative logarithm)."""
    from highside.special import gammaln

    log = (
        gammaln((POSTERIOR.freedom + size) / 2)
        - gammaln(POSTERIOR.freedom / 2)
        - 0.5 * size * np.log(POSTERIOR.freedom * np.pi)
    )
    return -float(log)


def _drawn(explained: Explained, fitted: Fitted, at: Array, own: Array) -> Drawn:
    problem = explained.problem
    table, base = problem.table, len(problem.base_names)
    values = replace(fitted, values=at[:-1])
    model = instrument(problem.model, problem.base_names, problem.base_units, values, range(len(fitted.options)))
    moved = np.tensordot(at[base : base + len(own)], own, 1) if len(own) else np.zeros((3, 0))
    return Drawn(model, table.noise_g or float(np.exp(at[-1])), moved, tuple(o.effect for o in fitted.options))

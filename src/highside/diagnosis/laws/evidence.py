"""The evidence of groups beside what is free and what is chosen: everything by inner products of whitened columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.families import Families, Part, WhiteFamilies, raw_columns_of
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import Whitener, evidence
from highside.diagnosis.laws.policy import LAW_EVIDENCE
from highside.diagnosis.laws.priors import Prior, best_priors, bound_of, shown_of
from highside.diagnosis.laws.problem import LawProblem

_T = TypeVar("_T")


@dataclass(frozen=True)
class LawTerm:
    """A chosen group with its prior."""

    group: LawGroup
    prior: Prior

    @property
    def precision(self) -> Array:
        """(m,) of its coefficients."""
        return np.asarray(1.0 / self.prior.variances(self.group.orders))


class Whitened:
    """Groups and residual under one noise; scores groups beside chosen terms."""

    def __init__(self, families: Families, whitener: Whitener, residual: Array) -> None:
        self.families, self.whitener = families, whitener
        self.residual, self._raw = whitener.white(residual[None])[0], residual
        self._scored = families.scores_under(whitener, residual)

    def of_groups(self, groups: list[LawGroup]) -> Whitened:
        """The same residual and noise beside other groups."""
        return Whitened(Families(self.families.problem, groups), self.whitener, self._raw)

    @property
    def groups(self) -> WhiteFamilies:
        """The groups, whitened: not held here, for those of another noise take their place."""
        return self.families.whitened(self.whitener)

    @cached_property
    def free(self) -> Array:
        """(P, C, n) all that is free, whitened."""
        return self.whitener.white(self.families.problem.free)

    def columns(self, terms: list[LawTerm]) -> tuple[Array, Array]:
        """Whitened columns (K, C, n) of all that is free and of the terms, and their prior precisions (K,)."""
        raw = [raw_columns(self.families.problem, [term]) for term in terms]
        white = [self.free, *(self.whitener.white(columns) for columns in raw)]
        return np.concatenate(white), prior_of(self.families.problem, terms)

    def total(self, terms: list[LawTerm]) -> float:
        """Log evidence of the terms beside all that is free."""
        columns, prior = self.columns(terms)
        both = flattened(np.concatenate([columns, self.residual[None]]))
        return float(evidence((both @ both.T)[None], prior, np.array([self.whitener.log_determinant]))[0])

    def posterior(self, terms: list[LawTerm]) -> tuple[Array, Array]:
        """Mean (K,) and covariance (K, K) of the coefficients of all that is free and of the terms."""
        columns, prior = self.columns(terms)
        flat = flattened(columns)
        inverse = inverse_of(flat @ flat.T, prior)
        return inverse @ (flat @ self.residual.reshape(-1)), inverse

    def left_of(self, terms: list[LawTerm], which: Sequence[int]) -> tuple[Array, Array]:
        """What some of the terms do, whitened (C n,), outside of all that is free and of what the others may do; and
        orthonormal rows (f, C n) of these."""
        columns, _ = self.columns([t for i, t in enumerate(terms) if i not in which])
        beside = orthonormal(flattened(columns))
        mean, _ = self.posterior(terms)
        target = np.zeros(self.residual.size)
        for k in which:
            start = len(self.free) + sum(t.group.size for t in terms[:k])
            own = self.groups.columns_of(terms[k].group)
            target = target + np.tensordot(mean[start : start + terms[k].group.size], own, 1).reshape(-1)
        return target - (target @ beside.T) @ beside, beside

    def may_reproduce(self, does: tuple[Array, Array]) -> NDArray[np.bool_]:
        """(G,) which groups may do what `left_of` gave, by inner products: all whose `reproduces` is worth asking."""
        target, beside = does
        channels = (len(self.families.problem.floor), self.families.problem.n)
        both = np.concatenate([beside, target[None]]).reshape(-1, *channels)
        near = np.zeros(len(self.families.groups), dtype=bool)
        for part, products in self.groups.products(both):
            across, drive = products[:, :, :-1], products[:, :, -1]
            left = part.gram - across @ across.transpose(0, 2, 1)
            explained = 2.0 * bound_of(*shown_of(part.gram, left, drive))
            most = LAW_CLASS.reproduced + LAW_CLASS.worth_asking * float(target @ target)
            near[part.family.members] = float(target @ target) - explained < most
        return near

    def reproduces(self, does: tuple[Array, Array], group: LawGroup) -> bool:
        """Whether a group can do what `left_of` gave, to within what the recording shows of a difference."""
        target, beside = does
        columns = self.groups.columns_of(group)
        flat = flattened(columns)
        own = orthonormal(flat - (flat @ beside.T) @ beside)
        left = target - (target @ own.T) @ own
        return float(left @ left) < LAW_CLASS.reproduced

    def scores(
        self,
        terms: list[LawTerm],
        *,
        least: float = 0.0,
        within: float = LAW_CLASS.same_confounded,
        down_to: float = -np.inf,
    ) -> tuple[Array, list[Prior]]:
        """(G,) nats that each group gains beside the terms, at its best prior, and these priors.

        -inf: more than `within` behind the best, less than `down_to`, or behind `least` where none comes up to that.
        """
        key = (least, within, down_to, *((term.group, term.prior) for term in terms))
        if key not in self._scored:
            self._scored[key] = self._gains(terms, least, within, down_to)
        return self._scored[key]

    def bounds(self, terms: list[LawTerm]) -> Array:
        """(G,) nats that each group gains beside the terms at most, by the best fit; -inf of what is barred."""
        most = np.full(len(self.families.groups), -np.inf)
        for part, _, bound in self._beside(terms):
            most[part.family.members] = bound
        return most

    def _beside(self, terms: list[LawTerm]) -> list[tuple[Part, tuple[Array, Array], Array]]:
        """Each part with what is left of its columns and of the residual beside the terms, and (G,) the most that each
        of its groups gains."""
        white = self.groups
        beside = [white.free, *(white.columns_of(term.group) for term in terms)]
        columns, prior = np.concatenate(beside), prior_of(self.families.problem, terms)
        flat = flattened(columns)
        inverse = inverse_of(flat @ flat.T, prior)
        coefficients = inverse @ (flat @ self.residual.reshape(-1))
        left = []
        for part, across, projections in white.beside([term.group for term in terms], self._raw):
            remaining = part.gram - np.tensordot(across, inverse, 1) @ across.transpose(0, 2, 1)
            left.append((part, shown_of(part.gram, remaining, projections - across @ coefficients)))
        # no prior gains more than the best fit does: what cannot come near the best is not looked at
        made = [(part, own, bound_of(*own) - part.family.tries) for part, own in left]
        for part, _, bound in made:
            bound[[i in self.families.barred for i in part.family.members]] = -np.inf
        return made

    def _gains(self, terms: list[LawTerm], least: float, within: float, down_to: float) -> tuple[Array, list[Prior]]:
        gains = np.full(len(self.families.groups), -np.inf)
        priors = [Prior(1.0, 1.0)] * gains.size
        made = self._beside(terms)
        parts, left, bounds = [one[0] for one in made], [one[1] for one in made], [one[2] for one in made]
        order = np.sort(np.concatenate([[0.0], *bounds]))
        high = float(order[-min(LAW_EVIDENCE.first, order.size)])
        looked = [np.zeros(bound.size, dtype=bool) for bound in bounds]
        # what is best is among them early, and what stays behind it need not be looked at so closely
        likely = sorted(range(len(parts)), key=lambda k: -float(bounds[k].max(initial=-np.inf)))
        # the highest bounds first; if none of these is enough, what may be; then what may come near the best
        for stage in range(3):
            best = float(gains.max(initial=0.0))
            if (stage == 1 and best >= least) or (stage == 2 and best < least):
                continue
            worth = max((high, least, best - within)[stage], down_to)
            for k in likely:
                part, (gram, drive), bound = parts[k], left[k], bounds[k]
                picked = np.flatnonzero((bound >= worth) & ~looked[k] & np.isfinite(bound))
                if not picked.size:
                    continue
                # of the first, what stays behind those before it is not looked at again
                near = (max(float(gains.max()) - within, down_to) if stage == 0 else worth) + part.family.tries[picked]
                gain, size, length = best_priors(gram[picked], drive[picked], part.family.orders[picked], near)
                looked[k][picked] = np.isfinite(gain) | (stage == 0)
                for own, j in enumerate(picked):
                    i = part.family.members[int(j)]
                    gains[i] = gain[own] - part.family.tries[j]
                    priors[i] = Prior(float(size[own]), float(length[own]))
        return gains, priors


def orthonormal(rows: Array) -> Array:
    """(f, m) rows that span these (k, m)."""
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)]
    if not len(rows):
        return rows
    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if (known := _by_cholesky(unit)) is not None:
        return known
    _, values, basis = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(basis[values > 1e-9 * values[0]])


def _by_cholesky(unit: Array) -> Array | None:
    """(k, m) orthonormal rows of the span of rows (k, m) that are clearly independent, by less work than singular
    values take; None of others. The same once more leaves rounding alone (CholeskyQR2: Yamamoto and others, Electron.
    Trans. Numer. Anal. 44, 2015)."""
    for turn in range(2):
        gram = unit @ unit.T
        if turn and np.abs(gram - np.eye(len(gram))).max() > LAW_EVIDENCE.nearly:
            return None
        try:
            lower = np.linalg.cholesky(gram)
        except np.linalg.LinAlgError:
            return None
        if np.diagonal(lower).min() < LAW_EVIDENCE.clearly:
            return None
        unit = np.linalg.inv(lower) @ unit
    return np.asarray(unit)


def raw_columns(problem: LawProblem, terms: list[LawTerm]) -> Array:
    """(K, C, n) columns of the terms."""
    parts = [np.empty((0, problem.count, problem.n))]
    return np.concatenate([*parts, *(raw_columns_of(problem, term.group) for term in terms)])


def prior_of(problem: LawProblem, terms: list[LawTerm]) -> Array:
    """(K,) prior precisions: 0 for what is free."""
    return np.concatenate([np.zeros(len(problem.free)), *(term.precision for term in terms)])


def inverse_of(gram: Array, prior: Array) -> Array:
    whole = gram + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit = whole / size[:, None] / size[None] + 1e-12 * np.eye(prior.size)
    return np.asarray(np.linalg.inv(unit) / size[:, None] / size[None])

"""The evidence of groups beside what is free and what is chosen: everything by inner products of whitened columns."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.classes_policy import LAW_CLASS
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


@dataclass(frozen=True)
class _Family:
    """Groups of the same number of columns on the same channels: `raw` (G, m, c, n)."""

    members: list[int]
    channels: tuple[int, ...]
    orders: Array
    """(G, m)"""
    groups: list[LawGroup]
    tries: Array
    """(G,) logarithm of how many like it are tried"""


class Families:
    """All groups of a problem, stacked where they are alike; those of `first`, which they begin with, stay there."""

    def __init__(self, problem: LawProblem, groups: list[LawGroup], first: Families | None = None) -> None:
        self.problem, self.groups, self.first, self._count = problem, groups, first, len(groups)
        alike: dict[tuple[int, tuple[int, ...]], list[int]] = defaultdict(list)
        for i in range(0 if first is None else first._count, len(groups)):
            alike[groups[i].size, groups[i].channels].append(i)
        self.families = [
            _Family(
                members,
                channels,
                np.stack([groups[i].orders for i in members]),
                [groups[i] for i in members],
                np.log([float(groups[i].tries) for i in members]),
            )
            for (_, channels), members in alike.items()
        ]
        self.barred: frozenset[int] = frozenset()
        """numbers of groups that are not scored"""
        self._kept: list[_WhiteFamilies] = []
        """under the last noises"""

    def without(self, barred: Callable[[LawGroup], bool]) -> Families:
        """The same without some groups; what is whitened is shared."""
        made = copy(self)
        made.barred = self.barred | {i for i, group in enumerate(self.groups) if barred(group)}
        return made

    def of(self, groups: list[LawGroup], barred: frozenset[int] = frozenset()) -> Families:
        """The same with these groups, the first of which are its own: what is whitened of those is shared."""
        made = Families(self.problem, groups, self)
        made.barred = barred
        return made

    @cached_property
    def size(self) -> int:
        """Numbers of all columns, those of `first` among them."""
        own = sum(family.orders.size * len(family.channels) for family in self.families) * self.problem.n
        return own + (self.first.size if self.first else 0)

    def whitened(self, whitener: Whitener) -> _WhiteFamilies:
        """All groups under a noise; as many noises are kept as there is room for with those of `first`."""
        for one in self._kept:
            if one.whitener.like(whitener):
                return one
        own = self.size - (self.first.size if self.first else 0)
        room = max(LAW_EVIDENCE.kept // max(self.size, 1), 1)
        del self._kept[: max(0, len(self._kept) - room + 1)]
        self._kept.append(_WhiteFamilies(self, whitener, keep=own <= LAW_EVIDENCE.kept))
        return self._kept[-1]


@dataclass(frozen=True)
class _Part:
    """A family under a noise: inner products (G, m, m) of its columns, and the columns (G, m, c n) where there is room
    for them."""

    family: _Family
    gram: Array
    columns: Array | None


def _forget(known: dict[LawGroup, _T], size: Callable[[_T], int], needed: AbstractSet[LawGroup]) -> None:
    """Drops what was kept first, but for what is needed, while more numbers are kept than there is room for."""
    excess = sum(map(size, known.values())) - LAW_EVIDENCE.kept
    for group in [one for one in known if one not in needed]:
        if excess <= 0:
            return
        excess -= size(known.pop(group))


class _WhiteFamilies:
    """All groups under one noise, and their inner products with whatever was set beside them.

    Whitened columns are kept where there is room; else they are made anew for each pass, a few groups at a time.
    """

    def __init__(self, families: Families, whitener: Whitener, *, keep: bool) -> None:
        # not the families themselves, which hold this: what holds each other stays until the collector comes by
        self.problem, self.whitener, self._keep = families.problem, whitener, keep
        self._families, self._before = families.families, families.first
        self._parts: list[_Part] = []
        """made by the first pass"""
        self.free: Array = self._first.free if self._first else whitener.white(families.problem.free)
        self._white: dict[LawGroup, Array] = {}
        self._across: dict[LawGroup, list[Array]] = {}
        self._free_across: list[Array] | None = None
        self._projections: tuple[Array, list[Array]] | None = None

    @property
    def _first(self) -> _WhiteFamilies | None:
        """The groups that these begin with: not held here, as in `Whitened.groups`."""
        return None if self._before is None else self._before.whitened(self.whitener)

    def _channels(self, family: _Family) -> list[int]:
        return list(range(self.problem.count)) if self.whitener.mixes else list(family.channels)

    def _columns(self, family: _Family, whole: Array | None) -> Iterator[Array]:
        """(g m, c, n) whitened columns of a few groups at a time, in `whole` (G m, c, n) or where the last were."""
        (count, size), n = family.orders.shape, self.problem.n
        channels, mixes = self._channels(family), self.whitener.mixes
        at_once = min(max(1, LAW_EVIDENCE.at_once // size), count)
        raw = np.zeros((at_once * size, len(channels), n))
        room = np.empty_like(raw) if whole is None else whole
        acting = list(family.channels) if mixes else list(range(len(channels)))
        for i in range(0, count, at_once):
            groups = family.groups[i : i + at_once]
            for k, group in enumerate(groups):
                raw[k * size : (k + 1) * size, acting] = group.columns()
            own = raw[: len(groups) * size]
            out = room[: len(own)] if whole is None else room[i * size : i * size + len(own)]
            if mixes:
                out[:] = self.whitener.white(own)
            else:
                for k, ch in enumerate(channels):
                    self.whitener.channel(ch, own[:, k], out[:, k])
            yield out

    def _raw(self, family: _Family) -> Iterator[Array]:
        """(g m, c, n) columns of a few groups at a time, not whitened, on the channels that they act on."""
        (count, size), n = family.orders.shape, self.problem.n
        at_once = min(max(1, LAW_EVIDENCE.at_once // size), count)
        room = np.empty((at_once * size, len(family.channels), n))
        for i in range(0, count, at_once):
            groups = family.groups[i : i + at_once]
            for k, group in enumerate(groups):
                room[k * size : (k + 1) * size] = group.columns()
            yield room[: len(groups) * size]

    def _passed(self, several: Sequence[Array]) -> list[list[Array]]:
        """Of each of several sets of whitened rows (K, C, n) the inner products (G, m, K) with each part."""
        made: list[list[Array]] = [[] for _ in several]
        across: list[Array] = []
        for k, family in enumerate(self._families):
            (count, size), channels = family.orders.shape, self._channels(family)
            rows = [one[:, channels].reshape(len(one), len(channels) * self.problem.n) for one in several]
            known = self._parts[k] if k < len(self._parts) else None
            if known is not None and known.columns is not None:
                blocks: Iterable[Array] = [known.columns]
            elif known is not None:
                # the filter on one side twice: few rows go through it, and no column of a group
                across = across or [self.whitener.transposed(one) for one in several]
                rows = [one[:, family.channels].reshape(len(one), -1) for one in across]
                blocks = self._raw(family)
            elif self._keep:
                whole = np.empty((count * size, len(channels), self.problem.n))
                for _ in self._columns(family, whole):
                    pass
                blocks = [whole]
            else:
                blocks = self._columns(family, None)
            grams: list[Array] = []
            products: list[list[Array]] = [[] for _ in several]
            for block in blocks:
                columns = block.reshape(-1, size, rows[0].shape[1])
                if known is None:
                    grams.append(columns @ columns.transpose(0, 2, 1))
                flat = columns.reshape(-1, columns.shape[2])
                for own, beside in zip(products, rows, strict=True):
                    own.append((flat @ beside.T).reshape(len(columns), size, -1))
            if known is None:
                self._parts.append(_Part(family, np.concatenate(grams), columns if self._keep else None))
            for found, own in zip(made, products, strict=True):
                found.append(np.concatenate(own))
        return made

    def products(self, white: Array) -> list[tuple[_Part, Array]]:
        """Each part with its inner products (G, m, K) with whitened rows (K, C, n)."""
        before = self._first.products(white) if self._first else []
        return [*before, *zip(self._parts, self._passed([white])[0], strict=True)]

    def columns_of(self, group: LawGroup) -> Array:
        """(m, C, n) whitened columns of a group."""
        if (first := self._first) is not None:
            return first.columns_of(group)
        if group not in self._white:
            self._white[group] = self.whitener.white(raw_columns_of(self.problem, group))
            _forget(self._white, lambda columns: columns.size, {group})
        return self._white[group]

    def beside(self, terms: Sequence[LawTerm], residual: Array) -> list[tuple[_Part, Array, Array]]:
        """Each part with its inner products (G, m, K) with all that is free and the terms, and (G, m) with a residual
        (C, n), not whitened: those of the last are kept. What is not known is taken in one pass."""
        before = self._first.beside(terms, residual) if self._first else []
        lacking = list(dict.fromkeys(term.group for term in terms if term.group not in self._across))
        wanted = [self.columns_of(group) for group in lacking]
        projected = self._projections is not None and self._projections[0] is residual
        if not projected:
            wanted.append(self.whitener.white(residual[None]))
        if self._free_across is None:
            wanted.append(self.free)
        made = self._passed(wanted) if wanted else []
        if self._free_across is None:
            self._free_across = made.pop()
        if not projected:
            self._projections = residual, [one[:, :, 0] for one in made.pop()]
        self._across.update(zip(lacking, made, strict=True))
        _forget(self._across, lambda parts: sum(one.size for one in parts), {term.group for term in terms})
        assert self._projections is not None
        own = (self._free_across, *(self._across[term.group] for term in terms))
        across = [np.concatenate(parts, axis=2) for parts in zip(*own, strict=True)]
        return [*before, *zip(self._parts, across, self._projections[1], strict=True)]


class Whitened:
    """Groups and residual under one noise; scores groups beside chosen terms."""

    def __init__(self, families: Families, whitener: Whitener, residual: Array) -> None:
        self.families, self.whitener = families, whitener
        self.residual, self._raw = whitener.white(residual[None])[0], residual
        self._scored: dict[tuple[object, ...], tuple[Array, list[Prior]]] = {}

    def of_groups(self, groups: list[LawGroup]) -> Whitened:
        """The same residual and noise beside other groups."""
        return Whitened(Families(self.families.problem, groups), self.whitener, self._raw)

    @property
    def groups(self) -> _WhiteFamilies:
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
        self, terms: list[LawTerm], *, least: float = 0.0, within: float = LAW_CLASS.same_confounded
    ) -> tuple[Array, list[Prior]]:
        """(G,) nats that each group gains beside the terms, at its best prior, and these priors.

        -inf: more than `within` behind the best, or behind `least` where none comes up to that.
        """
        key = (least, within, *((term.group, term.prior) for term in terms))
        if key not in self._scored:
            self._scored[key] = self._gains(terms, least, within)
        return self._scored[key]

    def _gains(self, terms: list[LawTerm], least: float, within: float) -> tuple[Array, list[Prior]]:
        white = self.groups
        beside = [white.free, *(white.columns_of(term.group) for term in terms)]
        columns, prior = np.concatenate(beside), prior_of(self.families.problem, terms)
        flat = flattened(columns)
        inverse = inverse_of(flat @ flat.T, prior)
        coefficients = inverse @ (flat @ self.residual.reshape(-1))
        groups = self.families.groups
        gains = np.full(len(groups), -np.inf)
        priors = [Prior(1.0, 1.0)] * len(groups)
        parts, left = [], []
        for part, across, projections in white.beside(terms, self._raw):
            remaining = part.gram - np.tensordot(across, inverse, 1) @ across.transpose(0, 2, 1)
            parts.append(part)
            left.append(shown_of(part.gram, remaining, projections - across @ coefficients))
        # no prior gains more than the best fit does: what cannot come near the best is not looked at
        bounds = [bound_of(*one) - part.family.tries for one, part in zip(left, parts, strict=True)]
        barred = self.families.barred
        for bound, part in zip(bounds, parts, strict=True):
            bound[[i in barred for i in part.family.members]] = -np.inf
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
            worth = (high, least, best - within)[stage]
            for k in likely:
                part, (gram, drive), bound = parts[k], left[k], bounds[k]
                picked = np.flatnonzero((bound >= worth) & ~looked[k] & np.isfinite(bound))
                if not picked.size:
                    continue
                # of the first, what stays behind those before it is not looked at again
                near = (float(gains.max()) - within if stage == 0 else worth) + part.family.tries[picked]
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


def raw_columns_of(problem: LawProblem, group: LawGroup) -> Array:
    """(m, C, n) columns of a group."""
    full = np.zeros((group.size, problem.count, problem.n))
    full[:, list(group.channels)] = group.columns()
    return full


def prior_of(problem: LawProblem, terms: list[LawTerm]) -> Array:
    """(K,) prior precisions: 0 for what is free."""
    return np.concatenate([np.zeros(len(problem.free)), *(term.precision for term in terms)])


def inverse_of(gram: Array, prior: Array) -> Array:
    whole = gram + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit = whole / size[:, None] / size[None] + 1e-12 * np.eye(prior.size)
    return np.asarray(np.linalg.inv(unit) / size[:, None] / size[None])

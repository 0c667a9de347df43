"""All groups of a problem under the noises that are tried: their columns, whitened, and the inner products of these."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.family import Family
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.on_channels import OnChannels
from highside.diagnosis.laws.policy import LAW_EVIDENCE
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem

_T = TypeVar("_T")
Scores = dict[Hashable, tuple[Array, list[Prior]]]
"""gains (G,) and the priors of them"""


class Families:
    """All groups of a problem, stacked where they are alike; those of `first`, which they begin with, stay there."""

    def __init__(self, problem: LawProblem, groups: list[LawGroup], first: Families | None = None) -> None:
        self.problem, self.groups, self.first, self._count = problem, groups, first, len(groups)
        alike: dict[tuple[int, tuple[int, ...]], list[int]] = defaultdict(list)
        for i in range(0 if first is None else first._count, len(groups)):
            alike[groups[i].size, groups[i].channels].append(i)
        # of few values the columns themselves are kept, which many noises and residuals ask for
        numbers = sum(size * len(channels) * len(members) for (size, channels), members in alike.items())
        keep = numbers * problem.n <= LAW_EVIDENCE.raw
        self.families = [
            Family(
                members,
                channels,
                np.stack([groups[i].orders for i in members]),
                [groups[i] for i in members],
                np.log([float(groups[i].tries) for i in members]),
                keep,
            )
            for (_, channels), members in alike.items()
        ]
        self.barred: frozenset[int] = frozenset()
        """numbers of groups that are not scored"""
        self._kept: list[WhiteFamilies] = []
        """under the last noises"""
        self._on_channels = OnChannels(self.families)
        self._scores: list[tuple[Whitener, Array, Scores]] = []

    def without(self, barred: Callable[[LawGroup], bool]) -> Families:
        """The same without some groups; what is whitened is shared."""
        made = copy(self)
        made._scores = []
        made.barred = self.barred | {i for i, group in enumerate(self.groups) if barred(group)}
        return made

    def of(self, groups: list[LawGroup], barred: frozenset[int] = frozenset()) -> Families:
        """The same with these groups, the first of which are its own: what is whitened of those is shared."""
        made = Families(self.problem, groups, self)
        made.barred = barred
        return made

    def beside(self, problem: LawProblem) -> Families:
        """The same beside what another problem of the same values leaves free: what the columns of the groups have in
        common on each channel is shared."""
        made = copy(self)
        made.problem, made._kept, made._scores = problem, [], []
        made.first = None if self.first is None else self.first.beside(problem)
        return made

    def scores_under(self, whitener: Whitener, residual: Array) -> Scores:
        """What was scored of a residual (C, n) under a noise, by what was asked for; of the last few."""
        for noise, of, known in self._scores:
            if of is residual and noise.like(whitener):
                return known
        self._scores = [*self._scores[1 - LAW_EVIDENCE.scores :], (whitener, residual, {})]
        return self._scores[-1][2]

    @cached_property
    def size(self) -> int:
        """Numbers of all columns, those of `first` among them."""
        own = sum(family.orders.size * len(family.channels) for family in self.families) * self.problem.n
        return own + (self.first.size if self.first else 0)

    def whitened(self, whitener: Whitener) -> WhiteFamilies:
        """All groups under a noise; as many noises are kept as there is room for with those of `first`."""
        for one in self._kept:
            if one.whitener.like(whitener):
                return one
        own = self.size - (self.first.size if self.first else 0)
        room = max(LAW_EVIDENCE.kept // max(self.size, 1), 1)
        del self._kept[: max(0, len(self._kept) - room + 1)]
        keep = own <= LAW_EVIDENCE.kept
        # of white noise a factor of each channel is all that differs, and no column need go through a filter
        by_channel = not whitener.mixes and (not keep or not whitener.noise.remembers)
        self._kept.append(WhiteFamilies(self, whitener, self._on_channels if by_channel else None, keep=keep))
        return self._kept[-1]


@dataclass(frozen=True)
class Part:
    """A family under a noise: inner products (G, m, m) of its columns, and the columns (G, m, c n) where there is room
    for them."""

    family: Family
    gram: Array
    columns: Array | None


def _forget(known: dict[LawGroup, _T], size: Callable[[_T], int], needed: AbstractSet[LawGroup]) -> None:
    """Drops what was kept first, but for what is needed, while more numbers are kept than there is room for."""
    excess = sum(map(size, known.values())) - LAW_EVIDENCE.kept
    for group in [one for one in known if one not in needed]:
        if excess <= 0:
            return
        excess -= size(known.pop(group))


class WhiteFamilies:
    """All groups under one noise, and their inner products with whatever was set beside them.

    Whitened columns are kept where there is room; else they are made anew for each pass, a few groups at a time.
    """

    def __init__(self, families: Families, whitener: Whitener, shared: OnChannels | None, *, keep: bool) -> None:
        # not the families themselves, which hold this: what holds each other stays until the collector comes by
        self.problem, self.whitener, self._shared, self._keep = families.problem, whitener, shared, keep
        self._families, self._before = families.families, families.first
        self._parts: list[Part] = []
        """made by the first pass"""
        self.free: Array = self._first.free if self._first else whitener.white(families.problem.free)
        self._white: dict[LawGroup, Array] = {}
        self._across: dict[LawGroup, list[Array]] = {}
        self._free_across: list[Array] | None = None
        self._projections: tuple[Array, list[Array]] | None = None

    @property
    def _first(self) -> WhiteFamilies | None:
        """The groups that these begin with: not held here, as in `Whitened.groups`."""
        return None if self._before is None else self._before.whitened(self.whitener)

    def _channels(self, family: Family) -> list[int]:
        return list(range(self.problem.count)) if self.whitener.mixes else list(family.channels)

    def _columns(self, family: Family, whole: Array | None) -> Iterator[Array]:
        """(g m, c, n) whitened columns of a few groups at a time, in `whole` (G m, c, n) or where the last were."""
        (count, size), n = family.orders.shape, self.problem.n
        channels, mixes = self._channels(family), self.whitener.mixes
        at_once = min(max(1, LAW_EVIDENCE.at_once // size), count)
        raw = np.zeros((at_once * size, len(channels), n))
        room = np.empty_like(raw) if whole is None else whole
        acting = list(family.channels) if mixes else list(range(len(channels)))
        start = 0
        for block in family.raw_blocks(n):
            own = raw[: len(block)]
            own[:, acting] = block
            out = room[: len(own)] if whole is None else room[start : start + len(own)]
            start += len(own)
            if mixes:
                out[:] = self.whitener.white(own)
            else:
                for k, ch in enumerate(channels):
                    self.whitener.channel(ch, own[:, k], out[:, k])
            yield out

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
                blocks = family.raw_blocks(self.problem.n)
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
                self._parts.append(Part(family, np.concatenate(grams), columns if self._keep else None))
            for found, own in zip(made, products, strict=True):
                found.append(np.concatenate(own))
        return made

    def products(self, white: Array) -> list[tuple[Part, Array]]:
        """Each part with its inner products (G, m, K) with whitened rows (K, C, n)."""
        before = self._first.products(white) if self._first else []
        if self._shared is not None:
            grams, _ = self._shared.beside(self.whitener, {})
            return [*before, *zip(self._as_parts(grams), self._shared.products(self.whitener, white), strict=True)]
        return [*before, *zip(self._parts, self._passed([white])[0], strict=True)]

    def columns_of(self, group: LawGroup) -> Array:
        """(m, C, n) whitened columns of a group."""
        if (first := self._first) is not None:
            return first.columns_of(group)
        if group not in self._white:
            self._white[group] = self.whitener.white(raw_columns_of(self.problem, group))
            _forget(self._white, lambda columns: columns.size, {group})
        return self._white[group]

    def beside(self, chosen: Sequence[LawGroup], residual: Array) -> list[tuple[Part, Array, Array]]:
        """Each part with its inner products (G, m, K) with all that is free and with some groups, and (G, m) with a
        residual (C, n), not whitened: those of the last are kept. What is not known is taken in one pass."""
        before = self._first.beside(chosen, residual) if self._first else []
        own = self._of_channels(chosen, residual) if self._shared is not None else self._of_all(chosen, residual)
        return [*before, *own]

    def _of_channels(self, chosen: Sequence[LawGroup], residual: Array) -> list[tuple[Part, Array, Array]]:
        assert self._shared is not None
        rows: dict[Hashable, Array] = {group: raw_columns_of(self.problem, group) for group in chosen}
        free = id(self.problem.free)
        rows |= {free: self.problem.free, id(residual): residual[None]}
        grams, made = self._shared.beside(self.whitener, rows)
        across = [
            np.concatenate(one, axis=2) for one in zip(made[free], *(made[group] for group in chosen), strict=True)
        ]
        return list(zip(self._as_parts(grams), across, (one[:, :, 0] for one in made[id(residual)]), strict=True))

    def _as_parts(self, grams: Sequence[Array]) -> list[Part]:
        return [Part(family, gram, None) for family, gram in zip(self._families, grams, strict=True)]

    def _of_all(self, chosen: Sequence[LawGroup], residual: Array) -> list[tuple[Part, Array, Array]]:
        lacking = list(dict.fromkeys(group for group in chosen if group not in self._across))
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
        _forget(self._across, lambda parts: sum(one.size for one in parts), set(chosen))
        assert self._projections is not None
        own = (self._free_across, *(self._across[group] for group in chosen))
        across = [np.concatenate(parts, axis=2) for parts in zip(*own, strict=True)]
        return list(zip(self._parts, across, self._projections[1], strict=True))


def raw_columns_of(problem: LawProblem, group: LawGroup) -> Array:
    """(m, C, n) columns of a group."""
    full = np.zeros((group.size, problem.count, problem.n))
    full[:, list(group.channels)] = group.columns()
    return full

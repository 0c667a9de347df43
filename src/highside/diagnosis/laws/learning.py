"""The noise of a session beside any laws, of highest evidence.

Settings of the noise are compared by inner products of whitened columns. What is whitened under a setting does not
depend on what else is fitted, so the inner products of two sets of columns are taken once: of what is free, of the
groups, of a residual. Of two sets only one goes through the filters, there and back: x' V^-1 y is x times the solved
y. Priors and what the data cannot show turn these small matrices alone. Of the settings a fourth is looked at first,
then the neighbours of the best level and of the best ladder.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened, outside
from highside.diagnosis.laws.evidence import LawTerm, orthonormal
from highside.diagnosis.laws.families import raw_columns_of
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import LawNoise, evidence, evidence_of_settings, whitened_each
from highside.diagnosis.laws.noise_filters import (
    LADDERS,
    LEVELS,
    CellFilters,
    Numbers,
    RowFilters,
    SettingFilters,
    level_lengths,
)
from highside.diagnosis.laws.noise_policy import LAW_NOISE
from highside.diagnosis.laws.policy import LAW_EVIDENCE
from highside.diagnosis.laws.problem import LawProblem

FREE = "free"
TOGETHER = ((1.0, 1.0, 0.0), (1.0, 0.0, 1.0))
"""errors that are of one size: of both set angles, and of the level in both its directions"""


@dataclass(frozen=True)
class _Columns:
    """Some columns (m, C, n) and how a fit combines them: `turn` (k, m)."""

    key: Hashable
    """the same of columns that are the same"""
    raw: Array
    turn: Array


class NoiseLearner:
    """Learns the noise of a problem beside any fit; the filters of all settings are made once."""

    def __init__(self, problem: LawProblem) -> None:
        self.problem = problem
        self._channels: list[_Products] = []
        self._raw: dict[LawGroup, tuple[Array, Array]] = {}
        self._residuals: list[Array] = []

    def learn(self, terms: Sequence[LawTerm], residual: Array) -> tuple[LawNoise, float]:
        """The noise of highest evidence beside what is free and the terms, and that evidence."""
        if not self.problem.memory:
            shown = [self.problem.free, *(np.tensordot(own.turn, own.raw, 1) for own in map(self._shown, terms))]
            prior = np.repeat([0.0, 1.0], [len(shown[0]), sum(len(own) for own in shown[1:])])
            return _with_jitter(self.problem, np.concatenate([*shown, residual[None]]), prior)
        if not self._channels:
            self._channels = _products_of(self.problem)
        if not any(one is residual for one in self._residuals):
            # what is kept goes by its identity
            self._residuals.append(residual)
        free = self.problem.free
        parts = [_Columns(FREE, free, np.eye(len(free))), *(self._shown(term) for term in terms)]
        count = sum(len(part.turn) for part in parts)
        prior = np.concatenate([np.zeros(len(free)), np.ones(count - len(free))])
        parts.append(_Columns(("residual", id(residual)), residual[None], np.eye(1)))
        try:
            noise, best = self._with_memory(parts, prior)
        except np.linalg.LinAlgError:
            # combinations in which large columns cancel are whitened themselves
            turned = np.concatenate([np.tensordot(part.turn, part.raw, 1) for part in parts])
            noise, best = self._with_memory([_Columns(object(), turned, np.eye(len(turned)))], prior)
        if self.problem.jitter is not None:
            both = np.concatenate([np.tensordot(part.turn, part.raw, 1) for part in parts])
            other, gained = _with_jitter(self.problem, both, prior)
            if gained > best:
                noise, best = other, gained
        return noise, best

    def _with_memory(self, parts: Sequence[_Columns], prior: Array) -> tuple[LawNoise, float]:
        """White noise and levels of the highest evidence: among the coarse settings, then among the neighbours of the
        best, until none of these is better."""
        best, which = _Best.floor(self.problem.count), [_COARSE] * self.problem.count
        for turn in range(LAW_NOISE.finer):
            settings = [own.settings(parts, each) for own, each in zip(self._channels, which, strict=True)]
            before, best = best, _best_of(self.problem, settings, prior, best)
            if turn and best.chosen == before.chosen:
                break
            which = [_near(own, others) for own, others in zip(best.chosen, best.of_kinds, strict=True)]
        return best.noise(self.problem), best.evidence

    def without_memory(self, terms: Sequence[LawTerm], residual: Array, *, to_the_floor: bool = False) -> float:
        """Evidence beside the best noise that is white or errors of the set angles; `to_the_floor`: the floor, and such
        errors."""
        shown = [self._shown(term) for term in terms]
        free = self.problem.free
        columns = [free, *(np.tensordot(part.turn, part.raw, 1) for part in shown)]
        count = sum(len(part.turn) for part in shown)
        prior = np.concatenate([np.zeros(len(free)), np.ones(count)])
        return _with_jitter(self.problem, np.concatenate([*columns, residual[None]]), prior, to_the_floor)[1]

    def _shown(self, term: LawTerm) -> _Columns:
        """Combinations of a term's columns of unit prior precision, less what the data cannot show."""
        if term.group not in self._raw:
            raw = raw_columns_of(self.problem, term.group)
            white = flattened(raw / self.problem.floor)
            self._raw[term.group] = raw, white @ white.T
        raw, gram = self._raw[term.group]
        size = np.sqrt(term.prior.variances(term.group.orders))
        values, vectors = np.linalg.eigh(size[:, None] * gram * size)
        kept = vectors[:, values > LAW_EVIDENCE.undetermined]
        return _Columns(term.group, raw, kept.T * size)


_COARSE: Numbers = np.concatenate([[0], LEVELS[1::2, 1::2].ravel(), LADDERS[1::2]])


def _near(chosen: int, others: Sequence[int]) -> Numbers:
    """A setting, white noise alone, and other settings with the neighbours of each in share and length."""
    found = {0, chosen}
    for number in others:
        if number >= LADDERS[0]:
            at = number - int(LADDERS[0])
            found.update(LADDERS[max(at - 1, 0) : at + 2].tolist())
        elif number:
            i, j = divmod(number - 1, LEVELS.shape[1])
            found.update(LEVELS[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].ravel().tolist())
    return np.array(sorted(found))


@dataclass(frozen=True)
class _Settings:
    """Some settings of one channel, by their rising numbers (S,): inner products (S, K + 1, K + 1) and log
    determinants (S,) at a factor of 1."""

    numbers: Numbers
    inner: Array
    log_determinant: Array

    @property
    def cost(self) -> Array:
        """(S,) nats that each must gain over white noise."""
        return np.where(self.numbers > 0, LAW_NOISE.cost, 0.0)

    def at(self, number: int) -> int:
        """Where a setting of these stands."""
        return int(np.searchsorted(self.numbers, number))


class _Products:
    """Inner products of one channel under its settings; `scale` is the mean variance of its white noise."""

    def __init__(self, channel: int, filters: SettingFilters, scale: float, n: int) -> None:
        self.channel, self.filters, self.scale, self.n = channel, filters, scale, n
        self._blocks: dict[tuple[Hashable, Hashable], tuple[Array, NDArray[np.bool_]]] = {}
        """(S, m, k), and of which settings (S,) they are known"""

    def settings(self, parts: Sequence[_Columns], numbers: Numbers) -> _Settings:
        """Of all parts, in their order, the residual last, under settings of these rising numbers."""
        ends = np.cumsum([0, *(len(part.turn) for part in parts)])
        inner = np.zeros((len(numbers), int(ends[-1]), int(ends[-1])))
        acting = [np.flatnonzero(np.any(part.raw[:, self.channel] != 0, axis=1)) for part in parts]
        pairs = [(i, j) for i in range(len(parts)) for j in range(i, len(parts)) if acting[i].size and acting[j].size]
        self._take(parts, acting, pairs, numbers)
        for i, j in pairs:
            if (found := self._blocks.get((parts[i].key, parts[j].key))) is not None:
                block = found[0][numbers]
            else:
                block = self._blocks[parts[j].key, parts[i].key][0][numbers].transpose(0, 2, 1)
            block = parts[i].turn[:, acting[i]] @ block @ parts[j].turn[:, acting[j]].T
            inner[:, ends[i] : ends[i + 1], ends[j] : ends[j + 1]] = block
            if j > i:
                inner[:, ends[j] : ends[j + 1], ends[i] : ends[i + 1]] = block.transpose(0, 2, 1)
        inner /= self.scale
        return _Settings(numbers, inner, self.filters.log_determinants(numbers) + self.n * float(np.log(self.scale)))

    def _take(
        self,
        parts: Sequence[_Columns],
        acting: Sequence[NDArray[np.intp]],
        pairs: Sequence[tuple[int, int]],
        numbers: Numbers,
    ) -> None:
        """Inner products (S, m, k) of the columns of two parts that act on the channel, under the settings for which
        they are not known: those that lack the same ones go through the filters together."""
        alike: dict[bytes, list[tuple[int, int]]] = defaultdict(list)
        for i, j in pairs:
            key, turned = (parts[i].key, parts[j].key), (parts[j].key, parts[i].key)
            if turned in self._blocks:
                key, (i, j) = turned, (j, i)
            if key not in self._blocks:
                count = self.filters.count
                self._blocks[key] = np.empty((count, acting[i].size, acting[j].size)), np.zeros(count, dtype=bool)
            alike[numbers[~self._blocks[key][1][numbers]].tobytes()].append((i, j))
        for lacking, own in alike.items():
            if lacking:
                self._pass(parts, acting, own, np.frombuffer(lacking, dtype=numbers.dtype))

    def _pass(
        self,
        parts: Sequence[_Columns],
        acting: Sequence[NDArray[np.intp]],
        pairs: Sequence[tuple[int, int]],
        numbers: Numbers,
    ) -> None:
        """These inner products under these settings, run by run: all at once are many times the columns."""
        blocks = {(i, j): self._blocks[parts[i].key, parts[j].key] for i, j in pairs}
        sizes = [own.size for own in acting]
        solved = _to_solve(pairs, sizes)
        wanted = sorted({i for i, j in pairs if i == j} | set(solved.values()))
        for run, whiten, transposed in self.filters.runs(numbers):
            for k in wanted:
                white = whiten(parts[k].raw[acting[k], self.channel])
                if (k, k) in blocks:
                    blocks[k, k][0][numbers[run]] = white @ white.transpose(0, 2, 1)
                mine = [pair for pair, own in solved.items() if own == k]
                if not mine:
                    continue
                flat = np.ascontiguousarray(transposed(white).transpose(2, 0, 1)).reshape(self.n, -1)
                for i, j in mine:
                    other = j if i == k else i
                    block = parts[other].raw[acting[other], self.channel] @ flat
                    block = block.reshape(sizes[other], -1, sizes[k]).transpose(1, 0, 2)
                    blocks[i, j][0][numbers[run]] = block if j == k else block.transpose(0, 2, 1)
        for _, known in blocks.values():
            known[numbers] = True


def _to_solve(pairs: Sequence[tuple[int, int]], sizes: Sequence[int]) -> dict[tuple[int, int], int]:
    """Of each pair of two parts the one that is solved for: the one with fewer columns, or one that is solved for
    anyway."""
    chosen: dict[tuple[int, int], int] = {}
    for pair in sorted((pair for pair in pairs if pair[0] != pair[1]), key=lambda p: -min(sizes[p[0]], sizes[p[1]])):
        anyway = [k for k in pair if k in chosen.values()]
        chosen[pair] = min(anyway or pair, key=lambda k: sizes[k])
    return chosen


def _products_of(problem: LawProblem) -> list[_Products]:
    """One for each channel; channels of independent values whose floors are in proportion share their filters."""
    made: list[tuple[Array, RowFilters]] = []
    found = []
    for c in range(problem.count):
        variance = problem.floor[c] ** 2
        mean = float(variance.mean())
        if problem.cells is not None:
            found.append(_Products(c, CellFilters(problem.cells, c, problem.t_s), mean, problem.n))
            continue
        white = variance / mean
        own = next((filters for known, filters in made if np.allclose(known, white, rtol=1e-9, atol=0.0)), None)
        if own is None:
            own = RowFilters.of(white, problem.t_s)
            made.append((white, own))
        found.append(_Products(c, own, mean, problem.n))
    return found


@dataclass(frozen=True)
class _Best:
    """Of each channel the setting and factor of highest evidence, and that evidence."""

    chosen: list[int]
    factor: Array
    evidence: float
    of_kinds: list[list[int]]
    """of each channel the best level and the best ladder that were looked at last"""

    @classmethod
    def floor(cls, count: int) -> _Best:
        """White noise of the floor, where a look begins."""
        return cls([0] * count, np.ones(count), -np.inf, [[] for _ in range(count)])

    def noise(self, problem: LawProblem) -> LawNoise:
        shares, lengths = np.array(LAW_NOISE.shares), level_lengths(problem.t_s)
        made = LawNoise.floor_alone(problem)
        share, length, ladder = made.share.copy(), made.length.copy(), made.ladder.copy()
        for c, number in enumerate(self.chosen):
            if number >= LADDERS[0]:
                ladder[c] = LAW_NOISE.ladders[number - int(LADDERS[0])]
            elif number:
                i, j = divmod(number - 1, lengths.size)
                share[c], length[c] = shares[i], lengths[j]
        return replace(made, factor=self.factor, share=share, length=length, ladder=ladder)


def _best_of(problem: LawProblem, settings: Sequence[_Settings], prior: Array, start: _Best) -> _Best:
    """White noise and levels among these settings, channel by channel; of each setting the factor that fits what it
    leaves. `start` is among them."""
    n, count = problem.n, problem.count
    chosen = [own.at(number) for own, number in zip(settings, start.chosen, strict=True)]
    factor, best, of_kinds = start.factor.copy(), start.evidence, [list(one) for one in start.of_kinds]

    def of(c: int) -> tuple[Array, float]:
        own = settings[c]
        return own.inner[chosen[c]] / factor[c] ** 2, float(own.log_determinant[chosen[c]]) + 2 * n * np.log(factor[c])

    looked: list[tuple[float, ...]] = [()] * count
    for _ in range(LAW_NOISE.turns):
        for c, own in enumerate(settings):
            # beside the same as before the same is best
            state = (*map(float, chosen), *factor.tolist())
            if looked[c] == state:
                continue
            looked[c] = state
            parts = [of(d) for d in range(count)]
            fitted = np.append(-_mean(sum((inner for inner, _ in parts), np.zeros_like(own.inner[0])), prior), 1.0)
            rest = sum((inner for d, (inner, _) in enumerate(parts) if d != c), np.zeros_like(own.inner[0]))
            logs = sum(log for d, (_, log) in enumerate(parts) if d != c)
            left = np.einsum("i,sij,j->s", fitted, own.inner, fitted) / n
            # how much more the noise is than what a fit leaves, where that takes up enough of it
            acting = np.diagonal(own.inner[0])[:-1] > 0
            factors = LAW_NOISE.factors if np.count_nonzero(acting) > LAW_NOISE.taken * n else LAW_NOISE.factors[:1]
            sizes = np.maximum(np.sqrt(np.maximum(left, 0.0))[:, None] * np.array(factors), 1.0)
            total = own.log_determinant[:, None] + 2 * n * np.log(sizes) + logs
            found = evidence_of_settings(own.inner, sizes, rest, prior, total) - own.cost[:, None]
            i, f = divmod(int(np.argmax(found)), sizes.shape[1])
            chosen[c], factor[c] = i, sizes[i, f]
            best = float(found[i, f]) - float(sum(settings[d].cost[chosen[d]] for d in range(count) if d != c))
            ladders = own.at(int(LADDERS[0]))
            kinds = [part for part in np.split(np.arange(len(own.numbers)), [1, ladders])[1:] if part.size]
            of_kinds[c] = [int(own.numbers[part[int(np.argmax(found.max(axis=1)[part]))]]) for part in kinds]
    numbers = [int(own.numbers[i]) for own, i in zip(settings, chosen, strict=True)]
    return _Best(numbers, factor, best, of_kinds)


def _mean(inner: Array, prior: Array) -> Array:
    """(K,) the coefficients' means from inner products (K + 1, K + 1)."""
    k = prior.size
    whole = inner[:k, :k] + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit = whole / size[:, None] / size[None] + 1e-12 * np.eye(k)
    return np.asarray(np.linalg.solve(unit, inner[:k, k] / size) / size)


def _with_jitter(problem: LawProblem, both: Array, prior: Array, to_the_floor: bool = False) -> tuple[LawNoise, float]:
    """White noise and errors of the set angles, which mix the channels."""
    ways = np.empty((0, *problem.residual.shape)) if problem.jitter is None else problem.jitter
    kinds = len(ways)
    level = 1.0 if problem.measured or to_the_floor else _level_left(problem, both)
    # one unit of an angle's error is as large as the floor
    unit = [level * float(np.sqrt(np.mean(problem.floor**2) / max(float(np.mean(way**2)), 1e-30))) for way in ways]
    noise = LawNoise.floor_alone(problem)
    noise = replace(noise, factor=level * noise.factor)

    known: dict[tuple[float, ...], float] = {}

    def best_of(tries: Sequence[LawNoise]) -> tuple[LawNoise, float]:
        keys = [(*one.factor.tolist(), *one.jitter.tolist()) for one in tries]
        fresh = {key: one for key, one in zip(keys, tries, strict=True) if key not in known}
        known.update(zip(fresh, _mixed_evidence(problem, list(fresh.values()), both, prior), strict=True))
        found = [known[key] for key in keys]
        return tries[int(np.argmax(found))], max(found)

    best = -np.inf
    for _ in range(LAW_NOISE.turns):
        for k in range(kinds):
            tries = [replace(noise, jitter=_put(noise.jitter, k, s * unit[k])) for s in (0.0, *LAW_NOISE.jitters)]
            if k == 0:
                together = [np.array(unit) * np.array(which[:kinds]) for which in TOGETHER]
                tries += [replace(noise, jitter=s * both) for both in together for s in LAW_NOISE.jitters]
            noise, best = best_of(tries)
        for c in () if to_the_floor else range(problem.count):
            noise, best = best_of([replace(noise, factor=_put(noise.factor, c, level * f)) for f in LAW_NOISE.white])
    return noise, best


def _mixed_evidence(problem: LawProblem, noises: Sequence[LawNoise], both: Array, prior: Array) -> list[float]:
    """Evidence of white noises with errors of the set angles, less what each kind of these must gain: of columns and,
    last, a residual (K + 1, C, n)."""
    step = max(1, LAW_NOISE.columns * LAW_NOISE.at_once // both.size)
    found: list[float] = []
    for i in range(0, len(noises), step):
        white, log_determinant = whitened_each(problem, noises[i : i + step], both)
        own = evidence(white @ white.transpose(0, 2, 1), prior, log_determinant)
        kinds = [int(np.count_nonzero(one.jitter)) for one in noises[i : i + step]]
        found += (own - LAW_NOISE.cost * np.array(kinds)).tolist()
    return found


def _level_left(problem: LawProblem, both: Array) -> float:
    """What white noise is tried in units of where no floor was measured, in units of the floor: a share of what a fit
    of all columns leaves, which are the first of `both`."""
    *columns, left = flattened(both / problem.floor)
    space = orthonormal(np.array(columns))
    left = outside(space, left)
    return max(1.0, LAW_NOISE.of_what_is_left * float(np.sqrt(left @ left / max(left.size - len(space), 1))))


def _put(values: Array, index: int, value: float) -> Array:
    result = values.copy()
    result[index] = value
    return result

"""A long recording in the space of its own columns: everything that tests and fits need of it, from inner products.

The rows are passed through once. Kept are, channel by channel, the Gram matrices of the whitened functions and of the
residual on each segment (a fold of the held-out test, a steady rate), and their sums over short blocks. All tests,
choices and fits see the recording only through inner products, so it is replaced by *coordinates*: vectors of a few
hundred numbers with the same inner products as columns of any length. The random walk of an offset is slow against a
block: its covariance changes only the part of the inner products that lies between the blocks' means, and that part is
passed through the filter of `markov`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.chunks import of_runs
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.core.memory import Memory, memory_of
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.regression import solved
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.policy import GRAMS
from highside.diagnosis.rows.segments import Key, Segments, equal_runs

Ints = NDArray[np.intp]

Fold = tuple[list[Key], list[Key]]
"""parts that are left out, and those of them that are scored"""

MEMORIES = (
    *((np.inf, share) for share in GRAMS.random_walk_shares),
    *((length, q) for length, own in GRAMS.forgetful for q in own),
)
"""(length, share) of each memory that is tried; the first is none."""


def _tried(blocks: int) -> int:
    """How many of `MEMORIES` are tried in so many blocks: the longest of levels that forget stand last."""
    longest = max(GRAMS.always_tried, GRAMS.longest_share * blocks)
    return sum(np.isinf(length) or length <= longest for length, _ in MEMORIES)


@dataclass(frozen=True)
class Gram:
    """Inner products of one channel's whitened functions, the residual as the last of them: m + 1 in all."""

    parts: dict[Key, Array]
    """(m + 1, m + 1) of each (fold, rate, core)"""
    sums: Array
    """(m + 1, blocks) sums over blocks"""
    counts: Array
    """(blocks,) rows of each block that count"""
    rows: dict[Key, float]
    """rows of each part that count"""
    at: Array
    """(blocks,) middle of each block, in steps"""
    walked: float = 0.0
    """steps that a random walk of the noise went on for before the first block, see `_level_noise`"""

    @property
    def total(self) -> Array:
        """(m + 1, m + 1) of all rows."""
        return np.asarray(sum(self.parts.values(), np.zeros_like(next(iter(self.parts.values())))))


def accumulate(design: Design, noise: RotationNoise, residual: Array) -> tuple[list[Gram], Segments]:
    """One pass over the rows; `residual` (C, N) after the base fit."""
    segments = Segments.of(design, noise.lead)
    sizes = [m + 1 for m in design.sizes]
    blocks = segments.starts.size - 1
    parts: list[dict[Key, Array]] = [{} for _ in sizes]
    rows: list[dict[Key, float]] = [{} for _ in sizes]
    sums = [np.zeros((m, blocks)) for m in sizes]
    counts = [np.zeros(blocks) for _ in sizes]
    chunks = list(design.chunks())

    def one(part: slice) -> list[_Chunk]:
        led = slice(max(0, part.start - noise.lead), part.stop)
        return [
            _chunk(noise.whiten(c, functions, part), noise.weight[c, part], segments, part)
            for c, functions in enumerate(design.functions(led, residual))
        ]

    for made in of_runs(one, chunks, _both):
        for c, chunk in enumerate(made):
            for key, gram, counted in chunk.pieces:
                parts[c][key] = parts[c][key] + gram if key in parts[c] else gram
                rows[c][key] = rows[c].get(key, 0.0) + counted
            own = slice(chunk.first, chunk.first + chunk.sums.shape[1])
            sums[c][:, own] += chunk.sums
            counts[c][own] += chunk.counts
    walked = 0.0 if design.base.size else float(segments.at[-1] - segments.at[0])
    return [Gram(*kept, segments.at, walked) for kept in zip(parts, sums, counts, rows, strict=True)], segments


@dataclass(frozen=True)
class _Chunk:
    """What a run of rows adds on one channel."""

    first: int
    """block to which its first row belongs"""
    pieces: list[tuple[Key, Array, float]]
    sums: Array
    """(m, blocks)"""
    counts: Array
    """(blocks,) rows that count"""


def _chunk(white: Array, weight: Array, segments: Segments, part: slice) -> _Chunk:
    fold, rate, core = segments.fold[part], segments.rate[part], segments.core[part]
    pieces = []
    for start, stop in equal_runs((fold * 64 + rate + 1) * 2 + core):
        name = (int(fold[start]), int(rate[start]), bool(core[start]))
        piece = white[:, start:stop]
        pieces.append((name, np.asarray(piece @ piece.T), float(np.sum(weight[start:stop] > 0))))
    starts = [start for start, _ in equal_runs(segments.block[part])]
    counts = np.add.reduceat((weight > 0).astype(float), starts)
    return _Chunk(int(segments.block[part.start]), pieces, np.add.reduceat(white, starts, axis=1), counts)


def _both(one: list[_Chunk], other: list[_Chunk]) -> list[_Chunk]:
    """What two neighbouring runs of rows add together, channel by channel; `one` stands before `other`."""
    return [_joined(*chunks) for chunks in zip(one, other, strict=True)]


def _joined(one: _Chunk, other: _Chunk) -> _Chunk:
    pieces: dict[Key, tuple[Array, float]] = {}
    for key, gram, counted in (*one.pieces, *other.pieces):
        before = pieces.get(key)
        pieces[key] = (gram, counted) if before is None else (before[0] + gram, before[1] + counted)
    # the last block of the one may go on in the other
    blocks = other.first - one.first + other.counts.size
    sums, counts = np.zeros((one.sums.shape[0], blocks)), np.zeros(blocks)
    for chunk in (one, other):
        own = slice(chunk.first - one.first, chunk.first - one.first + chunk.counts.size)
        sums[:, own] += chunk.sums
        counts[own] += chunk.counts
    return _Chunk(one.first, [(key, *both) for key, both in pieces.items()], sums, counts)


@dataclass(frozen=True)
class RandomWalkGrams:
    """Inner products of one channel under each of `MEMORIES`: (settings, m + 1, m + 1), and log determinants."""

    grams: Array
    log_determinant: Array
    rows: float
    rows_per_block: float
    before: float = 0.0
    """how long a random walk went on before the first row, in recordings"""

    @classmethod
    def of(cls, gram: Gram) -> RandomWalkGrams:
        """A block's mean has the white variance 1 / rows and the level of the random walk at its middle."""
        used = gram.counts > 0
        counts = gram.counts[used]
        means = gram.sums[:, used] / counts
        noise = _level_noise(counts, gram.at[used], MEMORIES[: _tried(int(used.sum()))], gram.walked)
        within = gram.total - (means * counts) @ means.T
        between = noise.white(means)
        return cls(
            within + between @ between.transpose(0, 2, 1),
            noise.log_determinant,
            float(counts.sum()),
            float(np.median(counts)),
            float(gram.walked / max(np.ptp(gram.at), 1.0)),
        )

    def mean_variance(self, memory: Memory) -> float:
        """Variance of the mean of a level over all rows, the largest of a memory that the data allow, in units of the
        white variance of a row: what a random walk gathers before (`_level_noise`) and a third of what it does in them;
        of a level that forgets, two lengths are one value."""
        if np.isinf(memory.length):
            return memory.upper * self.rows * (self.before + 1 / 3)
        return memory.upper / self.rows_per_block * min(1.0, 2 * memory.length * self.rows_per_block / self.rows)

    def under(self, memory: Memory) -> Array:
        """(m + 1, m + 1) under the largest memory of its length that the data allow."""
        return np.asarray(self.grams[MEMORIES.index((memory.length, memory.upper))])


class RandomWalkChannel:
    """-2 log likelihood of a channel under each of `MEMORIES`: `functions` by their numbers, -1 for none.

    `base` are the numbers of functions that are always projected off.
    """

    settings: ClassVar = list(MEMORIES)

    def __init__(self, random_walks: RandomWalkGrams, base: Ints) -> None:
        self.grams, self._logdet, self._rows = random_walks.grams, random_walks.log_determinant, random_walks.rows
        self._base = base

    def memory(self, columns: Ints) -> Memory:
        """The memory that the data require with functions (K,) projected off."""
        return memory_of(self.settings[: len(self.grams)], self.without(columns))

    def without(self, columns: Ints) -> Array:
        """(settings,)."""
        return self.with_block(columns, columns[:0])

    def with_block(self, columns: Ints, block: Ints) -> Array:
        """(settings,) with functions (K,) projected off and (B,) fitted."""
        return self._minus2l(columns, self._energy(np.concatenate([columns, block])))

    def with_each(self, columns: Ints, functions: Ints) -> Array:
        """(settings, F) with functions (K,) projected off and each of (F,) fitted."""
        energy = np.empty((len(self.grams), functions.size))
        kept = self._numbers(columns)
        for s, gram in enumerate(self.grams):
            last = gram.shape[0] - 1
            picked = np.concatenate([functions[functions >= 0], [last]])
            inner = gram[np.ix_(picked, picked)]
            if kept.size:
                cross = gram[np.ix_(kept, picked)]
                inner = inner - cross.T @ solved(gram[np.ix_(kept, kept)], cross)
            norm, moment = np.diag(inner)[:-1], inner[:-1, -1]
            shows = norm > REGRESSION.independent * np.diag(gram)[picked[:-1]]
            energy[s] = inner[-1, -1]
            energy[s, functions >= 0] -= np.where(shows, moment**2 / np.where(shows, norm, 1.0), 0.0)
        return self._minus2l(columns, energy)

    def _numbers(self, columns: Ints) -> Ints:
        return np.unique(np.concatenate([self._base, columns[columns >= 0]]))

    def _energy(self, columns: Ints) -> Array:
        kept = self._numbers(columns)
        found = np.empty(len(self.grams))
        for s, gram in enumerate(self.grams):
            moment = gram[kept, -1]
            found[s] = gram[-1, -1] - moment @ solved(gram[np.ix_(kept, kept)], moment)
        return found

    def _minus2l(self, columns: Ints, energy: Array) -> Array:
        kept = self._numbers(columns)
        freedom = self._rows - kept.size
        size = np.empty(len(self.grams))
        for s, gram in enumerate(self.grams):
            inner = gram[np.ix_(kept, kept)]
            scale = np.sqrt(np.maximum(np.diag(self.grams[0])[kept], 1e-300))
            values = np.linalg.eigvalsh(inner / scale[:, None] / scale[None, :])
            size[s] = np.log(values[values > 1e-9 * max(values.max(initial=0.0), 1e-300)]).sum() if kept.size else 0.0
        logdet = self._logdet + size
        shape = (-1,) + (1,) * (energy.ndim - 1)
        return np.asarray(freedom * np.log(energy / freedom) + logdet.reshape(shape))


def coordinates_and_lift(inner: Array) -> tuple[Array, Array]:
    """(m, R) coordinates of functions with the given inner products (m, m), and (m, R) the combinations of functions
    that are of unit size and share nothing: these are the coordinates' axes."""
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    values, vectors = np.linalg.eigh(inner / scale[:, None] / scale[None, :])
    good = values > 1e-9 * values[-1]
    part, root = vectors[:, good], np.sqrt(values[good])
    return scale[:, None] * part * root, part / root / scale[:, None]


class Space:
    """Coordinates with the inner products of the recording's whitened columns: channel beside channel, R in all."""

    def __init__(self, design: Design, grams: Sequence[Array]) -> None:
        """`grams` (m + 1, m + 1) of each channel, the residual last."""
        self._where = design.where
        self.coordinates: list[Array] = []
        self._lift: list[Array] = []
        residual = []
        for gram in grams:
            coordinates, lift = coordinates_and_lift(gram[:-1, :-1])
            self.coordinates.append(coordinates)
            self._lift.append(lift)
            residual.append(lift.T @ gram[:-1, -1])
        sizes = [c.shape[1] for c in self.coordinates]
        ends = np.cumsum([0, *sizes])
        self.channels = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        self.residual = np.concatenate(residual)

    @staticmethod
    def of_channel(gram: Array) -> Array:
        """(m,) weights of the functions that explain the residual best, from (m + 1, m + 1)."""
        return solved(gram[:-1, :-1], gram[:-1, -1])

    def columns(self, numbers: Ints) -> Array:
        """(k, R) of columns of the design."""
        result = np.zeros((numbers.size, self.size))
        for c, own in enumerate(self.channels):
            functions = self._where[numbers, c]
            shows = (functions >= 0) & (numbers >= 0)
            result[shows, own] = self.coordinates[c][functions[shows]]
        return result

    def moments(self, products: Sequence[Array]) -> Array:
        """(k, R) of vectors given by their inner products with the functions, (k, m) on each channel."""
        return np.concatenate([p @ lift for p, lift in zip(products, self._lift, strict=True)], axis=1)

    def weights(self, vector: Array) -> list[Array]:
        """(m,) on each channel: the combination of whitened functions that a vector (R,) stands for."""
        return [lift @ vector[own] for lift, own in zip(self._lift, self.channels, strict=True)]


class HeldOutRows:
    """Prediction of stretches of a recording from the rest of it, from inner products alone."""

    def __init__(self, design: Design, grams: Sequence[Gram]) -> None:
        self.where = design.where
        self.base = design.base
        self._grams = grams
        self._sums: dict[tuple[tuple[Key, ...], ...], list[Array]] = {}
        keys = sorted({key for gram in grams for key in gram.parts})
        self.keys = keys
        self._rows = {key: sum(g.rows.get(key, 0.0) for g in grams) for key in keys}
        self.folds: list[Fold] = []
        for fold in range(GRAMS.folds):
            own = [key for key in keys if key[0] == fold]
            self.folds.append((own, [key for key in own if key[2]]))
        rates = [[key for key in keys if key[1] == rate] for rate in sorted({key[1] for key in keys} - {-1})]
        self.by_rate: list[Fold] = [(own, own) for own in rates]

    def inner(self, numbers: Ints, groups: Sequence[Sequence[Key]]) -> Array:
        """(G, K + 1, K + 1) of columns and, last, the residual, over the parts of each group."""
        total = np.zeros((len(groups), numbers.size + 1, numbers.size + 1))
        for c, sums in enumerate(self._over(groups)):
            functions = self.where[numbers, c]
            shows = np.append(np.where(numbers >= 0, functions, -1) >= 0, True)
            picked, place = np.append(functions, -1)[shows], np.flatnonzero(shows)
            total[:, place[:, None], place] += sums[:, picked[:, None], picked]
        return total

    def _over(self, groups: Sequence[Sequence[Key]]) -> list[Array]:
        """(G, m + 1, m + 1) on each channel: inner products of all functions over the parts of each group."""
        which = tuple(tuple(keys) for keys in groups)
        if which not in self._sums:
            self._sums[which] = [
                np.stack(
                    [
                        sum((gram.parts[key] for key in keys if key in gram.parts), np.zeros_like(gram.total))
                        for keys in which
                    ]
                )
                for gram in self._grams
            ]
        return self._sums[which]

    def scored(self, fold: Fold) -> float:
        """Readings that a fold scores."""
        return float(sum(self._rows[key] for key in fold[1]))

    def energies(self, numbers: Ints, folds: Sequence[Fold]) -> Array:
        """(folds,) squared prediction error of what is scored, with columns (K,) fitted beside the base."""
        every = np.concatenate([self.base, numbers])
        held_out, scored = ([fold[i] for fold in folds] for i in (0, 1))
        total = self.inner(every, [self.keys, *held_out, *scored])
        rest, test = total[0] - total[1 : len(folds) + 1], total[len(folds) + 1 :]
        result = []
        whole = np.diag(total[0])[:-1]
        for trained, tested in zip(rest, test, strict=True):
            # what the other stretches do not determine, but for rounding, is not extrapolated
            shows = np.flatnonzero(np.diag(trained)[:-1] > REGRESSION.independent * whole)
            solution = np.append(np.zeros(every.size), 1.0)
            solution[shows] = -solved(trained[np.ix_(shows, shows)], trained[shows, -1])
            result.append(float(solution @ tested @ solution))
        return np.array(result)


def inner_by_parts(
    design: Design,
    grams: Sequence[Gram],
    segments: Segments,
    numbers: Ints,
    part_of: Callable[[Key], int],
    noise: RotationNoise,
) -> Array:
    """(P, P, K + 1, K + 1) inner products of columns (K,) and, last, the residual: (i, j) of their rows in part i with
    those in part j. Parts are made of those of the grams; only under a noise with memory do rows of different ones
    depend on one another. There a block, whose mean is whitened once more, belongs to the part of its middle row.
    """
    count = max(part_of(key) for gram in grams for key in gram.parts) + 1
    result = np.zeros((count, count, numbers.size + 1, numbers.size + 1))
    for c, gram in enumerate(grams):
        functions = np.where(numbers >= 0, design.where[numbers, c], -1)
        shown = np.append(np.flatnonzero(functions >= 0), numbers.size)
        picked = np.append(functions[functions >= 0], -1)
        own = np.zeros((count, count, picked.size, picked.size))
        for key, inner in gram.parts.items():
            own[part_of(key), part_of(key)] += inner[np.ix_(picked, picked)]
        memory = noise.memories[c] if c < len(noise.memories) else None
        if memory is not None and memory.upper > 0.0:
            own += _remembered(gram, picked, memory, np.array([part_of(key) for key in segments.of_blocks]), count)
        result[:, :, shown[:, None], shown] += own
    return result


def _remembered(gram: Gram, picked: Ints, memory: Memory, part: Ints, count: int) -> Array:
    """(P, P, k, k) what a memory changes of the inner products of functions (k,) between `part` (blocks,)."""
    used = gram.counts > 0
    counts, part = gram.counts[used], part[used]
    means = gram.sums[np.ix_(picked, np.flatnonzero(used))] / counts
    own = np.stack([means * (part == k) for k in range(count)])
    noise = _level_noise(counts, gram.at[used], [(memory.length, memory.upper)], gram.walked)
    white = noise.white(own.reshape(-1, counts.size))[0].reshape(own.shape)
    change = np.einsum("ikb,jlb->ijkl", white, white)
    for k in range(count):
        change[k, k] -= (own[k] * counts) @ own[k].T
    return np.asarray(change)


def _level_noise(counts: Array, steps: Array, memories: Sequence[tuple[float, float]], walked: float) -> LevelNoise:
    """The noise of the means of blocks (B,) of so many rows, under each (length, share) of `MEMORIES`.

    A random walk did not begin with the recording: where nothing takes what is constant it had gone on as long before,
    `walked` steps, and an offset must exceed what it gathered. A base takes that: an older walk only costs likelihood.
    """
    lengths, shares = np.array(memories).T
    typical = float(np.median(counts))
    forgets = np.isfinite(lengths)
    shares = np.where(forgets, shares / typical, shares)
    lengths = np.where(forgets, lengths * typical, np.inf)
    return LevelNoise.of(1 / counts, steps - steps[0], shares, lengths, walked)

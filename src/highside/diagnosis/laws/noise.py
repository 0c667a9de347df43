"""The noise that laws compete with: learnt by the same evidence, never below the floor.

Of each channel noise of at least the floor, which is white but for means over rows that are correlated, and on it a
level that forgets (an Ornstein-Uhlenbeck process; of a long memory a random walk) or a ladder of such levels (1/f).
Errors of the set angles move all channels of a value together. Values are whitened in time order by a Kalman filter, at
a cost that grows with their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.laws.ladder import LadderNoise
from highside.diagnosis.laws.noise_filters import filter_of
from highside.diagnosis.laws.noise_policy import LAW_NOISE
from highside.diagnosis.laws.policy import LAW_EVIDENCE
from highside.diagnosis.laws.problem import LawProblem

if TYPE_CHECKING:
    from highside.diagnosis.core.grouped_noise import GroupedNoise

Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class LawNoise:
    """Sizes of what a channel's noise is made of; arrays (C,), `jitter` (J,)."""

    factor: Array
    """of the white noise, in units of the floor"""
    share: Array
    """variance of the level in units of the white noise's mean; 0: there is none"""
    length: Array
    """its length in s"""
    ladder: Array
    """variance of each level of the ladder in the same units; 0: there is none"""
    jitter: Array
    """of each set angle, in its unit"""

    @classmethod
    def floor_alone(cls, problem: LawProblem) -> LawNoise:
        """The floor, and nothing else."""
        c = problem.count
        kinds = 0 if problem.jitter is None else len(problem.jitter)
        return cls(np.ones(c), np.zeros(c), np.ones(c), np.zeros(c), np.zeros(kinds))

    @property
    def remembers(self) -> bool:
        """Whether any channel's noise has a memory."""
        return bool(np.any(self.share > 0) or np.any(self.ladder > 0))

    def times_the_floor(self, problem: LawProblem) -> Array:
        """(C,) standard deviation of the noise of a channel, rms over its values, in units of the floor."""
        variance = self.factor**2 * (1.0 + self.share + LAW_NOISE.ladder * self.ladder)
        for size, way in zip(self.jitter, () if problem.jitter is None else problem.jitter, strict=True):
            variance = variance + np.mean((size * way / problem.floor) ** 2, axis=1)
        return np.asarray(np.sqrt(variance))

    def summary(self) -> str:
        """In words."""
        words = []
        if np.any(self.factor > 1):
            words.append(f"white noise up to {self.factor.max():.3g} times the floor")
        if np.any(self.share > 0):
            words.append("a zero offset that wanders")
        if np.any(self.ladder > 0):
            words.append("1/f noise")
        if np.any(self.jitter > 0):
            words.append("errors of the set angles")
        return " and ".join(words) or "the floor alone"


class Whitener:
    """A noise made ready: whitens columns and knows the logarithm of its determinant."""

    def __init__(self, problem: LawProblem, noise: LawNoise) -> None:
        self.noise, self.problem = noise, problem
        self.mixes = bool(np.any(noise.jitter > 0))
        self._filters: list[LevelNoise | LadderNoise | GroupedNoise | None] = []
        self.log_determinant = 0.0
        white = (noise.factor[:, None] * problem.floor) ** 2
        if self.mixes:
            assert problem.jitter is not None
            cov = np.zeros((problem.n, problem.count, problem.count))
            diagonal = np.arange(problem.count)
            cov[:, diagonal, diagonal] = white.T
            for size, way in zip(noise.jitter, problem.jitter, strict=True):
                cov += size**2 * way.T[:, :, None] * way.T[:, None, :]
            self._lower = np.ascontiguousarray(np.linalg.cholesky(cov).transpose(1, 2, 0))
            self.log_determinant = 2 * float(np.log(self._lower[diagonal, diagonal]).sum())
            self._scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2).T)
            return
        self._scale = np.sqrt(white)
        for c in range(problem.count):
            made = filter_of(white[c], problem, c, noise.share[c], noise.length[c], noise.ladder[c])
            self._filters.append(made)
            own = 2 * float(np.log(self._scale[c]).sum()) if made is None else float(made.log_determinant[0])
            self.log_determinant += own

    def like(self, other: Whitener) -> bool:
        """Whether it whitens as another does."""
        mine, its = vars(self.noise), vars(other.noise)
        one, two = self.problem, other.problem
        same = one.floor is two.floor and one.t_s is two.t_s and one.jitter is two.jitter
        return same and all(np.array_equal(mine[name], its[name]) for name in mine)

    def of_shape(self, c: int, other: Whitener) -> bool:
        """Whether one channel's noise is that of another whitener but for its size, and channels mix in neither."""
        mine, its, same = self.noise, other.noise, self.problem.floor is other.problem.floor
        level = mine.share[c] == its.share[c] and (not mine.share[c] or mine.length[c] == its.length[c])
        alike = level and mine.ladder[c] == its.ladder[c] and self.problem.t_s is other.problem.t_s
        return bool(alike and same and not self.mixes and not other.mixes)

    def channel(self, c: int, columns: Array, out: Array | None = None) -> Array:
        """(k, n) columns of one channel, where channels do not mix; written to `out` where that is given."""
        made = self._filters[c]
        result = np.empty(columns.shape) if out is None else out
        if made is None:
            return np.asarray(np.divide(columns, self._scale[c], out=result))
        made.white_into(columns, result)
        return result

    def white(self, columns: Array) -> Array:
        """(k, C, n) columns, whitened."""
        if self.mixes:
            made = np.empty(columns.shape)
            for i, row in enumerate(self._lower):
                left = columns[:, i]
                for j in range(i):
                    left = left - row[j] * made[:, j]
                made[:, i] = left / row[i]
            return made
        return np.stack([self.channel(c, columns[:, c]) for c in range(self.problem.count)], axis=1)

    def transposed(self, white: Array) -> Array:
        """(k, C, n) the transposed filter on whitened rows: with `white`, the inverse covariance times the rows."""
        if self.mixes:
            made = np.empty(white.shape)
            for i in range(len(self._lower) - 1, -1, -1):
                left = white[:, i]
                for j in range(i + 1, len(self._lower)):
                    left = left - self._lower[j, i] * made[:, j]
                made[:, i] = left / self._lower[i, i]
            return made
        return np.stack([self.transposed_channel(c, white[:, c]) for c in range(self.problem.count)], axis=1)

    def transposed_channel(self, c: int, rows: Array) -> Array:
        """(k, n) the same of one channel, where channels do not mix."""
        made = self._filters[c]
        if made is None:
            return np.asarray(rows / self._scale[c])
        return np.asarray(made.transposed(rows[None])[0])

    def clipped(self, residual: Array, fitted: Array) -> Array:
        """The residual (C, n) with values far from the fit clipped to within `LAW_NOISE.clip`, where they are few."""
        left = self.white((residual - fitted)[None])[0]
        over = np.sign(left) * np.maximum(np.abs(left) - LAW_NOISE.clip, 0.0)
        if not over.any() or float(np.mean(over != 0)) > LAW_NOISE.clipped:
            return residual
        return np.asarray(residual - over * self._scale)


def whitened_each(problem: LawProblem, noises: Sequence[LawNoise], columns: Array) -> tuple[Array, Array]:
    """(T, k, C n) columns (k, C, n) whitened under each of some noises without a memory, as `Whitener` does, and (T,)
    the logarithms of their determinants."""
    factor, count = np.array([one.factor for one in noises]), problem.count
    cov = np.zeros((len(noises), problem.n, count, count))
    own = np.arange(count)
    cov[:, :, own, own] = ((factor[:, :, None] * problem.floor) ** 2).transpose(0, 2, 1)
    ways = () if problem.jitter is None else problem.jitter
    for way, size in zip(ways, np.array([one.jitter for one in noises]).T, strict=True):
        cov += size[:, None, None, None] ** 2 * (way.T[:, :, None] * way.T[:, None, :])
    lower = np.ascontiguousarray(np.linalg.cholesky(cov).transpose(0, 2, 3, 1))
    made = np.empty((len(noises), len(columns), count, problem.n))
    for i in range(count):
        made[:, :, i] = columns[:, i]
        for j in range(i):
            made[:, :, i] -= lower[:, None, i, j] * made[:, :, j]
        made[:, :, i] /= lower[:, None, i, i]
    log_determinant = 2 * np.log(lower[:, own, own]).sum(axis=(1, 2))
    return made.reshape(len(noises), len(columns), -1), log_determinant


def evidence(inner: Array, prior: Array, log_determinant: Array) -> Array:
    """(B,) restricted log evidence from inner products (B, K + 1, K + 1) of columns and, last, the residual.

    `prior` (K,) are the columns' prior precisions, 0 for what is free.
    """
    k = prior.size
    power = np.maximum(np.diagonal(inner, axis1=1, axis2=2)[:, :k] + prior, 1e-300)
    size = np.sqrt(power)
    right = inner[:, :k, k] / size
    norm = np.sqrt(np.maximum(np.sum(right**2, axis=1, keepdims=True), 1e-300))
    # as `cholesky_and_half`, in one array: of many columns it is moving them about that takes the time
    scale = 1.0 / np.concatenate([size, norm], axis=1)
    whole = inner * scale[:, :, None]
    whole *= scale[:, None, :]
    whole[:, k, k] = 1.0 / np.finfo(float).tiny
    own = np.arange(k)
    try:
        whole[:, own, own] = power / size**2 + 1e-12
        lower = np.linalg.cholesky(whole)
    except np.linalg.LinAlgError:
        # columns that are nearly alike, by the rounding of inner products
        whole[:, own, own] += np.sqrt(LAW_EVIDENCE.ridge)
        lower = np.linalg.cholesky(whole)
    diagonal, half = np.diagonal(lower, axis1=1, axis2=2)[:, :k], lower[:, k, :k] * norm
    logs = 2 * np.log(diagonal).sum(axis=1) + 2 * np.log(size).sum(axis=1)
    known = np.log(prior[prior > 0]).sum()
    left = inner[:, k, k] - np.sum(half**2, axis=1)
    return np.asarray(-0.5 * (log_determinant + logs + left - known))


def evidence_of_settings(inner: Array, sizes: Array, rest: Array, prior: Array, total: Array) -> Array:
    """(S, F) of settings (S, K + 1, K + 1) at factors (S, F) beside other channels.

    What shares no channel with those that act here, nor with what those share one with, is the same in all. Few at a
    time: the matrices stay in the processor's cache.
    """
    near = _linked(inner[0] + rest, np.diagonal(inner[0]) > 0)
    away = np.append(~near[:-1], True)
    alone = rest[np.ix_(away, away)]
    alone[-1, -1] = 0.0
    apart = float(evidence(alone[None], prior[away[:-1]], np.zeros(1))[0])
    inner, rest, prior = inner[:, near][:, :, near], rest[np.ix_(near, near)], prior[near[:-1]]
    step = max(1, LAW_NOISE.matrices // rest.size)
    found = [
        evidence(
            (inner[i : i + step, None] / sizes[i : i + step, :, None, None] ** 2 + rest).reshape(-1, *rest.shape),
            prior,
            total[i : i + step].reshape(-1),
        )
        for i in range(0, len(sizes), step)
    ]
    return apart + np.concatenate(found).reshape(sizes.shape)


def _linked(inner: Array, acting: Flags) -> Flags:
    """(K + 1,) which columns have an inner product with one that is acting, or with such a one; the residual, the last,
    is one of them and links none."""
    shared = inner[:-1, :-1] != 0
    near = acting[:-1]
    while np.any(more := np.any(shared[near], axis=0) & ~near):
        near = near | more
    return np.append(near, True)


def cholesky_and_half(unit: Array, right: Array) -> tuple[Array, Array]:
    """Of lower factors L of matrices (B, k, k) the diagonals (B, k), and L^-1 `right` (B, k): the last row of the
    factor of the matrix that has `right` as one more row and column. Raises LinAlgError for one that is not positive.
    """
    count, k = right.shape
    if not k:
        return np.empty((count, 0)), np.empty((count, 0))
    # the size of the new row is of no account; its corner must leave the whole positive, and is not used
    size = np.sqrt(np.maximum(np.sum(right**2, axis=1), 1e-300))
    whole = np.empty((count, k + 1, k + 1))
    whole[:, :k, :k] = unit
    whole[:, k, :k] = whole[:, :k, k] = right / size[:, None]
    whole[:, k, k] = 1.0 / np.finfo(float).tiny
    lower = np.linalg.cholesky(whole)
    return np.diagonal(lower, axis1=1, axis2=2)[:, :k], lower[:, k, :k] * size[:, None]

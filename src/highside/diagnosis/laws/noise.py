"""The noise that laws compete with: learnt by the same evidence, never below the floor.

Of each channel white noise of at least the floor, and on it a level that forgets (an Ornstein-Uhlenbeck process; of a
long memory a random walk) or a ladder of such levels (1/f). Errors of the set angles move all channels of a value
together. Values are whitened in time order by a Kalman filter, at a cost that grows with their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.laws.policy import LAW_NOISE
from highside.diagnosis.laws.problem import LawProblem


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
        self._filters: list[LevelNoise | LadderNoise | None] = []
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
            made = filter_of(white[c], problem.t_s, noise.share[c], noise.length[c], noise.ladder[c])
            self._filters.append(made)
            own = 2 * float(np.log(self._scale[c]).sum()) if made is None else float(made.log_determinant[0])
            self.log_determinant += own

    def like(self, other: Whitener) -> bool:
        """Whether it whitens as another does."""
        mine, its = vars(self.noise), vars(other.noise)
        return self.problem is other.problem and all(np.array_equal(mine[name], its[name]) for name in mine)

    def channel(self, c: int, columns: Array) -> Array:
        """(k, n) columns of one channel, where channels do not mix."""
        made = self._filters[c]
        if made is None:
            return np.asarray(columns / self._scale[c])
        step = max(1, LAW_NOISE.many // columns.shape[1])
        result = np.empty(columns.shape)
        for i in range(0, len(columns), step):
            result[i : i + step] = made.white(columns[i : i + step])[0]
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

    def clipped(self, residual: Array, fitted: Array) -> Array:
        """The residual (C, n) with values far from the fit clipped to within `LAW_NOISE.clip`, where they are few."""
        left = self.white((residual - fitted)[None])[0]
        over = np.sign(left) * np.maximum(np.abs(left) - LAW_NOISE.clip, 0.0)
        if not over.any() or float(np.mean(over != 0)) > LAW_NOISE.clipped:
            return residual
        return np.asarray(residual - over * self._scale)


def filter_of(white: Array, t_s: Array, share: float, length: float, ladder: float) -> LevelNoise | LadderNoise | None:
    """The filter of one channel; None for white noise."""
    if ladder > 0:
        return LadderNoise.of(white, t_s, ladder * float(white.mean()), ladder_lengths(t_s))
    if share > 0:
        return LevelNoise.of(white, t_s, np.array([share * float(white.mean())]), np.array([length]))
    return None


def step_of(t_s: Array) -> float:
    """Median time from value to value, s."""
    return max(float(np.median(np.diff(t_s))), 1e-9) if t_s.size > 1 else 1.0


def ladder_lengths(t_s: Array) -> Array:
    """(L,) lengths of the ladder's levels, s."""
    return np.asarray(step_of(t_s) * LAW_NOISE.ladder_step ** np.arange(LAW_NOISE.ladder))


@dataclass(frozen=True)
class LadderNoise:
    """As `LevelNoise` of one setting, the sum of several levels of like variance."""

    variance: Array
    """(n,)"""
    gain: Array
    """(n, L)"""
    decay: Array
    """(n, L)"""

    @classmethod
    def of(cls, white: Array, t_s: Array, share: float, lengths: Array) -> LadderNoise:
        """`white` (n,) variances, `share` the variance of each level, `lengths` (L,) s."""
        n, levels = white.size, lengths.size
        decay = np.exp(-np.diff(t_s, prepend=t_s[:1])[:, None] / lengths)
        variance, gain = np.empty(n), np.empty((n, levels))
        spread = share * np.eye(levels)
        for t in range(n):
            if t:
                spread = spread * np.outer(decay[t], decay[t]) + np.diag(share * (1 - decay[t] ** 2))
            observed = spread.sum(axis=1)
            variance[t] = observed.sum() + white[t]
            gain[t] = observed / variance[t]
            spread = spread - np.outer(gain[t], observed)
        after = np.ones((n, levels))
        after[:-1] = decay[1:]
        return cls(variance, gain, after)

    @property
    def log_determinant(self) -> Array:
        """(1,)."""
        return np.array([float(np.log(self.variance).sum())])

    def white(self, columns: Array) -> Array:
        """(1, K, n) innovations of columns (K, n)."""
        result = np.empty((self.variance.size, len(columns)))
        levels = np.zeros((self.gain.shape[1], len(columns)))
        for t, reading in enumerate(np.ascontiguousarray(columns.T)):
            left = reading - levels.sum(axis=0)
            result[t] = left
            levels = (levels + self.gain[t][:, None] * left) * self.decay[t][:, None]
        result /= np.sqrt(self.variance)[:, None]
        return np.asarray(result.T[None])


# --- learning ------------------------------------------------------------------------------------------------


def evidence(inner: Array, prior: Array, log_determinant: Array) -> Array:
    """(B,) restricted log evidence from inner products (B, K + 1, K + 1) of columns and, last, the residual.

    `prior` (K,) are the columns' prior precisions, 0 for what is free.
    """
    k = prior.size
    whole = inner[:, :k, :k] + np.diag(prior)
    right = inner[:, :k, k]
    size = np.sqrt(np.maximum(np.diagonal(whole, axis1=1, axis2=2), 1e-300))
    unit = whole / size[:, :, None] / size[:, None, :] + 1e-12 * np.eye(k)
    diagonal, half = cholesky_and_half(unit, right / size)
    logs = 2 * np.log(diagonal).sum(axis=1) + 2 * np.log(size).sum(axis=1)
    known = np.log(prior[prior > 0]).sum()
    left = inner[:, k, k] - np.sum(half**2, axis=1)
    return np.asarray(-0.5 * (log_determinant + logs + left - known))


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


class NoiseLearner:
    """Learns the noise of a problem beside any fit; the filters of all settings are made once."""

    def __init__(self, problem: LawProblem) -> None:
        self.problem = problem
        self._channels: list[_Filters] = []

    def learn(self, columns: Array, prior: Array, residual: Array) -> tuple[LawNoise, float]:
        """The noise of highest evidence beside columns (K, C, n) with prior precisions (K,), and that evidence."""
        if not self._channels:
            self._channels = [_Filters.of(self.problem, c) for c in range(self.problem.count)]
        both = np.concatenate([columns, residual[None]])
        settings = [own.settings(both[:, c]) for c, own in enumerate(self._channels)]
        noise, best = _with_memory(self.problem, settings, prior)
        if self.problem.jitter is not None:
            other, gained = _with_jitter(self.problem, both, prior)
            if gained > best:
                noise, best = other, gained
        return noise, best


@dataclass(frozen=True)
class _Settings:
    """Settings of one channel: inner products (S, K + 1, K + 1) and log determinants (S,) at a factor of 1."""

    inner: Array
    log_determinant: Array
    share: Array
    length: Array
    ladder: Array
    cost: Array


@dataclass(frozen=True)
class _Filters:
    """Filters of one channel at a factor of 1: white noise, levels, ladders."""

    sigma: Array
    levels: tuple[LevelNoise, ...]
    ladders: tuple[LadderNoise, ...]
    share: Array
    length: Array
    ladder: Array

    @classmethod
    def of(cls, problem: LawProblem, c: int) -> _Filters:
        white, t_s = problem.floor[c] ** 2, problem.t_s
        mean, step = float(white.mean()), step_of(t_s)
        shares = np.repeat(LAW_NOISE.shares, len(LAW_NOISE.lengths))
        lengths = np.tile(LAW_NOISE.lengths, len(LAW_NOISE.shares)) * step
        at_once = max(1, LAW_NOISE.at_once // white.size)
        parts = [slice(i, i + at_once) for i in range(0, shares.size, at_once)]
        several = np.array(LAW_NOISE.ladders)
        none = np.zeros(1)
        return cls(
            problem.floor[c],
            tuple(LevelNoise.of(white, t_s, shares[part] * mean, lengths[part]) for part in parts),
            tuple(LadderNoise.of(white, t_s, share * mean, ladder_lengths(t_s)) for share in several),
            np.concatenate([none, shares, np.zeros(several.size)]),
            np.concatenate([none + 1, lengths, np.ones(several.size)]),
            np.concatenate([none, np.zeros(shares.size), several]),
        )

    def settings(self, rows: Array) -> _Settings:
        """Inner products of rows (K, n) under each."""
        shown = np.flatnonzero(np.any(rows != 0, axis=1))
        acting = rows[shown]
        plain = acting / self.sigma
        found = [(plain @ plain.T)[None]]
        filters: list[LevelNoise | LadderNoise] = [*self.levels, *self.ladders]
        for made in filters:
            turned = made.white(acting)
            found.append(turned @ turned.transpose(0, 2, 1))
        inner = np.zeros((sum(len(one) for one in found), len(rows), len(rows)))
        inner[:, shown[:, None], shown[None]] = np.concatenate(found)
        white = np.array([2 * float(np.log(self.sigma).sum())])
        logs = np.concatenate([white, *(made.log_determinant for made in filters)])
        cost = np.where(np.arange(logs.size) > 0, LAW_NOISE.cost, 0.0)
        return _Settings(inner, logs, self.share, self.length, self.ladder, cost)


def _with_memory(problem: LawProblem, settings: list[_Settings], prior: Array) -> tuple[LawNoise, float]:
    """White noise and levels, channel by channel; of each setting the factor that fits what it leaves."""
    n, count = problem.n, problem.count
    chosen, factor = [0] * count, np.ones(count)

    def of(c: int) -> tuple[Array, float]:
        own = settings[c]
        return own.inner[chosen[c]] / factor[c] ** 2, float(own.log_determinant[chosen[c]]) + 2 * n * np.log(factor[c])

    best = -np.inf
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
            sizes = np.maximum(np.sqrt(np.maximum(left, 0.0))[:, None] * np.array(LAW_NOISE.factors), 1.0)
            total = own.log_determinant[:, None] + 2 * n * np.log(sizes) + logs
            # few at a time: the matrices stay in the processor's cache
            step = max(1, LAW_NOISE.matrices // rest.size)
            found = np.concatenate(
                [
                    evidence(
                        (own.inner[i : i + step, None] / sizes[i : i + step, :, None, None] ** 2 + rest).reshape(
                            -1, *rest.shape
                        ),
                        prior,
                        total[i : i + step].reshape(-1),
                    )
                    for i in range(0, len(sizes), step)
                ]
            )
            found -= np.repeat(own.cost, sizes.shape[1])
            where = int(np.argmax(found))
            chosen[c], factor[c] = where // sizes.shape[1], sizes.reshape(-1)[where]
            best = float(found[where]) - float(sum(settings[d].cost[chosen[d]] for d in range(count) if d != c))
    chosen_settings = list(zip(settings, chosen, strict=True))
    noise = replace(
        LawNoise.floor_alone(problem),
        factor=factor,
        share=np.array([s.share[i] for s, i in chosen_settings]),
        length=np.array([s.length[i] for s, i in chosen_settings]),
        ladder=np.array([s.ladder[i] for s, i in chosen_settings]),
    )
    return noise, best


def _mean(inner: Array, prior: Array) -> Array:
    """(K,) the coefficients' means from inner products (K + 1, K + 1)."""
    k = prior.size
    whole = inner[:k, :k] + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit = whole / size[:, None] / size[None] + 1e-12 * np.eye(k)
    return np.asarray(np.linalg.solve(unit, inner[:k, k] / size) / size)


def _with_jitter(problem: LawProblem, both: Array, prior: Array) -> tuple[LawNoise, float]:
    """White noise and errors of the set angles, which mix the channels."""
    assert problem.jitter is not None
    kinds = len(problem.jitter)
    # one unit of an angle's error is as large as the floor
    unit = [float(np.sqrt(np.mean(problem.floor**2) / max(float(np.mean(way**2)), 1e-30))) for way in problem.jitter]
    noise = LawNoise.floor_alone(problem)

    known: dict[tuple[float, ...], float] = {}

    def of(one: LawNoise) -> float:
        key = (*one.factor.tolist(), *one.jitter.tolist())
        if key not in known:
            made = Whitener(problem, one)
            turned = made.white(both).reshape(len(both), -1)
            own = evidence((turned @ turned.T)[None], prior, np.array([made.log_determinant]))
            known[key] = float(own[0]) - LAW_NOISE.cost * int(np.count_nonzero(one.jitter))
        return known[key]

    best = -np.inf
    for _ in range(LAW_NOISE.turns):
        for k in range(kinds):
            tries = [replace(noise, jitter=_put(noise.jitter, k, s * unit[k])) for s in (0.0, *LAW_NOISE.jitters)]
            tries += [replace(noise, jitter=np.array(unit) * s) for s in LAW_NOISE.jitters if k == 0]
            found = [of(one) for one in tries]
            noise, best = tries[int(np.argmax(found))], max(found)
        for c in range(problem.count):
            tries = [replace(noise, factor=_put(noise.factor, c, f)) for f in LAW_NOISE.white]
            found = [of(one) for one in tries]
            noise, best = tries[int(np.argmax(found))], max(found)
    return noise, best


def _put(values: Array, index: int, value: float) -> Array:
    result = values.copy()
    result[index] = value
    return result

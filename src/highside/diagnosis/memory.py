"""Noise with memory: is the scatter from pose to pose coloured, do offsets wander, or did something slow happen?

Each channel's scatter is taken as s^2 (I + q K): white plus a part K with memory, either exp(-|i - j| / l) (coloured
noise, l poses long) or min(i, j) (a walk without end). q and K are chosen by restricted likelihood, with the base and
every smooth function of attitude projected off, but nothing that follows time or temperature: a fit that may bend with
time swallows the walk and then finds it absent.

A slow effect (step, drift, warm-up, thermal lag, temperature) is believed only where it beats the walk: q is chosen
anew with and without it, and the gain of likelihood must be large while no walk remains beside it. Otherwise the
answer is "wander", with the slow effects as what it resembles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import chdtrc

Array = NDArray[np.float64]

FOUND = 12.0
"""Gain of -2 log likelihood of a channel from which memory is believed."""
SUSPECT = 8.0
SLOW_LOG_P = 2.8
REMAINING = 15.0
"""A slow effect beside which more evidence of memory than this remains is not the whole story."""
LENGTHS = (1.5, 4.0, np.inf)
"""Memory in poses; infinite is the walk."""
SHARES = {1.5: (0.3, 1.0, 3.0, 10.0), 4.0: (0.1, 0.4, 1.5, 6.0), np.inf: (3e-4, 1e-3, 4e-3, 0.015, 0.05, 0.2, 0.8)}


@dataclass(frozen=True, slots=True)
class Memory:
    """The memory of one channel: `gain` of -2 log likelihood over white noise, `share` q and `length` l of the best,
    and `upper`, the largest share of that length that the data allow at 95 %."""

    gain: float
    share: float
    length: float
    upper: float

    @property
    def walks(self) -> bool:
        """Whether this is a walk beyond doubt."""
        return self.gain > FOUND and np.isinf(self.length)


@dataclass(frozen=True, slots=True)
class SlowEffect:
    """A candidate of the slow stage: its index among the candidates, its variant, and its function of time (n,)."""

    candidate: int
    variant: int
    function: Array


@dataclass(frozen=True, slots=True)
class SlowScore:
    """How a slow effect fares against the walk."""

    effect: SlowEffect
    log_p: float
    remaining: float
    score: float


@dataclass(frozen=True, slots=True)
class SlowStage:
    """`claimed` in the order found, `admitted` all that beat the walk by themselves, `near` those that come near."""

    claimed: list[SlowScore]
    admitted: list[SlowScore]
    near: list[SlowScore]


def kernel(t_s: Array, length: float) -> Array:
    """K (n, n) of poses at times `t_s`, in mean intervals between poses."""
    steps = (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]) / max(t_s.size - 1, 1), 1e-12)
    if np.isinf(length):
        return np.asarray(np.minimum(steps[:, None], steps[None, :]))
    return np.asarray(np.exp(-np.abs(steps[:, None] - steps[None, :]) / length))


class Likelihoods:
    """Restricted likelihood of a channel under each noise with memory, prepared once for many regressors.

    `residual` (n,), `variance` (n,) of the white part, `nuisance` (P, n), all of one channel.
    """

    def __init__(self, residual: Array, variance: Array, nuisance: Array, t_s: Array) -> None:
        self.settings = [(0.0, 0.0)] + [(length, q) for length in LENGTHS for q in SHARES[length]]
        level = float(variance.mean())
        space = _basis(nuisance)
        self._white: list[tuple[Array, Array, float]] = []
        for length, q in self.settings:
            cov = np.diag(variance) + (q * level * kernel(t_s, length) if q else 0.0)
            lower: Array = np.asarray(np.linalg.cholesky(cov), dtype=float)
            turned = solve_triangular(lower, space.T, lower=True, check_finite=False)
            q_, r_ = np.linalg.qr(turned)
            logdet = 2 * float(np.log(np.diag(lower)).sum() + np.log(np.abs(np.diag(r_))).sum())
            self._white.append((lower, np.asarray(q_, dtype=float), logdet))
        self._residual = residual
        self._freedom = residual.size - space.shape[0]

    def without(self, columns: Array) -> Array:
        """-2 log likelihood (settings,) with further columns (K, n) projected off."""
        return self._evaluate(columns, np.empty((0, self._residual.size)))[:, 0]

    def with_each(self, columns: Array, functions: Array) -> Array:
        """-2 log likelihood (settings, F) with columns (K, n) projected off and each function of (F, n) fitted."""
        return self._evaluate(columns, functions)[:, 1:]

    def with_block(self, columns: Array, block: Array) -> Array:
        """-2 log likelihood (settings,) with columns (K, n) projected off and a block of columns (B, n) fitted."""
        freedom = self._freedom - len(columns)
        own: Array = _basis(block)
        stack = np.vstack([self._residual[None], columns, own]).T
        result = np.empty(len(self._white))
        for k, (lower, q, logdet) in enumerate(self._white):
            turned: Array = np.asarray(solve_triangular(lower, stack, lower=True, check_finite=False))
            turned = turned - q @ (q.T @ turned)
            left = turned[:, 0]
            if len(columns) + len(own):
                others = np.linalg.qr(turned[:, 1:])[0]
                left = left - others @ (others.T @ left)
            energy = float(left @ left)
            result[k] = freedom * np.log(energy / freedom) + logdet
        return result

    def _evaluate(self, columns: Array, functions: Array) -> Array:
        result = np.empty((len(self._white), 1 + len(functions)))
        freedom = self._freedom - len(columns)
        stack = np.vstack([self._residual[None], columns, functions]).T
        for k, (lower, q, logdet) in enumerate(self._white):
            turned = solve_triangular(lower, stack, lower=True, check_finite=False)
            turned -= q @ (q.T @ turned)
            if len(columns):
                own, _ = np.linalg.qr(turned[:, 1 : 1 + len(columns)])
                turned -= own @ (own.T @ turned)
            left, tested = turned[:, 0], turned[:, 1 + len(columns) :]
            energy = float(left @ left)
            norm = np.sum(tested**2, axis=0)
            gained = np.where(norm > 1e-12, (left @ tested) ** 2 / np.where(norm > 1e-12, norm, 1.0), 0.0)
            result[k, 0] = freedom * np.log(energy / freedom) + logdet
            result[k, 1:] = freedom * np.log(np.maximum(energy - gained, 1e-30) / freedom) + logdet
        return result

    def memory(self, columns: Array) -> Memory:
        """The memory that the data ask for with columns (K, n) projected off."""
        minus2l = self.without(columns)
        at = int(np.argmin(minus2l))
        length, share = self.settings[at]
        allowed = [q for (one, q), value in zip(self.settings, minus2l, strict=True)
                   if one == length and value <= minus2l[at] + 2.7]  # fmt: skip
        return Memory(float(minus2l[0] - minus2l[at]), share, length, max([*allowed, share]))


def beats_the_walk(channels: Sequence[Likelihoods], others: Array, block: Array, dof: int) -> bool:
    """Whether a claim of `dof` directions, block (B, 3, n), is still needed where the noise may have any memory.

    The memory is chosen anew with and without it; `others` (K, 3, n) are the other claims.
    """
    gain = 0.0
    for c, channel in enumerate(channels):
        nothing = np.empty((0, block.shape[2]))
        plain = channel.with_block(nothing, others[:, c]) if len(others) else channel.without(nothing)
        gain += float(plain.min() - channel.with_block(nothing, np.concatenate([others[:, c], block[:, c]])).min())
    return bool(-np.log10(max(float(chdtrc(dof, max(gain, 0.0))), 1e-300)) > SLOW_LOG_P)


def _basis(columns: Array) -> Array:
    """Rows that span columns (P, n), well conditioned."""
    norm = np.linalg.norm(columns, axis=1)
    kept = columns[norm > 0] / norm[norm > 0][:, None]
    if not len(kept):
        return np.empty((0, columns.shape[1]))
    _, values, rows = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(rows[values > 1e-6 * values[0]])


def slow_effects(
    channels: Sequence[Likelihoods], slow: Sequence[SlowEffect], tries: dict[int, int], limit: int = 2
) -> SlowStage:
    """Test each slow effect against the walk, then again beside the first that is claimed."""
    claimed: list[SlowScore] = []
    admitted: list[SlowScore] = []
    near: list[SlowScore] = []
    functions = np.stack([e.function for e in slow])
    for turn in range(limit):
        columns = np.array([score.effect.function for score in claimed]).reshape(-1, functions.shape[1])
        gain, remaining = np.zeros(len(slow)), np.zeros(len(slow))
        for channel in channels:
            plain = float(channel.without(columns).min())
            tested = channel.with_each(columns, functions)
            gain += plain - tested.min(axis=0)
            remaining += tested[0] - tested.min(axis=0)
        count = np.array([float(tries[e.candidate]) for e in slow])
        log_p = -np.log10(np.maximum(chdtrc(len(channels), np.maximum(gain, 0.0)), 1e-300)) - np.log10(count)
        score = gain - 2 * np.log(count)
        scores = [
            SlowScore(e, float(log_p[k]), float(remaining[k]), float(score[k])) for k, e in enumerate(slow)
        ]  # fmt: skip
        taken = {c.effect.candidate for c in claimed}
        passing = [
            s for s in scores if s.log_p > SLOW_LOG_P and s.remaining < REMAINING and s.effect.candidate not in taken
        ]
        if turn == 0:
            near = [s for s in scores if s.log_p > 1.0]
        admitted += passing
        if not passing:
            break
        claimed.append(max(passing, key=lambda s: s.score))
    return SlowStage(claimed, admitted, near)

"""Noise with memory: is the scatter from pose to pose coloured, do offsets follow a random walk, or did something slow
happen?

Each channel's scatter is taken as s^2 (I + q K): white plus a part K with memory, either exp(-|i - j| / l) (coloured
noise, l poses long) or min(i, j) (a random walk without end). q and K are chosen by restricted likelihood, with the
base and every smooth function of attitude projected off, but nothing that follows time or temperature: a fit that may
vary with time swallows the random walk and then finds it absent.

A slow effect (step, drift, warm-up, thermal lag, temperature) is believed only where it beats the random walk: q is
chosen anew with and without it, and the gain of likelihood must be large while no random walk remains beside it.
Otherwise the answer is "wander", with the slow effects as what it resembles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.policy import INTERVALS, REGRESSION
from highside.diagnosis.core.problem_policy import SlowLimits
from highside.special import chdtrc


@dataclass(frozen=True, slots=True)
class Memory:
    """The memory of one channel: `gain` of -2 log likelihood over white noise, `share` q and `length` l of the best,
    and `upper`, the largest share of that length that the data allow at 95 %.

    `lead` is the gain of -2 log likelihood over the best noise that forgets, or is white, and `colour` its length."""

    gain: float
    share: float
    length: float
    upper: float
    lead: float = 0.0
    colour: float = 0.0

    @property
    def variance_share(self) -> float:
        """Variance of a memory as large as the data allow, in that of the white part; 0 where none is required."""
        return self.upper if self.share > 0 else 0.0

    @property
    def is_random_walk(self) -> bool:
        """Whether this is a random walk beyond doubt."""
        return self.gain > MEMORY.found and np.isinf(self.length)


@dataclass(frozen=True, slots=True)
class SlowEffect:
    """A candidate of the slow stage: its index among the candidates, its variant, and its function of time on each
    channel, (C, n) or its number (C,): of the C channels from `first` on, those of the accelerometers or of the gyros.
    """

    candidate: int
    variant: int
    function: AnyArray
    first: int = 0
    tries: float = 1.0
    """shapes that were searched for this one"""

    @property
    def acts(self) -> NDArray[np.bool_]:
        """(C,) on which channels: one amplitude is fitted to each."""
        return np.asarray(self.function >= 0 if self.function.ndim == 1 else np.any(self.function != 0.0, axis=1))


@dataclass(frozen=True, slots=True)
class SlowScore:
    """How a slow effect fares against the random walk."""

    effect: SlowEffect
    log_p: float
    remaining: float
    score: float


@dataclass(frozen=True, slots=True)
class SlowStage:
    """`claimed` in the order found, `admitted` all that beat the random walk by themselves, `near` those that come
    near."""

    claimed: list[SlowScore]
    admitted: list[SlowScore]
    near: list[SlowScore]


def intervals(t_s: Array) -> Array:
    """(n,) times of poses in mean intervals between poses, from 0."""
    return np.asarray((t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]) / max(t_s.size - 1, 1), 1e-12))


class Innovating(Protocol):
    """Noise under several settings S, by its innovations."""

    @property
    def log_determinant(self) -> Array: ...
    def white(self, columns: Array) -> Array: ...


class Likelihoods:
    """Restricted likelihood of a channel under each noise with memory, prepared once for many regressors.

    `residual` (n,), `variance` (n,) of the white part, `nuisance` (P, n), all of one channel; `t_s` (n,).
    """

    def __init__(self, residual: Array, variance: Array, nuisance: Array, t_s: Array) -> None:
        self.settings = settings()
        lengths, shares = np.array(self.settings).T
        self._prepare(
            residual, LevelNoise.of(variance, intervals(t_s), shares * float(variance.mean()), lengths), nuisance
        )

    def _prepare(self, residual: Array, noise: Innovating, nuisance: Array) -> None:
        self._noise = noise
        space = _basis(nuisance)
        turned = self._noise.white(np.vstack([residual[None], space]))
        q, r = np.linalg.qr(turned[:, 1:].transpose(0, 2, 1))
        self._space = q.transpose(0, 2, 1)
        diagonal = np.abs(np.diagonal(r, axis1=1, axis2=2))
        self._logdet = self._noise.log_determinant + 2 * np.log(diagonal).sum(axis=1)
        self._residual = self._outside(turned[:, :1])[:, 0]
        self._freedom = residual.size - space.shape[0]

    def _outside(self, turned: Array) -> Array:
        """What of innovations (S, K, n) the nuisance does not explain."""
        return np.asarray(turned - (turned @ self._space.transpose(0, 2, 1)) @ self._space)

    def _prepared(self, columns: Array) -> Array:
        return self._outside(self._noise.white(columns))

    def without(self, columns: Array) -> Array:
        """-2 log likelihood (settings,) with further columns (K, n) projected off."""
        return self.with_each(columns, columns[:0], include_none=True)[:, 0]

    def with_each(self, columns: Array, functions: Array, *, include_none: bool = False) -> Array:
        """-2 log likelihood (settings, F) with columns (K, n) projected off and each function of (F, n) fitted.

        With `include_none` first that of no function at all.
        """
        freedom = self._freedom - len(columns)
        turned = self._prepared(np.vstack([columns, functions]))
        left, tested = self._residual, turned[:, len(columns) :]
        if len(columns):
            q, _ = np.linalg.qr(turned[:, : len(columns)].transpose(0, 2, 1))
            left = left - np.einsum("snk,sk->sn", q, np.einsum("snk,sn->sk", q, left))
            tested = tested - (tested @ q) @ q.transpose(0, 2, 1)
        energy = np.sum(left**2, axis=1)[:, None]
        norm = np.sum(tested**2, axis=2)
        gained = np.einsum("sfn,sn->sf", tested, left) ** 2 / np.where(norm > 1e-12, norm, np.inf)
        gained = np.concatenate([np.zeros_like(energy), gained], axis=1) if include_none else gained
        return np.asarray(
            freedom * np.log(np.maximum(energy - gained, 1e-30) / max(freedom, 1)) + self._logdet[:, None]
        )

    def with_block(self, columns: Array, block: Array) -> Array:
        """-2 log likelihood (settings,) with columns (K, n) projected off and a block of columns (B, n) fitted."""
        freedom = self._freedom - len(columns)
        turned = self._prepared(np.vstack([columns, _basis(block)]))
        left = self._residual
        if turned.shape[1]:
            q, _ = np.linalg.qr(turned.transpose(0, 2, 1))
            left = left - np.einsum("snk,sk->sn", q, np.einsum("snk,sn->sk", q, left))
        return np.asarray(freedom * np.log(np.sum(left**2, axis=1) / max(freedom, 1)) + self._logdet)

    def memory(self, columns: Array) -> Memory:
        """The memory that the data require with columns (K, n) projected off."""
        return memory_of(self.settings, self.without(columns))


def settings() -> list[tuple[float, float]]:
    """(length, share) of each noise that is tried, white noise first."""
    return [(1.0, 0.0)] + [(length, q) for length in MEMORY.lengths for q in MEMORY.shares[length]]


def memory_of(tried: Sequence[tuple[float, float]], minus2l: Array) -> Memory:
    """The memory that -2 log likelihoods (settings,) require; the first setting is white noise."""
    at = int(np.argmin(minus2l))
    length, share = tried[at]
    allowed = [
        q
        for (one, q), value in zip(tried, minus2l, strict=True)
        if one == length and value <= minus2l[at] + INTERVALS.chi2_95
    ]
    forgets = np.array([np.isfinite(one) or q == 0.0 for one, q in tried])
    second = int(np.argmin(np.where(forgets, minus2l, np.inf)))
    colour = tried[second][0] if tried[second][1] > 0.0 else 0.0
    lead = float(minus2l[second] - minus2l[at])
    return Memory(float(minus2l[0] - minus2l[at]), share, length, max([*allowed, share]), lead, colour)


class Channel(Protocol):
    """The likelihood of one channel, whatever stands for columns: arrays (K, n) or their numbers (K,)."""

    def without(self, columns: Any) -> Array: ...
    def with_each(self, columns: Any, functions: Any) -> Array: ...
    def with_block(self, columns: Any, block: Any) -> Array: ...
    def memory(self, columns: Any) -> Memory: ...


def beats_random_walk(
    channels: Sequence[Channel],
    others: AnyArray,
    block: AnyArray,
    dof: int,
    tries: float = 1.0,
    certain: float = MEMORY.slow_log_p,
) -> bool:
    """Whether a claim of `dof` directions, block (B, C, ...), is still needed where the noise may have any memory.

    It is the best of so many `tries`; `certain` is the -log10 p required.

    The memory is chosen anew with and without it; `others` (K, C, ...) are the other claims.
    """
    gain = 0.0
    for c, channel in enumerate(channels):
        nothing = block[:0, c]
        plain = channel.with_block(nothing, others[:, c]) if len(others) else channel.without(nothing)
        gain += float(plain.min() - channel.with_block(nothing, np.concatenate([others[:, c], block[:, c]])).min())
    p = tries * float(chdtrc(dof, max(gain, 0.0)))
    return bool(-np.log10(max(p, 1e-300)) > certain)


def _basis(columns: Array) -> Array:
    """Rows that span columns (P, n), well conditioned."""
    norm = np.linalg.norm(columns, axis=1)
    kept = columns[norm > 0] / norm[norm > 0][:, None]
    if not len(kept):
        return np.empty((0, columns.shape[1]))
    _, values, rows = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(rows[values > REGRESSION.independent * values[0]])


def slow_scores(
    channels: Sequence[Channel], slow: Sequence[SlowEffect], beside: Sequence[SlowScore] = ()
) -> tuple[list[SlowScore], Array, Array]:
    """How every slow effect fares beside those; what each gains of -2 log likelihood; the evidence of memory on the
    channels that each acts on.

    The memory is chosen anew with each, so that differences of score between slow effects hold whether or not the
    noise contains a random walk.
    """
    tries = _tries(slow)
    gain, remaining, evidence = np.zeros((3, len(slow)))
    acts = np.stack([e.acts for e in slow])
    for first in sorted({e.first for e in slow}):
        at = np.array([k for k, e in enumerate(slow) if e.first == first])
        functions = np.stack([slow[k].function for k in at])
        columns = np.array([s.effect.function for s in beside if s.effect.first == first])
        columns = columns if len(columns) else functions[:0]
        for c in range(functions.shape[1]):
            channel = channels[first + c]
            without = channel.without(columns[:, c])
            plain = float(without.min())
            tested = channel.with_each(columns[:, c], functions[:, c])
            gain[at] += plain - tested.min(axis=0)
            # what other channels remember is no matter of this one's
            own = acts[at, c]
            evidence[at] += np.where(own, float(without[0]) - plain, 0.0)
            remaining[at] += np.where(own, tested[0] - tested.min(axis=0), 0.0)
    log_p, score = _slow_log_p(gain, _freedom(slow), tries), gain - 2 * np.log(tries)
    rows = zip(slow, log_p.tolist(), remaining.tolist(), score.tolist(), strict=True)
    return [SlowScore(*row) for row in rows], gain, evidence


def plain_level(channels: Sequence[Channel], slow: Sequence[SlowEffect]) -> Array:
    """(len(slow),) -2 log likelihood of the channels of each without any, the memory of each channel chosen."""
    level: dict[int, float] = {}
    for effect in slow:
        if effect.first not in level:
            none = effect.function[None][:0]
            own = channels[effect.first : effect.first + len(effect.function)]
            level[effect.first] = sum(float(channel.without(none[:, c]).min()) for c, channel in enumerate(own))
    return np.array([level[effect.first] for effect in slow])


def _tries(slow: Sequence[SlowEffect]) -> Array:
    """(len(slow),) how many shapes of its effect each is one of."""
    owners, count = np.unique([e.candidate for e in slow], return_counts=True)
    return np.array([float(count[owners == e.candidate][0]) * e.tries for e in slow])


def _freedom(slow: Sequence[SlowEffect]) -> Array:
    """(len(slow),) amplitudes of each."""
    return np.array([max(np.count_nonzero(e.acts), 1) for e in slow], dtype=float)


def slow_effects(
    channels: Sequence[Channel],
    slow: Sequence[SlowEffect],
    ids: Sequence[str],
    limits: SlowLimits,
    most: int = 2,
) -> SlowStage:
    """Test each slow effect (`ids` name them) against the random walk, then again beside the first that is claimed."""
    tries, own = _tries(slow), _freedom(slow)

    def scored(beside: Sequence[SlowScore]) -> tuple[list[SlowScore], Array, Array]:
        return slow_scores(channels, slow, beside)

    claimed: list[SlowScore] = []
    admitted: list[SlowScore] = []
    near: list[SlowScore] = []
    for turn in range(most):
        scores, gain, evidence = scored(claimed)
        taken = {c.effect.candidate for c in claimed}
        passing = [
            s
            for s, name, of_memory in zip(scores, ids, evidence.tolist(), strict=True)
            if s.effect.candidate not in taken and limits.passes(name, s.log_p, s.remaining, of_memory, s.score)
        ]
        if turn == 0:
            near = [s for s in scores if s.log_p > MEMORY.near_log_p]
        admitted += passing
        # of two that fit alike the one that stands first in the library
        best = max(passing, key=lambda s: round(s.score, 1)) if passing else None
        if turn == 0 and limits.pairs and evidence.max() > MEMORY.in_use:
            pair = _pair(scores, gain, ids, limits, tries, own, lambda one: scored([one]))
            if pair and (best is None or sum(s.score for s in pair) > best.score + MEMORY.pair_score):
                claimed += pair
                admitted += pair
                break
        if best is None:
            break
        claimed.append(best)
    return SlowStage(claimed, admitted, near)


def _pair(
    scores: Sequence[SlowScore],
    gain: Array,
    ids: Sequence[str],
    limits: SlowLimits,
    tries: Array,
    freedom: Array,
    beside: Callable[[SlowScore], tuple[list[SlowScore], Array, Array]],
) -> list[SlowScore]:
    """Two that only together leave no random walk, each of which is needed beside the other; none if there are no
    such."""
    seeds: dict[int, int] = {}
    for k in np.argsort([-s.score for s in scores]).tolist():
        if scores[k].log_p > MEMORY.near_log_p:
            seeds.setdefault(scores[k].effect.candidate, k)
    best: tuple[float, list[SlowScore]] = (0.0, [])
    for k in list(seeds.values())[: MEMORY.seeds]:
        after, more, evidence = beside(scores[k])
        # what the first gains where the second is there already
        beside_it = gain[k] + more - gain
        back = _slow_log_p(beside_it, freedom, tries[k])
        for j, second in enumerate(after):
            if second.effect.candidate == scores[k].effect.candidate:
                continue
            needed = all(
                limits.passes(
                    name,
                    log_p - MEMORY.pair_log_p,
                    second.remaining,
                    float(evidence[j]),
                    score - 2 * np.log(10**MEMORY.pair_log_p),
                )
                for name, log_p, score in (
                    (ids[j], second.log_p, second.score),
                    (ids[k], float(back[j]), float(beside_it[j] - 2 * np.log(tries[k]))),
                )
            )
            total = scores[k].score + second.score
            if needed and total > best[0]:
                best = (total, [scores[k], second])
    return best[1]


def _slow_log_p(gain: Array, freedom: Array | float, tries: Array | float) -> Array:
    """-log10 p of gains of -2 log likelihood by so many amplitudes, the best of so many tries."""
    return np.asarray(-np.log10(np.maximum(chdtrc(freedom, np.maximum(gain, 0.0)), 1e-300)) - np.log10(tries))

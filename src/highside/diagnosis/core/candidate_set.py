"""Candidates in units of the noise: how each stands beside what is fitted, and what the best of all shows by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.policy import CANDIDATE_SET, REGRESSION
from highside.diagnosis.core.problem_policy import OWN_NOISE
from highside.diagnosis.core.regression import ScoreTest, log10_p, outside


@dataclass(frozen=True, slots=True)
class Term:
    """A candidate at one of its variants."""

    candidate: int
    variant: int


class CandidateSet:
    """All variants of all candidates in units of the noise."""

    def __init__(self, candidates: Sequence[Candidate], blocks: Sequence[Array]) -> None:
        self.candidates = list(candidates)
        self.blocks = list(blocks)
        self.terms = [Term(i, j) for i, c in enumerate(candidates) for j in range(len(c.variants))]
        self.owner = np.array([m.candidate for m in self.terms], dtype=np.intp)
        self.tries = np.maximum(
            np.bincount(self.owner, minlength=len(self.candidates)), [c.searched for c in candidates]
        ).astype(float)
        self.score_test = ScoreTest(self.blocks)
        self.one_sided = [
            i for i, m in enumerate(self.terms) if _one_sided(self.candidates[m.candidate]) and len(blocks[i]) == 1
        ]
        sizes = [_known_size(self.candidates[m.candidate]) for m in self.terms]
        self.known = [(i, size) for i, size in enumerate(sizes) if size is not None]
        self._index = {term: i for i, term in enumerate(self.terms)}

    def columns(self, term: Term) -> Array:
        """(k, N), whitened."""
        return self.blocks[self._index[term]]

    def whole(self, term: Term) -> Term:
        """The variant of the same shape in which all amplitudes act; of what has no name each stands for itself."""
        if not self.candidates[term.candidate].named:
            return term
        variants = self.candidates[term.candidate].variants
        shape = variants[term.variant].shape
        of_it = (j for j, v in enumerate(variants) if v.whole and v.shape == shape)
        return Term(term.candidate, next(of_it, term.variant))

    def stack(self, terms: Sequence[Term]) -> Array:
        """Columns of several terms, (K, N)."""
        if not terms:
            return np.empty((0, self.blocks[0].shape[1]))
        return np.vstack([self.columns(term) for term in terms])


def _one_sided(candidate: Candidate) -> bool:
    """Whether the only amplitude of an effect cannot be negative."""
    if candidate.effect is None or len(candidate.amplitudes) != 1:
        return False
    return next(p.gate[0] for p in candidate.effect.parameters if not p.shape) == 0.0


def _known_size(candidate: Candidate) -> float | None:
    """The only amplitude that an effect may have."""
    effect = candidate.effect
    if effect is None or not effect.known_size or len(candidate.amplitudes) != 1:
        return None
    return next(p.typical for p in effect.parameters if not p.shape)


@dataclass(frozen=True)
class Ranking:
    """Every candidate at its best variant after what is already explained; arrays (candidates,)."""

    best: list[Term]
    gain: Array
    dof: Array
    log_p: Array
    """-log10 p with the number of shapes counted in"""
    bic: Array
    """gain of BIC from adding it; positive is better"""


def ranking(candidate_set: CandidateSet, space: Array, residual: Array, freedom: float, size: int) -> Ranking:
    """Run the score test for one residual (N,) outside of `space`; `size` is the number of readings."""
    gains, dof = candidate_set.score_test.run(space, residual[None])
    gain = gains[:, 0]
    for i in candidate_set.one_sided:
        # an amplitude that cannot be negative explains nothing by being so
        if float(outside(space, candidate_set.blocks[i])[0] @ residual) < 0:
            gain[i] = 0.0
        else:
            # of two slacks that lag alike the one that needs no hysteresis is the simpler
            effect = candidate_set.candidates[candidate_set.terms[i].candidate].effect
            gain[i] = max(
                0.0,
                gain[i]
                + (CANDIDATE_SET.half if effect is not None and effect.complex_safe else -CANDIDATE_SET.hysteresis),
            )
    for i, amplitude in candidate_set.known:
        # taken as large as it must be, not as large as would suit
        bare = amplitude * outside(space, candidate_set.blocks[i])[0]
        gain[i] = max(0.0, float(2 * bare @ residual - bare @ bare))
    score = gain - dof * np.log(size)
    best: list[Term] = []
    picked = np.zeros(len(candidate_set.candidates), dtype=np.intp)
    for k in range(len(candidate_set.candidates)):
        own = np.flatnonzero(candidate_set.owner == k)
        picked[k] = own[np.argmax(score[own])]
        best.append(candidate_set.terms[picked[k]])
    log_p = np.maximum(
        log10_p(gain[picked], dof[picked], freedom, candidate_set.tries),
        _log_p_beside_own(gain[picked], dof[picked], outside(space, residual), len(space), candidate_set.tries),
    )
    return Ranking(
        best,
        gain[picked],
        dof[picked].astype(float),
        log_p,
        score[picked] - 2 * np.log(candidate_set.tries),
    )


def _log_p_beside_own(gain: Array, dof: NDArray[np.intp], left: Array, used: int, tries: Array) -> Array:
    """-log10 p against the noise that a candidate itself leaves, where that is far below the noise learned before; else
    0.

    Of few readings the rich columns hold less than the whole library, and what they lack passes as noise. `left` (N,)
    is outside of the `used` directions of what is fitted. The scatter of one channel is known to a share of the freedom
    that is left.
    """
    freedom = left.size - used - dof
    share = freedom / OWN_NOISE.channels
    variance = np.maximum(float(left @ left) - gain, 0.0) / np.maximum(freedom, 1)
    quiet = (variance < OWN_NOISE.below) & (share >= OWN_NOISE.freedom)
    unit = np.maximum(variance, REGRESSION.visible**4)
    return np.where(quiet, log10_p(gain / unit, dof, np.maximum(share, 1.0), tries), 0.0)


def threshold(
    score_test: ScoreTest,
    owner: NDArray[np.intp],
    chance: Array,
    space: Array,
    freedom: Array | float,
    rate: float = CANDIDATE_SET.alarm_rate,
) -> float:
    """-log10 p that the family exceeds by chance in a share of sessions, `rate`; `chance` (B, N) are residuals of
    nothing.

    `freedom` is one for all, or one for each variant.
    """
    gains, dof = score_test.run(space, chance)
    each = np.broadcast_to(np.asarray(freedom, dtype=float), owner.shape)
    families = np.unique(owner)
    worst = np.zeros(len(chance))
    for family in families:
        own = owner == family
        for k in np.unique(dof[own]):
            same = own & (dof == k)
            tries = float(own.sum())
            worst = np.maximum(worst, log10_p(gains[same].max(axis=0), np.array(k), float(each[same].min()), tries))
    return max(
        float(np.quantile(worst, 1 - rate)),
        float(-np.log10(rate / families.size)),
    )


def pose_flips(rich: Array, rng: np.random.Generator, channels: int = 3) -> Array:
    """(FLIPS, C n) rich residuals (C n,) with the signs of blocks of poses flipped."""
    n = rich.size // channels
    block = np.arange(n) // CANDIDATE_SET.block_poses
    signs = rng.choice([-1.0, 1.0], size=(CANDIDATE_SET.flips, int(block[-1]) + 1))[:, block]
    return np.asarray(rich * np.tile(signs, (1, channels)))


def ranked(score: Array) -> list[int]:
    """Numbers of scores, best first; of equal ones (but for rounding) the one that stands first in the library."""
    return [int(k) for k in np.argsort(-np.round(score, 3), kind="stable")]


def span_with(base: Array, columns: Array) -> Array:
    """Orthonormal basis of an orthonormal base and further columns."""
    if columns.shape[0] == 0:
        return base
    norm = np.linalg.norm(columns, axis=1, keepdims=True)
    bare = outside(base, columns / np.where(norm > 0, norm, 1.0))
    values, vectors = np.linalg.eigh(bare @ bare.T)
    good = values > REGRESSION.visible**2
    added = (vectors[:, good] / np.sqrt(values[good])).T @ bare
    return np.vstack([base, outside(base, added)])

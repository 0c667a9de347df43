"""Likelihood of stretches that were left out: what terms of a candidate set predict there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term
from highside.diagnosis.core.policy import HELD_OUT, INTERVALS
from highside.diagnosis.core.result import Fit


class Gains(Protocol):
    """Held-out likelihood of the claims."""

    def gain(self, before: Sequence[Term], after: Sequence[Term]) -> tuple[float, float]:
        """Gain of log likelihood by going from some terms to others, and its standard error over blocks."""
        ...


class HeldOutBlocks:
    """Prediction of contiguous blocks from the rest, whitened; `base` (P, N) columns fitted always."""

    def __init__(self, base: Array, residual: Array, folds: Sequence[NDArray[np.intp]]) -> None:
        self._base, self._residual, self._folds = base, residual, folds

    def hides(self, columns: Array) -> bool:
        """Whether leaving out one of the blocks leaves next to nothing of columns (K, N)."""
        energy = np.sum(columns**2, axis=0)
        return bool(max(energy[fold].sum() for fold in self._folds) > (1 - HELD_OUT.transient) * energy.sum())

    def errors(self, columns: Array) -> list[Array]:
        """Prediction errors of each fold with these columns (K, N) fitted beside the base."""
        every = np.vstack([self._base, columns])
        norm = np.linalg.norm(every, axis=1, keepdims=True)
        every = every / np.where(norm > 0, norm, 1.0)
        gram, moment = every @ every.T, every @ self._residual
        result = []
        for fold in self._folds:
            part = every[:, fold]
            left = gram - part @ part.T
            # what the other blocks hardly determine is not extrapolated
            ridge = 1e-9 * np.eye(left.shape[0])
            solution = np.linalg.solve(left + ridge, moment - part @ self._residual[fold])
            result.append(self._residual[fold] - solution @ part)
        return result


@dataclass(frozen=True)
class PoseGains:
    """Held-out likelihood of terms of a candidate set, from their whitened columns.

    What lives within one block cannot be predicted from the others: with such a term the blocks of `apart`, of every
    so many poses, are left out instead.
    """

    candidate_set: CandidateSet
    held_out: HeldOutBlocks
    apart: HeldOutBlocks | None = None

    def gain(self, before: Sequence[Term], after: Sequence[Term]) -> tuple[float, float]:
        held_out = self.held_out
        if self.apart is not None and any(held_out.hides(self.candidate_set.columns(m)) for m in {*before, *after}):
            held_out = self.apart
        pairs = [held_out.errors(self.candidate_set.stack(terms)) for terms in (before, after)]
        return block_gain(*(np.array([float(e @ e) for e in errors]) for errors in pairs))


def block_gain(before: Array, after: Array) -> tuple[float, float]:
    """Gain of log likelihood and its standard error from the squared errors of each block."""
    by_block = (before - after) / 2
    return float(by_block.sum()), float(by_block.std(ddof=1) * np.sqrt(by_block.size))


def gain_interval(before: Array, after: Array) -> tuple[float, float]:
    """95 % interval of the share of the squared error that is removed, from the squared errors of each block (B,)."""
    left = float(after.sum() / before.sum())
    # of a ratio of sums, to first order
    error = float((after - left * before).std(ddof=1) * np.sqrt(before.size) / before.sum())
    return 1.0 - left - INTERVALS.normal * error, 1.0 - left + INTERVALS.normal * error


def pose_folds(
    n: int, count: int = HELD_OUT.folds, *, interleaved: bool = False, channels: int = 3
) -> list[NDArray[np.intp]]:
    """Contiguous blocks of poses, or every so many poses, as indices into whitened vectors (C n,)."""
    count = min(count, n // HELD_OUT.poses_a_fold)
    poses = np.arange(n)
    parts = [poses[k::count] for k in range(count)] if interleaved else np.array_split(poses, count)
    return [np.concatenate([part + c * n for c in range(channels)]) for part in parts]


def block_proof(
    base: Array,
    residual: Array,
    claimed: Array,
    folds: Sequence[NDArray[np.intp]],
    after: Array,
    floor: float,
    how: str,
) -> Fit:
    """Misfit before and after, in sample and on left-out blocks; all in g, base and claims (P, N), residual (N,)."""
    plain = HeldOutBlocks(base, residual, folds)
    before, held = plain.errors(claimed[:0]), plain.errors(claimed)

    def rms(parts: list[Array]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    low, high = gain_interval(*(np.array([float(e @ e) for e in errors]) for errors in (before, held)))
    return Fit(
        unit="g",
        rmse_before=float(np.sqrt(np.mean(residual**2))),
        rmse_after=float(np.sqrt(np.mean(after**2))),
        heldout_rmse_before=rms(before),
        heldout_rmse_after=rms(held),
        heldout_gain_low=low,
        heldout_gain_high=high,
        noise_floor=floor,
        how_held_out=f"{how}; gain = share of the held-out mean square removed",
    )

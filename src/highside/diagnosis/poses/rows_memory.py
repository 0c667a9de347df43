"""Do poses scatter because their rows have a memory? The rows within the poses tell.

Means of poses that disagree more than their rows scatter are no noise by themselves: an error of each pose that is
independent of the others, which something left out makes as well, does that too. Noise with a memory leaves its trace
within the poses: neighbouring rows differ by less than those at either end. Both are fitted to the rows, channel by
channel: white noise with an error of each pose, and white noise with a level that forgets; both of the size that fits
best, what may be refitted integrated out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.poses.policy import ROWS_MEMORY
from highside.diagnosis.poses.session import PoseSession


@dataclass(frozen=True)
class RowsMemory:
    """What the rows say, all channels together."""

    nats: float
    """by which a level that forgets is ahead of an independent error of each pose"""
    length_s: float
    """of the level of the channel that remembers most"""


def rows_memory(session: PoseSession, base: Array) -> RowsMemory | None:
    """The memory of the rows beside columns (P, 3, n) that may be refitted; None where there are no rows to tell."""
    held = session.rows
    if held is None or held.pose.size < ROWS_MEMORY.rows * session.n:
        return None
    values, pose, t_s, count = _stretches(held.values, held.pose, held.t_s)
    step = float(np.median(np.diff(t_s)))
    lengths = step * np.geomspace(ROWS_MEMORY.shortest, ROWS_MEMORY.longest, ROWS_MEMORY.lengths)
    share, length = (grid.ravel() for grid in np.meshgrid(ROWS_MEMORY.shares, lengths, indexing="ij"))
    level = LevelNoise.of(1.0 / count, t_s, share, length)
    poses = np.bincount(pose)
    each = np.bincount(pose, count)
    assert poses.size == session.n
    ahead, longest = 0.0, (0.0, 0.0)
    for channel, columns in zip(values, base.transpose(1, 0, 2), strict=True):
        columns = columns[np.any(columns != 0, axis=1)]
        rows = np.concatenate([columns[:, pose], channel[None]])
        rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
        white = level.white(rows)
        of_level = _evidence(white @ white.transpose(0, 2, 1), level.log_determinant, pose.size)
        sums = np.stack([np.bincount(pose, row * count, session.n) for row in rows])
        shares = np.concatenate([[0.0], ROWS_MEMORY.errors])[:, None]
        taken = shares / (1 + shares * each)
        inner = (rows * count) @ rows.T - np.einsum("sn,in,jn->sij", taken, sums, sums)
        logs = np.log1p(shares * each).sum(axis=1) - np.log(count).sum()
        best = int(np.argmax(of_level))
        ahead += float(of_level[best]) - float(_evidence(inner, logs, pose.size).max())
        longest = max(longest, (float(share[best]), float(length[best])))
    return RowsMemory(ahead, longest[1])


def _stretches(values: Array, pose: NDArray[np.intp], t_s: Array) -> tuple[Array, NDArray[np.intp], Array, Array]:
    """Means (3, m) of few stretches of each pose, with their poses, times and numbers of rows."""
    number = np.zeros(pose.size, dtype=np.intp)
    borders = np.flatnonzero(np.diff(pose)) + 1
    at = 0
    for own in np.split(np.arange(pose.size), borders):
        parts = min(own.size, ROWS_MEMORY.stretches)
        number[own] = at + np.arange(own.size) * parts // own.size
        at += parts
    count = np.bincount(number).astype(float)
    means = np.stack([np.bincount(number, row) / count for row in values])
    first = np.concatenate([[0], np.flatnonzero(np.diff(number)) + 1])
    return means, pose[first], np.bincount(number, t_s) / count, count


def _evidence(inner: Array, log_determinant: Array, n: int) -> Array:
    """(S,) log of the restricted likelihood, at the size that fits best, from inner products (S, K + 1, K + 1) of
    whitened columns and readings."""
    k = inner.shape[1] - 1
    size = np.sqrt(np.maximum(np.einsum("sii->si", inner), 1e-300))
    unit = inner / (size[:, :, None] * size[:, None]) + 1e-12 * np.eye(k + 1)
    # the last pivot is what the columns leave of the readings
    pivots = np.linalg.cholesky(unit)[:, np.arange(k + 1), np.arange(k + 1)]
    left = (pivots[:, k] * size[:, k]) ** 2
    columns = 2 * np.log(pivots[:, :k] * size[:, :k]).sum(axis=1)
    return np.asarray(-0.5 * ((n - k) * np.log(left / (n - k)) + log_determinant + columns))

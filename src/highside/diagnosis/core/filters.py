"""Filters of noise with memory over columns of readings: few columns as a system of few bands, many by blocks of rows.

The filters of `markov` and of the ladders are linear systems of few levels: what is left of a row is the row less the
levels before it, and a level takes on a part of what is left. So all rows together are one system of few bands. And
what a filter makes of a block of rows is a matrix of the block, and one of the levels before it, which go on from block
to block: over thousands of columns products of matrices take half the time. Row by row either takes many times as long.
The recursions are those of the Kalman filter (Durbin and Koopman, Time Series Analysis by State Space Methods, section
4.3), written out; nothing is approximated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.memory_policy import MEMORY


def through_bands(bands: Array, rows: Array, *, transposed: bool = False) -> Array:
    """(K, N) the solution of a system of bands, or of the transposed one, for each of rows (K, N): `bands` (B, N) are
    the diagonals from the main one, of ones, down."""
    from scipy.linalg.lapack import dtbtrs

    if not rows.size:
        # the routine writes beyond the end of an array of none
        return rows
    return np.asarray(dtbtrs(bands, rows.T, uplo="L", trans="T" if transposed else "N", diag="U")[0].T)


@dataclass(frozen=True)
class BlockFilter:
    """b blocks of B rows; the last may have fewer rows that are there."""

    within: Array
    """(b, B, B) what each row of a block (second) adds to each innovation (third)"""
    from_levels: Array
    """(b, L, B) what the levels before a block add to its innovations"""
    to_levels: Array
    """(b, B, L) what the rows of a block add to the levels after it"""
    passed_on: Array
    """(b, L, L) what the levels before a block are after it"""

    @classmethod
    def of(cls, gain: Array, decay: Array, variance: Array) -> BlockFilter:
        """Of levels (n, L): the part of what is left that each takes on, and its decay to the next row; `variance` (n,)
        of the innovations."""
        rows, (n, levels) = MEMORY.block_rows, gain.shape
        count = -(-n // rows)
        more = count * rows - n

        def blocks(values: Array, fill: float) -> Array:
            padded = np.concatenate([values, np.full((more, *values.shape[1:]), fill)])
            return padded.reshape(count, rows, *values.shape[1:])

        taken, kept, root = blocks(gain, 0.0), blocks(decay, 1.0), 1.0 / np.sqrt(blocks(variance, 1.0))
        # what becomes of one in each row of a block, and of one in each level before it
        state = np.zeros((count, rows + levels, levels))
        state[:, rows:] = np.eye(levels)
        made = np.empty((count, rows + levels, rows))
        for t in range(rows):
            left = -state.sum(axis=2)
            left[:, t] += 1.0
            made[:, :, t] = left * root[:, t, None]
            state = (state + left[:, :, None] * taken[:, t, None]) * kept[:, t, None]
        return cls(made[:, :rows], made[:, rows:], state[:, :rows], state[:, rows:])

    def white_into(self, columns: Array, out: Array) -> None:
        """Innovations of columns (K, n), written to `out` (K, n)."""
        count, rows, levels = self.to_levels.shape
        k, n = columns.shape
        before = np.zeros((k, levels))
        whole = n // rows
        if whole:
            own = columns[:, : whole * rows].reshape(k, whole, rows).transpose(1, 0, 2)
            made = out[:, : whole * rows].reshape(k, whole, rows).transpose(1, 0, 2)
            drive = own @ self.to_levels[:whole]
            at = np.empty((whole, k, levels))
            for b in range(whole):
                at[b] = before
                before = before @ self.passed_on[b] + drive[b]
            np.matmul(own, self.within[:whole], out=made)
            made += at @ self.from_levels[:whole]
        if whole < count:
            rest = columns[:, whole * rows :]
            end = n - whole * rows
            out[:, whole * rows :] = rest @ self.within[whole, :end, :end] + before @ self.from_levels[whole, :, :end]

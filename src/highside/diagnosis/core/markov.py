"""Noise with memory in state-space form: readings = level + white, the level a random walk or one that forgets
exponentially.

A pass of the Kalman filter turns readings and any number of columns into independent unit innovations in O(n), where
the covariance matrix would take O(n^3). The filter's gains depend on the times and variances alone, so all settings of
the level and all columns go through it together. -2 log likelihood = sum of squared innovations + log determinant
(the prediction error decomposition; Durbin and Koopman, Time Series Analysis by State Space Methods, section 7.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.filters import BlockFilter, through_bands
from highside.diagnosis.core.memory_policy import MEMORY


@dataclass(frozen=True)
class LevelNoise:
    """S settings of a level over n readings; arrays (S, n): innovations' variance, gain, and decay to the next row."""

    variance: Array
    gain: Array
    decay: Array

    @classmethod
    def of(cls, white: Array, steps: Array, shares: Array, lengths: Array, walked: float = 0.0) -> LevelNoise:
        """`white` (n,) variances of the white part, `steps` (n,) rising places of the readings; `shares` and `lengths`
        (S,): the variance of the level (a random walk's for each unit of `steps`, a forgetful level's at any time) and
        its length (infinite: a random walk, that was 0 so many units of `steps` before the first place as `walked`
        says)."""
        settings, n = shares.size, white.size
        random_walk = np.isinf(lengths)
        apart = np.diff(steps, prepend=steps[:1])
        decay = np.where(random_walk[:, None], 1.0, np.exp(-apart[None] / np.where(random_walk, 1.0, lengths)[:, None]))
        drive = np.where(random_walk[:, None], shares[:, None] * apart, shares[:, None] * (1 - decay**2))
        variance, gain = np.empty((settings, n)), np.empty((settings, n))
        level = np.where(random_walk, shares * walked, shares)
        for t in range(n):
            if t:
                level = decay[:, t] ** 2 * level + drive[:, t]
            total = level + white[t]
            variance[:, t] = total
            gain[:, t] = level / total
            level = level * (1 - gain[:, t])
        after = np.ones((settings, n))
        after[:, :-1] = decay[:, 1:]
        return cls(variance, gain, after)

    def of_settings(self, which: NDArray[np.intp]) -> LevelNoise:
        """Some of the settings."""
        return LevelNoise(self.variance[which], self.gain[which], self.decay[which])

    @property
    def log_determinant(self) -> Array:
        """(S,) logarithm of the determinant of the covariance."""
        return np.asarray(np.log(self.variance).sum(axis=1))

    def white(self, columns: Array) -> Array:
        """(S, K, n) independent unit innovations of columns (K, n)."""
        made = np.empty((len(self.variance), *columns.shape))
        for s, out in enumerate(made):
            self._white_into(s, columns, out)
        return made

    def transposed(self, white: Array) -> Array:
        """(S, K, n) the transposed filter on whitened columns (S, K, n): with `white`, the inverse covariance times the
        columns. Back from the last row, what a level takes on is what the rows behind it take from that level."""
        made = np.asarray(white / np.sqrt(self.variance)[:, None])
        for s, own in enumerate(made):
            behind = through_bands(self._bands(s), own, transposed=True)
            own[:, :-1] -= self.decay[s, :-1] * self.gain[s, :-1] * behind[:, 1:]
        return made

    def white_into(self, columns: Array, out: Array) -> None:
        """The innovations of columns (K, n) under the only setting, written to `out` (K, n)."""
        self._white_into(0, columns, out)

    def _white_into(self, s: int, columns: Array, out: Array) -> None:
        """Few columns as a system of two bands: what the filter predicts of a row follows from that of the row
        before."""
        if len(columns) >= MEMORY.block_from:
            BlockFilter.of(self.gain[s, :, None], self.decay[s, :, None], self.variance[s]).white_into(columns, out)
            return
        drive = np.zeros(columns.shape)
        np.multiply(columns[:, :-1], self.decay[s, :-1] * self.gain[s, :-1], out=drive[:, 1:])
        np.subtract(columns, through_bands(self._bands(s), drive), out=out)
        out /= np.sqrt(self.variance[s])

    def _bands(self, s: int) -> Array:
        """(2, n) the system, by its diagonals from the main one down."""
        below = (self.gain[s] - 1.0) * self.decay[s]
        return np.asfortranarray(np.stack([np.ones(below.size), below]))


@dataclass(frozen=True)
class VectorNoise:
    """As `LevelNoise` for three channels whose white part hangs together: one setting, levels of their own."""

    root: Array
    """(n, 3, 3) inverse of the Cholesky factor of the innovations' covariance"""
    gain: Array
    """(n, 3, 3)"""
    decay: Array
    """(n, 3)"""

    @classmethod
    def of(cls, white: Array, steps: Array, shares: Array, lengths: Array) -> VectorNoise:
        """`white` (n, 3, 3) covariances, `steps` (n,), `shares` and `lengths` (3,) of each channel's level."""
        n = steps.size
        random_walk = np.isinf(lengths)
        apart = np.diff(steps, prepend=steps[:1])
        decay = np.where(random_walk, 1.0, np.exp(-apart[:, None] / np.where(random_walk, 1.0, lengths)))
        drive = np.where(random_walk, shares * apart[:, None], shares * (1 - decay**2))
        root, gain = np.empty((n, 3, 3)), np.empty((n, 3, 3))
        level = np.diag(np.where(random_walk, 0.0, shares))
        for t in range(n):
            if t:
                level = level * np.outer(decay[t], decay[t]) + np.diag(drive[t])
            total = level + white[t]
            root[t] = np.linalg.inv(np.linalg.cholesky(total))
            gain[t] = level @ root[t].T @ root[t]
            level = level - gain[t] @ level
        after = np.ones((n, 3))
        after[:-1] = decay[1:]
        return cls(root, gain, after)

    def white(self, columns: Array) -> Array:
        """(..., 3, n) -> (..., 3 n) independent unit innovations."""
        n = columns.shape[-1]
        readings = np.ascontiguousarray(columns.reshape(-1, 3, n).transpose(2, 1, 0))
        result = np.empty_like(readings)
        level = np.zeros(readings.shape[1:])
        for t in range(n):
            left = readings[t] - level
            result[t] = self.root[t] @ left
            level = (level + self.gain[t] @ left) * self.decay[t][:, None]
        return np.asarray(result.transpose(2, 1, 0).reshape(*columns.shape[:-2], 3 * n))

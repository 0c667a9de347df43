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
from highside.diagnosis.core.policy import MEMORY


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
        settings, n = self.variance.shape
        if settings == 1 and len(columns) > MEMORY.banded_from:
            return self._white_banded(columns, np.empty((len(columns), n)))[None]
        result = np.empty((n, settings, columns.shape[0]))
        level = np.zeros((settings, columns.shape[0]))
        gain, decay = self.gain.T[:, :, None], self.decay.T[:, :, None]
        for t, reading in enumerate(np.ascontiguousarray(columns.T)):
            left = np.subtract(reading, level, out=result[t])
            level = (level + gain[t] * left) * decay[t]
        result /= np.sqrt(self.variance.T)[:, :, None]
        return np.asarray(result.transpose(1, 2, 0))

    def transposed(self, white: Array) -> Array:
        """(S, K, n) the transposed filter on whitened columns (S, K, n): with `white`, the inverse covariance times the
        columns. Back from the last row, what a level takes on is what the rows behind it take from that level."""
        result = np.ascontiguousarray(white.transpose(2, 0, 1)) / np.sqrt(self.variance.T)[:, :, None]
        behind = np.zeros(result.shape[1:])
        gain, decay = (self.decay * self.gain).T[:, :, None], self.decay.T[:, :, None]
        for t in range(len(result) - 1, -1, -1):
            taken = gain[t] * behind
            behind = decay[t] * behind - taken - result[t]
            result[t] += taken
        return np.asarray(result.transpose(1, 2, 0))

    def white_into(self, columns: Array, out: Array) -> None:
        """The innovations of columns (K, n) under the only setting, written to `out` (K, n)."""
        self._white_banded(columns, out)

    def _white_banded(self, columns: Array, out: Array) -> Array:
        """What the filter predicts of a row follows from that of the row before alone: a system of two bands. A few
        columns at a time, they stay in the processor's cache."""
        from scipy.linalg.lapack import dtbtrs

        n = self.variance.shape[1]
        gain, root = self.decay[0] * self.gain[0], 1.0 / np.sqrt(self.variance[0])
        bands = np.asfortranarray(np.stack([np.ones(n), gain - self.decay[0]]))
        drive = np.empty((min(MEMORY.banded_at_once, len(columns)), n))
        for i in range(0, len(columns), MEMORY.banded_at_once):
            own = columns[i : i + MEMORY.banded_at_once]
            part = drive[: len(own)]
            part[:, 0] = 0.0
            np.multiply(own[:, :-1], gain[:-1], out=part[:, 1:])
            level = dtbtrs(bands, part.T, uplo="L", diag="U", overwrite_b=1)[0].T
            result = out[i : i + MEMORY.banded_at_once]
            np.subtract(own, level, out=result)
            result *= root
        return out


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

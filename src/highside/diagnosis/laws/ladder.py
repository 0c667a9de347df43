"""Noise whose spectrum falls with the frequency (1/f): a ladder of levels, each of which forgets a few times later than
the one before, all of one variance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.filters import BlockFilter, through_bands
from highside.diagnosis.laws.noise_policy import LAW_NOISE


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
        return cls.several(white, t_s, np.array([share]), lengths)[0]

    @classmethod
    def several(cls, white: Array, t_s: Array, shares: Array, lengths: Array) -> list[LadderNoise]:
        """One for each of the shares (R,)."""
        n, levels = white.size, lengths.size
        decay = np.exp(-np.diff(t_s, prepend=t_s[:1])[:, None] / lengths)
        variance, gain = np.empty((n, shares.size)), np.empty((n, shares.size, levels))
        each, diagonal = shares[:, None, None], np.arange(levels)
        spread = each * np.eye(levels)
        for t in range(n):
            if t:
                spread = spread * np.outer(decay[t], decay[t])
                spread[:, diagonal, diagonal] += each[:, 0] * (1 - decay[t] ** 2)
            observed = spread.sum(axis=2)
            variance[t] = observed.sum(axis=1) + white[t]
            gain[t] = observed / variance[t][:, None]
            spread = spread - gain[t][:, :, None] * observed[:, None, :]
        after = np.ones((n, levels))
        after[:-1] = decay[1:]
        return [cls(variance[:, r], gain[:, r], after) for r in range(shares.size)]

    @property
    def log_determinant(self) -> Array:
        """(1,)."""
        return np.array([float(np.log(self.variance).sum())])

    @cached_property
    def _bands(self) -> Array:
        """(L + 2, n (L + 1)) the filter as one system of few bands, of what is left of each row and its levels after
        it: a row is what is left and the sum of the levels before it."""
        n, levels = self.decay.shape
        bands = np.zeros((levels + 2, n, levels + 1), order="F")
        bands[0] = 1.0
        for k in range(levels):
            bands[1 + k, :, 0] = -self.decay[:, k] * self.gain[:, k]
            bands[levels - k, :, 1 + k] = 1.0
            bands[levels + 1, :-1, 1 + k] = -self.decay[1:, k]
        return np.asfortranarray(bands.reshape(levels + 2, -1))

    @cached_property
    def _blocks(self) -> BlockFilter:
        return BlockFilter.of(self.gain, self.decay, self.variance)

    def white(self, columns: Array) -> Array:
        """(1, K, n) innovations of columns (K, n)."""
        made = np.empty((1, *columns.shape))
        self.white_into(columns, made[0])
        return made

    def white_into(self, columns: Array, out: Array) -> None:
        """These, written to `out` (K, n)."""
        if len(columns) > LAW_NOISE.ladder_by_bands:
            self._blocks.white_into(columns, out)
        else:
            np.divide(self._through_bands(columns), np.sqrt(self.variance), out=out)

    def transposed(self, white: Array) -> Array:
        """(1, K, n) the transposed filter on whitened columns (1, K, n), as `LevelNoise.transposed`."""
        return self._through_bands(white[0] / np.sqrt(self.variance), transposed=True)[None]

    def _through_bands(self, columns: Array, *, transposed: bool = False) -> Array:
        """(K, n) what is left of columns (K, n), or the transposed filter on them."""
        n, levels = self.decay.shape
        both = np.zeros((len(columns), n, levels + 1))
        both[:, :, 0] = columns
        made = through_bands(self._bands, both.reshape(len(columns), n * (levels + 1)), transposed=transposed)
        return made.reshape(both.shape)[:, :, 0]


def white_by_ladders(ladders: Sequence[LadderNoise], columns: Array) -> Array:
    """(R, K, n) innovations of columns (K, n) under each ladder."""
    return np.concatenate([one.white(columns) for one in ladders])


def transposed_by_ladders(ladders: Sequence[LadderNoise], white: Array) -> Array:
    """(R, K, n) the transposed filters on whitened columns (R, K, n)."""
    return np.concatenate([one.transposed(rows[None]) for one, rows in zip(ladders, white, strict=True)])

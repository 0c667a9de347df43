"""Noise that is independent from reading to reading and from channel to channel, but for a memory of each channel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.core.memory import Innovating, Memory, intervals
from highside.diagnosis.core.policy import FITS
from highside.diagnosis.core.regression import outside, span


@dataclass(frozen=True)
class IndependentNoise:
    """`std` (C, n) of each reading, in the reading's unit; `levels` whiten each channel in time order where its scatter
    has a memory."""

    std: Array
    freedom: float
    levels: tuple[Innovating, ...] = ()

    @classmethod
    def learned(cls, residual: Array, rich: Array) -> IndependentNoise:
        """Of a residual (C, n) what the rich columns (P, C, n) do not explain, the lost degrees of freedom counted: one
        size a channel."""
        channels, n = residual.shape
        sigma = np.full((channels, 1), max(float(residual.std()), 1e-12))
        for _ in range(2):
            noise = cls(np.broadcast_to(sigma, residual.shape), 1.0)
            space = span(noise.white(rich))
            left = outside(space, noise.white(residual)).reshape(channels, n)
            share = (1.0 - np.sum(space**2, axis=0)).reshape(channels, n)
            size = np.sum(left**2, axis=1) / np.maximum(share.sum(axis=1), FITS.rich_left * n)
            sigma = np.maximum(sigma * np.sqrt(size)[:, None], 1e-12)
        return cls(np.broadcast_to(sigma, residual.shape), float(share.sum()) / channels)

    def white(self, columns: Array) -> Array:
        """(..., C, n) -> (..., C n) in units of the noise."""
        shape = (*columns.shape[:-2], columns.shape[-2] * columns.shape[-1])
        if not self.levels:
            return np.asarray(columns / self.std).reshape(shape)
        turned = [
            level.white(columns[..., c, :].reshape(-1, columns.shape[-1]))[0].reshape(
                *columns.shape[:-2], columns.shape[-1]
            )
            for c, level in enumerate(self.levels)
        ]
        return np.stack(turned, axis=-2).reshape(shape)

    def with_memory(self, memories: Sequence[Memory], t_s: Array) -> IndependentNoise:
        """The same with the memory of each channel, as large as the data allow; `t_s` (n,)."""
        return self.remembering([m.length for m in memories], [m.variance_share for m in memories], t_s)

    def remembering(self, lengths: Sequence[float], shares: Sequence[float], t_s: Array) -> IndependentNoise:
        """The same with a memory of so many readings on each channel, its variance in that of the white part."""
        levels = []
        for std, length, share in zip(self.std, lengths, shares, strict=True):
            size = np.array([share * float((std**2).mean())])
            levels.append(LevelNoise.of(std**2, intervals(t_s), size, np.array([length])))
        return replace(self, levels=tuple(levels))

"""What is known once something departs: of all hypotheses and onsets together, each by its likelihood.

The likeliest alone would state more than is known: where `b_x` and `S_xz` are one class, its parameters are right if it
is what happened, and many standard deviations off if it is not. So each hypothesis `k` at each onset is a member with
the weight

    w_k = span_k exp(ratio_k / 2) / sqrt(ratio_k),

the marginal likelihood of a size of any order of magnitude (density `1 / |size|`, which needs no unit and no largest
size), where `span_k` is the share of the watch's time that the onset stands for: steps may come at any time, and what
begins with the watch has all of it. With state `x`, covariance `P` of the filter and the mean error `d_k` of one of
size one, a member says `x + d_k size_k` and `P + d_k d_k' std_k^2`. Mean and covariance of the mixture are those of its
members and of the scatter between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array

__all__ = ["Mixture"]

_LEAST_WEIGHT = 1e-7
"""of the largest: members below it change no stated digit"""


@dataclass(frozen=True, slots=True)
class Mixture:
    """Members (K,): `of` which hypothesis, `weight` (sum one), `size` with `std`; `left` (N, K) mean error of the
    filter for a size of one."""

    of: NDArray[np.intp]
    weight: Array
    size: Array
    std: Array
    left: Array

    @classmethod
    def of_columns(
        cls, of: NDArray[np.intp], span: Array, ratio: Array, size: Array, std: Array, left: Array
    ) -> Mixture | None:
        """From all columns of a bank; None where none explains anything. `ratio`: twice the log-likelihood ratio, zero
        for what is no explanation."""
        known = np.flatnonzero((ratio > 0.0) & (span > 0.0))
        if not known.size:
            return None
        log = 0.5 * ratio[known] - 0.5 * np.log(np.maximum(ratio[known], 1.0)) + np.log(span[known])
        weight = np.exp(log - log.max())
        kept = weight > _LEAST_WEIGHT
        known, weight = known[kept], weight[kept] / weight[kept].sum()
        return cls(of[known], weight, size[known], std[known], left[:, known])

    def corrected(self, state: Array, covariance: Array) -> tuple[Array, Array]:
        """State (N,) and covariance (N, N) of the filter, with what departs."""
        moved = self.left * self.size
        mean = moved @ self.weight
        apart = moved - mean[:, None]
        own = (self.left * (self.weight * self.std**2)) @ self.left.T
        return state + mean, covariance + own + (apart * self.weight) @ apart.T

    def size_of(self, hypothesis: int) -> tuple[float, float] | None:
        """Of one hypothesis, over all its onsets: size and standard deviation, if this is what happened. None: it is
        no member."""
        own = self.of == hypothesis
        if not own.any():
            return None
        weight = self.weight[own] / self.weight[own].sum()
        mean = float(weight @ self.size[own])
        return mean, float(np.sqrt(weight @ (self.std[own] ** 2 + (self.size[own] - mean) ** 2)))

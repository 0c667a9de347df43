"""One quantity, or the amplitudes of one effect, of several tools: their mean, their scatter, whom it does not fit.

Tool i has the score `U_i` (k,) and the information `J_i` (k, k) of its amplitudes; where `J_i` can be inverted the
estimate is `J_i^-1 U_i` with covariance `J_i^-1`. Tools differ: amplitude p scatters about the common mean with
variance `tau_p^2`. That is estimated by restricted maximum likelihood (Harville 1977, as in DerSimonian and Kacker
2007, by fixed-point steps), the mean by generalised least squares in a form that needs no inverse of an information,

    W_i = J_i (1 + T J_i)^-1,   W_i theta_i = (1 + J_i T)^-1 U_i,   T = diag(tau^2),

and its standard deviation is widened where tools scatter by more than that (Knapp and Hartung 2003, never narrowed);
tests are of Student's t with one degree of freedom less than there are tools.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.fleet.policy import POOLING
from highside.special import fdtrc, stdtr

__all__ = [
    "LeftOut",
    "Pooled",
    "between_tools",
    "conspicuous",
    "left_out",
    "marginal",
    "moments_scatter",
    "outlying",
    "pool",
    "reml_scatter",
]


@dataclass(frozen=True)
class Pooled:
    """What tools have in common in k amplitudes."""

    mean: Array
    """(k,)"""
    covariance: Array
    """(k, k) of the mean, widened"""
    scatter: Array
    """(k,) standard deviation from tool to tool"""
    tools: int
    gain: float = 0.0
    """of twice the log likelihood, by mean and scatter over nothing in common, less what each amplitude's scatter would
    by chance (BIC); without any scatter where that explains more"""

    @property
    def std(self) -> Array:
        """(k,) of the mean."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def t(self) -> Array:
        """(k,) mean in its standard deviations."""
        std = self.std
        return np.where(std > 0, self.mean / np.where(std > 0, std, 1.0), 0.0)

    @property
    def p(self) -> float:
        """That a mean so far from nothing would be chance: of one amplitude by Student's t; of several by the most
        significant of them, or by all together (an F test of their chi-square), whichever says more, twice.

        The covariance is known but for its scale, which all amplitudes of all tools but the mean's have told."""
        k, n = self.mean.size, self.tools
        single = k * 2.0 * float(stdtr(n - 1, -np.max(np.abs(self.t), initial=0.0)))
        if k == 1:
            return min(1.0, single)
        return min(1.0, 2.0 * single, 2.0 * float(fdtrc(k, k * (n - 1), self.evidence / k)))

    @property
    def evidence(self) -> float:
        """Chi-square that the mean explains."""
        return float(self.mean @ np.linalg.pinv(self.covariance, hermitian=True) @ self.mean)


def reml_scatter(estimate: Array, variance: Array) -> float:
    """Standard deviation between (n,) estimates beyond their own `variance` (n,), by restricted maximum likelihood."""
    if estimate.size < 2:
        return 0.0
    tau2 = moments_scatter(estimate, variance) ** 2
    for _ in range(POOLING.steps):
        weight = 1.0 / (variance + tau2)
        mean = np.sum(weight * estimate) / np.sum(weight)
        square = weight**2 * ((estimate - mean) ** 2 - variance)
        new = max(0.0, float(np.sum(square) / np.sum(weight**2) + 1.0 / np.sum(weight)))
        if abs(new - tau2) <= POOLING.settled * (new + float(np.min(variance))):
            return float(np.sqrt(new))
        tau2 = new
    return float(np.sqrt(tau2))


def moments_scatter(estimate: Array, variance: Array) -> float:
    """The same by moments (DerSimonian and Laird 1986): the start, and the check, of `reml_scatter`."""
    if estimate.size < 2:
        return 0.0
    weight = 1.0 / variance
    mean = np.sum(weight * estimate) / np.sum(weight)
    q = float(np.sum(weight * (estimate - mean) ** 2))
    divisor = float(np.sum(weight) - np.sum(weight**2) / np.sum(weight))
    return float(np.sqrt(max(0.0, (q - (estimate.size - 1)) / divisor)))


def marginal(score: Array, information: Array) -> tuple[Array, Array]:
    """(n, k) estimates and variances of each amplitude by itself; infinite where a tool says nothing of it."""
    power = np.einsum("nkk->nk", information)
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    values, vectors = np.linalg.eigh(information / (scale[:, :, None] * scale[:, None, :]))
    good = values > POOLING.visible * np.maximum(values[:, -1:], 1.0)
    inverse = (vectors * np.where(good, 1.0 / np.where(good, values, 1.0), 0.0)[:, None, :]) @ vectors.transpose(
        0, 2, 1
    )
    inverse = inverse / (scale[:, :, None] * scale[:, None, :])
    # an amplitude that lies in a direction of which nothing is known has no estimate of its own
    unknown = np.einsum("nkj,nj->nk", vectors**2, (~good).astype(float)) > POOLING.visible
    estimate: Array = np.zeros(score.shape)
    variance: Array = np.full(score.shape, np.inf)
    estimate[~unknown] = np.einsum("nij,nj->ni", inverse, score)[~unknown]
    variance[~unknown] = np.einsum("nkk->nk", inverse)[~unknown]
    return estimate, variance


def between_tools(score: Array, information: Array) -> Array:
    """(k,) scatter from tool to tool of each amplitude, of scores (n, k) and informations (n, k, k)."""
    estimate, variance = marginal(score, information)
    found = np.zeros(score.shape[1])
    for p in range(found.size):
        finite = np.isfinite(variance[:, p])
        found[p] = reml_scatter(estimate[finite, p], variance[finite, p])
    return found


def _weights(score: Array, information: Array, scatter: Array) -> tuple[Array, Array]:
    """(n, k, k) weights and (n, k) weighted estimates."""
    t = np.diag(scatter**2)
    one = np.eye(scatter.size)
    weighted = np.linalg.solve(one + information @ t, score[..., None])[..., 0]
    weight = np.linalg.solve(one + information @ t, information)
    return 0.5 * (weight + weight.transpose(0, 2, 1)), np.asarray(weighted, dtype=np.float64)


def pool(score: Array, information: Array, scatter: Array | None = None) -> Pooled:
    """The common mean of n tools, of scores (n, k) and informations (n, k, k); `scatter` (k,) where it is known."""
    n, k = score.shape
    tau = between_tools(score, information) if scatter is None else scatter
    weight, weighted = _weights(score, information, tau)
    covariance = np.linalg.pinv(weight.sum(axis=0), hermitian=True)
    mean = covariance @ weighted.sum(axis=0)
    left = weighted - weight @ mean
    q = float(np.einsum("ni,nij,nj->", left, np.linalg.pinv(weight, hermitian=True), left))
    freedom = max(1, int(np.linalg.matrix_rank(weight, hermitian=True).sum()) - k)
    gain = max(
        _gain(score, information, np.zeros(k)), _gain(score, information, tau) - np.count_nonzero(tau) * np.log(n)
    )
    return Pooled(mean, covariance * max(1.0, q / freedom), tau, n, gain)


def _gain(score: Array, information: Array, scatter: Array) -> float:
    """Of twice the log likelihood of all tools, by the mean (k,) and this scatter (k,) over neither."""
    weight, weighted = _weights(score, information, scatter)
    mean = np.linalg.pinv(weight.sum(axis=0), hermitian=True) @ weighted.sum(axis=0)
    left = score - information @ mean
    inner = np.eye(scatter.size) + scatter[:, None] * information * scatter
    by_scatter = scatter * left
    more = np.einsum("ni,ni->", by_scatter, np.linalg.solve(inner, by_scatter[..., None])[..., 0])
    by_mean = 2.0 * np.sum(score @ mean) - np.einsum("nij,i,j->", information, mean, mean)
    return float(by_mean + more - np.linalg.slogdet(inner)[1].sum())


@dataclass(frozen=True)
class LeftOut:
    """Each tool against what the others say: n tools, k amplitudes; the scatter is that of all."""

    mean: Array
    """(n, k) of the others"""
    covariance: Array
    """(n, k, k) of that"""


def left_out(score: Array, information: Array, scatter: Array) -> LeftOut:
    """The mean of all tools but one, for each."""
    weight, weighted = _weights(score, information, scatter)
    covariance = np.linalg.pinv(weight.sum(axis=0) - weight, hermitian=True)
    return LeftOut(np.einsum("nij,nj->ni", covariance, weighted.sum(axis=0) - weighted), covariance)


def conspicuous(score: Array, information: Array) -> NDArray[np.intp]:
    """Tools that lie so far from the median of the others that they are worth a test."""
    estimate, variance = marginal(score, information)
    found = np.zeros(len(score), dtype=bool)
    for p in range(score.shape[1]):
        finite = np.isfinite(variance[:, p])
        if np.sum(finite) < 2:
            continue
        away = np.abs(estimate[:, p] - np.median(estimate[finite, p]))
        # half of all lie within it: 1.48 times that is a standard deviation that outliers do not widen
        spread = 1.48 * float(np.median(away[finite]))
        found |= finite & (
            away > POOLING.conspicuous * np.maximum(spread, np.sqrt(np.where(finite, variance[:, p], 0)))
        )
    return np.flatnonzero(found)


def outlying(score: Array, information: Array, i: int) -> float:
    """p of tool i being of the others' kind, its amplitudes (k,) against what the other tools predict of them.

    The mean and the scatter are those of the others, so that a tool that stands out does not widen its own measure.
    """
    others = np.arange(len(score)) != i
    rest = pool(score[others], information[others])
    estimate, variance = marginal(score[i : i + 1], information[i : i + 1])
    shown = np.flatnonzero(np.isfinite(variance[0]))
    if not shown.size:
        return 1.0
    block = np.linalg.inv(information[i][np.ix_(shown, shown)])
    spread = block + np.diag(rest.scatter[shown] ** 2) + rest.covariance[np.ix_(shown, shown)]
    away = estimate[0, shown] - rest.mean[shown]
    square = float(away @ np.linalg.solve(spread, away)) / shown.size
    return float(fdtrc(shown.size, max(1, rest.tools - 1), square))

"""A Fourier series where part of the turn is not covered: no order is chosen, every harmonic is held small instead.

The k-th harmonic has the prior N(0, (s / k^2)^2) on its sine and on its cosine, up to an order K; the constant, the
rate terms and the first two harmonics get a prior as wide as the data themselves. Neither s, K nor the noise sigma is
believed: each is tried on a grid, and the curves are averaged, each by how probable it makes the data (the evidence)
and by how probable it was before: a half-Cauchy for s (Gelman 2006: flat near zero, of the size of the data), every
order K from half of the largest on alike - a lower one would assert that nothing is above it, which nobody saw. The
covariance holds the spread, so that it tells how far the curve may be off in the gap.

With the triangle R of the rows, z = Q'y and S the standard deviations of the prior, z ~ N(0, R S S R' + sigma^2 I). Of
R S = U diag(r) V' are made evidence and posterior of every sigma at once:

    mean = S V r / (r^2 + sigma^2) U'z,      covariance = S V sigma^2 / (r^2 + sigma^2) V' S

Outliers are held down by Huber's weights, found at the most probable s, K and sigma. They begin at 2.5 standard
deviations: the evidence takes what is left for normal noise, and a row matters more where others are missing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.rotation.bases import combined, gram, projected, triangle_of

_SIZES = np.geomspace(1e-3, 4.0, 13)
"""sizes s that are tried, in units of the data's own size"""
_NOISES = np.geomspace(1.0 / 3.0, 3.0, 9)
"""noises that are tried, in units of what least squares leave"""
_LEAST_NOISE = 1e-5
"""in units of the data's size; below it nothing changes in a gap"""
_NO_WEIGHT = 1e-6
_BOUND = 2.5
_ROUNDS = 20
_CONVERGED = 1e-2
"""largest change of a weight"""


class Bridged(NamedTuple):
    """Parameters (P,) with covariance, Huber's weight of each row (N,), and how many parameters the rows determined."""

    parameters: Array
    covariance: Array
    weight: Array
    determined: float


class _GridPoint(NamedTuple):
    """One order and size: how probable with each noise, and what the posteriors are made of."""

    evidence: Array
    """log, by noise"""
    prior: Array
    """standard deviations S, (q,)"""
    reach: Array
    """S V, (q, q)"""
    r: Array
    """(q,)"""
    observed: Array
    """U'z, (q,)"""

    def mean(self, noise: float) -> Array:
        return np.asarray(self.reach @ (self.observed * self.r / (self.r**2 + noise**2)))

    def covariance(self, noise: float) -> Array:
        return np.asarray((self.reach * (noise**2 / (self.r**2 + noise**2))) @ self.reach.T)

    def determined(self, noise: float) -> float:
        return float(np.sum(self.r**2 / (self.r**2 + noise**2)))


def bridged(rows: Array, error: Array, extra: int, first: tuple[Array, float] | None) -> Bridged:
    """Fit `error` (N,) on `rows` (P, N): the constant, `extra` rate terms, then sine and cosine of each harmonic.

    `first`: residuals (N,) and noise of a fit from which the weights begin; None: every row counts in full.
    """
    weight = np.ones(error.size) if first is None else _weights(first[0], _BOUND * first[1])
    if first is not None:
        # one order and a few sizes are enough to know which rows lie off
        order = (rows.shape[0] - 1 - extra) // 2
        tried, noises = _grid(rows, error, weight, extra, least_order=order, sizes=_SIZES[::3])
        best = max(tried, key=lambda one: float(one.evidence.max()))
        noise = float(noises[np.argmax(best.evidence)])
        weight = _held_down(rows[: best.prior.size], error, weight, best.prior, noise)
    tried, noises = _grid(rows, error, weight, extra)
    evidence = np.stack([one.evidence for one in tried])
    share = np.exp(evidence - evidence.max())
    share[share < _NO_WEIGHT] = 0.0
    share /= share.sum()
    chosen = [(tried[i], float(noises[j]), float(share[i, j])) for i, j in zip(*np.nonzero(share), strict=True)]
    mean = np.zeros(rows.shape[0])
    for one, noise, counts in chosen:
        mean[: one.prior.size] += counts * one.mean(noise)
    covariance = np.zeros((mean.size, mean.size))
    for one, noise, counts in chosen:
        q = one.prior.size
        off = -mean
        off[:q] += one.mean(noise)
        covariance += counts * np.outer(off, off)
        covariance[:q, :q] += counts * one.covariance(noise)
    determined = sum(counts * one.determined(noise) for one, noise, counts in chosen)
    return Bridged(mean, covariance, weight, determined)


def _grid(
    rows: Array, error: Array, weight: Array, extra: int, *, least_order: int = 0, sizes: Array = _SIZES
) -> tuple[list[_GridPoint], Array]:
    """Every order from `least_order` on and size, and the noises (standard deviations) of their evidences."""
    p, n = rows.shape
    root = np.sqrt(weight)
    triangle = triangle_of(rows * root, error * root)
    R, z, rest = triangle[:p, :p], triangle[:p, p], float(triangle[p, p] ** 2)
    size = float(np.std(error)) + abs(float(np.mean(error)))
    # squares of it must not vanish
    size = max(size, 1e-100)
    noises = max(np.sqrt(rest / max(1, n - p)), _LEAST_NOISE * size) * _NOISES
    order = (p - 1 - extra) // 2
    harmonic = np.repeat(np.arange(1, order + 1), 2)
    tried: list[_GridPoint] = []
    for top in range(max((order + 1) // 2, least_order), order + 1):
        q = 2 * top + 1 + extra
        k = harmonic[: 2 * top]
        prior = np.full((sizes.size, q), 10.0 * size)
        prior[:, 1 + extra :] = np.where(k <= 2, 2.0 * size / k**2, size * sizes[:, None] / k**2)
        U, r, V = np.linalg.svd(R[:q, :q] * prior[:, None, :])
        observed = np.einsum("sij,i->sj", U, z[:q])
        reach = prior[:, :, None] * V.transpose(0, 2, 1)
        # rows that the orders above would have explained hold noise alone
        left = rest + float(z[q:] @ z[q:])
        total = r[:, None, :] ** 2 + noises[:, None] ** 2
        evidence = -0.5 * np.sum(observed[:, None, :] ** 2 / total + np.log(total), axis=2)
        evidence -= 0.5 * left / noises**2 + (n - q) * np.log(noises)
        # the half-Cauchy on a grid of equal ratios
        evidence += np.log(sizes / (1.0 + sizes**2))[:, None]
        tried += [_GridPoint(*one) for one in zip(evidence, prior, reach, r, observed, strict=True)]
    return tried, np.asarray(noises)


def _held_down(rows: Array, error: Array, weight: Array, prior: Array, noise: float) -> Array:
    """Huber's weights (N,) under one prior, by rounds of weighted posterior means."""
    own = rows * prior[:, None]
    for _ in range(_ROUNDS):
        # a weight needs no more digits than the normal equations keep
        inner = gram(own * np.sqrt(weight)) / noise**2
        right = projected(own, weight * error) / noise**2
        solved = np.asarray(np.linalg.solve(inner + np.eye(prior.size), right), dtype=float)
        residual = error - combined(solved, own)
        values = np.linalg.eigvalsh(inner)
        determined = float(np.sum(values / (1.0 + values)))
        middle = 1.482602218505602 * float(np.median(np.abs(residual)))
        noise = max(middle * np.sqrt(error.size / max(1.0, error.size - determined)), noise / 3.0)
        before, weight = weight, _weights(residual, _BOUND * noise)
        if float(np.abs(weight - before).max()) < _CONVERGED:
            break
    return weight


def _weights(residual: Array, limit: float) -> Array:
    """1 within the limit, falling as 1 / |residual| beyond it."""
    return limit / np.maximum(np.abs(residual), limit)

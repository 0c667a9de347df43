"""Linear algebra of the diagnosis: spaces spanned by columns, and the score test of many candidates for one residual.

Vectors are rows here: a set of P columns over N readings is (P, N), whitened (unit noise). A *space* is an orthonormal
(r, N). All tests are of what lies outside of the space already explained.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import REGRESSION


def flattened(columns: Array) -> Array:
    """(P, C n) of columns (P, C, n), of which there may be none: what is free may be nothing."""
    return columns.reshape(len(columns), math.prod(columns.shape[1:]))


def span(columns: Array, tolerance: float = REGRESSION.independent) -> Array:
    """Orthonormal basis (r, N) of columns (P, N); what depends on others to within `tolerance` is dropped."""
    norm = np.linalg.norm(columns, axis=1)
    kept = columns[norm > 0] / norm[norm > 0][:, None]
    if kept.shape[0] == 0:
        return np.empty((0, columns.shape[1]))
    values, vectors = np.linalg.eigh(kept @ kept.T)
    good = values > tolerance**2 * values[-1] + 1e-12
    basis = (vectors[:, good] / np.sqrt(values[good])).T @ kept
    # once more against rounding: the Gram matrix has the square of the condition number
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(basis @ basis.T)) @ basis)
    except np.linalg.LinAlgError:
        # of very many columns rounding may leave two that are nearly the same
        return np.asarray(np.linalg.qr(basis.T)[0].T)


def projected(rows: Array, target: Array, tolerance: float | None = None) -> Array:
    """(N,) what rows (k, N) take of a target (N,) by least squares; of singular values below `tolerance` times the
    largest nothing, by default those that are rounding."""
    return (
        np.asarray(np.linalg.lstsq(rows.T, target, rcond=tolerance)[0] @ rows) if len(rows) else np.zeros(target.size)
    )


def outside(space: Array, columns: Array) -> Array:
    """What of the columns (..., N) lies outside of a space (r, N)."""
    return columns - (columns @ space.T) @ space


@dataclass(frozen=True, slots=True)
class Score:
    """How well one variant of a candidate explains a residual: gain of chi-square and the directions used."""

    gain: float
    dof: int


class ScoreTest:
    """All variants of all candidates, whitened and normalised once, to be run against residuals of growing models.

    `blocks` are the whitened columns (k, N) of each variant.
    """

    def __init__(self, blocks: Sequence[Array]) -> None:
        self._groups: list[tuple[NDArray[np.intp], Array, Array]] = []
        """of each number of columns the variants, their columns (V, k, N) and inner products (V, k, k) of these"""
        self.count = len(blocks)
        sizes = np.array([len(block) for block in blocks], dtype=int)
        for size in np.unique(sizes):
            group = np.flatnonzero(sizes == size)
            stacked = np.stack([blocks[int(i)] for i in group])
            norm = np.linalg.norm(stacked, axis=2, keepdims=True)
            stacked /= np.where(norm > 0, norm, 1.0)
            self._groups.append((group, stacked, stacked @ stacked.transpose(0, 2, 1)))

    def run(self, space: Array, residuals: Array) -> tuple[Array, NDArray[np.intp]]:
        """Gains (variants, B) of chi-square for residuals (B, N) outside of `space`; directions used (variants,)."""
        left = outside(space, residuals)
        gains = np.zeros((self.count, left.shape[0]))
        dof = np.zeros(self.count, dtype=np.intp)
        for group, stacked, whole in self._groups:
            # all variants in one product of matrices: a processor is slow at many small ones
            flat, (count, size) = stacked.reshape(-1, left.shape[1]), whole.shape[:2]
            within = (flat @ space.T).reshape(count, size, -1)
            values, vectors = np.linalg.eigh(whole - within @ within.transpose(0, 2, 1))
            good = values > REGRESSION.visible**2
            inverse = np.where(good, 1.0 / np.sqrt(np.where(good, values, 1.0)), 0.0)
            projected = inverse[:, :, None] * (vectors.transpose(0, 2, 1) @ (flat @ left.T).reshape(count, size, -1))
            gains[group] = np.sum(projected**2, axis=1)
            dof[group] = good.sum(axis=1)
        return gains, dof


def log10_p(gain: Array, dof: Array | NDArray[np.intp], freedom: Array | float, tries: Array | float = 1.0) -> Array:
    """-log10 of the F test's p-value for a gain of chi-square with `dof` directions against unit noise.

    The noise is known to `freedom` degrees of freedom, which may be infinite (chi squared); `tries` shapes were
    searched (Sidak). There is no largest one: of two effects that are certain the better one is still known.
    """
    from highside.diagnosis.core.probability import log10_f_beyond
    from highside.special import chdtrc, fdtrc

    k, above = np.maximum(dof, 1), np.maximum(gain, 0.0)
    known = np.isinf(freedom)
    p = np.where(known, chdtrc(k, above), fdtrc(k, np.where(known, 1.0, freedom), above / k))
    p = np.where(dof > 0, p, 1.0)
    rare = p < REGRESSION.by_logarithm
    p = -np.expm1(np.asarray(tries) * np.log1p(-np.minimum(p, 1 - 1e-12)))
    found = np.asarray(-np.log10(np.maximum(p, REGRESSION.by_logarithm)), dtype=float)
    if np.any(rare):
        one, of, known, searched = (a[rare] for a in np.broadcast_arrays(above, k, freedom, tries, rare)[:4])
        found = np.broadcast_to(found, rare.shape).copy()
        found[rare] = -log10_f_beyond(one, of, known) - np.log10(searched)
    return found


def p_of(log_p: float) -> float:
    """The probability of a -log10 p: not 0, which would say that it cannot be."""
    return float(max(10.0**-log_p, REGRESSION.rarest))


def solved(inner: Array, right: Array) -> Array:
    """Least-squares solution of a singular normal equation, columns scaled to one size."""
    if not inner.size:
        return right
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    values, vectors = np.linalg.eigh(inner / scale[:, None] / scale[None, :])
    good = values > 1e-9 * max(float(values[-1]), 1e-300)
    part = vectors[:, good]
    scaled = (right.T / scale).T
    return np.asarray(((part / values[good]) @ (part.T @ scaled)).T / scale).T

"""Stated covariance where the variances behind it are themselves estimates: Student's intervals, in three dimensions.

The error of a corrected vector has the variance `V = Vc + Vr`: that of the calibration, and the rest (the reading's own
noise among it). The calibration's rests on variance components that the session only estimates. In one dimension, with
`Var(v)` the variance of the estimated variance v, a sum has `f = 2 V^2 / Var(v)` effective degrees of freedom
(Satterthwaite, Biometrics Bulletin 2, 1946, 110; Welch, Biometrika 34, 1947, 28), and the quantile of Student's
distribution is that of the normal one times `1 + (z^2 + 1) / (4 f)`. So

    stated variance = V + (z^2 + 1) / 4 Var(v) / V,

and the widening fades as the reading's noise, which is known, outweighs the calibration. The factor is that for
z = 1.96, so that intervals of 1.96 stated standard deviations hold 95 %.

A calibration carries two matrices: the covariance `Phi` of its parameters, and the widening of `Phi` alone,
`S = (z^2 + 1) / 4 sum W_kl (d_k Phi) Phi^-1 (d_l Phi)`. Both carried to the vector, the widening of a sum is
`(S V^-1 Vc + Vc V^-1 S) / 2`: S where there is nothing but the calibration, `S Vc / V` in one dimension. It may have a
negative eigenvalue, relative to V of at most an eighth of the largest of S relative to Vc: V with it remains a
covariance.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from highside.arrays import Array

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Row and column of the six elements of a covariance."""

QUANTILE = 1.96
_FACTOR = (QUANTILE**2 + 1.0) / 4.0

Element = TypeVar("Element", float, Array)
Six = tuple[Element, Element, Element, Element, Element, Element]


def widened(covariance: Array, W: Array, moved: Array, changes: Array) -> tuple[Array, Array]:
    """Covariance (P, P) of parameters whose estimate rests on K other estimates with covariance `W` (K, K), and its
    widening `S` (P, P).

    `moved` (P, K): derivatives of the parameters by the K others: the solution moves with the weights (Kackar and
    Harville, J. Am. Stat. Assoc. 79, 1984, 853). `changes` (K, P, P): those of `covariance`.
    """
    slopes = np.linalg.inv(np.linalg.cholesky(covariance)) @ changes
    flat = slopes.reshape(-1, covariance.shape[0])
    mixed = (W @ slopes.reshape(len(W), -1)).reshape(flat.shape)
    return np.asarray(covariance + moved @ W @ moved.T), np.asarray(_FACTOR * flat.T @ mixed)


def widening(alone: Six[Element], calibration: Six[Element], total: Six[Element]) -> Six[Element]:
    """`(S V^-1 Vc + Vc V^-1 S) / 2` of symmetric matrices given by their six elements, floats or arrays (N,).

    `alone`: S, `calibration`: Vc, `total`: V, regular.
    """
    s0, s1, s2, s3, s4, s5 = alone
    c0, c1, c2, c3, c4, c5 = calibration
    v0, v1, v2, v3, v4, v5 = total
    # V^-1 by cofactors
    m0, m1, m2 = v3 * v5 - v4 * v4, v2 * v4 - v1 * v5, v1 * v4 - v2 * v3
    m3, m4, m5 = v0 * v5 - v2 * v2, v1 * v2 - v0 * v4, v0 * v3 - v1 * v1
    scale = 0.5 / (v0 * m0 + v1 * m1 + v2 * m2)
    # V^-1 Vc, row by row
    p00, p01, p02 = m0 * c0 + m1 * c1 + m2 * c2, m0 * c1 + m1 * c3 + m2 * c4, m0 * c2 + m1 * c4 + m2 * c5
    p10, p11, p12 = m1 * c0 + m3 * c1 + m4 * c2, m1 * c1 + m3 * c3 + m4 * c4, m1 * c2 + m3 * c4 + m4 * c5
    p20, p21, p22 = m2 * c0 + m4 * c1 + m5 * c2, m2 * c1 + m4 * c3 + m5 * c4, m2 * c2 + m4 * c4 + m5 * c5
    return (
        2.0 * scale * (s0 * p00 + s1 * p10 + s2 * p20),
        scale * (s0 * p01 + s1 * p11 + s2 * p21 + s1 * p00 + s3 * p10 + s4 * p20),
        scale * (s0 * p02 + s1 * p12 + s2 * p22 + s2 * p00 + s4 * p10 + s5 * p20),
        2.0 * scale * (s1 * p01 + s3 * p11 + s4 * p21),
        scale * (s1 * p02 + s3 * p12 + s4 * p22 + s2 * p01 + s4 * p11 + s5 * p21),
        2.0 * scale * (s2 * p02 + s4 * p12 + s5 * p22),
    )


def widening_block(alone: Array, calibration: Array, total: Array) -> Array:
    """`widening` of arrays (6, N)."""
    s, c, v = ((m[0], m[1], m[2], m[3], m[4], m[5]) for m in (alone, calibration, total))
    return np.stack(widening(s, c, v))


def six_of(matrices: Array) -> Six[Array]:
    """The six elements, (N,) each, of symmetric matrices (N, 3, 3)."""
    xx, xy, xz, yy, yz, zz = (matrices[:, i, j] for i, j in UPPER)
    return xx, xy, xz, yy, yz, zz


def with_widening(covariance: Array, alone: Array | None, rest: Array | float = 0.0) -> Array:
    """Stated covariance (N, 3, 3) of vectors: `covariance` by the calibration and `rest` by all else, with the widening
    of their sum, where `alone` (N, 3, 3; None: nothing is estimated) is that of the calibration without the rest."""
    total = covariance + rest
    if alone is None:
        return np.asarray(total)
    out = np.array(total)
    for (i, j), more in zip(UPPER, widening(six_of(alone), six_of(covariance), six_of(total)), strict=True):
        out[:, i, j] += more
        if i != j:
            out[:, j, i] += more
    return out

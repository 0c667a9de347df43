"""Columns of the linear fits, as rows of a matrix (P, N), and their conditioning.

Fourier: 1, sin t, cos t, sin 2t, cos 2t, ... Well conditioned on a whole turn (1.41).
Chebyshev: T_0 .. T_9 of x = t / pi - 1 for t wrapped to [0, 2 pi): the same polynomials as powers of t, of which the
ninth power in radians has a condition of 2e9 and in degrees 5e23, beyond what double precision can solve.
Rate: u, u^2 of the standardised rotor rate u = (rate - centre) / spread.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import wrap_positive

_BLOCK_ROWS = 256
_GRAM_COLUMNS = 128


def fourier_rows(theta_rad: Array, order: int) -> Array:
    """(2 order + 1, N): 1, sin t, cos t, ..., sin(order t), cos(order t)."""
    rows = np.empty((2 * order + 1, theta_rad.size))
    rows[0] = 1.0
    if order == 0:
        return rows
    s1, c1 = rows[1], rows[2]
    np.sin(theta_rad, out=s1)
    np.cos(theta_rad, out=c1)
    twice = 2.0 * c1
    for k in range(2, order + 1):
        # sin(kt) = 2 cos t sin((k-1)t) - sin((k-2)t), and so for the cosine: rounding grows with k only
        s, c = rows[2 * k - 1], rows[2 * k]
        np.multiply(twice, rows[2 * k - 3], out=s)
        np.multiply(twice, rows[2 * k - 2], out=c)
        if k > 2:
            s -= rows[2 * k - 5]
            c -= rows[2 * k - 4]
        else:
            c -= 1.0
    return rows


def fourier_sum(theta_rad: Array, coefficients: Array) -> Array:
    """R0 + sum a_k sin kt + b_k cos kt for coefficients (R0, a1, b1, a2, b2, ...): (N,), by Horner's rule in e^(it).

    a sin kt + b cos kt is the real part of (b - i a) e^(ikt).
    """
    order = (coefficients.size - 1) // 2
    result = np.full(theta_rad.shape, coefficients[0])
    if order == 0:
        return result
    complex_coefficients = coefficients[2::2] - 1j * coefficients[1::2]
    z = np.empty(theta_rad.shape, dtype=complex)
    np.cos(theta_rad, out=z.real)
    np.sin(theta_rad, out=z.imag)
    total = complex_coefficients[-1] * z
    for k in range(order - 2, -1, -1):
        total += complex_coefficients[k]
        total *= z
    result += total.real
    return result


def scaled_angle(theta_rad: Array) -> Array:
    """x = t / pi - 1 in [-1, 1) of the wrapped angle: a polynomial knows nothing of periods."""
    return wrap_positive(theta_rad) / np.pi - 1.0


def chebyshev_rows(theta_rad: Array, degree: int) -> Array:
    """(degree + 1, N): T_0(x) .. T_degree(x)."""
    x = scaled_angle(theta_rad)
    rows = np.empty((degree + 1, x.size))
    rows[0] = 1.0
    if degree > 0:
        rows[1] = x
    twice = 2.0 * x
    for k in range(2, degree + 1):
        np.multiply(twice, rows[k - 1], out=rows[k])
        rows[k] -= rows[k - 2]
    return rows


def triangle_of(rows: Array, last: Array) -> Array:
    """The triangle R of the QR of the columns `rows` (P, N) and, behind them, `last` (N,): (P + 1, P + 1), N > P.

    Tall matrices are taken in blocks whose triangles are then stacked and factored once more (TSQR, Demmel et al.
    2012): as accurate, three times faster because a block stays in the cache, and no threads start for it.
    """
    columns = np.vstack([rows, last]).T
    width = columns.shape[1]
    while (blocks := columns.shape[0] // _BLOCK_ROWS) and width <= _BLOCK_ROWS // 2:
        cut = blocks * _BLOCK_ROWS
        parts: Any = np.linalg.qr(columns[:cut].reshape(blocks, _BLOCK_ROWS, width), mode="r")
        columns = np.vstack([parts.reshape(-1, width), columns[cut:]])
    triangle: Any = np.linalg.qr(columns, mode="r")
    return np.asarray(triangle, dtype=float)


# Products over the rows. Written so that no threaded BLAS routine starts: matrices this narrow gain nothing from
# threads, and on a busy machine a thread that has to wait for its turn costs more than the whole fit.


def combined(weights: Array, rows: Array) -> Array:
    """sum_p weights_p rows_p: (N,)."""
    return np.asarray(np.einsum("p,pn->n", weights, rows))


def projected(rows: Array, values: Array) -> Array:
    """rows @ values: (P,)."""
    return np.asarray(np.einsum("pn,n->p", rows, values))


def gram(rows: Array) -> Array:
    """rows @ rows.T: (P, P)."""
    p, n = rows.shape
    blocks = n // _GRAM_COLUMNS
    cut = blocks * _GRAM_COLUMNS
    parts = np.ascontiguousarray(rows[:, :cut].reshape(p, blocks, _GRAM_COLUMNS).transpose(1, 0, 2))
    rest = rows[:, cut:]
    return np.asarray(np.matmul(parts, parts.transpose(0, 2, 1)).sum(axis=0) + rest @ rest.T)


@dataclass(frozen=True, slots=True)
class RateTerms:
    """How the rotor rate enters: standardised, and in which powers."""

    centre_radps: float
    spread_radps: float
    powers: tuple[int, ...]

    def rows(self, rate_radps: Array) -> Array:
        """(len(powers), N)."""
        u = (np.asarray(rate_radps, dtype=float) - self.centre_radps) / self.spread_radps
        return np.stack([u**power for power in self.powers]) if self.powers else np.empty((0, u.size))

"""Probabilities of Student's law, of chi squared and of the F law, from `scipy.special`.

They are the functions that `scipy.stats` calls for them (equal to its results to 1e-12), without the half second that
the import of that package takes before a short diagnosis. Where a probability is smaller than a double can be, its
logarithm comes from a continued fraction: findings are ranked and compared with chance by it, and of two that are
certain beyond any number one is still the better.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from highside.arrays import Array
from highside.diagnosis.core.policy import REGRESSION
from highside.special import betaln, chdtrc, fdtrc, gammaln, ndtri, stdtr, stdtrit


def student_beyond(value: Any, freedom: float) -> Any:
    """The chance of more than `value` (number or array) under Student's law."""
    return stdtr(freedom, -np.asarray(value, dtype=float))[()]


def student_quantile(chance: float, freedom: float) -> float:
    """The value below which Student's law with `freedom`, which may be infinite, stays with this chance."""
    return float(ndtri(chance) if np.isinf(freedom) else stdtrit(freedom, chance))


def chi2_beyond(value: float, freedom: int) -> float:
    """The chance of more than `value` (not negative) under chi squared."""
    return float(chdtrc(freedom, value))


def straight_line(at: Array, level: Array) -> tuple[float, float]:
    """Slope of the straight line through points (N,), N > 2, and the chance of such a one where there is none.

    Student's t of the coefficient of correlation, two-sided, as in any textbook of regression.
    """
    x, y = at - at.mean(), level - level.mean()
    across, along, up = float(x @ y), float(x @ x), float(y @ y)
    if up == 0.0:
        return 0.0, 1.0
    r = float(np.clip(across / np.sqrt(along * up), -1.0, 1.0))
    freedom = at.size - 2
    left = (1.0 - r) * (1.0 + r)
    p = 0.0 if left <= 0.0 else 2.0 * float(student_beyond(abs(r) * np.sqrt(freedom / left), freedom))
    return across / along, p


def log10_f_beyond(gain: ArrayLike, dof: ArrayLike, freedom: ArrayLike) -> Array:
    """log10 of the chance that `dof` squares of unit noise, of which the size is known to `freedom` degrees of freedom
    (infinite: chi squared), exceed `gain`; arrays are broadcast. Not above 0, and of no size too small."""
    shape = np.broadcast_shapes(np.shape(gain), np.shape(dof), np.shape(freedom))
    above, k, known = (np.broadcast_to(np.asarray(a, dtype=float), shape).ravel() for a in (gain, dof, freedom))
    endless = np.isinf(known)
    p = np.where(endless, chdtrc(k, above), fdtrc(k, np.where(endless, 1.0, known), above / k))
    found = np.log10(np.maximum(p, REGRESSION.by_logarithm))
    small, infinite = p < REGRESSION.by_logarithm, np.isinf(above)
    for law, of in ((_chi2_tail, small & endless), (_f_tail, small & ~endless)):
        where = of & ~infinite
        if np.any(where):
            found[where] = law(above[where], k[where], known[where]) / np.log(10.0)
    return np.where(infinite, -np.inf, found).reshape(shape)


def _chi2_tail(gain: Array, dof: Array, freedom: Array) -> Array:
    """ln Q(a, x) of the incomplete gamma function far out, by its continued fraction (DLMF 8.9.2)."""
    a, x = dof / 2, gain / 2

    def terms() -> Iterator[tuple[Array, Array]]:
        yield np.ones_like(x), x + 1 - a
        for m in range(1, REGRESSION.terms):
            yield -m * (m - a), x + 2 * m + 1 - a

    return np.asarray(a * np.log(x) - x - gammaln(a) + np.log(_fraction(terms())))


def _f_tail(gain: Array, dof: Array, freedom: Array) -> Array:
    """ln I_z(a, b) of the incomplete beta function at z = freedom / (freedom + gain), far out, by its continued
    fraction (DLMF 8.17.22)."""
    a, b, one = freedom / 2, dof / 2, np.ones_like(gain)
    z = freedom / (freedom + gain)

    def terms() -> Iterator[tuple[Array, Array]]:
        yield one, one
        for m in range(REGRESSION.terms // 2):
            yield -(a + m) * (a + b + m) * z / ((a + 2 * m) * (a + 2 * m + 1)), one
            n = m + 1
            yield n * (b - n) * z / ((a + 2 * n - 1) * (a + 2 * n)), one

    # ln(1 - z) of a z next to 1
    outer = -a * np.log1p(gain / freedom) + b * (np.log(gain) - np.log(freedom + gain))
    return np.asarray(outer - np.log(a) - betaln(a, b) + np.log(_fraction(terms())))


def _fraction(terms: Iterator[tuple[Array, Array]]) -> Array:
    """a1 / (b1 + a2 / (b2 + ...)) of positive value by its terms (a, b), by Lentz's method."""
    tiny = REGRESSION.rarest
    first, below = next(terms)
    value = first / below
    # ratios of successive numerators, the first of which is infinite, and of denominators
    c, d = np.full_like(value, np.inf), 1.0 / below
    for a, b in terms:
        d = b + a * d
        d = 1.0 / np.where(np.abs(d) < tiny, tiny, d)
        c = b + a / c
        c = np.where(np.abs(c) < tiny, tiny, c)
        step = c * d
        value = value * step
        if np.all(np.abs(step - 1.0) < REGRESSION.settled):
            break
    return np.asarray(value)

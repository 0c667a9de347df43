"""Probabilities of Student's law and of chi squared, from `scipy.special`.

They are the functions that `scipy.stats` calls for them (equal to its results to 1e-12), without the half second that
the import of that package takes before a short diagnosis.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri, stdtr, stdtrit

from highside.arrays import Array


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

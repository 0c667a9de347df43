"""Weights of rows, in the memory or made run by run."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rows.session import RotationSession
from highside.long_arrays import by_runs


def constant_weight(session: RotationSession, value: float) -> Array:
    """(N,) one value."""
    return by_runs(session.readings, (session.n,), lambda part: np.full(part.stop - part.start, value))


def without_rows(weight: Array, rows: NDArray[np.intp]) -> Array:
    """A weight (N,) that is 0 at rising rows."""

    def of(part: slice) -> Array:
        own = np.array(weight[part])
        low, high = np.searchsorted(rows, [part.start, part.stop])
        own[rows[low:high] - part.start] = 0.0
        return own

    return by_runs(weight, weight.shape, of)

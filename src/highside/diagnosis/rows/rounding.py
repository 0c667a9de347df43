"""What readings are taken to be exact to."""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.long_arrays import by_runs, mean_square


def rounding(readings: Array, residual: Array, seed: int) -> Array:
    """(C, n) noise of the size to which readings, and what a base fit leaves of them, are taken to be exact.

    A simulation without noise has none, and then what effects do beyond first order would be all that is observed.
    """
    of_readings, of_residual = (np.sqrt(mean_square(x)) for x in (readings, residual))
    size = np.maximum(ROW_NOISE.rounding * of_readings, ROW_NOISE.digits * of_residual)

    def of(part: slice) -> Array:
        # each stretch has draws of its own, so that any can be made again without those before
        drawn = []
        for number in range(part.start // ROW_NOISE.stretch, (part.stop - 1) // ROW_NOISE.stretch + 1):
            first = number * ROW_NOISE.stretch
            count = min(ROW_NOISE.stretch, readings.shape[1] - first)
            draws = np.random.default_rng([seed, number] if number else seed).standard_normal((len(readings), count))
            drawn.append(draws[:, max(part.start - first, 0) : part.stop - first])
        return np.asarray(size * np.concatenate(drawn, axis=1))

    return by_runs(readings, readings.shape, of)

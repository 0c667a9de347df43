"""Held-out misfit of a rotation in means: stretch by stretch, sector by sector of the toolface.

Single rows are mostly noise, in which a misfit that is beyond doubt is a hundredth of the mean square. Means over the
sectors of a turn, as over the readings of a pose, show it. A stretch is predicted from the others; a line that does not
turn with the tool is averaged over its own phase. What a complete simulation would leave is not the noise alone: it too
is fitted to the other stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.gram import SECTORS, Gram, HeldOutRows, solved

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class MeanErrors:
    """Squared errors of means in units of their noise, by stretches (F,): found, expected where nothing is missing,
    and how many means there are; `rows` of a mean, on average."""

    energy: Array
    expected: Array
    count: Array
    rows: float


def mean_errors(held: HeldOutRows, grams: Sequence[Gram], numbers: Ints, ways: Sequence[int]) -> MeanErrors:
    """Of columns (K,) fitted beside the base; `ways` of averaging: 0 by the toolface, k by the phase of line k - 1."""
    every = np.concatenate([held.base, numbers])
    total = held.inner(every, [held.keys, *(left_out for left_out, _ in held.folds)])
    energy, expected, count = (np.zeros(len(held.folds)) for _ in range(3))
    rows = 0.0
    for k, left_out in enumerate(total[1:]):
        rest = total[0] - left_out
        values = solved(rest[:-1, :-1], rest[:-1, -1])
        own = slice(k * SECTORS, (k + 1) * SECTORS)
        spread = solved(rest[:-1, :-1], np.eye(every.size))
        for c, gram in enumerate(grams):
            functions = held.where[every, c]
            shows = np.flatnonzero((functions >= 0) & (every >= 0))
            for way in ways:
                held_rows = gram.cell_rows[way][own]
                used = held_rows > 0
                sums = gram.cells[way][:, own][:, used]
                columns = sums[functions[shows]]
                error = sums[-1] - values[shows] @ columns
                doubt = np.sum(columns * (spread[np.ix_(shows, shows)] @ columns), axis=0)
                energy[k] += float(np.sum(error**2 / held_rows[used]))
                expected[k] += float(np.sum(1.0 + doubt / held_rows[used]))
                count[k] += float(used.sum())
                rows += float(held_rows.sum())
    return MeanErrors(energy, expected, count, rows / max(float(count.sum()), 1.0))

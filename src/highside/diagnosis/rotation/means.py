"""Held-out misfit of a rotation in means: stretch by stretch, sector by sector of the toolface.

Single rows are mostly noise, in which a misfit that is beyond doubt is a hundredth of the mean square. Means over the
sectors of a turn, as over the readings of a pose, show it. A stretch is predicted from the others; a line that does not
turn with the tool is averaged over its own phase. What a complete simulation would leave is not the noise alone: it too
is fitted to the other stretches.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.chunks import chunks_of, of_runs
from highside.diagnosis.core.regression import solved
from highside.diagnosis.rotation.policy import MEANS
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import HeldOutRows
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.policy import GRAMS
from highside.diagnosis.rows.segments import Segments

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Sectors:
    """Sums of whitened functions over cells: the sectors of a turn, fold by fold."""

    functions: list[Ints]
    """(k,) numbers of those of each channel, ascending"""
    sums: list[Array]
    """(k + 1, ways, folds x sectors) on each channel, the residual last"""
    rows: list[Array]
    """(ways, folds x sectors) rows of each cell that count"""

    @classmethod
    def of(
        cls,
        design: Design,
        noise: RotationNoise,
        residual: Array,
        segments: Segments,
        numbers: Ints,
        ways: Sequence[int],
    ) -> Sectors:
        """Of columns (K,) and the residual (C, N), in one pass; `ways` of averaging: 0 by the toolface, k by the phase
        of line k - 1."""
        turns = design.turns()
        where = design.where[numbers[numbers >= 0]]
        functions = [np.unique(own[own >= 0]) for own in where.T]
        sums = [np.zeros((own.size + 1, len(ways), GRAMS.folds * MEANS.sectors)) for own in functions]
        rows = [np.zeros((len(ways), GRAMS.folds * MEANS.sectors)) for _ in functions]

        def cells(part: slice) -> Iterator[Ints]:
            for way in ways:
                sector = np.minimum((turns[way][part] % 1.0 * MEANS.sectors).astype(np.intp), MEANS.sectors - 1)
                yield np.where(segments.core[part], segments.fold[part] * MEANS.sectors + sector, -1)

        def over(part: slice) -> list[tuple[int, list[Array]]]:
            led = slice(max(0, part.start - noise.lead), part.stop)
            made = design.functions(led, residual, functions)
            white = [noise.whiten(c, each, part) for c, each in enumerate(made)]
            found = []
            for cell in cells(part):
                scored = cell[cell >= 0]
                low, stop = (int(scored.min()), int(scored.max()) + 1) if scored.size else (0, 0)
                belongs = (cell[:, None] == np.arange(low, stop)).astype(float)
                counted = [(noise.weight[c, part] > 0) @ belongs for c in range(len(white))]
                found.append((low, [np.vstack([w @ belongs, n]) for w, n in zip(white, counted, strict=True)]))
            return found

        for found in of_runs(over, chunks_of(residual.shape[1])):
            for way, (low, channels) in enumerate(found):
                for c, both in enumerate(channels):
                    own = slice(low, low + both.shape[1])
                    sums[c][:, way, own] += both[:-1]
                    rows[c][way, own] += both[-1]
        return cls(functions, sums, rows)


@dataclass(frozen=True)
class MeanErrors:
    """Squared errors of means in units of their noise, by stretches (F,): found, expected where nothing is missing,
    and how many means there are; `rows` of a mean, on average."""

    energy: Array
    expected: Array
    count: Array
    rows: float


def mean_errors(held: HeldOutRows, sectors: Sectors, numbers: Ints) -> MeanErrors:
    """Of columns (K,), which `sectors` has, fitted beside the base."""
    every = np.concatenate([held.base, numbers])
    total = held.inner(every, [held.keys, *(held_out for held_out, _ in held.folds)])
    energy, expected, count = (np.zeros(len(held.folds)) for _ in range(3))
    rows = 0.0
    for k, held_out in enumerate(total[1:]):
        rest = total[0] - held_out
        values = solved(rest[:-1, :-1], rest[:-1, -1])
        own = slice(k * MEANS.sectors, (k + 1) * MEANS.sectors)
        spread = solved(rest[:-1, :-1], np.eye(every.size))
        for c, functions in enumerate(sectors.functions):
            wanted = np.where(every >= 0, held.where[every, c], -1)
            shows = np.flatnonzero(wanted >= 0)
            place = np.searchsorted(functions, wanted[shows])
            for sums, counted in zip(sectors.sums[c].transpose(1, 0, 2), sectors.rows[c], strict=True):
                held_rows = counted[own]
                used = held_rows > 0
                columns = sums[place][:, own][:, used]
                error = sums[-1, own][used] - values[shows] @ columns
                doubt = np.sum(columns * (spread[np.ix_(shows, shows)] @ columns), axis=0)
                energy[k] += float(np.sum(error**2 / held_rows[used]))
                expected[k] += float(np.sum(1.0 + doubt / held_rows[used]))
                count[k] += float(used.sum())
                rows += float(held_rows.sum())
    return MeanErrors(energy, expected, count, rows / max(float(count.sum()), 1.0))

"""How the rows of a recording are divided: folds that are left out, steady rates, blocks, stretches."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.policy import GRAMS
from highside.diagnosis.rows.session import RotationSession
from highside.long_arrays import by_runs, runs_of

Ints = NDArray[np.intp]

Key = tuple[int, int, bool]
"""of a part of the rows: fold, steady rate (-1: none), whether it is scored in its fold"""


def block_seconds(session: RotationSession) -> float:
    """Length of the blocks by whose means a noise with memory is observed."""
    return max(session.shortest_block_s, session.n * session.step_s / GRAMS.max_blocks)


@dataclass(frozen=True)
class Segments:
    """To which fold, steady rate (-1: none) and block a row belongs, and whether it is scored in its fold."""

    fold: Ints
    rate: Ints
    core: NDArray[np.bool_]
    block: Ints
    flip: Ints
    at: Array
    """(blocks,) middle of each block, in steps"""
    starts: Ints
    """(blocks + 1,) first row of each block, and how many rows there are"""

    @classmethod
    def of(cls, design: Design, lead: int) -> Segments:
        """The rows at a fold's ends are trained on by nobody else, and not scored: their noise is serially
        correlated."""
        session = design.session
        n = session.n
        gap = lead + round(1.0 / session.step_s)
        borders = -(-np.arange(GRAMS.folds + 1) * n // GRAMS.folds)

        def fold(part: slice) -> Ints:
            return np.arange(part.start, part.stop) * GRAMS.folds // n

        def core(part: slice) -> NDArray[np.bool_]:
            rows, own = np.arange(part.start, part.stop), fold(part)
            edge = np.minimum(rows - borders[own], borders[own + 1] - 1 - rows)
            return np.asarray(
                (edge >= gap)
                | (own == 0) & (rows < borders[1] - gap)
                | (own == GRAMS.folds - 1) & (rows >= borders[-2] + gap)
            )

        block = _Stretches.of(session, block_seconds(session))
        flip = _Stretches.of(session, GRAMS.flip_s)
        rows = session.places
        return cls(
            by_runs(rows, (n,), fold),
            session.rate_group,
            by_runs(rows, (n,), core),
            by_runs(rows, (n,), block.number),
            by_runs(rows, (n,), flip.number),
            block.sums / np.diff(block.starts) + 0.5,
            block.starts,
        )

    @property
    def of_blocks(self) -> list[Key]:
        """The part that the middle row of each block is of."""
        middle = (self.starts[:-1] + self.starts[1:]) // 2
        return [(int(self.fold[row]), int(self.rate[row]), bool(self.core[row])) for row in middle]


@dataclass(frozen=True)
class _Stretches:
    """Equally long stretches of time; one that lost all of its rows is none."""

    session: RotationSession
    seconds: float
    starts: Ints
    """(stretches + 1,) first row of each, and how many rows there are"""
    sums: Array
    """(stretches,) of the places of their rows"""

    @classmethod
    def of(cls, session: RotationSession, seconds: float) -> _Stretches:
        """Found run by run."""
        starts: list[int] = []
        sums: list[float] = []
        last = None
        for part in runs_of(session.n):
            places = session.places[part]
            values = (places * session.step_s / seconds).astype(np.intp)
            for start, stop in equal_runs(values):
                if values[start] != last:
                    starts.append(part.start + start)
                    sums.append(0.0)
                    last = values[start]
                sums[-1] += float(places[start:stop].sum())
        return cls(session, seconds, np.array([*starts, session.n]), np.array(sums))

    def number(self, part: slice) -> Ints:
        """(n,) of the stretch of each row."""
        return np.searchsorted(self.starts, np.arange(part.start, part.stop), side="right") - 1


def equal_runs(values: NDArray[np.generic]) -> list[tuple[int, int]]:
    """(start, stop) of runs of equal values."""
    borders = np.flatnonzero(np.asarray(values[1:] != values[:-1])) + 1
    edges = [0, *borders.tolist(), values.shape[0]]
    return list(pairwise(edges))

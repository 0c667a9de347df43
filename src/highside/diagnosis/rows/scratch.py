"""Columns of all rows that cannot be made run by run (an effect that remembers): of many rows they lie in a file.

Thirty-four of them are tried on three channels, 270 bytes a row. Rows are read back run by run, so that nothing stays
in memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import cast

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rows.policy import DESIGN
from highside.long_arrays import runs_of
from highside.physics.memory import Carry, carried
from highside.physics.state import ChainState
from highside.scratch_arrays import filed


def kept(values: Array) -> Array:
    """A column (N,), of many rows in a file. Raises InputError where there is no room for it."""
    # a row of a larger array would keep all of it
    values = np.array(values, dtype=float)
    return values if values.size <= DESIGN.in_memory else cast(Array, filed(values))


def all_with_memory(state: ChainState, of: Callable[[ChainState], Array]) -> Array:
    """(..., N) what `of` gives for all rows of a state, made in the memory by the very runs of `rows_with_memory`.

    A lag takes the step of its rows from the first two of those that it is given at once: at late times the difference
    of two that lie close together is known to fewer digits (2e-10 of 0.02 s after 2e4 s), and a column of all rows and
    one of runs would differ by as much.
    """
    return np.concatenate(list(rows_with_memory(state, of)), axis=-1)


def rows_with_memory(state: ChainState, of: Callable[[ChainState], Array]) -> Iterator[Array]:
    """(..., n) what `of` gives for each run of the rows of a state: its memory reaches from run to run."""
    carry = Carry()
    for part in runs_of(state.n):
        # the first row of all stands before the run: effects reckon time from it
        before = 1 if part.start else 0
        rows = np.concatenate([np.zeros(before, dtype=np.intp), np.arange(part.start, part.stop)])
        with carried(carry):
            made = of(state.rows(rows))
        yield made[..., before:]

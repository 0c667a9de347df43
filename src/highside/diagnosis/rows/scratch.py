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


def rows_with_memory(state: ChainState, of: Callable[[ChainState], Array]) -> Iterator[Array]:
    """(..., n) what `of` gives for each run of the rows of a state: its memory reaches from run to run."""
    carry = Carry()
    for part in runs_of(state.n):
        # the first row of all stands before the run: effects reckon time from it
        rows = np.concatenate([[0], np.arange(part.start, part.stop)])
        with carried(carry):
            made = of(state.rows(rows))
        yield made[..., 1:]

"""A Recording of more rows than a memory should hold: its columns in scratch files, read run by run.

Only Parquet can be read by parts. Columns without a meaning, and texts, are left where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.long_arrays import concatenated
from highside.reading.row_groups import RowGroups
from highside.recording.columns import expected_in
from highside.recording.table import RECORDING_COLUMNS
from highside.scratch_arrays import ScratchColumns

MANY_ROWS = 1_500_000
"""Rows from which a recording is not read into the memory. Source: 1,000,000 take 1.2 GiB there
(tests/bench/diagnosis_memory.py)."""


@dataclass(frozen=True)
class LongRecording:
    """Columns (N,) by name, as in a `Recording`; rows that lack a value that a diagnosis needs are left out."""

    columns: dict[str, Array]
    source: str
    n: int
    lost: int = 0
    """rows that were left out"""
    lacking: tuple[str, ...] = ()
    """the columns in which they lack a value"""
    aside: tuple[str, ...] = ()
    """columns of numbers that are not used: without a meaning, or with values missing"""

    def complete(self, *names: str) -> Array:
        """The named columns as (len(names), N). Raises InputError that names those that are absent."""
        absent = [name for name in names if name not in self.columns]
        if absent:
            raise InputError(
                f"lacks the column{'s' if len(absent) > 1 else ''} {', '.join(absent)}",
                where=self.source,
                remedy=f"it has: {', '.join(self.columns)}",
            )
        return concatenated([self.columns[name][None] for name in names])


def long_recording(path: Path, needed: Sequence[str], *, at_least: int = MANY_ROWS) -> LongRecording | None:
    """The rows of a Parquet file, unless they are fewer than `at_least`; None for these, and for what is not Parquet.

    Rows that lack a value of `needed` are left out. Raises InputError for what is damaged, holds an infinite number or
    a row without its time, and where there is no room for scratch files.
    """
    groups = RowGroups.of(path)
    if groups is None or groups.rows < at_least:
        return None
    names = [name for name in groups.names if name in RECORDING_COLUMNS]
    if "t_s" not in names:
        raise InputError("lacks the column t_s", where=str(path), remedy=f"it has: {', '.join(groups.names)}")
    asked = [name for name in names if name in needed]
    into, done, lost = ScratchColumns(names), 0, 0
    lacking = dict.fromkeys(asked, False)
    for batch in groups.batches(names):
        _require_finite(batch, done, path)
        done += batch["t_s"].size
        holes = {name: np.isnan(batch[name]) for name in asked}
        whole = ~np.any(list(holes.values()), axis=0) if holes else np.ones(batch["t_s"].size, dtype=bool)
        for name, own in holes.items():
            lacking[name] |= bool(own.any())
        lost += int(np.sum(~whole))
        into.add(batch if whole.all() else {name: values[whole] for name, values in batch.items()})
    columns = {name: cast(Array, values) for name, values in into.columns().items()}
    # a column that is not needed and lacks values says nothing that can be relied on
    aside = [name for name, values in columns.items() if done > lost and np.isnan(values.min())]
    return LongRecording(
        {name: values for name, values in columns.items() if name not in aside},
        str(path),
        done - lost,
        lost,
        tuple(name for name, some in lacking.items() if some),
        (*aside, *(name for name in groups.names if name not in names)),
    )


def _require_finite(batch: dict[str, Array], first: int, path: Path) -> None:
    """As every reader of recordings does."""
    for name, values in batch.items():
        wrong = np.isinf(values) | (np.isnan(values) if name == "t_s" else False)
        if wrong.any():
            row = first + int(np.argmax(wrong))
            what = "every row needs its time" if np.isnan(values[row - first]) else "holds an infinite number"
            raise InputError(what, where=f"{path}: row {row}", field=name, remedy=f"{expected_in(name)} are expected")

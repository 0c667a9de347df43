"""Numbers that mark a missing value: -999.25 of LAS files, -9999 of loggers.

A marker stands far outside of all other values of its column; so it is told from a reading that happens to be the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.source import Numbers, SourceColumn, SourceTable

MARKERS = (-999.25, -999.0, -9999.0, -9999.25, -99999.0, -999999.0, 9999.0, 99999.0, 999999.0)
"""-999.25: CWLS, LAS 2.0 (`NULL`); the others are customs of loggers"""


def without_markers(table: SourceTable, policy: ImportPolicy = POLICY) -> SourceTable:
    """The table with a missing value wherever a marker stands, each column of them said."""
    remarks = list(table.remarks)
    columns = []
    for column in table.columns:
        marked = _marked(column, policy)
        columns.append(column if marked is None else replace(column, numbers=marked[0], integers=None))
        if marked is not None:
            remarks.append(f"{marked[2]} cells of {column.name} hold {marked[1]:g}, the mark of a missing value")
    return (
        replace(table, columns=tuple(columns), remarks=tuple(remarks)) if len(remarks) > len(table.remarks) else table
    )


def _marked(column: SourceColumn, policy: ImportPolicy) -> tuple[Numbers, float, int] | None:
    numbers = column.numbers
    if numbers is None or column.instant or numbers.size == 0:
        return None
    for marker in MARKERS:
        there = numbers == marker
        count = int(there.sum())
        if count == 0:
            continue
        others = np.abs(numbers[~there & np.isfinite(numbers)])
        if others.size and float(others.max()) * policy.marker_times < abs(marker):
            return np.where(there, np.nan, numbers), marker, count
    return None

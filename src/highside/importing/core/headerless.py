"""Columns without any name: three next to each other whose size is one g wherever they point, and the rates beside."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.importing.core.converters import sphere_of, steps_of_rates
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.source import SourceColumn, SourceTable
from highside.importing.core.vectors import acceleration_unit, turn_ratio

UNNAMED = "column "
"""as the readers call a column without a name"""


def unnamed(table: SourceTable) -> bool:
    """Whether no column has a name of its own."""
    return all(column.name.startswith(UNNAMED) for column in table.columns)


def accelerations_among(table: SourceTable, policy: ImportPolicy = POLICY) -> list[list[SourceColumn]]:
    """Each three neighbours that stay one g of a known unit while all of them turn."""
    found = []
    for columns in _threes(table):
        block = _block(columns)
        whole = bool((block == np.rint(block)).all())
        guess = acceleration_unit(block, None, whole, policy)
        if guess.open is not None or guess.unit is None:
            continue
        in_g = (block - guess.unit.zero) * guess.unit.factor
        sphere = sphere_of(in_g, policy)
        if sphere is not None and abs(sphere.counts - 1.0) <= policy.gravity_share:
            found.append(columns)
    return found


def rates_among(
    table: SourceTable, taken: set[str], gravity: NDArray[np.float64], policy: ImportPolicy = POLICY
) -> list[list[SourceColumn]]:
    """Each three neighbours that come in the steps of a gyro, or with which gravity turns."""
    rows = np.arange(table.n, dtype=np.float64)
    return [
        columns
        for columns in _threes(table)
        if not taken & {column.name for column in columns}
        and (
            steps_of_rates(_block(columns), policy) is not None
            or turn_ratio(_block(columns), gravity, rows, policy) is not None
        )
    ]


def _threes(table: SourceTable) -> list[list[SourceColumn]]:
    columns = table.columns
    threes = [list(columns[place : place + 3]) for place in range(len(columns) - 2)]
    return [three for three in threes if all(c.numbers is not None and np.isfinite(c.numbers).all() for c in three)]


def _block(columns: list[SourceColumn]) -> NDArray[np.float64]:
    return np.vstack([column.numbers for column in columns if column.numbers is not None])

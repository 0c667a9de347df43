"""Columns by name, as every table of this package has them; below what reads, shows and converts tables."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Column", "NamedColumns", "expected_in"]

Column = NDArray[np.float64]

_UNITS = {"_s": "seconds", "_dps": "degrees per second", "_deg": "degrees", "_g": "multiples of g"}
"""what a column's name ends with, and what is expected in it then"""


class NamedColumns(Protocol):
    """Columns of equal length: numbers, texts, and the order of all."""

    columns: dict[str, Column]
    texts: dict[str, tuple[str, ...]]
    order: tuple[str, ...]
    source: str | None

    @property
    def n(self) -> int:
        """Number of rows."""

    @property
    def rows_are(self) -> str:
        """What a row is, in words."""

    def has(self, *names: str) -> bool:
        """Whether all these columns are there as numbers."""

    def require(self, *names: str) -> tuple[Column, ...]:
        """The columns (N,) of these names. Raises InputError where one is absent or holds no number."""


def expected_in(name: str) -> str:
    """What a column of that name holds, in words: `seconds`, `multiples of g`, or just `numbers`."""
    return next((unit for suffix, unit in _UNITS.items() if name.endswith(suffix)), "numbers")

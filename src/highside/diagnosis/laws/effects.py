"""An effect of the library among the groups: it competes with the laws by the same evidence."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.groups import LawGroup


@dataclass(frozen=True, eq=False)
class EffectGroup(LawGroup):
    """What one unit of each amplitude does, `table` (k, C, n)."""

    table: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    unit: Array = field(default_factory=lambda: np.empty(0))
    """(amplitudes,) size of each column before; 0 for one that does not show"""

    @classmethod
    def of(cls, effect: str, columns: Array, floor: Array) -> EffectGroup:
        """From its columns (k, C, n), each brought to one size in units of the floor."""
        size = np.sqrt(np.mean((columns / floor) ** 2, axis=(1, 2), keepdims=True))
        shown = size[:, 0, 0] > 0
        scaled = columns[shown] / size[shown]
        return cls((), (), np.zeros(len(scaled)), np.empty(0), 1, effect, scaled, size[:, 0, 0])

    @property
    def place(self) -> str:
        return ""

    @property
    def label(self) -> str:
        return self.effect

    @property
    def kind(self) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
        return self.effect, (), ()

    @cached_property
    def channels(self) -> tuple[int, ...]:
        return tuple(int(c) for c in np.flatnonzero(np.any(self.table != 0, axis=(0, 2))))

    @cached_property
    def orders(self) -> Array:
        return self.order

    @property
    def size(self) -> int:
        return len(self.table)

    def columns(self) -> Array:
        return self.table[:, list(self.channels)]

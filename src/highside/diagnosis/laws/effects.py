"""An effect of the library among the groups: it competes with the laws by the same evidence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.policy import LAW_SEARCH

Columns = Callable[[Mapping[str, float]], Array]
"""what one unit of each amplitude does, (k, C, n), at values of the shapes"""


@dataclass(frozen=True, eq=False)
class Shape:
    """The values of an effect's shape parameters, and what lies between them and their neighbours."""

    values: Mapping[str, float]
    near: Mapping[str, tuple[float, float]]
    """the values next to each that may be sharpened, below and above"""
    epochs: frozenset[str]
    """of these the times of onset, between which steps are even; between others they are even in their logarithm"""
    columns: Columns

    def finer(self) -> list[Shape]:
        """Shapes between the neighbours, each shape parameter with so many values."""
        parts = LAW_SEARCH.finer_shapes
        axes = {}
        for name, (low, high) in self.near.items():
            even = name in self.epochs or low <= 0.0
            axes[name] = np.linspace(low, high, parts) if even else np.geomspace(low, high, parts)
        made = []
        for at in product(*(range(parts) if np.ptp(axis) > 0.0 else (0,) for axis in axes.values())):
            values, near = dict(self.values), {}
            for k, (name, axis) in zip(at, axes.items(), strict=True):
                values[name] = float(axis[k])
                near[name] = (float(axis[max(k - 1, 0)]), float(axis[min(k + 1, parts - 1)]))
            made.append(replace(self, values=values, near=near))
        return made


@dataclass(frozen=True, eq=False)
class EffectGroup(LawGroup):
    """What one unit of each amplitude does, `table` (k, C, n)."""

    table: Array = field(default_factory=lambda: np.empty((0, 0, 0)))
    unit: Array = field(default_factory=lambda: np.empty(0))
    """(amplitudes,) size of each column before; 0 for one that does not show"""
    floor: Array = field(default_factory=lambda: np.empty((0, 0)))
    shape: Shape | None = None

    @classmethod
    def of(cls, effect: str, columns: Array, floor: Array, *, tries: float = 1) -> EffectGroup:
        """From its columns (k, C, n), each brought to one size in units of the floor; `tries` shapes are tried."""
        size = np.sqrt(np.mean((columns / floor) ** 2, axis=(1, 2), keepdims=True))
        shown = size[:, 0, 0] > 0
        scaled = columns[shown] / size[shown]
        return cls((), (), np.zeros(len(scaled)), np.empty(0), tries, effect, scaled, size[:, 0, 0], floor)

    def without(self, column: int) -> EffectGroup:
        """The same without one of its columns, whose amplitude is none."""
        unit = self.unit.copy()
        unit[np.flatnonzero(unit)[column]] = 0.0
        return replace(self, order=self.order[1:], table=np.delete(self.table, column, axis=0), unit=unit)

    def shaped(
        self, values: Mapping[str, float], near: Mapping[str, tuple[float, float]], epochs: frozenset[str], of: Columns
    ) -> EffectGroup:
        """The same, with the values of its shapes and what may be tried between them (`Shape`)."""
        return replace(self, shape=Shape(values, near, epochs, of))

    def finer(self) -> list[EffectGroup]:
        """The effect at shapes between its own and the ones tried beside it; itself where none can be sharpened."""
        if self.shape is None or not any(low < high for low, high in self.shape.near.values()):
            return []
        made = []
        for shape in self.shape.finer():
            columns = self.shape.columns(shape.values)
            if np.any(columns) and np.isfinite(columns).all():
                made.append(replace(EffectGroup.of(self.effect, columns, self.floor, tries=self.tries), shape=shape))
        return made

    def slopes(self, sizes: Array) -> dict[str, Array]:
        """(C, n) by each shape parameter that is no time of onset, at these sizes (amplitudes,) of the effect."""
        found: dict[str, Array] = {}
        if self.shape is None:
            return found
        shape = self.shape
        for name in (n for n in shape.near if n not in shape.epochs):
            step = LAW_SEARCH.shape_step * abs(shape.values[name])
            both = [shape.columns({**shape.values, name: shape.values[name] + side}) for side in (-step, step)]
            found[name] = np.tensordot(sizes, both[1] - both[0], 1) / (2 * step)
        return found

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

    def columns(self, out: Array | None = None) -> Array:
        own = self.table[:, list(self.channels)]
        if out is None:
            return own
        out[:] = own
        return out

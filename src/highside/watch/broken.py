"""Which axis is dead, stuck, saturated or far off, where the length of the readings is not gravity's.

While the tool turns, gravity swings x and y alike, and what one of them shows has with z the length of gravity: an
axis can be the broken one only where the other two agree with that. At rest, an axis that reads the same in attitudes
in which both others read something else follows no attitude. What neither tells is left unnamed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array

__all__ = ["AT_REST", "UNNAMED", "Beyond", "broken_axis"]

AXES = "xyz"
AT_REST = -1.0
"""in place of a swing"""
UNNAMED = ("dead axis", "stuck axis", "saturation", "large offset")


@dataclass
class Beyond:
    """Readings whose length is not that of gravity with small errors: time, s, and excess, g, of each; `axes` (6,) as
    `broken_axis` takes them."""

    lengths: list[tuple[float, float]] = field(default_factory=list)
    axes: list[Array] = field(default_factory=list)

    def add(self, t_s: float, excess_g: float, axes: Array) -> None:
        """One more, in the order of time."""
        self.lengths.append((t_s, excess_g))
        self.axes.append(axes)

    def last_g(self, measured_s: float | None) -> float | None:
        """Excess of the last, where none that fits has been measured since; None: one has, or there is none."""
        if not self.lengths or (measured_s is not None and measured_s >= self.lengths[-1][0]):
            return None
        return self.lengths[-1][1]

    def memory(self) -> dict[str, Array]:
        """For `recall`."""
        return {
            "beyond": np.array(self.lengths, dtype=float).reshape(-1, 2),
            "beyond_axes": np.array(self.axes, dtype=float).reshape(-1, 6),
        }

    @classmethod
    def recall(cls, memory: Mapping[str, Array]) -> Beyond:
        """From a `memory`; one of before axes were named has none."""
        lengths = [(float(t), float(excess)) for t, excess in memory["beyond"]]
        return cls(lengths, list(memory.get("beyond_axes", np.zeros((0, 6)))))


def broken_axis(readings: Array, tolerance: float) -> tuple[str, ...]:
    """What is broken, as a class. `readings` (K, 6): means of the axes, g, and how far each swings while the tool
    turns, or `AT_REST`; `tolerance`: g, within which readings are the same."""
    if not readings.size:
        return UNNAMED
    means, swings = readings[:, :3], readings[:, 3:]
    turns = swings[:, 0] >= 0.0
    found = _of_turns(means[turns], swings[turns], tolerance) if turns.any() else _of_rests(means, tolerance)
    if len(found) != 1:
        return UNNAMED
    (k,) = found
    if np.ptp(means[:, k]) > tolerance or (swings[:, k] > tolerance).any():
        return (f"saturation of {AXES[k]}",)
    if np.abs(means[:, k]).max() < tolerance:
        return (f"dead axis {AXES[k]}",)
    return (f"stuck axis {AXES[k]}", f"saturation of {AXES[k]}")


def _of_turns(means: Array, swings: Array, tolerance: float) -> list[int]:
    """The axes without which each turn is one of gravity."""
    x, y, z = swings[:, 0], swings[:, 1], means[:, 2]
    off = np.array([np.hypot(y, z) - 1.0, np.hypot(x, z) - 1.0, x - y])
    return [k for k in range(3) if (np.abs(off[k]) < tolerance).all()]


def _of_rests(means: Array, tolerance: float) -> list[int]:
    """The axis that stays while both others move."""
    stays = np.ptp(means, axis=0) <= tolerance
    return [int(k) for k in np.flatnonzero(stays)] if stays.sum() == 1 else []

"""Which axis is dead, stuck, saturated or far off, where the length of the readings is not gravity's.

While the tool turns, gravity swings x and y alike, and what one of them shows has with z the length of gravity: an
axis can be the broken one only where the other two agree with that. At rest, an axis that reads the same in attitudes
in which both others read something else follows no attitude. What neither tells is left unnamed.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array

__all__ = ["AT_REST", "UNNAMED", "broken_axis"]

AXES = "xyz"
AT_REST = -1.0
"""in place of a swing"""
UNNAMED = ("dead axis", "stuck axis", "saturation", "large offset")


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

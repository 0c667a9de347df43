"""What can be seen of a recording before its gyros are believed: units, saturation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from highside.drift.blocks import Batch, Block
from highside.drift.frames import to_body
from highside.errors import InputError

FloatArray = NDArray[np.float64]

_FLAT_ROWS = 5
_LEAST_SATURATED_RADPS = math.radians(20.0)
_SEEN_RAD = math.radians(2.0)
"""a block turns visibly for gravity from here on"""


def check_units(t_s: FloatArray, rate: FloatArray, accel: FloatArray, where: str | None = None) -> None:
    """Refuse accelerometers that are not in g, and gyros that gravity shows to be in rad/s. Tool frame.

    Raises InputError. Gyros can be judged only where gravity turns in the tool.
    """
    size = float(np.median(np.sqrt((accel * accel).sum(axis=0))))
    if not 0.5 < size < 2.0:
        guess = "m/s2" if 5.0 < size < 20.0 else "mg" if 500.0 < size < 2000.0 else "another unit"
        raise InputError(
            f"the reading's length is {size:.4g} where 1 g is expected: is it in {guess}?",
            where=where,
            field="ax_g, ay_g, az_g",
            remedy="give g",
        )
    watch = UnitWatch()
    for block in Batch.of(t_s, to_body(rate), to_body(accel), 0.5).blocks():
        watch.add(block)
    if watch.verdict is not None:
        raise InputError(watch.verdict, where=where, field="gx_dps, gy_dps, gz_dps", remedy="give deg/s")


class UnitWatch:
    """Compares the turn of gravity from one block to the next with what the gyros say that it should be."""

    def __init__(self) -> None:
        self._before: Block | None = None
        self._seen = self._said = 0.0

    def add(self, block: Block) -> None:
        """One more block, in order."""
        before, self._before = self._before, block
        if before is None or block.gap_s > 0.0 or max(before.accel_std, block.accel_std) > 0.1:
            return
        g0, g1 = (each.accel / (math.sqrt(float(each.accel @ each.accel)) or 1.0) for each in (before, block))
        turn = math.sqrt(float(np.square(np.cross(g1, g0)).sum()))
        predicted = block.rate - (block.rate @ g0) * g0
        if _SEEN_RAD < turn < 1.0:
            self._seen += turn
            self._said += math.sqrt(float(predicted @ predicted)) * block.seconds

    @property
    def verdict(self) -> str | None:
        """What is wrong with the unit of the gyros; None where nothing is, or gravity has not turned enough to tell."""
        if self._seen <= 10.0 * _SEEN_RAD or self._said <= 0.0:
            return None
        ratio = self._seen / self._said
        if ratio > 20.0:
            return f"gravity turns {ratio:.0f} times as fast as the gyros say: are they in rad/s?"
        if ratio < 0.05:
            return f"the gyros say {1 / ratio:.0f} times the turn that gravity shows: their unit is not deg/s"
        return None


def saturated_rows(rate: FloatArray) -> int:
    """Rows in which a gyro stays at its own extreme for several rows on end: its range is exceeded. rate (3, N)."""
    rows = np.zeros(rate.shape[1], dtype=bool)
    for axis in rate:
        extreme = float(np.abs(axis).max())
        if extreme < _LEAST_SATURATED_RADPS:
            continue
        flat = np.abs(axis) == extreme
        edges = np.flatnonzero(np.diff(np.concatenate([[0], flat.astype(np.int8), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin >= _FLAT_ROWS:
                rows[begin:end] = True
    return int(rows.sum())

"""Checks of a recording before its gyros are believed: units, silence, saturation."""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import direction_cosines, from_rotation_vector, to_rotation_vector
from highside.errors import InputError
from highside.gyro.blocks import MAX_GAP_S, Batch, Block
from highside.gyro.frames import to_body

_FLAT_ROWS = 5
_LEAST_SATURATED_RADPS = math.radians(20.0)
_VISIBLE_RAD = math.radians(2.0)
"""a block turns visibly for gravity from here on"""
_DOUBTFUL = 20.0
"""gyros with so much less or more noise than stated are doubted (rad/s for deg/s is 57)"""


def check_units(
    t_s: Array, rate: Array, accel: Array, where: str | None = None, *, arw: float = 0.0
) -> tuple[str, ...]:
    """Refuse accelerometers that are not in g, and gyros that are silent or that gravity shows to be in another unit.

    Tool frame: t_s (N,), rate (3, N) rad/s, accel (3, N) g; `arw` (rad/sqrt(s)) is the noise that the gyros are said to
    have. Returns sentences on what is doubtful: gravity can judge gyros only where it turns in the tool, at rest
    nothing but their noise tells their unit. Raises InputError.
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
    dt = np.diff(t_s)
    step = np.sqrt((rate * rate).sum(axis=0))[1:] * dt
    if np.any(step[dt <= MAX_GAP_S] > math.pi):
        raise InputError(
            "turn by more than half a turn from one row to the next",
            where=where,
            field="gx_dps, gy_dps, gz_dps",
            remedy="give deg/s, at a rate that follows the tool",
        )
    still = [f"g{axis}_dps" for axis, row in zip("xyz", rate, strict=True) if not np.ptp(row)]
    zero = [name for name in still if not rate["xyz".index(name[1])].any()]
    if zero:
        raise InputError(
            "is zero throughout: the gyro is silent",
            where=where,
            field=", ".join(zero),
            remedy="drift needs three gyros that measure",
        )
    doubts = []
    if still:
        doubts.append(f"{', '.join(still)} never changes: a gyro that hangs, and no azimuth then")
    watch = UnitWatch()
    blocks = Batch.of(t_s, to_body(rate), to_body(accel), 0.5).blocks()
    for block in blocks:
        watch.add(block)
    if watch.verdict is not None:
        raise InputError(watch.verdict, where=where, field="gx_dps, gy_dps, gz_dps", remedy="give deg/s")
    arws = [block.rate_noise * math.sqrt(block.seconds / block.n) for block in blocks if block.n > _FLAT_ROWS]
    arws = [own_arw for own_arw in arws if own_arw > 0.0]
    # of the quietest moments: vibration is noise too
    ratio = float(np.percentile(arws, 1)) / arw if arws and arw > 0.0 else 1.0
    if not 1.0 / _DOUBTFUL < ratio < _DOUBTFUL:
        doubts.append(
            f"the gyros' noise is {max(ratio, 1.0 / ratio):.0f} times {'less' if ratio < 1.0 else 'more'} than the "
            "angle random walk that they are said to have: are they in deg/s? Other gyros want their own figures"
        )
    return tuple(doubts)


def _middle(block: Block) -> Array:
    """Direction of the mean reading in the middle of a block: the turn by the gyros, right or wrong, taken back."""
    g = direction_cosines(from_rotation_vector(0.5 * to_rotation_vector(block.q))).T @ block.accel
    return np.asarray(g / (math.sqrt(float(g @ g)) or 1.0))


class UnitWatch:
    """Compares the turn of gravity from one block to the next with what the gyros say that it should be.

    Least squares over all blocks in which either turns visibly: by_gravity = factor * by_gyros, and how well they
    agree.
    """

    def __init__(self) -> None:
        self._before: Block | None = None
        self._turned = self._seen2 = self._said2 = self._both = 0.0

    def add(self, block: Block) -> None:
        """One more block, in order."""
        before, self._before = self._before, block
        if before is None or block.gap_s > 0.0 or max(before.accel_std, block.accel_std) > 0.1:
            return
        g0, g1 = _middle(before), _middle(block)
        by_gravity = np.cross(g1, g0)
        rate = 0.5 * (before.rate + block.rate)
        by_gyros = (rate - (rate @ g0) * g0) * 0.5 * (before.seconds + block.seconds)
        turn, across = math.sqrt(float(by_gravity @ by_gravity)), math.sqrt(float(by_gyros @ by_gyros))
        whole = max(math.sqrt(float(each.rate @ each.rate)) * each.seconds for each in (before, block))
        if max(turn, across) < _VISIBLE_RAD or turn > 1.0 or whole > 1.0:
            # nothing to compare, or so much that it may look like little
            return
        self._turned += max(turn, across)
        self._seen2 += turn * turn
        self._said2 += across * across
        self._both += float(by_gravity @ by_gyros)

    @property
    def verdict(self) -> str | None:
        """What is wrong with the unit of the gyros; None where nothing is, or gravity has not turned enough to tell."""
        if self._turned <= 10.0 * _VISIBLE_RAD or self._said2 <= 0.0:
            return None
        factor, agreement = self._both / self._said2, self._both / math.sqrt(self._seen2 * self._said2 or 1.0)
        if factor > 20.0 and agreement > 0.7:
            return f"gravity turns {factor:.0f} times as fast as the gyros say: are they in rad/s?"
        if factor < 0.05 and self._said2 > self._seen2:
            return (
                f"gravity shows {max(factor, 0.0):.1%} of the turn that the gyros say: their unit is not deg/s, their "
                "axes are not the accelerometers', or their bias is beyond any use"
            )
        return None


def saturated_rows(rate: Array) -> int:
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

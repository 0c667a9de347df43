"""A schedule of affine corrections over millions of readings: the loop that is compiled.

Zones are sorted by inclination and a window ends at the latest where its neighbour is whole, so that between two
neighbouring centres only these two zones can take part. The readings are taken in pieces; where a whole piece lies
between the same two centres (a log changes its inclination slowly), matrices and windows are constants of a loop that
the compiler turns into vector instructions. Other pieces are done reading by reading, by the same formulas.

`key_of` and `window_weight` are the plain functions of the live path.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from highside.attitude.compiled import attitude_by_half_angles, shared

PIECE = 512
"""Readings a piece: the keys of one and its results stay in the first-level cache."""

WHOLE = 1.0 - 1e-9
"""Weights that sum to this leave nothing for the fallback; the jump is 1e-9 of a difference of some 1e-4 g."""


@shared
def key_of(x: float, y: float, z: float) -> float:
    """What orders readings by inclination without an arc tangent: `sin^2 I` up to 90 deg, `2 - sin^2 I` beyond."""
    r2 = x * x + y * y
    n2 = r2 + z * z
    part = 0.0 if n2 == 0.0 else r2 / n2
    return part if z >= 0.0 or n2 == 0.0 else 2.0 - part


@shared
def window_weight(key: float, low: float, high: float, rise: float, fall: float) -> float:
    """Weight of a zone at a key; `schedule.Window.edges` says what the four numbers are."""
    x = 1.0
    if rise > 0.0:
        x = min(x, (key - low) * rise)
    if fall > 0.0:
        x = min(x, (high - key) * fall)
    return x * x * (3.0 - 2.0 * x) if x > 0.0 else 0.0


@shared
def row_of(m: tuple[float, float, float, float], x: float, y: float, z: float) -> float:
    """One row of an affine correction."""
    return m[0] * x + m[1] * y + m[2] * z + m[3]


@shared
def row_at(m: Any, k: int) -> tuple[float, float, float, float]:
    """Row `k` of matrices that lie one below the other, as floats."""
    return m[k, 0], m[k, 1], m[k, 2], m[k, 3]


@shared
def blended(
    key: float,
    lower: tuple[float, float, float, float],
    upper: tuple[float, float, float, float],
    has_fallback: bool,
) -> tuple[float, float, float]:
    """Weights of the zone below, of the zone above and of the fallback; NaN where nothing holds.

    `lower` and `upper` are the numbers of `window_weight`. The sum is one.
    """
    below = window_weight(key, lower[0], lower[1], lower[2], lower[3])
    above = window_weight(key, upper[0], upper[1], upper[2], upper[3])
    total = below + above
    rest = 1.0 - total if has_fallback and total < WHOLE else 0.0
    scale = 1.0 if rest > 0.0 else (math.nan if total == 0.0 else 1.0 / total)
    return below * scale, above * scale, rest * scale


def scheduled_loop(
    readings: tuple[Any, Any, Any],
    matrices: Any,
    window_table: Any,
    centers: Any,
    guide: Any,
    fallback: Any,
    has_fallback: bool,
    unit: float,
    start: int,
    stop: int,
    out_inc: Any,
    out_tf: Any,
) -> None:
    """I and T of the readings `start` to `stop` (three arrays (N,)) into `out_inc`, `out_tf` (N,), times `unit`.

    `matrices` (3 Z + 6, 4): (C, -o) of the zones, with one of zeros before and after them; `window_table` (Z + 2, 4)
    likewise, its first and last never touched; `centers` (Z,) their keys, rising. `guide`, `fallback` (3, 4).
    """
    keys = np.empty(PIECE)
    count = centers.size
    u0, u1, u2 = row_at(guide, 0), row_at(guide, 1), row_at(guide, 2)
    f0, f1, f2 = row_at(fallback, 0), row_at(fallback, 1), row_at(fallback, 2)
    for low in range(start, stop, PIECE):
        high = min(low + PIECE, stop)
        n = high - low
        ax, ay, az = readings[0][low:high], readings[1][low:high], readings[2][low:high]
        incs, tfs = out_inc[low:high], out_tf[low:high]
        for i in range(n):
            a, b, c = ax[i], ay[i], az[i]
            keys[i] = key_of(row_of(u0, a, b, c), row_of(u1, a, b, c), row_of(u2, a, b, c))
        k = np.searchsorted(centers, keys[0], side="right")
        least = centers[k - 1] if k > 0 else -1.0
        most = centers[k] if k < count else 3.0
        alike = 0
        for i in range(n):
            alike += 1 if keys[i] >= least and keys[i] < most else 0
        step = n if alike == n else 1
        for at in range(0, n, step):
            if step == 1:
                k = np.searchsorted(centers, keys[at], side="right")
            # between centres k - 1 and k: zones k - 1 and k, places k and k + 1 of the tables
            l0, l1, l2 = row_at(matrices, 3 * k), row_at(matrices, 3 * k + 1), row_at(matrices, 3 * k + 2)
            h0, h1, h2 = row_at(matrices, 3 * k + 3), row_at(matrices, 3 * k + 4), row_at(matrices, 3 * k + 5)
            below, above = row_at(window_table, k), row_at(window_table, k + 1)
            # counted from 0: an index that might be negative costs the compiler its vector loads
            xs, ys, zs = ax[at : at + step], ay[at : at + step], az[at : at + step]
            some, inc_out, tf_out = keys[at : at + step], incs[at : at + step], tfs[at : at + step]
            for i in range(step):
                a, b, c = xs[i], ys[i], zs[i]
                v, w, rest = blended(some[i], below, above, has_fallback)
                x = v * row_of(l0, a, b, c) + w * row_of(h0, a, b, c) + rest * row_of(f0, a, b, c)
                y = v * row_of(l1, a, b, c) + w * row_of(h1, a, b, c) + rest * row_of(f1, a, b, c)
                z = v * row_of(l2, a, b, c) + w * row_of(h2, a, b, c) + rest * row_of(f2, a, b, c)
                inc, tf = attitude_by_half_angles(x, y, z)
                inc_out[i] = inc * unit
                tf_out[i] = tf * unit

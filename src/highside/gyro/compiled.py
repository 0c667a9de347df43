"""Long recordings sample by sample in machine code: gathering into blocks, and the rows between their ends.

Optional (extra `fast`): without numba, or for recordings whose interpretation takes less time than loading a compiler,
`kernels` gives None and numpy does the same by other loops. The filter itself has one block a second to process and
stays in numpy. `gather` and `follow` add the loops over samples to functions of `blocks` and `filter_state`, compiled
from the same source. IEEE arithmetic, nothing fused or reordered: the blocks are the same bits, rows between their ends
differ by the last digit.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import types
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.gyro import filter_state
from highside.gyro.blocks import EMPTY, MAX_GAP_S, SUMS, advance, cos_and_sinc
from highside.gyro.filter_state import quaternion_exp, quaternion_product

LEAST_ROWS = 600_000
"""below, loading the compiled code (0.7 s, and 8 s to make it the first time) takes longer than doing without"""
LOADED_LEAST_ROWS = 5_000
"""the same once it is loaded"""


class Kernels(NamedTuple):
    """The compiled functions."""

    gather: Callable[..., int]
    follow: Callable[..., None]


def gather(
    t_s: Array,
    rate: Array,
    accel: Array,
    block_s: float,
    number: NDArray[np.intp],
    sums: Array,
    edges: Array,
) -> int:
    """Sums of all blocks, `blocks.Gatherer` for rows of the tool frame: t_s (N,), rate, accel (3, N).

    Fills number (N,), sums (32, M) and edges (3, M): gap, start, end. Returns the number of blocks, at most M.
    """
    at = EMPTY
    block, label, start, gap = 0, 0.0, t_s[0], 0.0
    before, bx, by, bz = t_s[0], -rate[1, 0], -rate[2, 0], rate[0, 0]
    last = t_s[0]
    for i in range(t_s.size):
        t = t_s[i]
        x, y, z = -rate[1, i], -rate[2, i], rate[0, i]
        ax, ay, az = -accel[1, i], -accel[2, i], accel[0, i]
        own = math.floor((t - t_s[0]) / block_s + 1e-6)
        if own != label:
            for j in range(SUMS):
                sums[j, block] = at[j]
            edges[0, block], edges[1, block], edges[2, block] = gap, start, last
            at, gap, start, label = EMPTY, 0.0, last, own
            block += 1
        dt = t - before
        if dt > MAX_GAP_S or dt < 0.0:
            gap += abs(dt)
            dt = 0.0
        dx, dy, dz = x - bx, y - by, z - bz
        norm = math.sqrt(ax * ax + ay * ay + az * az)
        at = advance(at, dt, (x, y, z), (ax, ay, az), norm, dx * dx + dy * dy + dz * dz, 1.0)
        before, bx, by, bz = t, x, y, z
        last = t
        number[i] = block
    for j in range(SUMS):
        sums[j, block] = at[j]
    edges[0, block], edges[1, block], edges[2, block] = gap, start, last
    return block + 1


def follow(
    t_s: Array,
    rate: Array,
    accel: Array,
    number: NDArray[np.intp],
    q: Array,
    bias: Array,
    scale: Array,
    frozen: NDArray[np.bool_],
    leap: Array,
    edges: Array,
    q_end: Array,
    earth: Array,
    angles: Array,
) -> None:
    """Angles (3, N) (inclination, toolface, azimuth) of the rows between the ends of blocks.

    By block: attitude q (M, 4), bias (M, 3), scale (M,) at its start, whether it stands, `leap` (M, 3) the rotation
    that a smoother adds until its end (given out evenly), edges (3, M) as of `gather`, q_end (M, 4) as known at its
    end.
    """
    at = EMPTY
    count = t_s.size
    before = t_s[0]
    for i in range(count):
        k = number[i]
        if i > 0 and k != number[i - 1]:
            at = EMPTY
        t = t_s[i]
        dt = t - before
        before = t
        if dt > MAX_GAP_S or dt < 0.0:
            dt = 0.0
        at = advance(at, dt, (-rate[1, i], -rate[2, i], rate[0, i]), (0.0, 0.0, 0.0), 0.0, 0.0, 1.0)
        if i == count - 1 or number[i + 1] != k or k == 0:
            a, b, c, d = q_end[k, 0], q_end[k, 1], q_end[k, 2], q_end[k, 3]
        else:
            now = (q[k, 0], q[k, 1], q[k, 2], q[k, 3])
            if not frozen[k]:
                b0, b1, b2, s, seconds = bias[k, 0], bias[k, 1], bias[k, 2], scale[k], at[19]
                small = quaternion_exp(
                    -(at[4] * b0 + at[5] * b1 + at[6] * b2 + at[13] * s),
                    -(at[7] * b0 + at[8] * b1 + at[9] * b2 + at[14] * s),
                    -(at[10] * b0 + at[11] * b1 + at[12] * b2 + at[15] * s),
                )
                earths = quaternion_exp(-earth[0] * seconds, -earth[1] * seconds, -earth[2] * seconds)
                now = quaternion_product(
                    quaternion_product(earths, now), quaternion_product((at[0], at[1], at[2], at[3]), small)
                )
            if leap[k, 0] != 0.0 or leap[k, 1] != 0.0 or leap[k, 2] != 0.0:
                share = (t - edges[1, k]) / (edges[2, k] - edges[1, k])
                now = quaternion_product(
                    now, quaternion_exp(share * leap[k, 0], share * leap[k, 1], share * leap[k, 2])
                )
            a, b, c, d = now
        up = 2 * (c * d + a * b)
        angles[0, i] = math.asin(min(max(up, -1.0), 1.0)) + 0.5 * math.pi
        angles[1, i] = math.atan2(-2 * (b * d - a * c), a * a - b * b - c * c + d * d) % (2 * math.pi)
        angles[2, i] = math.atan2(2 * (b * c - a * d), a * a - b * b + c * c - d * d) % (2 * math.pi)


_COMPILED = ("quaternion_product", "quaternion_exp")
"""of `filter_state`, called by `follow`"""


def _digest(functions: list[Any], names: dict[str, Any]) -> str:
    """A name for this version of these functions and of the constants that they use."""
    codes = [(f.__code__.co_code.hex(), f.__code__.co_names, f.__code__.co_consts) for f in functions]
    constants = sorted((name, value) for name, value in names.items() if isinstance(value, int | float | tuple))
    return hashlib.sha256(repr((codes, constants)).encode()).hexdigest()[:12]


@cache
def _compile() -> Kernels | None:
    if importlib.util.find_spec("numba") is None:
        return None
    import numba

    names = dict(vars(filter_state))
    source = _digest([names[name] for name in _COMPILED] + [cos_and_sinc, advance, gather, follow], names)

    def compiled(function: Any, names: dict[str, Any]) -> Any:
        # the same code, seeing the compiled forms of what it calls
        copy = types.FunctionType(function.__code__, names, function.__name__, function.__defaults__)
        # what is kept holds what it calls, too, but is looked up by its own file: so its name tells all of them
        copy.__module__, copy.__qualname__ = function.__module__, f"{function.__qualname__}_{source}"
        try:
            return numba.njit(copy, cache=True, error_model="numpy")
        except RuntimeError:
            # nowhere to keep it: compiled anew in each process
            return numba.njit(copy, error_model="numpy")

    for name in _COMPILED:
        names[name] = compiled(names[name], names)
    own = dict(globals())
    own |= {name: names[name] for name in _COMPILED}
    around = dict(advance.__globals__)
    around["cos_and_sinc"] = compiled(cos_and_sinc, around)
    own["advance"] = compiled(advance, around)
    for name in ("gather", "follow"):
        own[name] = compiled(own[name], own)
    return Kernels(own["gather"], own["follow"])


def kernels(rows: int) -> Kernels | None:
    """The compiled functions, if they can be had and are worth loading for so many rows."""
    loaded = _compile.cache_info().currsize > 0
    return _compile() if rows >= (LOADED_LEAST_ROWS if loaded else LEAST_ROWS) else None

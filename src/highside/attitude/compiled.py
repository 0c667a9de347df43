"""Loops over millions of readings compiled by numba, where it is installed (the extra `fast`).

Numpy does one operation on a whole block, then the next; a compiled loop does all of them on a few readings held in
registers. The formulas are the plain functions that the rest of the package calls (`shared` makes them known to the
compiler), so that there is one of each; without numba the numpy blocks of `attitude.block` do the same work.

No "fast math": the compiler may neither reorder nor omit a check for NaN, so that a reading gives the same bits
whatever stands next to it. The two arc tangents are the rational function of `attitude.block` (the C library's is a
call for each value); multiplied out it has one division and no subtraction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

ATAN_CONSTANT = 0.1147107217776141
ATAN_POLES: tuple[tuple[float, float], ...] = (
    (4.353706015945994, 19.022546643583684),
    (1.073897484782816, 4.804600846780154),
    (0.45062816052493354, 2.2189288046597206),
    (0.2130562799172061, 1.3740327518636595),
    (0.07938382099473763, 1.0618304126313258),
)
"""atan(u) / u = ATAN_CONSTANT + sum c / (u^2 + e) on [-1, 1]. Interpolated at w = u^2 = v / (1.41 - 0.41 v) with v the
eleven Chebyshev points of [0, 1], which spreads the error evenly."""

COMPILED_FROM = 1_000_000
"""Readings a call from which compiling pays: loading the compiler takes 0.3 to 0.5 s, once in a process."""

F = TypeVar("F", bound=Callable[..., Any])
Loop = Callable[..., None]


def _quotient() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Numerator and denominator (highest power of u^2 first) of the sum of poles; all coefficients are positive."""
    roots = [-e for _, e in ATAN_POLES]
    below = np.poly(roots)
    above = ATAN_CONSTANT * below
    for i, (c, _) in enumerate(ATAN_POLES):
        above = np.polyadd(above, c * np.poly(roots[:i] + roots[i + 1 :]))
    return tuple(above.tolist()), tuple(below.tolist())


(_P5, _P4, _P3, _P2, _P1, _P0), (_, _Q4, _Q3, _Q2, _Q1, _Q0) = _quotient()
_PI, _HALF_PI, _TURN = math.pi, 0.5 * math.pi, 2.0 * math.pi
_SHARED: list[Callable[..., Any]] = []


def shared(function: F) -> F:
    """Mark a plain function of floats as one that compiled loops call too; it is returned unchanged."""
    _SHARED.append(function)
    return function


@shared
def atan_unit(u: float) -> float:
    """atan u for |u| <= 1, relative error 3.3e-15."""
    w = u * u
    above = ((((_P5 * w + _P4) * w + _P3) * w + _P2) * w + _P1) * w + _P0
    below = ((((w + _Q4) * w + _Q3) * w + _Q2) * w + _Q1) * w + _Q0
    return u * above / below


@shared
def attitude_by_half_angles(x: float, y: float, z: float) -> tuple[float, float]:
    """(I, T) in rad of a gravity vector by the formulas of `attitude.block`: `scalar.attitude` to 1e-14 rad.

    NaN gives NaN; a vector along the axis toolface 0, the zero vector inclination 0.
    """
    r2 = x * x + y * y
    r = math.sqrt(r2)
    n = math.sqrt(r2 + z * z)
    across = r + abs(y)
    along = n + r
    t = 2.0 * atan_unit(0.0 if across == 0.0 else x / across)
    tf = abs(_HALF_PI - t) if y >= 0.0 else 3.0 * _HALF_PI + t
    tf = 0.0 if (across == 0.0 or tf >= _TURN) else tf
    inc = abs(_HALF_PI - 2.0 * atan_unit(0.0 if along == 0.0 else z / along))
    return (0.0 if along == 0.0 else inc), tf


def affine_loop(
    readings: tuple[Any, Any, Any], c: tuple[float, ...], unit: float, low: int, high: int, out_inc: Any, out_tf: Any
) -> None:
    """I and T of `C m - o` for the readings `low` to `high` (three arrays (N,)), times `unit`; `c`: (C, -o) by rows."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11 = c
    ax, ay, az = readings[0][low:high], readings[1][low:high], readings[2][low:high]
    incs, tfs = out_inc[low:high], out_tf[low:high]
    for i in range(high - low):
        a, b, d = ax[i], ay[i], az[i]
        x = c0 * a + c1 * b + c2 * d + c3
        y = c4 * a + c5 * b + c6 * d + c7
        z = c8 * a + c9 * b + c10 * d + c11
        inc, tf = attitude_by_half_angles(x, y, z)
        incs[i] = inc * unit
        tfs[i] = tf * unit


def wanted(n: int) -> bool:
    """Whether `n` readings are worth compiling for, and there is a compiler."""
    return n >= COMPILED_FROM and _compiler() is not None


@lru_cache(maxsize=1)
def _compiler() -> Any:
    """numba, with the shared formulas made known to it; None where it is missing or does not fit our numpy."""
    try:
        import numba
        from numba.extending import register_jitable
    except ImportError:
        return None
    for function in _SHARED:
        register_jitable(function)
    return numba


@lru_cache(maxsize=8)
def compiled(loop: Loop) -> Loop:
    """`loop` compiled, running without the interpreter lock; kept on disk where a folder may be written to.

    Only where `wanted` said yes.
    """
    # divisions by zero give what the processor gives, not an exception
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    try:
        out: Loop = _compiler().njit(cache=True, **options)(loop)
    except RuntimeError:  # no such folder: a service without a home
        out = _compiler().njit(**options)(loop)
    return out

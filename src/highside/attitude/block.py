"""Corrected inclination and toolface in bulk: compiled where numba is installed, else numpy over blocks.

Arrays are (3, N), one row an axis; outputs may be preallocated. The work is done in blocks of `BLOCK` readings, every
step writing into a small workspace (`out=`), so that memory is read and written once; blocks are shared out to
threads, numpy releasing the interpreter lock during each step.

The two arc tangents would take most of the time (numpy calls the C library for each value: 20 ns), so they are put
in a form that numpy's vector instructions can do. With `r = sqrt(x^2 + y^2)` and `n = sqrt(r^2 + z^2)`, the formula of
the half angle, tan(a/2) = sin a / (1 + cos a), gives

    T = pi - copysign(pi/2 + 2 atan(x / (r + |y|)), y),      I = pi/2 - 2 atan(z / (n + r)),

both with an argument u in [-1, 1] and no branch. There `atan u = u * (c_0 + sum_i c_i / (u^2 + e_i))` with five
terms: the rational function that meets atan(sqrt w)/sqrt w at eleven points of [0, 1] (relative error 3.3e-15; c and
e are all positive, so the sum loses no digits). I and T differ from the C library's by at most 8e-15 rad (5e-13 deg).
In a log the inclination of a block hardly changes. With I_0 in its middle, t = tan(I - I_0) = (r cos I_0 - z sin I_0) /
(z cos I_0 + r sin I_0) is small and four terms of its series do instead of the second arc tangent and the length n.
Millions of readings are done by the loops of `attitude.compiled`, three to four times as fast, by the same formulas.
Squares of readings must neither overflow nor underflow: lengths of 1e-150 to 1e150.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude import compiled
from highside.attitude.compiled import ATAN_CONSTANT, ATAN_POLES
from highside.attitude.scalar import UNDEFINED_BELOW_SIGMAS, UNIFORM_ANGLE_STD_RAD, UNKNOWN_INCLINATION_STD_RAD

BoolArray = NDArray[np.bool_]

BLOCK = 65536
"""Readings a block. Blocks of 8,192 fit the second-level cache and are as fast in one thread; two threads then get in
each other's way, because the interpreter lock changes hands at each step: 24 ns a reading instead of 14."""

MATMUL_COLUMNS = 8192
"""Columns a matrix product: the BLAS library starts threads of its own for larger ones, against ours."""

THREADS_FROM = 4 * BLOCK
"""Below this many readings one thread does it."""

NEAR_RAD = 0.02
"""|t| below which atan t = t - t^3/3 + t^5/5 - t^7/7 to 6e-17 rad."""
NEAR_FROM = 1024
"""Readings a block below which looking for a common inclination does not pay."""


class _Workspace:
    """The arrays one thread computes a block in, and its constants as 0-d arrays (cheaper than Python floats)."""

    def __init__(self, size: int, half_turn: float) -> None:
        self.g = np.empty((3, size))
        self.u = np.empty((2, size))
        self.w = np.empty((2, size))
        self.term = np.empty((2, size))
        self.total = np.empty((2, size))
        # 2 atan(u) in the unit wanted: the residues carry the factor
        scale = 2.0 * half_turn / math.pi
        self.constant = np.array(ATAN_CONSTANT * scale)
        self.poles = [(np.array(c * scale), np.array(e)) for c, e in ATAN_POLES]
        self.half_turn = np.array(half_turn)
        self.quarter_turn = np.array(0.5 * half_turn)
        self.turn = 2.0 * half_turn


def _attitude_of_block(g: Array, out_inc: Array, out_tf: Array, ws: _Workspace) -> None:
    """I and T of g (3, n) into out_inc, out_tf (n,); g may be the workspace's own and is left unchanged."""
    n = g.shape[1]
    x, y, z = g
    near = _near_one_inclination(g)
    r, length = ws.term[:, :n]
    np.multiply(x, x, out=r)
    np.multiply(y, y, out=length)
    np.add(r, length, out=r)
    if near is None:
        np.multiply(z, z, out=length)
        np.add(length, r, out=length)
        np.sqrt(ws.term[:, :n], out=ws.term[:, :n])
    else:
        np.sqrt(r, out=r)
        if not _inclination_near(near, r, z, out_inc, ws):
            near = None
            np.hypot(r, z, out=length)
    rows = 2 if near is None else 1
    u, w, term, total = ws.u[:rows, :n], ws.w[:rows, :n], ws.term[:rows, :n], ws.total[:rows, :n]
    np.abs(y, out=w[0])
    np.add(w[0], r, out=w[0])
    np.divide(x, w[0], out=u[0])
    # 0/0 on the axis, put right at the end; written so that NaN counts as suspect
    suspect = not w[0].min() > 0.0
    on_axis = w[0] == 0.0 if suspect else None
    no_vector = None
    if rows == 2:
        np.add(length, r, out=w[1])
        np.divide(z, w[1], out=u[1])
        no_vector = w[1] == 0.0 if suspect else None

    np.multiply(u, u, out=w)
    (c, e), *others = ws.poles
    np.add(w, e, out=term)
    np.divide(c, term, out=total)
    np.add(total, ws.constant, out=total)
    for c, e in others:
        np.add(w, e, out=term)
        np.divide(c, term, out=term)
        np.add(total, term, out=total)
    np.multiply(total, u, out=total)

    if rows == 2:
        np.subtract(ws.quarter_turn, total[1], out=out_inc)
        np.abs(out_inc, out=out_inc)  # at I = 0 the difference may be -1e-15
    np.add(total[0], ws.quarter_turn, out=out_tf)
    np.copysign(out_tf, y, out=out_tf)
    np.subtract(ws.half_turn, out_tf, out=out_tf)
    if not out_tf.max() < ws.turn:
        out_tf[out_tf >= ws.turn] = 0.0
    if on_axis is not None:
        out_tf[on_axis] = 0.0
    if no_vector is not None:
        out_inc[no_vector] = 0.0


def _near_one_inclination(g: Array) -> tuple[float, float] | None:
    """Cosine and sine of an inclination (times a length) that a block stays near to, judged by some of its readings."""
    n = g.shape[1]
    if n < NEAR_FROM:
        return None
    x, y, z = (row.tolist() for row in g[:, :: n // 16])
    inc = [math.atan2(math.hypot(a, b), c) for a, b, c in zip(x, y, z, strict=True)]
    low, high = min(inc), max(inc)
    if not high - low < NEAR_RAD:  # NaN is not near anything
        return None
    middle = 0.5 * (low + high)
    return math.cos(middle), math.sin(middle)


def _inclination_near(near: tuple[float, float], r: Array, z: Array, out_inc: Array, ws: _Workspace) -> bool:
    """I into out_inc where all of it is within NEAR_RAD of one; else False. `r` and `z` are left unchanged."""
    n = r.size
    cos, sin = near
    across, along, t2 = ws.total[0, :n], ws.total[1, :n], ws.u[0, :n]
    np.multiply(r, cos, out=across)
    np.multiply(z, sin, out=t2)
    np.subtract(across, t2, out=across)
    np.multiply(z, cos, out=along)
    np.multiply(r, sin, out=t2)
    np.add(along, t2, out=along)
    if not along.min() > 0.0:
        return False
    np.divide(across, along, out=across)
    if not (across.min() > -NEAR_RAD and across.max() < NEAR_RAD):
        return False
    unit = float(ws.half_turn) / math.pi
    np.multiply(across, across, out=t2)
    np.multiply(t2, -unit / 7.0, out=along)
    for c in (unit / 5.0, -unit / 3.0):
        np.add(along, c, out=along)
        np.multiply(along, t2, out=along)
    np.add(along, unit, out=along)
    np.multiply(along, across, out=along)
    np.add(along, math.atan2(sin, cos) * unit, out=out_inc)
    np.abs(out_inc, out=out_inc)
    return True


def checked(raw: Array, outs: tuple[Array | None, ...]) -> tuple[Array, list[Array]]:
    """Raw as (3, N) float64 and each output (N,), made where it was not given; ValueError for other shapes."""
    raw = np.asarray(raw, dtype=np.float64)
    if raw.ndim != 2 or raw.shape[0] != 3:
        hint = "; transpose it" if raw.ndim == 2 and raw.shape[1] == 3 else ""
        raise ValueError(f"readings must have the shape (3, N), one row an axis, not {raw.shape}{hint}")
    n = raw.shape[1]
    made = []
    for out in outs:
        if out is not None and (out.shape != (n,) or out.dtype != np.float64 or not out.flags.writeable):
            raise ValueError(f"an output must be a writeable float64 array of shape ({n},), not {out.shape}")
        made.append(np.empty(n) if out is None else out)
    return raw, made


def correct_and_attitude(
    raw: Array,
    C: Array,
    b: Array,
    out_inc: Array | None = None,
    out_tf: Array | None = None,
    *,
    degrees: bool = False,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Inclination and toolface of `C (raw - b)`, equations 5 and 2.

    `raw` is (3, N) in g, `C` (3, 3), `b` (3,) in g; `out_inc`, `out_tf` float64 (N,), made if not given and returned,
    in [0, pi] and [0, 2 pi) rad, or degrees. `threads` defaults to the processors of the machine; the result does not
    depend on it. NaN gives NaN; a vector along the axis toolface 0, the zero vector inclination 0. Raises ValueError
    for other shapes, (N, 3) among them.
    """
    raw, (inc, tf) = checked(raw, (out_inc, out_tf))
    C = np.ascontiguousarray(C, dtype=np.float64)
    b = np.asarray(b, dtype=np.float64)
    if C.shape != (3, 3) or b.shape != (3,):
        raise ValueError(f"the correction needs C of shape (3, 3) and b of shape (3,), not {C.shape} and {b.shape}")
    shift = (-(C @ b))[:, None]
    half_turn = 180.0 if degrees else math.pi
    if compiled.wanted(raw.shape[1]):
        loop = compiled.compiled(compiled.affine_loop)
        rows, c = tuple(raw), tuple(np.hstack([C, shift]).ravel().tolist())
        unit = half_turn / math.pi
        share_out(lambda start, stop: loop(rows, c, unit, start, stop, inc, tf), raw.shape[1], threads)
        return inc, tf

    def work(start: int, stop: int) -> None:
        ws = _Workspace(min(BLOCK, stop - start), half_turn)
        # (errstate belongs to a thread) 0/0 is a vector along the axis
        with np.errstate(all="ignore"):
            for lo in range(start, stop, BLOCK):
                hi = min(lo + BLOCK, stop)
                g = ws.g[:, : hi - lo]
                for at in range(lo, hi, MATMUL_COLUMNS):
                    upto = min(at + MATMUL_COLUMNS, hi)
                    np.matmul(C, raw[:, at:upto], out=g[:, at - lo : upto - lo])
                np.add(g, shift, out=g)
                _attitude_of_block(g, inc[lo:hi], tf[lo:hi], ws)

    share_out(work, raw.shape[1], threads)
    return inc, tf


def attitude_by(
    prepare: Callable[[], Callable[[int, int, Array], None]],
    n: int,
    out_inc: Array | None = None,
    out_tf: Array | None = None,
    *,
    degrees: bool = False,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Inclination and toolface (n,) of vectors that a caller makes block by block, equation 2; NaN gives NaN.

    `prepare` is called once a thread and returns a function that writes the vectors `low` to `high` into an array
    (3, high - low) of at most `BLOCK` columns.
    """
    inc = np.empty(n) if out_inc is None else out_inc
    tf = np.empty(n) if out_tf is None else out_tf
    half_turn = 180.0 if degrees else math.pi

    def work(start: int, stop: int) -> None:
        ws = _Workspace(min(BLOCK, stop - start), half_turn)
        fill = prepare()
        with np.errstate(all="ignore"):
            for lo in range(start, stop, BLOCK):
                hi = min(lo + BLOCK, stop)
                g = ws.g[:, : hi - lo]
                fill(lo, hi, g)
                _attitude_of_block(g, inc[lo:hi], tf[lo:hi], ws)

    share_out(work, n, threads)
    return inc, tf


def attitude_block(
    g: Array,
    out_inc: Array | None = None,
    out_tf: Array | None = None,
    *,
    degrees: bool = False,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Inclination and toolface of gravity vectors `g` (3, N), equation 2; otherwise as `correct_and_attitude`."""
    g, (inc, tf) = checked(g, (out_inc, out_tf))
    half_turn = 180.0 if degrees else math.pi

    def work(start: int, stop: int) -> None:
        ws = _Workspace(min(BLOCK, stop - start), half_turn)
        with np.errstate(all="ignore"):
            for lo in range(start, stop, BLOCK):
                hi = min(lo + BLOCK, stop)
                _attitude_of_block(g[:, lo:hi], inc[lo:hi], tf[lo:hi], ws)

    share_out(work, g.shape[1], threads)
    return inc, tf


def share_out(work: Callable[[int, int], None], n: int, threads: int | None) -> None:
    """Run `work(start, stop)` over [0, n) in as many contiguous parts as there are threads."""
    count = (os.cpu_count() or 1) if threads is None else threads
    if count < 1:
        raise ValueError(f"threads must be at least 1, not {count}")
    if count == 1 or n < THREADS_FROM:
        if n:
            work(0, n)
        return
    # parts end on block borders: the same blocks, so the same results, for any number of threads
    blocks = -(-n // BLOCK)
    edges = [min(n, BLOCK * (blocks * k // count)) for k in range(count + 1)]
    with ThreadPoolExecutor(count) as pool:
        parts = [pool.submit(work, lo, hi) for lo, hi in pairwise(edges) if hi > lo]
        for part in parts:
            part.result()


def toolface_std_block(offset_in_sigmas: Array) -> Array:
    """`scalar.toolface_std` of an array."""
    s = np.minimum(offset_in_sigmas, 1e6)
    top = 0.3039635509 + s * (-0.05891792 + s * (0.5782321 + s * (-0.55254875 + s * 0.28703004)))
    bottom = 1.0 + s * (-0.58951436 + s * 0.28703004)
    with np.errstate(divide="ignore"):
        return np.where(offset_in_sigmas > 1e6, 1.0 / offset_in_sigmas, np.sqrt(bottom / top))


def attitude_std_block(g: Array, cov: Array) -> tuple[Array, Array, BoolArray]:
    """Standard deviations of I and T (rad), and where T is undefined: `scalar.attitude_with_std` of many readings.

    `g` is (3, N); `cov` the covariance (6,) of all readings or (6, N) of each, upper triangle (xx, xy, xz, yy, yz, zz)
    in g^2. Raises ValueError for other shapes.
    """
    from highside.special import erfc

    g, _ = checked(g, ())
    cov = np.asarray(cov, dtype=np.float64)
    if cov.shape not in ((6,), (6, g.shape[1])):
        raise ValueError(f"the covariance must have the shape (6,) or (6, {g.shape[1]}), not {cov.shape}")
    xx, xy, xz, yy, yz, zz = cov if cov.ndim == 2 else cov[:, None]
    x, y, z = g
    r = np.sqrt(x * x + y * y)
    n = np.sqrt(r * r + z * z)
    with np.errstate(divide="ignore", invalid="ignore"):
        off_axis = r > 0.0
        ct, st = np.where(off_axis, x / r, 1.0), np.where(off_axis, y / r, 0.0)
        ci, si = z / n, r / n
        rr = np.where(off_axis, ct * ct * xx + 2.0 * ct * st * xy + st * st * yy, 0.5 * (xx + yy))
        tt = np.where(off_axis, st * st * xx - 2.0 * ct * st * xy + ct * ct * yy, 0.5 * (xx + yy))
        rr, tt = np.maximum(rr, 0.0), np.maximum(tt, 0.0)
        rz = ct * xz + st * yz
        s_t = np.where(off_axis, r / np.sqrt(tt), 0.0)
        s_r = np.where(off_axis, r / np.sqrt(rr), 0.0)
        passed = erfc(s_r * math.sqrt(0.5)) - erfc(s_t * math.sqrt(0.5))
        tf_var = toolface_std_block(s_t) ** 2 + 0.5 * math.pi**2 * np.maximum(passed, 0.0)
        folded = tt * np.exp(-3.6 * np.minimum(s_t, 100.0))
        inc_var = (ci * ci * (rr + folded) - 2.0 * ci * si * rz + si * si * zz) / (n * n)
        inc_std = np.minimum(np.sqrt(np.maximum(inc_var, 0.0)), UNKNOWN_INCLINATION_STD_RAD)
    no_vector = n == 0.0
    inc_std = np.where(no_vector, UNKNOWN_INCLINATION_STD_RAD, inc_std)
    tf_std = np.minimum(np.sqrt(tf_var), UNIFORM_ANGLE_STD_RAD)
    return inc_std, tf_std, np.minimum(s_t, s_r) < UNDEFINED_BELOW_SIGMAS

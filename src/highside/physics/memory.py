"""Operators with memory over a series: a first-order lag and the play of a loose joint."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray

MANY = 1000
"""Rows from which a compiled recursion pays."""


def low_pass(t_s: AnyArray, x: AnyArray, tau: complex | float) -> AnyArray:
    """Solution y of tau dy/dt = x - y, (N,), at rest at the start (y = x), exact for x linear between the rows.

    `t_s` rises; rows may be uneven. `tau` in s may be complex (for a derivative by complex step).
    """
    u = np.diff(t_s) / tau
    decay = np.exp(-u)
    # over one row y' = decay y + (1 - decay) x0 + (x1 - x0) (1 - (1 - decay) / u); u = 0 (equal times) changes nothing
    safe = np.where(u == 0, 1.0, u)
    share = np.where(u == 0, 0.0, 1 - (1 - decay) / safe)
    drive = (1 - decay) * x[:-1] + np.diff(x) * share
    y = np.empty(x.shape, dtype=np.result_type(drive, x))
    y[:1] = x[:1]
    if u.size > MANY and np.max(np.abs(u - u[0])) < 1e-9 * abs(u[0]):
        from scipy.signal import lfilter

        # even rows: the same recursion with one coefficient
        y[1:] = lfilter([1.0], [1.0, -decay[0]], drive, zi=np.array([decay[0] * y[0]]))[0]
        return y
    last = y[0] if y.size else 0.0
    for k, (a, d) in enumerate(zip(decay.tolist(), drive.tolist(), strict=True), 1):
        last = a * last + d
        y[k] = last
    return y


def play(x: AnyArray, half_width: float) -> AnyArray:
    """Play operator, (N,): follows x with a slack of `half_width` on each side; starts in the middle of its slack."""
    y = np.empty(x.size)
    last = float(x[0]) if x.size else 0.0
    borders = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 2
    if borders.size < x.size / 20:
        # on a stretch that only rises (falls) it is pushed from one side alone
        for part in np.split(np.arange(x.size), borders):
            pushed = np.minimum(np.maximum(last, x[part] - half_width), x[part] + half_width)
            y[part] = pushed
            last = float(pushed[-1])
        return y
    for k, value in enumerate(x.tolist()):
        last = min(max(last, value - half_width), value + half_width)
        y[k] = last
    return y

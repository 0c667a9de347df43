"""Operators with memory over a series: a first-order lag, the play of a loose joint, an angle without its turns.

A series may be worked through in pieces: within `carried` each operator goes on where it stood at the end of the piece
before (a piece begins with the first row of all, from which effects reckon time; that one is no part of the way).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import AnyArray

MANY = 1000
"""Rows from which a compiled recursion pays."""


@dataclass
class Carry:
    """Where the operators stand, in the order in which they are called for each piece: (rows of inputs and output) at
    the row before the next piece, which repeats the last `overlap` rows."""

    overlap: int = 0
    _stands: dict[int, tuple[AnyArray, ...]] = field(default_factory=dict)
    _calls: int = 0

    def next_piece(self) -> None:
        """The next calls are those for the next piece."""
        self._calls = 0

    def begin(self) -> tuple[int, tuple[AnyArray, ...] | None]:
        """Number of this call, and where its operator stands; None at the first piece."""
        number = self._calls
        self._calls += 1
        return number, self._stands.get(number)

    def keep(self, number: int, *series: AnyArray) -> None:
        """Remember inputs and output (n,) of a piece."""
        at = series[0].size - 1 - self.overlap
        self._stands[number] = tuple(one[max(at, 0)] for one in series)


_carry: ContextVar[Carry | None] = ContextVar("carry", default=None)


@contextmanager
def carried(carry: Carry) -> Iterator[None]:
    """Operators go on where they stood when they were last called within the same `carry`."""
    before = _carry.set(carry)
    carry.next_piece()
    try:
        yield
    finally:
        _carry.reset(before)


def low_pass(t_s: AnyArray, x: AnyArray, tau: complex | float) -> AnyArray:
    """Solution y of tau dy/dt = x - y, (N,), at rest at the start (y = x), exact for x linear between the rows.

    `t_s` rises; rows may be uneven. `tau` in s may be complex (for a derivative by complex step).
    """
    carry = _carry.get()
    if carry is None:
        return _low_pass(t_s, x, tau, None)
    number, stands = carry.begin()
    if stands is None:
        y = _low_pass(t_s, x, tau, None)
    else:
        t_before, x_before, y_before = stands
        times, values = np.append(t_before, t_s[1:]), np.append(x_before, x[1:])
        y = np.append(x[:1], _low_pass(times, values, tau, complex(y_before))[1:])
    carry.keep(number, t_s, x, y)
    return y


def _low_pass(t_s: AnyArray, x: AnyArray, tau: complex | float, begins: complex | None) -> AnyArray:
    """From `begins`, where that is known."""
    u = np.diff(t_s) / tau
    decay = np.exp(-u)
    # over one row y' = decay y + (1 - decay) x0 + (x1 - x0) (1 - (1 - decay) / u); u = 0 (equal times) changes nothing
    safe = np.where(u == 0, 1.0, u)
    share = np.where(u == 0, 0.0, 1 - (1 - decay) / safe)
    drive = (1 - decay) * x[:-1] + np.diff(x) * share
    y = np.empty(x.shape, dtype=np.result_type(drive, x))
    y[:1] = x[:1] if begins is None else (begins if np.iscomplexobj(y) else begins.real)
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
    carry = _carry.get()
    if carry is None:
        return _play(x, half_width, float(x[0]) if x.size else 0.0)
    number, stands = carry.begin()
    if stands is None:
        y = _play(x, half_width, float(x[0]))
    else:
        # with the row before: whether the way turns at the first of the piece is seen from there
        x_before, y_before = stands
        y = np.append(x[:1], _play(np.append(x_before, x[1:]), half_width, float(y_before))[1:])
    carry.keep(number, x, y)
    return y


def _play(x: AnyArray, half_width: float, last: float) -> AnyArray:
    """From where it stood last."""
    y = np.empty(x.size)
    borders = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 2
    if borders.size < x.size / 20:
        # on a stretch that only rises (falls) it is pushed from one side alone
        for part in np.split(np.arange(x.size), borders):
            if part.size:
                pushed = np.minimum(np.maximum(last, x[part] - half_width), x[part] + half_width)
                y[part] = pushed
                last = float(pushed[-1])
        return y
    for k, value in enumerate(x.tolist()):
        last = min(max(last, value - half_width), value + half_width)
        y[k] = last
    return y


def unwrapped_angle(angle_rad: AnyArray) -> AnyArray:
    """(N,) an angle without its turns, as `np.unwrap`."""
    carry = _carry.get()
    if carry is None:
        return np.unwrap(angle_rad)
    number, stands = carry.begin()
    if stands is None:
        y = np.unwrap(angle_rad)
    else:
        before, without = stands
        way = np.unwrap(np.append(before, angle_rad[1:])) - before
        y = np.append(angle_rad[:1], without + way[1:])
    carry.keep(number, angle_rad, y)
    return y

"""Rows of a rotation averaged in cells.

A cell is a sector of toolface within some turns at one rate: what follows the toolface keeps its shape, what is slow
its time, and averaging loses no strength. A few thousand values stand for any number of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.laws.policy import LAW_CELLS
from highside.physics.state import ChainState

if TYPE_CHECKING:
    from highside.diagnosis.rows.session import RotationSession

Ints = NDArray[np.intp]

AVERAGED = (
    "inc_rad",
    "temp_c",
    "rotor_rate_radps",
    "rotor_accel_radps2",
    "inc_rate_radps",
    "vibration_rms_g",
    "vibration_x_rms_g",
    "vibration_y_rms_g",
    "vibration_z_rms_g",
)
"""of a state, what is averaged over a cell as it is"""


@dataclass(frozen=True)
class CellMeans:
    """Means over cells of rows: `number` (n,) of each row's cell, in time order; -1 for a row of none."""

    number: Ints
    count: Array
    """(m,) rows of each"""
    middle: Ints
    """(m,) the row that stands for a cell"""

    def mean(self, values: Array) -> Array:
        """(..., n) -> (..., m)."""
        flat, used = values.reshape(-1, values.shape[-1]), self._used
        numbers = self.number[used]
        sums = [np.bincount(numbers, weights=row[used], minlength=self.count.size) for row in flat]
        return np.asarray((np.stack(sums) / self.count).reshape(*values.shape[:-1], self.count.size))

    @cached_property
    def _used(self) -> slice | NDArray[np.bool_]:
        """The rows that are in a cell."""
        used = self.number >= 0
        return slice(None) if used.all() else used

    @cached_property
    def by_cell(self) -> tuple[Ints, Ints]:
        """The rows that are in a cell, cell by cell and in order within each, and the number of each one's cell."""
        rows = np.argsort(self.number, kind="stable")
        rows = rows[np.searchsorted(self.number[rows], 0) :]
        return rows, self.number[rows]

    def nodes(self, values: Array) -> tuple[Array, Array, Array]:
        """Nodes and weights (k, m) by which the mean of a smooth function of values (n,) over the rows of each cell is
        a sum over k of its values: Gauss quadrature, exact of polynomials up to the degree 2 k - 1. And the standard
        deviation (m,) within each cell.

        Golub and Welsch, Math. Comput. 23, 1969, of the distribution that the values have in each cell, from its
        orthogonal polynomials (Stieltjes). Where there are fewer values than nodes, they are the nodes, and exact.
        """
        number, count = np.maximum(self.number, 0), LAW_CELLS.nodes
        middle = self.mean(values)
        u = values - middle[number]
        spread = np.sqrt(np.maximum(self.mean(u * u), 0.0))
        unit = np.where(spread > LAW_CELLS.alike * np.abs(middle), spread, np.inf)
        u = u / unit[number]
        jacobi = np.zeros((middle.size, count, count))
        before, own, beta = np.zeros(u.size), np.ones(u.size), np.zeros(middle.size)
        for k in range(count):
            # each polynomial has a mean square of 1, or is zero where the values are all at nodes
            moved = u * own
            alpha = self.mean(moved * own)
            jacobi[:, k, k] = alpha
            if k == count - 1:
                break
            further = moved - alpha[number] * own - beta[number] * before
            size = np.sqrt(self.mean(further * further))
            beta = np.where(size > LAW_CELLS.further, size, 0.0)
            jacobi[:, k, k + 1] = jacobi[:, k + 1, k] = beta
            inverse = np.where(beta > 0.0, 1.0 / np.where(beta > 0.0, beta, 1.0), 0.0)
            before, own = own, further * inverse[number]
        found, vectors = np.linalg.eigh(jacobi)
        return middle + np.where(np.isfinite(unit), unit, 0.0) * found.T, vectors[:, 0].T ** 2, spread

    def extent(self, values: Array) -> tuple[Array, Array]:
        """Of values (n,) the smallest and the largest (m,) within each cell."""
        number, own = self.number[self._used], values[self._used]
        order = np.argsort(number, kind="stable")
        starts = np.searchsorted(number[order], np.arange(self.count.size))
        return np.minimum.reduceat(own[order], starts), np.maximum.reduceat(own[order], starts)

    def from_middle(self, tf_rad: Array) -> Array:
        """(n,) how far each row is turned, the short way, from the one that stands for its cell."""
        away = tf_rad - tf_rad[self.middle][np.maximum(self.number, 0)]
        return np.asarray((away + np.pi) % (2 * np.pi) - np.pi)

    def within(self, wanted: NDArray[np.bool_]) -> tuple[Ints, Callable[[Array], Array]]:
        """The rows (N,) of the cells `wanted` (m,), and what takes (..., N) to (..., m): means of these cells."""
        rows = np.flatnonzero(wanted[self.number] & (self.number >= 0))
        return rows, replace(self, number=self.number[rows]).mean

    def state(self, state: ChainState, *, since_first: bool = False) -> ChainState:
        """The states of the cells: what varies within one is its mean, as its reading is; of the rest the middle row's.

        A function of the middle row alone departs from the mean reading to first order, which strong laws show. With
        `since_first` the first row stands before them: the time of many effects is that since it.
        """
        before = np.zeros(int(since_first), dtype=np.intp)

        def cells(values: Array) -> Array:
            return np.concatenate([values[before], self.mean(values)])

        made = state.rows(np.concatenate([before, self.middle]))
        averaged: dict[str, Any] = {name: cells(np.asarray(getattr(state, name), dtype=float)) for name in AVERAGED}
        extra = {name: cells(np.asarray(values, dtype=float)) for name, values in state.extra.items()}
        turned = made.tf_rad + np.concatenate([np.zeros(before.size), self.mean(self.from_middle(state.tf_rad))])
        return replace(made, tf_rad=turned, extra=extra, **averaged)


def sectors_of(session: RotationSession, orders: Sequence[float]) -> int:
    """Sectors of a turn in which lines of these orders keep their size, as far as the rows tell sectors apart."""
    turning = np.abs(session.state.rotor_rate_radps) * session.step_s
    most = 2 * np.pi / max(float(np.median(turning)), 1e-9)
    wanted = min(LAW_CELLS.a_wave * max(orders, default=0.0), most)
    return max(LAW_CELLS.sectors, round(wanted))


def cells_of(session: RotationSession, sectors: int = LAW_CELLS.sectors) -> CellMeans:
    """Sectors of toolface within some turns at one rate; where rows are few each is its own.

    Where a rate that never rests would leave nearly every row a cell of its own, sectors and then rates are wider: the
    cost of a search is that of its cells.
    """
    n = session.n
    rows = np.arange(n)
    kept = np.ones(n, dtype=bool) if session.omitted is None else ~session.omitted
    if n <= LAW_CELLS.most:
        number = np.where(kept, np.cumsum(kept) - 1, -1)
        return CellMeans(number, np.ones(int(kept.sum())), rows[kept])
    number, count = _numbered(session, kept, sectors, 1)
    while count.size > LAW_CELLS.limit and sectors > LAW_CELLS.sectors:
        sectors = max(LAW_CELLS.sectors, sectors // 2)
        number, count = _numbered(session, kept, sectors, 1)
    for wider in LAW_CELLS.wider:
        if count.size <= LAW_CELLS.limit:
            break
        number, count = _numbered(session, kept, sectors, wider)
    # the row in the middle of a cell stands for it, and says where it stands in time: rows of one cell lie turns apart
    used = number >= 0
    by_cell = np.argsort(number[used], kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    middle = rows[used][by_cell[starts + count // 2]]
    order = np.argsort(middle, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    number = np.where(used, place[np.maximum(number, 0)], -1)
    count, middle = count[order], middle[order]
    return CellMeans(number, count.astype(float), middle)


def _numbered(session: RotationSession, kept: NDArray[np.bool_], sectors: int, wider: int) -> tuple[Ints, Ints]:
    """Number (n,) of each row's cell, -1 for one that is left out, and the rows of each. A cell ends where the rate has
    changed; with rates `wider` than usual it goes on when the rate is back."""
    state, turn = session.state, 2 * np.pi
    angle = state.tf_rad - state.tf_rad.min()
    sector = np.floor(np.mod(angle, turn) / turn * sectors).astype(int)
    way = np.cumsum(np.abs(np.diff(angle, prepend=angle[:1]))) / turn
    rate = state.rotor_rate_radps
    level = np.round(rate / max(wider * LAW_CELLS.rate * float(np.abs(rate).max()), 1e-12)).astype(int)
    blocks = max(2, LAW_CELLS.most // sectors)
    each = max(1.0, float(way[-1]) / blocks)
    seconds = max(float(state.t_s[-1] - state.t_s[0]), 1e-9) / blocks
    # a block ends after so many turns, after so long, or where the rate changes
    block = (
        np.floor(way / each).astype(int),
        np.floor((state.t_s - state.t_s[0]) / seconds / LAW_CELLS.slow).astype(int),
    )
    borders = (np.diff(block[0], prepend=0) != 0) | (np.diff(block[1], prepend=0) != 0)
    if wider > 1:
        of_rate = level - level.min()
        run = np.cumsum(borders).astype(np.int64) * (int(of_rate.max()) + 1) + of_rate
    else:
        run = np.cumsum(borders | (np.diff(level, prepend=level[:1]) != 0)).astype(np.int64)
    key = run * sectors + sector
    _, number, count = np.unique(np.where(kept, key, -1), return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    return (number, count) if kept.all() else (number - 1, count[1:])

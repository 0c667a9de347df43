"""Where along a covariate a mismatch begins and ends: the shortest range outside of which nothing is left.

The covariate is cut into cells (its settings, where it is stepped). In every cell of a window the mismatch may be
anything, in the others nothing; base parameters are fitted along with it, so what the base absorbs of the mismatch does
not smear it over the rest of the range. Among all windows that one is taken whose gain of chi-square, less `price` for
each free cell, is largest: twice the log of the number of cells (Foster and George, Ann. Statist. 22, 1994, the risk
inflation criterion), so that chance adds none. Further windows are added where they pay for their own search as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import REGRESSION, SUPPORT
from highside.long_arrays import by_runs, runs_of

Ints = NDArray[np.intp]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Cells:
    """A covariate cut into B cells: `of` (n,) the cell of each row, `edges` of each cell, in rising order."""

    covariate: str
    of: Ints
    edges: tuple[Interval, ...]
    circular: bool = False

    @property
    def count(self) -> int:
        """How many cells."""
        return len(self.edges)

    def functions(self, rows: slice | None = None) -> Array:
        """(B, n) indicators."""
        of = self.of if rows is None else self.of[rows]
        return np.asarray(of == np.arange(self.count)[:, None], dtype=float)


def cells_of(covariate: str, along: Array, *, circular: bool = False, count: int = SUPPORT.cells) -> Cells:
    """Cut a covariate (n,): at its settings where it is stepped, else evenly. A circular one turns at 360."""
    values = _settings(along, max(SUPPORT.settings, count))
    if values is not None:
        of = by_runs(along, along.shape, lambda part: np.searchsorted(values, np.round(along[part], 3)))
        if circular and values.size > 1:
            before, after = values - np.roll(values, 1), np.roll(values, -1) - values
            before[0], after[-1] = before[0] + 360.0, after[-1] + 360.0
            edges = [(float(v - b / 2), float(v + a / 2)) for v, b, a in zip(values, before, after, strict=True)]
        else:
            middle = (values[1:] + values[:-1]) / 2
            bounds = np.concatenate([values[:1], middle, values[-1:]])
            edges = [(float(a), float(b)) for a, b in pairwise(bounds)]
        return Cells(covariate, of, tuple(edges), circular)
    first, last = (0.0, 360.0) if circular else (float(along.min()), float(along.max()))
    bounds = np.linspace(first, last, count + 1)

    def cell(part: slice) -> Ints:
        return np.clip(np.searchsorted(bounds, along[part], side="right") - 1, 0, count - 1)

    return Cells(covariate, by_runs(along, along.shape, cell), tuple(pairwise(bounds.tolist())), circular)


def _settings(along: Array, most: int) -> Array | None:
    """The different values (k,) of a covariate (n,), to three digits behind the point; None where they are more."""
    found: Array = np.empty(0)
    for part in runs_of(along.shape[-1]):
        found = np.union1d(found, np.round(along[part], 3))
        if found.size > most:
            return None
    return found


@dataclass(frozen=True)
class Window:
    """The part of a covariate that a mismatch needs: intervals, the gain of chi-square and the directions it used."""

    covariate: str
    intervals: tuple[Interval, ...]
    gain: float
    dof: int


def support(cells: Cells, gram: Array, moment: Array, size: Array) -> Window:
    """The shortest windows of cells that explain a residual.

    `gram` (B k, B k) and `moment` (B k,): inner products of the cells' columns outside of the base with one another and
    with the residual, whitened, k columns (channels) of a cell beside one another; `size` (B k,) their squared lengths
    before the base was taken off.
    """
    count = cells.count
    each = size.size // count
    price = 2 * np.log(max(count, 2))
    taken = np.zeros(count, dtype=bool)
    gain, dof = 0.0, 0
    for turn in range(SUPPORT.windows):
        best: tuple[float, float, int, Ints] | None = None
        for start in range(count):
            order = (np.arange(count) + start) % count if cells.circular else np.arange(start, count)
            columns = (order[:, None] * each + np.arange(each)).ravel()
            explained, directions = _growing(gram[np.ix_(columns, columns)], moment[columns], size[columns])
            ends = np.arange(1, order.size + 1) * each - 1
            worth = explained[ends] - price * directions[ends]
            at = int(np.argmax(worth))
            if best is None or worth[at] > best[0]:
                best = (float(worth[at]), float(explained[ends[at]]), int(directions[ends[at]]), order[: at + 1])
        if best is None or best[0] <= (0.0 if turn == 0 else price):
            break
        taken[best[3]] = True
        gain, dof = gain + best[1], dof + best[2]
        if taken.all():
            break
        used = (best[3][:, None] * each + np.arange(each)).ravel()
        inner = gram[np.ix_(used, used)] + np.diag(1e-9 * size[used] + 1e-30)
        cross = np.linalg.solve(inner, np.column_stack([gram[used], moment[used]]))
        gram, moment = gram - gram[:, used] @ cross[:, :-1], moment - gram[:, used] @ cross[:, -1]
    return Window(cells.covariate, runs(cells, taken), gain, dof)


def _growing(gram: Array, moment: Array, size: Array) -> tuple[Array, Array]:
    """Gain of chi-square and directions used by the first 1, 2, ... columns."""
    scale = np.sqrt(np.maximum(size, 1e-30))
    scaled = gram / scale[:, None] / scale[None, :] + SUPPORT.ridge * np.eye(size.size)
    lower = np.linalg.cholesky(scaled)
    turned = np.linalg.solve(lower, moment / scale)
    visible = (np.diag(lower) > REGRESSION.visible) & (size > 0)
    return np.cumsum(np.where(visible, turned**2, 0.0)), np.cumsum(visible)


def runs(cells: Cells, taken: NDArray[np.bool_]) -> tuple[Interval, ...]:
    """Intervals of neighbouring cells; one that runs over the turn is reported in two parts."""
    found: list[Interval] = []
    for (low, high), one, before in zip(cells.edges, taken, np.concatenate([[False], taken[:-1]]), strict=True):
        if one and before:
            found[-1] = (found[-1][0], high)
        elif one:
            found.append((low, high))
    if not cells.circular:
        return tuple(found)
    if taken.all():
        return ((0.0, 360.0),)
    parts: list[Interval] = []
    for low, high in found:
        if low < 0.0:
            parts += [(low + 360.0, 360.0), (0.0, high)]
        elif high > 360.0:
            parts += [(low, 360.0), (0.0, high - 360.0)]
        else:
            parts.append((low, high))
    parts.sort()
    joined = parts[:1]
    for low, high in parts[1:]:
        if low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    return tuple(joined)

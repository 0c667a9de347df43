"""The noise of means over cells of rows, whitened group by group: of a floor that is correlated as that of the rows is,
and of levels that wander on it.

Cells of one block are passed turn by turn, and their means hold what wanders within it all alike: no chain from cell to
cell has their covariance, so the cells that lie among one another are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.filters import through_bands
from highside.diagnosis.core.grouped_noise import GroupedNoise, LevelInGroup
from highside.diagnosis.laws.noise_policy import LAW_NOISE

Levels = tuple[LevelInGroup, ...]


class Cells(Protocol):
    """Cells of rows (n,), in time order."""

    @property
    def number(self) -> NDArray[np.intp]:
        """(n,) of each row's cell; -1 for a row of none."""

    @property
    def count(self) -> Array:
        """(m,) rows of each cell."""


class CellNoise:
    """Noise of the means (C, m) over cells of rows (n,), of a floor whose mean variance is 1 in each channel; filters
    are made when first asked for, and the last ones stay."""

    def __init__(self, cells: Cells, t_s: Array, floor: Array, forgets: Array, group: int = LAW_NOISE.group) -> None:
        """`floor` (C, m) the standard deviation of each mean, `forgets` (C,) of each channel how the noise of rows is
        forgotten: rows k apart are correlated by exp(-k times this); `group` cells, at least, are taken together."""
        borders = borders_of_groups(cells, group)
        self.level: Callable[[float], Levels] = cache(lambda length_s: levels_in_groups(cells, t_s / length_s, borders))
        self._floors = [
            list(_floor(cells, borders, sigma / np.sqrt(np.mean(sigma**2)), rate))
            for sigma, rate in zip(floor, forgets, strict=True)
        ]
        self._kept: dict[tuple[float, ...], GroupedNoise] = {}

    def filter(self, channel: int, lengths: Sequence[float] = (), variance: float = 0.0) -> GroupedNoise:
        """The filter of a channel's floor beside levels of these lengths in s and of one variance."""
        key = (channel, variance, *lengths)
        if (made := self._kept.pop(key, None)) is None:
            levels = [self.level(float(length)) for length in lengths]
            made = GroupedNoise.of(self._floors[channel], levels, variance)
        self._kept[key] = made
        while sum(one.size for one in self._kept.values()) > LAW_NOISE.kept and len(self._kept) > 1:
            del self._kept[next(iter(self._kept))]
        return made


def borders_of_groups(cells: Cells, group: int) -> tuple[int, ...]:
    """Where groups of so many cells at least begin, and the number of cells: no row of a group lies before one of a
    group before it."""
    rows, n = np.flatnonzero(cells.number >= 0), cells.number.size
    first, last = np.full(cells.count.size, n), np.zeros(cells.count.size, dtype=np.intp)
    np.minimum.at(first, cells.number[rows], rows)
    np.maximum.at(last, cells.number[rows], rows)
    apart = np.maximum.accumulate(last)[:-1] < np.minimum.accumulate(first[::-1])[::-1][1:]
    borders = [0]
    for k in np.flatnonzero(apart) + 1:
        borders += [int(k)] if k - borders[-1] >= group else []
    return (*borders, cells.count.size)


def levels_in_groups(cells: Cells, at: Array, borders: Sequence[int]) -> Levels:
    """What a level of unit variance that is correlated by exp(-distance) of places `at` (n,) of the rows does to the
    means of each group of cells."""
    made = []
    parts = list(_groups(cells, borders))
    begins = [at[rows[0]] for rows, _ in parts]
    ends = [*begins[1:], at[parts[-1][0][-1]]]
    for (rows, kind), begin, end in zip(parts, begins, ends, strict=True):
        places = at[rows]
        alike = np.append(np.exp(-np.diff(places)), 0.0)
        # what each row shares with the rows of each cell before it follows from what the row before it shares
        drive = np.zeros(kind.shape)
        drive[:, 1:] = kind[:, :-1] * alike[:-1]
        before = through_bands(np.asfortranarray(np.stack([np.ones(rows.size), -alike])), drive) @ kind.T
        whole = before + before.T + kind @ kind.T
        made.append(
            LevelInGroup(whole, kind @ np.exp(begin - places), kind @ np.exp(places - end), float(np.exp(begin - end)))
        )
    return tuple(made)


def _groups(cells: Cells, borders: Sequence[int]) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """Of each group its rows (N,), and what takes them to the means of its cells (g, N)."""
    rows = np.flatnonzero(cells.number >= 0)
    number = cells.number[rows]
    for low, high in pairwise(borders):
        own = np.flatnonzero((number >= low) & (number < high))
        kind = np.zeros((high - low, own.size))
        kind[number[own] - low, np.arange(own.size)] = 1.0 / cells.count[number[own]]
        yield rows[own], kind


def _floor(cells: Cells, borders: Sequence[int], sigma: Array, forgets: float) -> Iterator[Array]:
    """(g, g) covariance of the floor of each group of means, of standard deviations (m,)."""
    if not np.isfinite(forgets):
        yield from (np.diag(sigma[low:high] ** 2) for low, high in pairwise(borders))
        return
    levels = levels_in_groups(cells, forgets * np.arange(cells.number.size, dtype=np.float64), borders)
    for level, (low, high) in zip(levels, pairwise(borders), strict=True):
        size = sigma[low:high] / np.sqrt(np.diagonal(level.covariance))
        yield level.covariance * size[:, None] * size

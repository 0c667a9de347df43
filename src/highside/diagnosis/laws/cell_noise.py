"""The noise of means over cells of rows, whitened group by group: of a floor that is correlated as that of the rows is,
and of levels that wander on it.

Cells of one block are passed turn by turn, and their means hold what wanders within it all alike: no chain from cell to
cell has their covariance, so the cells that lie among one another are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
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
    parts = list(_groups(cells, borders))
    begins = [at[part.rows[0]] for part in parts]
    ends = [*begins[1:], at[parts[-1].rows[-1]]]
    return tuple(part.level(at[part.rows], begin, end) for part, begin, end in zip(parts, begins, ends, strict=True))


@dataclass(frozen=True)
class _Group:
    """The rows (N,) of a group of cells, in time order, with the number of each one's cell in the group and its weight
    in the mean over that."""

    rows: NDArray[np.intp]
    cell: NDArray[np.intp]
    weight: Array
    count: int
    """cells"""

    def level(self, places: Array, begin: float, end: float) -> LevelInGroup:
        """What the level does, which is correlated by exp(-distance) of places (N,), from `begin` to `end`."""
        from_begin = self._means(self.cell, np.exp(begin - places), self.count)
        to_end = self._means(self.cell, np.exp(places - end), self.count)
        return LevelInGroup(self._covariance(places), from_begin, to_end, float(np.exp(begin - end)))

    def _covariance(self, places: Array) -> Array:
        """(g, g) of the means: rows of one part, of few rows, pair by pair; what a row shares with one of a part before
        its own is a product of what each shares with the border between."""
        size = LAW_NOISE.part
        part, g = np.arange(places.size) // size, self.count
        border = places[::size]
        following = np.append(border[1:], places[-1])
        since = self._means(part * g + self.cell, np.exp(border[part] - places), border.size * g).reshape(-1, g)
        until = self._means(part * g + self.cell, np.exp(places - following[part]), border.size * g).reshape(-1, g)
        # what each cell's rows before a part have in common with its beginning
        bands = np.asfortranarray(np.stack([np.ones(border.size), -np.append(np.exp(-np.diff(border)), 0.0)]))
        known = np.zeros((g, border.size))
        known[:, 1:] = until[:-1].T
        before = through_bands(bands, known) @ since
        return before + before.T + self._within(places)

    def _within(self, places: Array) -> Array:
        """(g, g) what pairs of rows of one part add to the covariance."""
        size, g = LAW_NOISE.part, self.count
        room = (-(-places.size // size), size)
        at, weight, cell = (
            np.resize(np.append(one, np.zeros(size, one.dtype)), room) for one in (places, self.weight, self.cell)
        )
        weight.reshape(-1)[places.size :] = 0.0
        alike = np.exp(-np.abs(at[:, :, None] - at[:, None])) * weight[:, :, None] * weight[:, None]
        pairs = cell[:, :, None] * g + cell[:, None]
        summed = np.bincount(pairs.reshape(-1), weights=alike.reshape(-1), minlength=g * g)
        return np.asarray(summed, dtype=float).reshape(g, g)

    def _means(self, number: NDArray[np.intp], values: Array, count: int) -> Array:
        """(count,) sums of weighted values (N,) by their number."""
        return np.asarray(np.bincount(number, weights=self.weight * values, minlength=count), dtype=float)


def _groups(cells: Cells, borders: Sequence[int]) -> Iterator[_Group]:
    """The rows of each group of cells."""
    rows = np.flatnonzero(cells.number >= 0)
    number = cells.number[rows]
    # a group's rows all lie before those of the next
    group = np.searchsorted(borders, number, side="right") - 1
    limits = np.searchsorted(group, np.arange(len(borders)))
    for (low, high), start, stop in zip(pairwise(borders), limits[:-1], limits[1:], strict=True):
        own = number[start:stop]
        yield _Group(rows[start:stop], own - low, 1.0 / cells.count[own], high - low)


def _floor(cells: Cells, borders: Sequence[int], sigma: Array, forgets: float) -> Iterator[Array]:
    """(g, g) covariance of the floor of each group of means, of standard deviations (m,)."""
    if not np.isfinite(forgets):
        yield from (np.diag(sigma[low:high] ** 2) for low, high in pairwise(borders))
        return
    levels = levels_in_groups(cells, forgets * np.arange(cells.number.size, dtype=np.float64), borders)
    for level, (low, high) in zip(levels, pairwise(borders), strict=True):
        size = sigma[low:high] / np.sqrt(np.diagonal(level.covariance))
        yield level.covariance * size[:, None] * size

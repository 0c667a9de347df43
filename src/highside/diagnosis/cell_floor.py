"""The noise floor of means over cells of rows, from the scatter of the rows within the cells.

What a misfit does is nearly alike in all rows of a cell, so neither the size of the noise nor how neighbouring rows are
correlated is learned from it. A cell that is passed slowly has many neighbours among its rows, one that is passed fast
has its rows turns apart: of correlated noise the mean of the first is less certain than of as many independent rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.filters import through_bands
from highside.diagnosis.law_cells import CellMeans
from highside.diagnosis.laws.policy import LAW_FLOOR


def floor_of_cell_means(
    residual: Array, cells: CellMeans, least: Array, slopes: Sequence[Array] = ()
) -> tuple[Array, Array]:
    """(C, m) standard deviation of the means over cells of a residual's rows (C, n), and of each channel (C,) how noise
    is forgotten: its rows k apart are correlated by exp(-k times this); infinite where rows are independent.

    `least` (C,) is the standard deviation of a row, at least; `slopes`, (n,) each, are what a misfit may follow within
    a cell: in cells of enough rows its straight part is no noise.
    """
    pairs = _pairs(cells, LAW_FLOOR.rows_of_a_cell)
    if pairs.far[0].size < LAW_FLOOR.rows:
        pairs, slopes = _pairs(cells, 2), ()
    if pairs.far[0].size < LAW_FLOOR.rows:
        # of single rows the scatter is what bends from row to row, of variance 6 for white noise of variance 1
        bent = residual[:, 2:] - 2 * residual[:, 1:-1] + residual[:, :-2]
        bent = np.pad(bent, ((0, 0), (1, 1)), mode="edge")[:, cells.number >= 0] / np.sqrt(1 + 4 + 1)
        sizes = np.array([_scatter(row) for row in bent])
        return np.maximum(sizes, least)[:, None] / np.sqrt(cells.count), np.full(len(residual), np.inf)
    courses = _courses(cells, slopes)
    within = residual.copy()
    for course in courses:
        within -= (cells.mean(residual * course) * cells.count)[:, np.maximum(cells.number, 0)] * course
    near, far = (_differences(within, courses, *one) for one in (pairs.near, pairs.far))
    gaps = (pairs.far[1] - pairs.far[0]).astype(float)
    made, forgets = [], []
    for size, of_near, of_far in zip(least, near, far, strict=True):
        sigma, correlation = _size_and_correlation(of_near, of_far, gaps)
        forgets.append(-float(np.log(correlation)) if correlation > 0.0 else np.inf)
        share = 1.0 / cells.count
        if correlation > 0.0:
            share = shares_of_means(cells, forgets[-1] * np.arange(within.shape[1], dtype=np.float64))
        made.append(max(sigma, size) * np.sqrt(share))
    return np.stack(made), np.array(forgets)


@dataclass(frozen=True)
class _Pairs:
    """Two rows each, (k,) and (k,), of one cell."""

    near: tuple[NDArray[np.intp], NDArray[np.intp]]
    """neighbours; where a cell has none within it, of neighbouring cells"""
    far: tuple[NDArray[np.intp], NDArray[np.intp]]
    """of one passage of the cell's sector and the next, of the halves of the only one: as near as rows are that noise
    makes independent, as what wanders within a cell is not noise of its rows"""


def _pairs(cells: CellMeans, least: int) -> _Pairs:
    """Those of the cells that have so many rows."""
    rows, number = cells.by_cell
    kept = cells.count[number] >= least
    rows, number = rows[kept], number[kept]
    own = number[1:] == number[:-1]
    neighbours = own & (np.diff(rows) == 1)
    near = np.flatnonzero(neighbours)
    passages = np.bincount(number[1:][own & ~neighbours], minlength=cells.count.size) + 1
    step = np.where(passages > 1, np.ceil(cells.count / passages), cells.count // 2).astype(int)[number]
    there = np.arange(rows.size) + step
    inside = there < rows.size
    inside[inside] = number[there[inside]] == number[inside]
    far = np.flatnonzero(inside)
    if near.size >= LAW_FLOOR.rows:
        return _Pairs((rows[near], rows[near + 1]), (rows[far], rows[there[far]]))
    used = np.sort(rows)
    near = np.flatnonzero(np.diff(used) == 1)
    return _Pairs((used[near], used[near + 1]), (rows[far], rows[there[far]]))


def _differences(within: Array, courses: Sequence[Array], one: NDArray[np.intp], other: NDArray[np.intp]) -> Array:
    """(C, k) differences of the rows (C, n) of pairs, of the variance of two rows of white noise of which the courses
    were taken out."""
    lost = np.zeros(one.size)
    for course in courses:
        lost += 0.5 * (course[other] - course[one]) ** 2
    return np.asarray((within[:, other] - within[:, one]) / np.sqrt(2.0 * np.maximum(1.0 - lost, LAW_FLOOR.apart)))


def _courses(cells: CellMeans, slopes: Sequence[Array]) -> list[Array]:
    """(n,) each, of unit size within each cell and orthogonal there: a constant, and what slopes do beside it."""
    own = np.maximum(cells.number, 0)
    made = [np.where(cells.number >= 0, (1.0 / np.sqrt(cells.count))[own], 0.0)]
    for slope in slopes:
        before = np.sqrt(cells.mean(slope**2) * cells.count)
        left = slope * (cells.number >= 0)
        for course in made:
            left = left - (cells.mean(left * course) * cells.count)[own] * course
        size = np.sqrt(cells.mean(left**2) * cells.count)
        kept = (size > LAW_FLOOR.straight * before) & (cells.count >= LAW_FLOOR.rows_of_a_cell)
        made.append(left * np.where(kept, 1.0 / np.where(kept, size, 1.0), 0.0)[own])
    return made


def _size_and_correlation(near: Array, far: Array, gaps: Array) -> tuple[float, float]:
    """Standard deviation of rows, and the correlation of neighbours, from differences of neighbours (k,) and of rows
    so many rows apart (l,), of the variance of a row if rows are independent."""
    apart = _scatter(near) if near.size else np.inf
    sigma, correlation = 0.0, 0.0
    for _ in range(LAW_FLOOR.turns):
        alike = correlation**gaps
        # of pairs that are far beside what the noise remembers, if there are enough
        known = alike < LAW_FLOOR.alike
        known |= np.count_nonzero(known) < LAW_FLOOR.rows
        sigma = _scatter(far[known] / np.sqrt(np.maximum(1.0 - alike[known], LAW_FLOOR.apart)))
        correlation = 1.0 - (apart / sigma) ** 2 if sigma > 0 else 0.0
        if correlation < LAW_FLOOR.coloured:
            return _scatter(far), 0.0
        correlation = min(correlation, LAW_FLOOR.correlation)
    return sigma, correlation


def shares_of_means(cells: CellMeans, at: Array) -> Array:
    """(m,) variance of the mean of each cell's rows, in units of that of a row, of noise that is correlated by
    exp(-distance) of places `at` (n,), which rise (an Ornstein-Uhlenbeck process; of rows a first-order autoregressive
    one)."""
    rows, number = cells.by_cell
    alike, own = np.zeros(rows.size), number[1:] == number[:-1]
    alike[1:][own] = np.exp(-np.diff(at[rows])[own])
    # what a row shares with all before it in its cell follows from what the row before it shares
    bands = np.asfortranarray(np.stack([np.ones(rows.size), np.append(-alike[1:], 0.0)]))
    pairs = np.bincount(number, weights=through_bands(bands, alike[None])[0], minlength=cells.count.size)
    return np.asarray((cells.count + 2.0 * pairs) / cells.count**2)


def _scatter(values: Array | NDArray[np.float64]) -> float:
    """Standard deviation by the median of the size."""
    return float(np.median(np.abs(values))) / LAW_FLOOR.mad

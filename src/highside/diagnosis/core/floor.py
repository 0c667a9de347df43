"""The noise floor: how well readings repeat, known without the misfit that is to be explained.

Noise that is learned from a misfit grows with what is missing from the model, and then explains it. The floor is
learned from what no mismatch of the mean can reach: second differences between successive stretches of rows while
nothing moves, which a steady drift does not raise either. It is taken at several lengths of stretch, and the largest
stands: neighbouring rows that are correlated differ by less than their mean is uncertain by. Readings on the lattice of
a converter whose step exceeds their scatter do not improve by averaging; there the floor is that of the step (a uniform
law).

What a fit leaves is compared with it by an F test. Scatter above the floor is a finding unless it is identified as
noise: an error of a set angle acts across gravity and leaves the magnitude alone, a random walk has its spectrum.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.regression import outside, span
from highside.special import fdtrc

Ints = NDArray[np.intp]

SPREADS = ("std_ax", "std_ay", "std_az")
"""columns of a table of means: the standard deviation of one reading"""


@dataclass(frozen=True)
class NoiseFloor:
    """`sigma` (C, n): standard deviation of each reading (a mean of rows); `freedom` to which it is known."""

    sigma: Array
    freedom: float

    def projected(self, normal: Array) -> NoiseFloor:
        """The floor of the component along unit vectors `normal` (C, n), one channel."""
        return NoiseFloor(np.sqrt(np.sum((normal * self.sigma) ** 2, axis=0))[None], self.freedom)


@dataclass(frozen=True)
class Excess:
    """What a fit leaves, in units of the floor: `ratio` of the two standard deviations, and the `p` of chance."""

    ratio: float
    p: float
    left: float
    """standard deviation that is left, in the readings' unit"""
    floor: float
    """that of the floor"""

    def above(self, ratio: float) -> bool:
        """Whether the floor does not explain what is left, by more than a factor of `ratio`."""
        return self.p < FLOOR.chance and self.ratio > ratio


def lattice_step(values: Array) -> float:
    """The step of the lattice on which readings (N,) lie; 0.0 where they lie on none."""
    levels = np.unique(values)
    if levels.size < 2:
        return 0.0
    steps = np.diff(levels)
    step = float(np.median(steps[steps <= FLOOR.lattice_spread * steps.min()]))
    off = np.abs(steps / step - np.round(steps / step))
    return step if float(off.max()) < FLOOR.lattice_off else 0.0


def rounding_variance(step: float) -> float:
    """Variance of the error that a converter's step makes, wherever on the lattice a reading falls."""
    return step**2 / 12


def step_of_rounding(variance: float) -> float:
    """The step of a converter whose error has this variance."""
    return float(np.sqrt(12 * variance))


def rounding_error(values: Array, left: Array, tf_rad: Array) -> float:
    """The error that the lattice of a turning channel's readings (N,) leaves in their means over a smooth function, in
    their unit; 0.0 where they lie on none.

    `left` (N,) is what a fit leaves of each reading, `tf_rad` (N,) the toolface. Rounding shifts a mean by up to
    (q / pi) |E exp(2 pi i x / q)|, with q the step and x the value before rounding, noise included (Widrow and Kollar
    2008, chapter 4: the first term of the series; the whole sawtooth is half a step, pi / 2 times that). Readings are
    multiples of the step, so that the fitted part of x enters by `left` alone: a turn that carries the channel over
    many steps within a sector of the toolface removes the error, and so does noise of half a step.
    """
    step = lattice_step(values)
    return _error_of_means(step, left, tf_rad) if step else 0.0


def rounding_errors(values: Array, left: Array, tf_rad: Array) -> Array:
    """(N,) as `rounding_error`, and where it is larger that of each span of time by itself: at a rate that comes back
    to the same toolfaces it is, and over all rates it cancels."""
    step = lattice_step(values)
    if step == 0.0:
        return np.zeros(values.size)
    found = np.full(values.size, _error_of_means(step, left, tf_rad))
    for rows in np.array_split(np.arange(values.size), FLOOR.spans):
        found[rows] = max(found[rows[0]], _error_of_means(step, left[rows], tf_rad[rows])) if rows.size else 0.0
    return found


def _error_of_means(step: float, left: Array, tf_rad: Array) -> float:
    """What `rounding_error` says, of readings (N,) on a lattice of a known step, in the unit of that."""
    sector = (FLOOR.sectors * (tf_rad / (2 * np.pi) % 1.0)).astype(np.intp) % FLOOR.sectors
    count = np.maximum(np.bincount(sector, minlength=FLOOR.sectors), 1)
    phase = 2 * np.pi * left / step
    turned = [np.bincount(sector, part, FLOOR.sectors) / count for part in (np.cos(phase), np.sin(phase))]
    # random phases have 1 / N of coherence
    moved = float(np.sqrt(max(np.average(turned[0] ** 2 + turned[1] ** 2 - 1 / count, weights=count), 0.0)))
    white = max(float(np.mean(np.diff(left) ** 2)) / 2 - rounding_variance(step), 0.0)
    return step / 2 * moved * float(np.exp(-2 * np.pi**2 * white / step**2))


def floor_of_means(values: Array, rows: Sequence[Ints], *, alike: bool = False) -> NoiseFloor | None:
    """The floor of the means of channels (C, N) over intervals `rows`; None where intervals have one row only.

    An interval in which a channel scatters far more than in all others (a spike, a jump) has its own, and no part in
    that of the others; but where all are `alike`, as of a tool held by hand, whose stillness differs anyway.
    """
    count = np.array([r.size for r in rows], dtype=float)
    if not rows or np.median(count) < 2:
        return None
    sigma = np.empty((len(values), len(rows)))
    freedom = np.inf
    for c, channel in enumerate(values):
        loud = {} if alike else _loud(channel, rows)
        variance, known = _of_a_row(channel, [r for k, r in enumerate(rows) if k not in loud])
        step = lattice_step(np.concatenate([channel[r] for r in rows]))
        mean = variance / count
        if variance < (FLOOR.dither * step) ** 2:
            # without dither the mean is as coarse as a reading
            mean = mean + rounding_variance(step)
        for k, own in loud.items():
            mean[k] = max(mean[k], own / count[k])
        sigma[c], freedom = np.sqrt(np.maximum(mean, FLOOR.least**2)), min(freedom, known)
    return NoiseFloor(sigma, freedom)


def floor_of_table(columns: Mapping[str, ArrayLike], at: Ints | slice = slice(None)) -> NoiseFloor | None:
    """The floor (3, n) of the rows `at` of a table of means, by the spread of one reading in g (`std_ax`, `std_ay`,
    `std_az`) and the number of readings (`n`, else 1) that it gives of each; None where it gives no spread."""
    if not all(name in columns for name in SPREADS):
        return None
    spread = np.stack([np.asarray(columns[name], dtype=float)[at] for name in SPREADS])
    count = np.asarray(columns["n"], dtype=float)[at] if "n" in columns else np.ones(spread.shape[1])
    sigma = np.maximum(spread / np.sqrt(count), FLOOR.least)
    return NoiseFloor(sigma, float(np.sum(np.maximum(count - 1, 1))))


def _loud(channel: Array, rows: Sequence[Ints]) -> dict[int, float]:
    """The intervals in which a channel (N,) scatters more than in all others by more than chance, and the variance of a
    row in each; no more than a share of them, beyond which all are of one kind."""
    pairs = [_differences(channel[r]) for r in rows]
    squares, known = np.array(pairs).T
    kept, loud = np.ones(len(rows), dtype=bool), dict[int, float]()
    while len(loud) < FLOOR.most_loud * len(rows):
        own = np.where(kept & (known > 0), squares / np.maximum(known, 1), 0.0)
        k = int(np.argmax(own))
        kept[k] = False
        others = float(squares[kept].sum()) / max(float(known[kept].sum()), 1.0)
        freedom = FLOOR.overlap * known[k], FLOOR.overlap * float(known[kept].sum())
        if own[k] <= 0.0 or others <= 0.0 or len(rows) * fdtrc(*freedom, own[k] / others) >= FLOOR.loud:
            break
        loud[k] = float(own[k])
    return loud


def _differences(values: Array) -> tuple[float, int]:
    """The sum of squares of differences of rows (m,), of the second order where there are three, each of the variance
    of a row; and how many they are."""
    order = min(values.size - 1, 2)
    if order < 1:
        return 0.0, 0
    # the variance of a first difference is twice, of a second six times that of a value
    return float(np.sum(np.diff(values, order) ** 2)) / (2 if order == 1 else 6), values.size - order


def _of_a_row(channel: Array, rows: Sequence[Ints]) -> tuple[float, float]:
    """Variance of a row by which the mean of an interval is uncertain, and the degrees of freedom it is known to.

    A longer stretch counts where its variance is the larger one by more than chance: else the shorter one, which is
    known far better. Where it is, rows are correlated, and the largest counts of those that are known well. One
    interval that is long enough shows what the others are too short for.
    """
    best, correlated = (0.0, 1.0), False
    length = 1
    longest = max(r.size for r in rows)
    while length <= max(1, longest // FLOOR.stretches):
        squares, known = 0.0, 0
        for own in rows:
            parts = own.size // length
            if parts < 2:
                continue
            more = _differences(channel[own[: parts * length]].reshape(parts, length).mean(axis=1))
            squares, known = squares + more[0], known + more[1]
        if known < FLOOR.least_differences and length > 1:
            break
        if known:
            found = (length * squares / known, max(FLOOR.overlap * known, 1.0))
            clearly = _longer(found, best)
            correlated |= clearly and length > 1
            if length == 1 or clearly or (correlated and known >= FLOOR.many_differences and found[0] > best[0]):
                best = found
        length *= 2
    return best


def _longer(found: tuple[float, float], best: tuple[float, float]) -> bool:
    """Whether a variance with its degrees of freedom exceeds another one by more than chance."""
    if best[0] <= 0.0:
        return found[0] > 0.0
    return bool(fdtrc(found[1], best[1], found[0] / best[0]) < FLOOR.longer)


def excess(residual: Array, columns: Array, floor: NoiseFloor) -> Excess:
    """What columns (P, C, n), fitted to a residual (C, n) in units of the floor, leave of it."""
    white = (residual / floor.sigma).reshape(-1)
    space = span((columns / floor.sigma).reshape(len(columns), -1)) if len(columns) else np.empty((0, white.size))
    left = outside(space, white)
    freedom = max(white.size - len(space), 1)
    square = float(left @ left) / freedom
    size = float(np.sqrt(np.mean(floor.sigma**2)))
    ratio = float(np.sqrt(square))
    return Excess(ratio, float(fdtrc(freedom, floor.freedom, square)), ratio * size, size)

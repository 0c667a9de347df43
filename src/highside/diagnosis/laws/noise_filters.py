"""The filters of the noise that laws compete with: of one setting, and of all that are tried.

Values that are independent beside a level or a ladder go through them one by one; means over cells, which are not,
group by group.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.markov import LevelNoise
from highside.diagnosis.laws.ladder import LadderNoise, transposed_by_ladders, white_by_ladders
from highside.diagnosis.laws.noise_policy import LAW_NOISE
from highside.diagnosis.laws.problem import LawProblem

if TYPE_CHECKING:
    from highside.diagnosis.core.grouped_noise import GroupedNoise
    from highside.diagnosis.laws.cell_noise import CellNoise

Numbers = NDArray[np.intp]
Filter = Callable[[Array], Array]

LEVELS = np.arange(len(LAW_NOISE.shares) * len(LAW_NOISE.lengths)).reshape(len(LAW_NOISE.shares), -1) + 1
"""number of each level's setting; white noise alone is number 0"""
LADDERS = np.arange(len(LAW_NOISE.ladders)) + LEVELS.size + 1


def filter_of(
    white: Array, problem: LawProblem, c: int, share: float, length: float, ladder: float
) -> LevelNoise | LadderNoise | GroupedNoise | None:
    """The filter of one channel of variances (n,); None for white noise."""
    t_s, mean = problem.t_s, float(white.mean())
    if problem.cells is not None:
        lengths = ladder_lengths(t_s).tolist() if ladder > 0 else [length] if share > 0 else []
        return problem.cells.filter(c, lengths, ladder if ladder > 0 else share).scaled(float(np.sqrt(mean)))
    if ladder > 0:
        return LadderNoise.of(white, t_s, ladder * mean, ladder_lengths(t_s))
    if share > 0:
        return LevelNoise.of(white, t_s, np.array([share * mean]), np.array([length]))
    return None


def step_of(t_s: Array) -> float:
    """Median time from value to value, s."""
    return max(float(np.median(np.diff(t_s))), 1e-9) if t_s.size > 1 else 1.0


def level_lengths(t_s: Array) -> Array:
    """(K,) lengths of a level that are tried, s."""
    return _reaching(np.array(LAW_NOISE.lengths), LAW_NOISE.spans_of_a_walk, t_s)


def ladder_lengths(t_s: Array) -> Array:
    """(L,) lengths of the ladder's levels, s."""
    steps = np.asarray(LAW_NOISE.ladder_step ** np.arange(LAW_NOISE.ladder), dtype=float)
    return _reaching(steps, LAW_NOISE.spans_of_a_ladder, t_s)


def _reaching(steps: Array, spans: float, t_s: Array) -> Array:
    """Lengths in s of some in median steps, drawn apart so that the longest is so many spans of a session at least."""
    step = step_of(t_s)
    longest = max(float(steps[-1]), spans * float(np.ptp(t_s)) / step)
    return np.asarray(step * steps ** (np.log(longest) / np.log(steps[-1])))


class SettingFilters(Protocol):
    """Filters of all settings of one channel by their numbers, at a factor of 1 of a floor of mean variance 1."""

    @property
    def count(self) -> int:
        """Number of settings."""

    def log_determinants(self, numbers: Numbers) -> Array:
        """(s,) of some of them."""

    def runs(self, numbers: Numbers) -> Iterator[tuple[slice, Filter, Filter]]:
        """Runs of these settings: where they stand among them, what whitens rows, (m, n) to (s, m, n), and the
        transposed filters on what is white."""


@dataclass(frozen=True)
class RowFilters:
    """Those of values that are independent beside levels and ladders."""

    sigma: Array
    levels: LevelNoise
    ladders: tuple[LadderNoise, ...]
    log_determinant: Array
    """(S,)"""

    @classmethod
    def of(cls, white: Array, t_s: Array) -> RowFilters:
        """`white` (n,) variances."""
        shares = np.repeat(LAW_NOISE.shares, len(LAW_NOISE.lengths))
        lengths = np.tile(level_lengths(t_s), len(LAW_NOISE.shares))
        levels = LevelNoise.of(white, t_s, shares, lengths)
        ladders = tuple(LadderNoise.several(white, t_s, np.array(LAW_NOISE.ladders), ladder_lengths(t_s)))
        plain = np.array([float(np.log(white).sum())])
        logs = [plain, levels.log_determinant, *(ladder.log_determinant for ladder in ladders)]
        return cls(np.sqrt(white), levels, ladders, np.concatenate(logs))

    @property
    def count(self) -> int:
        """Number of settings."""
        return int(self.log_determinant.size)

    def log_determinants(self, numbers: Numbers) -> Array:
        """(s,) of some of them."""
        return np.asarray(self.log_determinant[numbers])

    def runs(self, numbers: Numbers) -> Iterator[tuple[slice, Filter, Filter]]:
        """As in `SettingFilters`."""
        bounds = np.searchsorted(numbers, [1, LADDERS[0]])
        if bounds[0]:
            yield slice(0, 1), lambda rows: (rows / self.sigma)[None], lambda white: white / self.sigma
        at_once = max(1, LAW_NOISE.at_once // self.sigma.size)
        for i in range(bounds[0], bounds[1], at_once):
            run = slice(i, min(i + at_once, int(bounds[1])))
            made = self.levels.of_settings(numbers[run] - 1)
            yield run, made.white, made.transposed
        if ladders := [self.ladders[k] for k in numbers[bounds[1] :] - LADDERS[0]]:
            run = slice(int(bounds[1]), len(numbers))
            yield run, partial(white_by_ladders, ladders), partial(transposed_by_ladders, ladders)


@dataclass(frozen=True)
class CellFilters:
    """Those of a channel of means over cells; one at a time is made."""

    cells: CellNoise
    channel: int
    t_s: Array
    """(m,) of the cells"""

    @property
    def count(self) -> int:
        """Number of settings."""
        return int(LADDERS[-1]) + 1

    def log_determinants(self, numbers: Numbers) -> Array:
        """(s,) of some of them."""
        return np.concatenate([self._filter(number).log_determinant for number in numbers.tolist()])

    def runs(self, numbers: Numbers) -> Iterator[tuple[slice, Filter, Filter]]:
        """As in `SettingFilters`."""
        for i, number in enumerate(numbers.tolist()):
            made = self._filter(number)
            yield slice(i, i + 1), made.white, made.transposed

    def _filter(self, number: int) -> GroupedNoise:
        if not number:
            return self.cells.filter(self.channel)
        if number >= LADDERS[0]:
            variance = LAW_NOISE.ladders[number - int(LADDERS[0])]
            return self.cells.filter(self.channel, ladder_lengths(self.t_s).tolist(), variance)
        i, j = divmod(number - 1, LEVELS.shape[1])
        return self.cells.filter(self.channel, [float(level_lengths(self.t_s)[j])], LAW_NOISE.shares[i])

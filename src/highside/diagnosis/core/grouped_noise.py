"""Noise of values in groups that follow one another: correlated in any way within a group, and from group to group by
levels that forget.

Each group is whitened by the inverse of a Cholesky factor, given what the groups before it say about the levels: a
Kalman filter that takes a group at a time (Durbin and Koopman, Time Series Analysis by State Space Methods, section
4.3). Exact, at a cost that grows with the number of values times the size of a group.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from highside.arrays import Array

RIDGE = 1e-12
"""Part by which a variance is raised. Source: rounding of sums of some hundred products."""


@dataclass(frozen=True)
class LevelInGroup:
    """A level of unit variance over one group of g values: the level is known where the group begins."""

    covariance: Array
    """(g, g) of the values"""
    seen: Array
    """(g,) covariance of each value with the level where the group begins"""
    ahead: Array
    """(g,) covariance of each value with the level where the next group begins"""
    kept: float
    """covariance of the level where the next group begins with that where this one does"""


@dataclass(frozen=True)
class GroupedNoise:
    """n values in groups, beside L levels."""

    scale: float
    inverse: tuple[Array, ...]
    """(g, g) of each group, lower triangles: the inverse Cholesky factor of the covariance given the groups before"""
    seen: tuple[Array, ...]
    """(g, L) what the levels where a group begins do to its values"""
    taken: tuple[Array, ...]
    """(g, L) what its white values say of the levels where the next group begins"""
    kept: tuple[Array, ...]
    """(L,) what is left of these there"""

    @classmethod
    def of(cls, floor: Sequence[Array], levels: Sequence[Sequence[LevelInGroup]], variance: float) -> GroupedNoise:
        """Of the covariances (g, g) of each group's floor and of levels of one variance, group by group. Raises
        LinAlgError where one is no covariance."""
        from scipy.linalg.lapack import dtrtri

        spread = variance * np.eye(len(levels))
        inverse, seen, taken, kept = list[Array](), list[Array](), list[Array](), list[Array]()
        for k, own in enumerate(floor):
            mine = [level[k] for level in levels]
            a = np.stack([one.seen for one in mine], axis=1) if mine else np.zeros((len(own), 0))
            d = np.array([one.kept for one in mine])
            ahead = np.stack([one.ahead for one in mine], axis=1) if mine else a
            whole = own + a @ spread @ a.T
            for one in mine:
                whole = whole + variance * (one.covariance - np.outer(one.seen, one.seen))
            # rounding must not make of levels that are many times the floor what is no covariance
            diagonal = np.arange(len(whole))
            whole[diagonal, diagonal] *= 1.0 + RIDGE
            lower = dtrtri(np.linalg.cholesky(whole), lower=1)[0]
            of_next = a @ spread * d + variance * (ahead - a * d)
            inverse.append(lower)
            seen.append(a)
            taken.append(lower @ of_next)
            kept.append(d)
            spread = spread * np.outer(d, d) + variance * np.diag(1.0 - d**2) - taken[-1].T @ taken[-1]
        return cls(1.0, tuple(inverse), tuple(seen), tuple(taken), tuple(kept))

    def scaled(self, factor: float) -> GroupedNoise:
        """The same, so many times as large."""
        return replace(self, scale=self.scale * factor)

    @cached_property
    def size(self) -> int:
        """Numbers that are held."""
        return sum(one.size for one in self.inverse)

    @property
    def log_determinant(self) -> Array:
        """(1,) logarithm of the determinant of the covariance."""
        n = sum(len(one) for one in self.inverse)
        logs = sum(float(np.log(np.diagonal(one)).sum()) for one in self.inverse)
        return np.array([2.0 * (n * float(np.log(self.scale)) - logs)])

    def white(self, columns: Array) -> Array:
        """(1, K, n) independent unit values of columns (K, n)."""
        made = np.empty((1, *columns.shape))
        self.white_into(columns, made[0])
        return made

    def white_into(self, columns: Array, out: Array) -> None:
        """These, written to `out` (K, n)."""
        start, levels = 0, np.zeros((len(columns), len(self.kept[0])))
        for one, seen, taken, kept in zip(self.inverse, self.seen, self.taken, self.kept, strict=True):
            own = slice(start, start := start + len(one))
            white = (columns[:, own] / self.scale - levels @ seen.T) @ one.T
            out[:, own] = white
            levels = levels * kept + white @ taken

    def transposed(self, white: Array) -> Array:
        """(1, K, n) the transposed filter on whitened columns (1, K, n): with `white`, the inverse covariance times the
        columns. Back from the last group, what a level takes on is what the groups behind it take from that level."""
        made, end = np.empty(white.shape), white.shape[-1]
        behind = np.zeros((*white.shape[:-1], len(self.kept[0])))
        for k in range(len(self.inverse) - 1, -1, -1):
            own = slice(end - len(self.inverse[k]), end)
            end = own.start
            solved = (white[..., own] + behind @ self.taken[k].T) @ self.inverse[k]
            made[..., own] = solved / self.scale
            behind = behind * self.kept[k] - solved @ self.seen[k]
        return made

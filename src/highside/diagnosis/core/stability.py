"""Is the size of a claim a constant: does it agree over thirds of the session and halves of the inclinations or rates?

The columns of a claim are split by parts of the recording and each part gets a size of its own, base and the other
claims common to all. If the sizes agree, that gains nothing but chance: chi-square with the parts' own widths, as an F
test. A size that changes is no constant of the instrument, and its name does not stand; it may be a law of what it
changes with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import STABILITY
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.regression import log10_p, outside, solved, span
from highside.physics.effects import title_of
from highside.physics.state import ChainState

Parts = NDArray[np.intp]
Ints = NDArray[np.intp]


@dataclass(frozen=True)
class Stability:
    """The least stable split of a claim: its name, -log10 p, and the share of the claim's gain that it adds."""

    split: str
    log_p: float
    share: float
    factors: tuple[float, ...]
    """size in each part, in units of the size in all"""
    instead: str = ""
    """id of another effect, of which these are the sizes, that explains more in the claim's place"""
    beside_random_walk: bool = False
    """whether the size may change, or the zero offsets follow a random walk that does the same: the name stands"""
    limit: float = STABILITY.log_p
    """-log10 p from which the sizes are different; of a change that was chosen by evidence none is needed"""

    @property
    def stable(self) -> bool:
        """Whether the sizes agree to within chance, or to within what is of no matter."""
        return self.log_p < self.limit or self.share < STABILITY.share

    @property
    def words(self) -> str:
        """The sizes side by side."""
        parts = " / ".join(f"{factor:.2f}" for factor in self.factors)
        return f"its size over {self.split} is {parts} times that over all"

    def doubt_for(self, effect: str) -> str:
        """What is open of a claim that stands: its size changes, or the noise does that."""
        return (
            f"{title_of(effect)} may be no constant: {self.words}, or the zero offsets follow a random walk; its size "
            "is a mean over the session: record another one to see which"
        )

    def hint_for(self, effect: str) -> str:
        """Why an effect is no name of what is there."""
        if self.instead:
            return (
                f"{title_of(effect)} explains less than {_lower(title_of(self.instead))} would if that changes: "
                f"{self.words}"
            )
        return f"{title_of(effect)} is not the cause, for it is no constant: {self.words}"


def _lower(title: str) -> str:
    return title[0].lower() + title[1:]


def splits_of(state: ChainState) -> Mapping[str, Parts]:
    """(n,) number of the part of each row or pose, by the name of the split."""
    found = {"thirds of the session": _equal_parts(np.argsort(np.argsort(state.t_s, kind="stable")), 3)}
    for name, values in (
        ("halves of the inclinations", state.inc_rad),
        ("halves of the rates", np.abs(state.rotor_rate_radps)),
    ):
        levels = np.unique(np.round(values, STABILITY.decimals))
        if levels.size >= STABILITY.levels:
            found[name] = (values > np.median(levels)).astype(np.intp)
    return found


def _equal_parts(rank: NDArray[np.intp], count: int) -> Parts:
    return np.asarray(rank * count // rank.size, dtype=np.intp)


def stability(
    columns: Array,
    white: Callable[[Array], Array],
    others: Array,
    residual: Array,
    freedom: float,
    splits: Mapping[str, Parts],
) -> Stability | None:
    """The least stable of the splits. `columns` (k, C, n) of the claim, `white` takes (k, C, n) to (k, N); `others`
    (r, N) orthonormal: base and other claims; `residual` (N,) whitened."""
    whole = outside(others, white(columns))
    own = span(whole, tolerance=REGRESSION.visible)
    explained = float(np.sum((own @ residual) ** 2))
    if explained <= 0.0:
        return None
    size = np.linalg.lstsq(whole.T, residual, rcond=REGRESSION.visible)[0] @ columns.reshape(len(columns), -1)
    signal = size.reshape(columns.shape[1:])
    worst: Stability | None = None
    for name, part in splits.items():
        # the claim as it was fitted, with one factor for each part: few directions, so that a change stands out
        pieces = np.stack([signal * (part == k) for k in range(int(part.max()) + 1)])
        rows = outside(others, white(pieces))
        space = span(rows, tolerance=REGRESSION.visible)
        dof = len(space) - 1
        if dof < 1:
            continue
        gain = max(float(np.sum((space @ residual) ** 2)) - explained, 0.0)
        log_p = float(log10_p(np.array(gain), np.array(dof), freedom, float(len(splits))))
        factors = np.linalg.lstsq(rows.T, residual, rcond=REGRESSION.visible)[0]
        one = Stability(name, log_p, gain / explained, tuple(float(f) for f in factors))
        if worst is None or one.log_p > worst.log_p:
            worst = one
    return worst


def stability_of_inner(
    inner: Mapping[str, Array], amplitudes: int, freedom: float, excess: float = 1.0
) -> Stability | None:
    """As `stability`, where rows are known by their inner products alone: of each split (P, P, m, m) over its parts,
    (i, j) those of what is in part i with what is in part j. Of the m columns the last is the residual, before it stand
    the `amplitudes` of the claim, first base and other claims. All whitened; what the claim's size varies by between
    blocks of rows is `excess` times the variance of white noise."""
    worst: Stability | None = None
    for name, blocks in inner.items():
        whole = blocks.sum(axis=(0, 1))
        others = len(whole) - amplitudes - 1
        size = solved(whole[:-1, :-1], whole[:-1, -1])[others:]
        explained = _gain(whole, others)
        # the claim as it was fitted, in each part by itself
        across = np.tensordot(blocks[..., others:-1], size, 1)
        pieces = np.tensordot(across[..., others:-1], size, 1)
        cross = across.sum(axis=0)[:, :others].T
        moment = across.sum(axis=0)[:, -1]
        taken = solved(whole[:others, :others], np.column_stack([cross, whole[:others, -1]]))
        left = pieces - cross.T @ taken[:, :-1]
        shows = np.diag(left) > REGRESSION.visible**2 * np.maximum(np.diag(pieces), 0.0)
        dof = int(shows.sum()) - 1
        if dof < 1 or explained <= 0.0:
            continue
        factors = np.zeros(len(pieces))
        seen = (moment - cross.T @ taken[:, -1])[shows]
        factors[shows] = solved(left[np.ix_(shows, shows)], seen)
        gain = max(float(factors[shows] @ seen) - explained, 0.0)
        log_p = float(log10_p(np.array(gain / excess), np.array(dof), freedom, float(len(inner))))
        one = Stability(name, log_p, gain / explained, tuple(float(f) for f in factors))
        if worst is None or one.log_p > worst.log_p:
            worst = one
    return worst


@dataclass(frozen=True)
class Change:
    """The change of a size over the session that explains most: what claim and change explain beside all that is kept,
    what the change alone adds, and the size at the beginning, middle and end, in units of that without a change."""

    gain: float
    added: float
    factors: tuple[float, float, float]
    courses: int
    """that were tried"""
    excess: float = 1.0
    """variance of the size between blocks of rows, in those that white noise makes"""

    @property
    def log_p(self) -> float:
        """-log10 p of what the change adds."""
        return float(log10_p(np.array(self.added / self.excess), np.array(1), np.inf, float(self.courses)))

    @property
    def stability(self) -> Stability:
        """As of any other split; a change is believed from `StabilityPolicy.change_log_p` on."""
        return self._as_stability(STABILITY.change_log_p)

    @property
    def chosen(self) -> Stability:
        """As `stability`, of a change that is preferred to what is claimed by evidence: no chance is asked."""
        return self._as_stability(-np.inf)

    def _as_stability(self, limit: float) -> Stability:
        before = max(self.gain - self.added, 1e-300)
        words = "the beginning, middle and end of the session"
        return Stability(words, self.log_p, self.added / before, self.factors, limit=limit)


def best_change(blocks: Array, kept: Ints, own: Ints) -> Change | None:
    """The best change of the size of an effect, once, steadily or in a wave over the session.

    `blocks` (P, m, m) are inner products over consecutive parts, the residual last; `own` the numbers of the effect's
    columns, `kept` those of all beside it. None where it explains nothing.
    """
    whole = blocks.sum(axis=0)
    both = np.concatenate([kept, own])
    size = solved(whole[np.ix_(both, both)], whole[both, -1])[kept.size :]
    alone = explained_by(whole, both) - explained_by(whole, kept)
    if alone <= 0.0:
        return None
    courses = _courses(len(blocks))
    across = np.tensordot(blocks[:, own], size, (1, 0))
    square = across[:, own] @ size
    rows = courses @ across
    taken = solved(whole[np.ix_(both, both)], np.column_stack([rows[:, both].T, whole[both, -1]]))
    bare = courses**2 @ square
    left = bare - np.sum(rows[:, both] * taken[:, :-1].T, axis=1)
    shows = left > REGRESSION.visible**2 * bare
    amount = np.where(shows, rows[:, -1] - rows[:, both] @ taken[:, -1], 0.0) / np.where(shows, left, 1.0)
    added = amount**2 * left * shows
    best = int(np.argmax(added))
    course = 1.0 + amount[best] * (courses[best] - courses[best].mean())
    factors = (float(course[0]), float(course[course.size // 2]), float(course[-1]))
    return Change(alone + float(added[best]), float(added[best]), factors, len(courses))


def _courses(count: int) -> Array:
    """(K, count) how a size may go over so many parts of a session: it steps between two of them, it rises steadily, or
    follows one wave of any phase."""
    steps = np.arange(count) >= np.arange(1, count)[:, None]
    middle = (np.arange(count) + 0.5) / count
    phases = np.pi * np.arange(STABILITY.wave_phases) / STABILITY.wave_phases
    waves = np.cos(2 * np.pi * middle - phases[:, None])
    return np.concatenate([steps.astype(float), (np.arange(count) / (count - 1))[None], waves])


def explained_by(inner: Array, which: Ints) -> float:
    """Chi-square that columns explain of the last."""
    return float(inner[which, -1] @ solved(inner[np.ix_(which, which)], inner[which, -1]))


def _gain(inner: Array, others: int) -> float:
    """Chi-square that the columns beyond the first explain of the last, outside of the first."""
    return explained_by(inner, np.arange(len(inner) - 1)) - explained_by(inner, np.arange(others))

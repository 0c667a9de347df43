"""A Kalman filter, and beside it what every hypothesis of a departure would have done to its innovations.

The filter knows of no departure. If the state took a step `size x direction` at some onset, its errors and innovations
have a mean that is linear in `size`: one column `D` (N,) a hypothesis and onset carries the mean of the error, and

    s = L^-1 H D,   information += s's,   score += s'e,   D -= K H D,

with e the whitened innovations and L their root (Willsky and Jones 1976). `score^2 / information` is twice the
log-likelihood ratio at the best size `score / information`. A drift begins with a column of zeros, to which each hour
adds `direction`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.watch.mixture import Mixture
from highside.watch.parameters import AXES, GRAVITY, INDEX, KT, KV, MATRIX, OFFSETS, SIZE, S
from highside.watch.policy import WatchPolicy

__all__ = ["HYPOTHESES", "Bank", "Filter", "Hypothesis", "Scored", "Update"]


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One way to depart. `direction` (N,) of the state; `onsets`: whether it may begin at any time, or only with the
    watch; `drifts`: grows by `direction` an hour."""

    name: str
    effect: str
    """of the library of `diagnose`; `site_gravity` is none of the tool"""
    unit: str
    direction: tuple[float, ...]
    onsets: bool = True
    drifts: bool = False


def _unit(*places: int) -> tuple[float, ...]:
    return tuple(1.0 if i in places else 0.0 for i in range(SIZE))


def _hypotheses() -> tuple[Hypothesis, ...]:
    steps = [Hypothesis(name, "bias_step", "g", _unit(INDEX[name])) for name in OFFSETS]
    for name in MATRIX:
        effect = "scale" if name[2] == name[3] else "misalignment"
        steps += [Hypothesis(name, effect, "g/g", _unit(INDEX[name]))]
    steps.append(Hypothesis("S_all", "reference_voltage", "g/g", _unit(S, S + 4, S + 8)))
    # a coefficient is what it is from the start: one "from now on" would be a step of the offset by another name
    rest = [Hypothesis("gravity", "site_gravity", "g/g", _unit(GRAVITY), onsets=False)]
    for k, axis in enumerate(AXES):
        rest.append(Hypothesis(f"kT_{axis}", "temperature_bias", "g/degC", _unit(KT + k), onsets=False))
        rest.append(Hypothesis(f"kV_{axis}", "axis_vibration_rectification", "g/g^2", _unit(KV + k), onsets=False))
    drifts = [Hypothesis(f"drift_{i}", "bias_drift", "g/h", _unit(INDEX[f"b_{i}"]), drifts=True) for i in AXES]
    return (*steps, *rest, *drifts)


HYPOTHESES = _hypotheses()
"""all that is tested; a claim names one of these, or a class of them"""


class Update(NamedTuple):
    """One measurement in the filter: `H` (M, N), gain (N, M), root (M, M) of the innovations' covariance, whitened
    innovations (M,)."""

    H: Array
    gain: Array
    root: Array
    innovations: Array


@dataclass(slots=True)
class Filter:
    """State (N,) and covariance (N, N), without any departure."""

    state: Array
    covariance: Array
    process_noise: Array
    """growth of the covariance per hour"""
    walked: Array = field(init=False)
    """(N, N) the part of the covariance that the random walk has made, through the same gains"""

    def __post_init__(self) -> None:
        """Nothing has walked yet."""
        self.walked = np.zeros_like(self.covariance)

    def wait(self, hours: float) -> None:
        """Let time pass."""
        self.covariance = self.covariance + self.process_noise * hours
        self.walked = self.walked + self.process_noise * hours

    def innovations(self, y: Array, H: Array) -> Array:
        """(M,) whitened, that `take` would have."""
        root = np.linalg.cholesky(H @ self.covariance @ H.T + np.eye(y.size))
        return np.asarray(np.linalg.solve(root, y - H @ self.state), dtype=np.float64)

    def take(self, y: Array, H: Array) -> Update:
        """A measurement `y = H x + e` with e of unit variance."""
        PH = self.covariance @ H.T
        root = np.asarray(np.linalg.cholesky(H @ PH + np.eye(y.size)), dtype=np.float64)
        half = np.linalg.solve(root, PH.T).T
        innovations = np.asarray(np.linalg.solve(root, y - H @ self.state), dtype=np.float64)
        self.state = self.state + half @ innovations
        covariance = self.covariance - half @ half.T
        self.covariance = 0.5 * (covariance + covariance.T)
        gain = np.linalg.solve(root.T, half.T).T
        left = np.eye(self.state.size) - gain @ H
        walked = left @ self.walked @ left.T
        self.walked = 0.5 * (walked + walked.T)
        return Update(H, gain, root, innovations)


@dataclass(frozen=True, slots=True)
class Scored:
    """A hypothesis at an onset: twice its log-likelihood ratio, size and standard deviation, and when it began."""

    hypothesis: Hypothesis
    ratio: float
    size: float
    std: float
    since_s: float
    squares: float
    """of the whitened innovations since then, less what it explains of them"""
    numbers: int
    """how many they are"""

    def leaves_more(self, policy: WatchPolicy) -> bool:
        """Whether what it leaves is more than noise as it was expected."""
        chance = policy.left_sigmas * np.sqrt(2.0 * self.numbers)
        return self.numbers > 0 and bool(self.squares > policy.left_ratio * self.numbers + chance)


class Bank:
    """Columns of all hypotheses and onsets."""

    def __init__(self, policy: WatchPolicy) -> None:
        self._policy = policy
        everywhere = [k for k, h in enumerate(HYPOTHESES) if h.onsets]
        directions = np.array([HYPOTHESES[k].direction for k in everywhere]).T
        drifting = np.array([HYPOTHESES[k].drifts for k in everywhere])
        self._new = directions * ~drifting
        self._new_of = np.array(everywhere, dtype=np.intp)
        self._ramps = [(int(k), directions[:, k]) for k in np.flatnonzero(drifting)]
        """of the columns of one onset those that grow, and by what an hour"""
        first = [k for k, h in enumerate(HYPOTHESES) if not h.onsets]
        self._D = np.array([HYPOTHESES[k].direction for k in first]).T
        self._of: NDArray[np.intp] = np.array(first, dtype=np.intp)
        self._since = np.zeros(len(first))
        self._information = np.zeros(len(first))
        self._score = np.zeros(len(first))
        self._since_mark = np.zeros((2, len(first)))
        """information and score since `mark`"""
        self._all = np.zeros((2, len(first)))
        """sum of squares of the innovations since the onset, and how many they are"""
        self._first = len(first)
        self.begun = False

    def wait(self, hours: float) -> None:
        """Let drifts grow, each from its onset on."""
        width = self._new_of.size
        for column, ramp in self._ramps:
            self._D[:, self._first + column :: width] += (ramp * hours)[:, None]

    def begin(self, t_s: float) -> None:
        """From here on all steps may have happened, and all drifts have begun. Onsets that are no longer recent are
        thinned to `WatchPolicy.onset_s`, one at a time."""
        if not self.begun:
            self._since[: self._first] = t_s
        self.begun = True
        width = self._new_of.size
        drop: slice | None = None
        if (leaves := self._leaving(t_s)) is not None:
            drop = slice(self._first + leaves * width, self._first + (leaves + 1) * width)
        for name, new in (
            ("_D", self._new),
            ("_of", self._new_of),
            ("_since", np.full(width, t_s)),
            ("_information", np.zeros(width)),
            ("_score", np.zeros(width)),
            ("_since_mark", np.zeros((2, width))),
            ("_all", np.zeros((2, width))),
        ):
            held = getattr(self, name)
            if drop is not None:
                held = np.delete(held, drop, axis=-1)
            setattr(self, name, np.concatenate([held, new], axis=-1))

    def _leaving(self, t_s: float) -> int | None:
        """Which onset makes room for one at `t_s`; never the first, which is that of the watch, nor one at which what
        departs may have begun: a large step that lacks its own onset is read with a wrong size at the one beside it."""
        onsets, policy = self._since[self._first :: self._new_of.size], self._policy
        close = np.diff(onsets) < policy.onset_s
        old = close & (onsets[1:] < t_s - policy.recent_s)
        if old.any():
            ratio = self._ratios()[0]
            best = ratio.max()
            if best > policy.threshold:
                likeliest = ratio[self._first :].reshape(onsets.size, -1).max(axis=1)
                old &= likeliest[1:] < best - 2.0 * policy.same_class
        if old.any():
            return int(np.argmax(old)) + 1
        return 1 if onsets.size >= policy.most_onsets else None

    def take(self, update: Update) -> None:
        """What one measurement says of all."""
        seen = update.H @ self._D
        signature = np.linalg.solve(update.root, seen)
        information, score = np.einsum("mc,mc->c", signature, signature), update.innovations @ signature
        self._information += information
        self._score += score
        self._since_mark += np.stack([information, score])
        self._all += np.array([[update.innovations @ update.innovations], [update.innovations.size]])
        self._D -= update.gain @ seen

    def mark(self) -> None:
        """From the next measurement on `explained` counts."""
        self._since_mark = np.zeros((2, self._of.size))

    def explained(self) -> float:
        """By how much the best hypothesis lessens the sum of squares of the innovations since `mark`: of those within
        `WatchPolicy.same_class` of the best of all, each with the size that all it has seen gives it."""
        ratio, size = self._ratios()
        near = (ratio > 0.0) & (ratio >= ratio.max(initial=0.0) - self._policy.same_class)
        information, score = self._since_mark[:, near]
        return float((2.0 * size[near] * score - size[near] ** 2 * information).max(initial=0.0))

    def memory(self) -> dict[str, Array]:
        """All it has gathered, in numbers: for `recall`."""
        return {
            "D": self._D.copy(),
            "of": self._of.astype(float),
            "since": self._since.copy(),
            "information": self._information.copy(),
            "score": self._score.copy(),
            "all": self._all.copy(),
        }

    def recall(self, memory: Mapping[str, Array]) -> None:
        """Go on from a `memory`. Raises ValueError for one that is none of this bank's."""
        of = memory["of"].astype(np.intp)
        width, first = self._new_of.size, self._first
        count = of.size
        shapes = {"D": (SIZE, count), "of": (count,)}
        shapes |= dict.fromkeys(("since", "information", "score"), (count,))
        # one of before what is left was counted has none: it is counted from here on, and looks smaller than it is
        shapes |= {"all": (2, count)} if "all" in memory else {}
        if any(memory[name].shape != shape for name, shape in shapes.items()):
            raise ValueError("columns that do not fit one another")
        onsets, rest = divmod(count - first, width)
        expected = np.concatenate([self._of[:first], np.tile(self._new_of, max(onsets, 0))])
        if count < first or rest or not np.array_equal(of, expected):
            raise ValueError("columns of other hypotheses")
        if not np.all(memory["information"] >= 0.0):
            raise ValueError("information below zero")
        self._all = memory["all"].copy() if "all" in memory else np.zeros((2, count))
        if not (self._all >= 0.0).all():
            raise ValueError("what is left of the innovations is none")
        self._of = of
        self._D = memory["D"].copy()
        self._since = memory["since"].copy()
        self._information, self._score = memory["information"].copy(), memory["score"].copy()
        self.mark()
        self.begun = onsets > 0

    def best(self) -> list[Scored]:
        """Of each hypothesis its best onset, the likeliest first. One that needs a size beyond reason is left out."""
        ratio, size = self._ratios()
        out = []
        for k, hypothesis in enumerate(HYPOTHESES):
            own = np.flatnonzero(self._of == k)
            if own.size == 0:
                continue
            at = int(own[np.argmax(ratio[own])])
            if ratio[at] > 0.0:
                std = float(1.0 / np.sqrt(self._information[at]))
                squares, numbers = self._all[:, at]
                out.append(
                    Scored(
                        hypothesis=hypothesis,
                        ratio=float(ratio[at]),
                        size=float(size[at]),
                        std=std,
                        since_s=float(self._since[at]),
                        squares=float(squares - ratio[at]),
                        numbers=int(numbers),
                    )
                )
        return sorted(out, key=lambda one: -one.ratio)

    def mixture(self) -> Mixture | None:
        """All hypotheses and onsets by their likelihood; None where none of a reasonable size explains anything."""
        ratio, size = self._ratios()
        std = 1.0 / np.sqrt(np.maximum(self._information, 1e-300))
        return Mixture.of_columns(self._of, self._spans(), ratio, size, std, self._D)

    def _spans(self) -> Array:
        """Of each column the share of the watch's time in which what it says may have begun: a step is seen at the
        first onset after it; what came before the watch is taken for as likely as in one such span."""
        onsets = self._since[self._first :: self._new_of.size]
        spans = np.ones(self._first + self._new_of.size * onsets.size)
        steps = np.diff(onsets)
        if steps.size and (steps > 0.0).all():
            each = np.concatenate([[np.median(steps)], steps])
            spans[self._first :] = np.repeat(each / each.sum(), self._new_of.size)
        return spans

    def largest(self) -> float:
        """Twice the log-likelihood ratio of the best."""
        return float(self._ratios()[0].max(initial=0.0))

    def speaks_against(self) -> bool:
        """Whether what has been seen by now speaks against any departure that was said before. Not where no hypothesis
        of a reasonable size explains it any more, or one alone does not."""
        if not 0.0 < self.largest() < self._policy.taken_back * self._policy.threshold:
            return False
        return not self.best()[0].leaves_more(self._policy)

    def information_of(self, name: str, since_s: float) -> float:
        """1 / variance of the size of a hypothesis, from its first onset at `since_s` or later; 0: none."""
        own = np.flatnonzero((self._since >= since_s) | (np.arange(self._of.size) < self._first))
        own = own[[HYPOTHESES[k].name == name for k in self._of[own]]]
        return float(self._information[own[np.argmin(self._since[own])]]) if own.size else 0.0

    def onsets_of(self, best: Scored, within: float) -> tuple[float, float]:
        """Between which times, s, the same hypothesis explains the innovations within `within` of the best: from the
        last onset before, since a step is seen at the first one after it."""
        ratio, _ = self._ratios()
        mine = self._of == HYPOTHESES.index(best.hypothesis)
        near = self._since[mine & (ratio >= best.ratio - within)]
        earlier = self._since[mine & (self._since < near.min())]
        return float(earlier.max(initial=-np.inf)) if earlier.size else float(near.min()), float(near.max())

    def _ratios(self) -> tuple[Array, Array]:
        seen = self._information > 0.0
        size = np.divide(self._score, self._information, out=np.zeros_like(self._score), where=seen)
        ratio = size * self._score
        ratio[np.abs(size) > self._policy.largest] = 0.0
        return ratio, size

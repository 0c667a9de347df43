"""The course of readings while poses are held: one function of the time since the last move, its size in each pose.

A course is a sum of known functions of that time with weights; less its mean in each pose it has one amplitude per pose
and channel. Of a decay the function is given; a free course is learnt: weights and amplitudes in turn (alternating
least squares), the amplitudes being simple functions of the load. Whether a course is there is judged on poses that it
was not learnt from, against a straight line, so that neither its freedom nor a noise that is slower than it looks from
row to row makes one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.laws.since_move_policy import LAW_COURSE
from highside.physics.law import Axis
from highside.physics.law_functions import Function

Ints = NDArray[np.intp]
SINCE = "time_since_move"


@dataclass(frozen=True)
class HeldRows:
    """Rows of n poses: readings `accel` (3, N) in g at times `t_s` (N,), and the numbers of each pose's rows."""

    accel: Array
    t_s: Array
    rows: Sequence[Ints]

    def since(self, pose: int) -> Array:
        """(L,) s since the first row of a pose."""
        own = self.t_s[self.rows[pose]]
        return np.asarray(own - own[0])

    @cached_property
    def longest_s(self) -> float:
        """Of the longest pose."""
        return max(float(self.since(k)[-1]) for k in range(len(self.rows)))


@dataclass(frozen=True)
class Course:
    """The sum of the functions of an axis of the time since the last move with weights (K,), known to a covariance
    (K, K)."""

    axis: Axis
    weights: Array
    covariance: Array


def of_unit_size(course: Course, held: HeldRows) -> Course:
    """A course whose rms over all rows, less its means, is one: what its amplitudes are is the rms in g."""
    power = Sums.of(held, course.axis).amplitudes(course.weights)[1]
    size = float(np.sqrt(power.sum() / sum(r.size for r in held.rows)))
    return Course(course.axis, course.weights / size, course.covariance / size**2)


def decay_course(tau_s: float, longest_s: float) -> Course:
    """exp(-s / tau) over poses of up to this length."""
    axis = Axis(SINCE, 0.0, longest_s, (Function("decay", (0.0, tau_s)),))
    return Course(axis, np.ones(1), np.zeros((1, 1)))


@dataclass(frozen=True)
class Sums:
    """What the rows of n poses say of K functions: `gram` (n, K, K) of the functions less their means in the pose, and
    `moments` (3, n, K) of the readings with them."""

    gram: Array
    moments: Array

    @classmethod
    def of(cls, held: HeldRows, axis: Axis) -> Sums:
        """Of the functions of an axis."""
        gram, moments = [], []
        for pose, rows in enumerate(held.rows):
            functions = less_mean(axis.basis(held.since(pose)))
            gram.append(functions @ functions.T)
            moments.append(held.accel[:, rows] @ functions.T)
        return cls(np.stack(gram), np.stack(moments, axis=1))

    def amplitudes(self, weights: Array) -> tuple[Array, Array]:
        """(3, n) size of a course in each pose and channel, g, and (n,) the power of the course there."""
        power = np.einsum("k,nkj,j->n", weights, self.gram, weights)
        power = np.maximum(power, np.finfo(float).tiny)
        return self.moments @ weights / power, power

    def subset(self, poses: Ints) -> Sums:
        """Of these poses."""
        return Sums(self.gram[poses], self.moments[:, poses])


def course_beyond(held: HeldRows, sigma: Array, simple: Array, other: Course | None) -> Course | None:
    """A course that predicts poses it was not learnt from better than a straight line and than another course do; None
    where none does. `sigma` (3,) is the noise of a row, `simple` (3, k, n) what an amplitude may follow."""
    line = Axis(SINCE, 0.0, held.longest_s, (Function("straight"),))
    rivals = [_predicted(Sums.of(held, line), sigma, simple)]
    if other is not None:
        rivals.append(_predicted(Sums.of(held, other.axis), sigma, simple))
    best = max(rivals, key=lambda gains: float(gains.sum()))
    found, gains = None, best
    rows = max(r.size for r in held.rows)
    for count in range(2, min(LAW_COURSE.most, rows - 1) + 1):
        axis = _smooth(held.longest_s, count)
        own = _predicted(Sums.of(held, axis), sigma, simple)
        if own.sum() > gains.sum() + (LAW_COURSE.finer if found else 0.0):
            found, gains = axis, own
    ahead = gains - np.maximum(best, 0.0)
    spread = float(ahead.std(ddof=1)) * np.sqrt(ahead.size)
    if found is None or ahead.sum() < max(LAW_COURSE.gain, LAW_COURSE.sure * spread):
        return None
    sums = Sums.of(held, found)
    weights, amplitudes = _learnt(sums, sigma, simple)
    precision = np.einsum("cn,nkj->kj", (amplitudes / sigma[:, None]) ** 2, sums.gram)
    return Course(found, weights, np.linalg.pinv(precision, hermitian=True))


def course_in_common(held: HeldRows, simple: Array) -> list[tuple[Array, float]]:
    """Of each channel what all poses go through alike: (N,) g at the rows, each pose's mean off, with as many bends as
    a free course may have and amplitudes that are simple functions (3, k, n); and the share of all that is free of the
    rows which that takes up. Nothing where it would take up more than `LAW_COURSE.share`."""
    rows = sum(r.size for r in held.rows)
    axis = _smooth(held.longest_s, min(LAW_COURSE.most, max(r.size for r in held.rows) - 1))
    sums, found = Sums.of(held, axis), []
    for own, moments in zip(simple, sums.moments, strict=True):
        # of each function of the time times each of what an amplitude may follow
        gram = np.einsum("jn,mn,nab->ajbm", own, own, sums.gram)
        size, turn = np.linalg.eigh(gram.reshape(2 * (len(own) * len(axis.functions),)))
        turn, size = turn[:, size > LAW_COURSE.rank * size[-1]], size[size > LAW_COURSE.rank * size[-1]]
        share = size.size / (rows - len(held.rows))
        fitted = np.zeros(held.accel.shape[1])
        if share <= LAW_COURSE.share:
            sizes = turn @ ((turn.T @ np.einsum("jn,na->aj", own, moments).reshape(-1)) / size)
            weights = sizes.reshape(-1, len(own)) @ own
            for pose, r in enumerate(held.rows):
                fitted[r] = weights[:, pose] @ less_mean(axis.basis(held.since(pose)))
        found.append((fitted, share if share <= LAW_COURSE.share else 0.0))
    return found


def less_mean(values: Array) -> Array:
    """(k, L) less the mean of each over L."""
    return np.asarray(values - values.mean(axis=1, keepdims=True))


def _smooth(longest_s: float, count: int) -> Axis:
    return Axis(SINCE, 0.0, longest_s, tuple(Function("wide_cosine", (float(k),)) for k in range(1, count + 1)))


def _predicted(sums: Sums, sigma: Array, simple: Array) -> Array:
    """(n,) nats by which a course with what its amplitudes follow, both learnt from other poses, predicts the rows of
    each pose better than a constant does."""
    n = sums.gram.shape[0]
    fold = np.arange(n) % LAW_COURSE.folds
    gains = np.zeros(n)
    for k in range(LAW_COURSE.folds):
        learnt, kept = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        weights, amplitudes = _learnt(sums.subset(learnt), sigma, simple[:, :, learnt])
        _, power = sums.subset(learnt).amplitudes(weights)
        follows = _follow(amplitudes, power, simple[:, :, learnt])
        told = np.einsum("ck,ckn->cn", follows, simple[:, :, kept])
        seen, power = sums.subset(kept).amplitudes(weights)
        gains[kept] = np.sum(power * (told * seen - 0.5 * told**2) / sigma[:, None] ** 2, axis=0)
    return gains


def _follow(amplitudes: Array, power: Array, simple: Array) -> Array:
    """(3, k) coefficients of amplitudes (3, n) in simple functions, each pose counted by the power of its course."""
    root = np.sqrt(power)
    return np.stack(
        [
            np.linalg.lstsq((one * root).T, value * root, rcond=LAW_COURSE.rank)[0]
            for value, one in zip(amplitudes, simple, strict=True)
        ]
    )


def _learnt(sums: Sums, sigma: Array, simple: Array) -> tuple[Array, Array]:
    """Weights (K,) of a course and its amplitudes (3, n), as what they follow tells them."""
    weights = _first(sums, sigma, simple)
    for turn in range(LAW_COURSE.turns):
        amplitudes, power = sums.amplitudes(weights)
        amplitudes = np.einsum("ck,ckn->cn", _follow(amplitudes, power, simple), simple)
        if turn == LAW_COURSE.turns - 1 or weights.size == 1:
            break
        own = amplitudes / sigma[:, None] ** 2
        gram = np.einsum("cn,cn,nkj->kj", amplitudes, own, sums.gram)
        weights = np.linalg.lstsq(gram, np.einsum("cn,cnk->k", own, sums.moments), rcond=LAW_COURSE.rank)[0]
    return weights, np.asarray(amplitudes)


def _first(sums: Sums, sigma: Array, simple: Array) -> Array:
    """(K,) the course that the poses have in common when they are added up as one simple function of one channel says:
    of all these the one that explains most."""
    best, gain = np.eye(sums.gram.shape[-1])[0], 0.0
    for functions, moments, noise in zip(simple, sums.moments, sigma, strict=True):
        for size in functions:
            gram, moment = np.einsum("n,nkj->kj", size**2, sums.gram), size @ moments
            weights = np.linalg.lstsq(gram, moment, rcond=LAW_COURSE.rank)[0]
            explained = float(moment @ weights) / noise**2
            if explained > gain:
                best, gain = weights, explained
    return np.asarray(best)

"""Which candidates the data ask for: family-wise calibrated tests, forward steps by held-out likelihood, swaps, drops.

A candidate passes where its F test is rarer than what the family of all candidates shows by chance in 1 % of sessions.
That threshold is taken from the rich residual with the signs of contiguous blocks flipped (all channels of a block
together, so that their correlation stays), and is never lower than Bonferroni's. Among those that pass, the best gain
of likelihood on held-out blocks wins; then each member is compared with each non-member by BIC until nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.candidates import Candidate
from highside.diagnosis.regression import VISIBLE, Race, log10_p, outside

Array = NDArray[np.float64]

ALARM_RATE = 0.01
FLIPS = 300
BLOCK_POSES = 6
MAX_CLAIMS = 4
HALF = 2 * np.log(2)
"""Gain of an amplitude of known sign: half of what one of either sign might have been has been ruled out."""
ROUNDING = 1e-6
"""Gains that differ by less are equal: of these that which stands first in the library is chosen."""
REMEMBERS = 6.6
"""Gain of chi-square that one direction has by chance in 1 % of cases: a slack that remembers must be better by as much
than one that does not, which it becomes where the tool hardly ever turns back."""
MERGE_BIC = 6.0
STARTS = 4
"""Candidates from each of which choosing begins."""
PROMISING = 0.3
"""Share of the first choice's gain of BIC from which choosing is begun from another candidate as well."""
HELD = 0.01
"""Share of an effect's energy outside of another, below which it is a case of that other."""
SHORTLIST = 4
TRANSIENT = 0.1
"""Share of a member's energy outside of a block, below which the other blocks say nothing of it."""


@dataclass(frozen=True, slots=True)
class Member:
    """A candidate at one of its variants."""

    candidate: int
    variant: int


class Pool:
    """All variants of all candidates in units of the noise."""

    def __init__(self, candidates: Sequence[Candidate], blocks: Sequence[Array]) -> None:
        self.candidates = list(candidates)
        self.blocks = list(blocks)
        self.members = [Member(i, j) for i, c in enumerate(candidates) for j in range(len(c.variants))]
        self.owner = np.array([m.candidate for m in self.members], dtype=np.intp)
        self.tries = np.maximum(
            np.bincount(self.owner, minlength=len(self.candidates)), [c.searched for c in candidates]
        ).astype(float)
        self.race = Race(self.blocks)
        self.one_sided = [
            i for i, m in enumerate(self.members) if _one_sided(self.candidates[m.candidate]) and len(blocks[i]) == 1
        ]
        sizes = [_known_size(self.candidates[m.candidate]) for m in self.members]
        self.known = [(i, size) for i, size in enumerate(sizes) if size is not None]
        self._index = {member: i for i, member in enumerate(self.members)}

    def columns(self, member: Member) -> Array:
        """(k, N), whitened."""
        return self.blocks[self._index[member]]

    def whole(self, member: Member) -> Member:
        """The variant of the same shape in which all amplitudes act; of what has no name each stands for itself."""
        if not self.candidates[member.candidate].named:
            return member
        variants = self.candidates[member.candidate].variants
        shape = variants[member.variant].shape
        of_it = (j for j, v in enumerate(variants) if v.whole and v.shape == shape)
        return Member(member.candidate, next(of_it, member.variant))

    def stack(self, members: Sequence[Member]) -> Array:
        """Columns of several members, (K, N)."""
        if not members:
            return np.empty((0, self.blocks[0].shape[1]))
        return np.vstack([self.columns(member) for member in members])


def _one_sided(candidate: Candidate) -> bool:
    """Whether the only amplitude of an effect cannot be negative."""
    if candidate.effect is None or len(candidate.amplitudes) != 1:
        return False
    return next(p.gate[0] for p in candidate.effect.parameters if not p.shape) == 0.0


def _known_size(candidate: Candidate) -> float | None:
    """The only amplitude that an effect may have."""
    effect = candidate.effect
    if effect is None or not effect.known_size or len(candidate.amplitudes) != 1:
        return None
    return next(p.typical for p in effect.parameters if not p.shape)


@dataclass(frozen=True)
class Standing:
    """Every candidate at its best variant after what is already explained; arrays (candidates,)."""

    best: list[Member]
    gain: Array
    dof: Array
    log_p: Array
    """-log10 p with the number of shapes counted in"""
    bic: Array
    """gain of BIC from adding it; positive is better"""


def standing(pool: Pool, space: Array, residual: Array, freedom: float, size: int) -> Standing:
    """Run the race for one residual (N,) outside of `space`; `size` is the number of readings."""
    gains, dof = pool.race.run(space, residual[None])
    gain = gains[:, 0]
    for i in pool.one_sided:
        # an amplitude that cannot be negative explains nothing by being so
        if float(outside(space, pool.blocks[i])[0] @ residual) < 0:
            gain[i] = 0.0
        else:
            # of two slacks that lag alike the one that need not remember is the simpler
            effect = pool.candidates[pool.members[i].candidate].effect
            gain[i] = max(0.0, gain[i] + (HALF if effect is not None and effect.complex_safe else -REMEMBERS))
    for i, amplitude in pool.known:
        # taken as large as it must be, not as large as would suit
        bare = amplitude * outside(space, pool.blocks[i])[0]
        gain[i] = max(0.0, float(2 * bare @ residual - bare @ bare))
    score = gain - dof * np.log(size)
    best: list[Member] = []
    picked = np.zeros(len(pool.candidates), dtype=np.intp)
    for k in range(len(pool.candidates)):
        own = np.flatnonzero(pool.owner == k)
        picked[k] = own[np.argmax(score[own])]
        best.append(pool.members[picked[k]])
    return Standing(
        best,
        gain[picked],
        dof[picked].astype(float),
        log10_p(gain[picked], dof[picked], freedom, pool.tries),
        score[picked] - 2 * np.log(pool.tries),
    )


def threshold(race: Race, owner: NDArray[np.intp], chance: Array, space: Array, freedom: Array | float) -> float:
    """-log10 p that the family exceeds by chance in 1 % of sessions; `chance` (B, N) are residuals of nothing.

    `freedom` is one for all, or one for each variant.
    """
    gains, dof = race.run(space, chance)
    each = np.broadcast_to(np.asarray(freedom, dtype=float), owner.shape)
    families = np.unique(owner)
    worst = np.zeros(len(chance))
    for family in families:
        own = owner == family
        for k in np.unique(dof[own]):
            same = own & (dof == k)
            tries = float(own.sum())
            worst = np.maximum(worst, log10_p(gains[same].max(axis=0), np.array(k), float(each[same].min()), tries))
    return max(float(np.quantile(worst, 1 - ALARM_RATE)), float(-np.log10(ALARM_RATE / families.size)))


def pose_flips(rich: Array, rng: np.random.Generator, channels: int = 3) -> Array:
    """(FLIPS, C n) rich residuals (C n,) with the signs of blocks of poses flipped."""
    n = rich.size // channels
    block = np.arange(n) // BLOCK_POSES
    signs = rng.choice([-1.0, 1.0], size=(FLIPS, int(block[-1]) + 1))[:, block]
    return np.asarray(rich * np.tile(signs, (1, channels)))


class Gains(Protocol):
    """Held-out likelihood of the claims."""

    def gain(self, before: Sequence[Member], after: Sequence[Member]) -> tuple[float, float]:
        """Gain of log likelihood by going from some members to others, and its standard error over blocks."""
        ...


class HeldOut:
    """Prediction of contiguous blocks from the rest, whitened; `base` (P, N) columns fitted always."""

    def __init__(self, base: Array, residual: Array, folds: Sequence[NDArray[np.intp]]) -> None:
        self._base, self._residual, self._folds = base, residual, folds

    def hides(self, columns: Array) -> bool:
        """Whether leaving out one of the blocks leaves next to nothing of columns (K, N)."""
        energy = np.sum(columns**2, axis=0)
        return bool(max(energy[fold].sum() for fold in self._folds) > (1 - TRANSIENT) * energy.sum())

    def errors(self, columns: Array) -> list[Array]:
        """Prediction errors of each fold with these columns (K, N) fitted beside the base."""
        every = np.vstack([self._base, columns])
        norm = np.linalg.norm(every, axis=1, keepdims=True)
        every = every / np.where(norm > 0, norm, 1.0)
        gram, moment = every @ every.T, every @ self._residual
        result = []
        for fold in self._folds:
            part = every[:, fold]
            left = gram - part @ part.T
            # what the other blocks hardly determine is not extrapolated
            ridge = 1e-9 * np.eye(left.shape[0])
            solution = np.linalg.solve(left + ridge, moment - part @ self._residual[fold])
            result.append(self._residual[fold] - solution @ part)
        return result


@dataclass(frozen=True)
class PoseGains:
    """Held-out likelihood of members of a pool, from their whitened columns.

    What lives within one block cannot be predicted from the others: with such a member the blocks of `apart`, of every
    so many poses, are left out instead.
    """

    pool: Pool
    held_out: HeldOut
    apart: HeldOut | None = None

    def gain(self, before: Sequence[Member], after: Sequence[Member]) -> tuple[float, float]:
        held_out = self.held_out
        if self.apart is not None and any(held_out.hides(self.pool.columns(m)) for m in {*before, *after}):
            held_out = self.apart
        pairs = [held_out.errors(self.pool.stack(members)) for members in (before, after)]
        return block_gain(*(np.array([float(e @ e) for e in errors]) for errors in pairs))


def block_gain(before: Array, after: Array) -> tuple[float, float]:
    """Gain of log likelihood and its standard error from the squared errors of each block."""
    by_block = (before - after) / 2
    return float(by_block.sum()), float(by_block.std(ddof=1) * np.sqrt(by_block.size))


def gain_interval(before: Array, after: Array) -> tuple[float, float]:
    """95 % interval of the share of the squared error that is removed, from the squared errors of each block (B,)."""
    left = float(after.sum() / before.sum())
    # of a ratio of sums, to first order
    error = float((after - left * before).std(ddof=1) * np.sqrt(before.size) / before.sum())
    return 1.0 - left - 1.96 * error, 1.0 - left + 1.96 * error


def pose_folds(n: int, count: int = 10, *, interleaved: bool = False) -> list[NDArray[np.intp]]:
    """Contiguous blocks of poses, or every so many poses, as indices into whitened vectors (3 n,)."""
    count = min(count, n // 3)
    poses = np.arange(n)
    parts = [poses[k::count] for k in range(count)] if interleaved else np.array_split(poses, count)
    return [np.concatenate([part, part + n, part + 2 * n]) for part in parts]


@dataclass(frozen=True)
class Selector:
    """Everything that choosing needs: candidates, the base's space, the residual, the threshold."""

    pool: Pool
    base: Array
    """(r, N) orthonormal"""
    residual: Array
    freedom: float
    threshold: float
    held_out: Gains
    size: int
    """number of readings, for BIC"""
    fixed: tuple[Member, ...] = ()
    """claims that were made before and stay"""
    banned: frozenset[int] = frozenset()
    """candidates that may not be chosen"""
    most: int = MAX_CLAIMS
    """claims at which choosing ends"""
    starts: int = 1
    """candidates from each of which choosing begins; the cheapest in BIC and names is kept"""
    told: int = MAX_CLAIMS
    """names that are told at most: another beginning that leads to more, where the first does not, is no better"""
    opposed: bool = False
    """whether two are sought that cancel one another, where none is asked for by itself"""

    def space_with(self, members: Sequence[Member]) -> Array:
        """Base and members."""
        return span_with(self.base, self.pool.stack(members))

    def standing(self, members: Sequence[Member]) -> Standing:
        """All candidates after base and members."""
        return standing(self.pool, self.space_with(members), self.residual, self.freedom, self.size)

    def select(self) -> list[Member]:
        """The claims, in the order in which they were found."""
        found = self._grown(list(self.fixed))
        if self.starts > 1 and len(found) > len(self.fixed):
            # one that stands between two true ones is found before them, and no single exchange leads on from it
            others = [m for m in self._from_others(found) if len(m) <= max(self.told, len(found))]
            grown = [found, *others]
            found = min(grown, key=lambda members: self._cost(members) + MERGE_BIC * len(members))
        return self._merged(found)

    def _grown(self, members: list[Member]) -> list[Member]:
        """Members with what is asked for beside them."""
        seen = {frozenset(members)}
        while len(members) < self.most:
            step = self._forward(members)
            steps = [step] if step is not None else self._forward_two(members)
            if not steps and self.opposed:
                steps = self._opposed(members)
            if not steps or len(members) + len(steps) > self.most:
                break
            members = self._settle([*members, *steps])
            if frozenset(members) in seen:
                # what was added is let go again, and would be for ever
                break
            seen.add(frozenset(members))
        return members

    def _from_others(self, found: Sequence[Member]) -> list[list[Member]]:
        """What grows from candidates that are not the first choice, if that is more than themselves."""
        now = self.standing(self.fixed)
        taken = {m.candidate for m in self.fixed} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        passing = [k for k in passing if now.bic[k] > PROMISING * now.bic[passing[0]]]
        grown = []
        for k in passing[: self.starts]:
            begun = [*self.fixed, now.best[k]]
            step = self._forward(begun) if now.best[k] not in found and len(begun) < self.most else None
            if step is not None:
                grown.append(self._grown(self._settle([*begun, step])))
        return grown

    def _merged(self, members: list[Member]) -> list[Member]:
        """One name instead of two where another variant of the one explains nearly what both do, or holds all of both.

        An effect that was let act in part leaves a rest, which something else may then be found to explain. What is
        asked for beside the very same variant is no such rest, however many amplitudes BIC charges for it.
        """
        for kept in members:
            for dropped in members:
                if kept == dropped or {kept, dropped} & set(self.fixed):
                    continue
                others = [m for m in members if m not in (kept, dropped)]
                variants = [m for m in self.pool.members if m.candidate == kept.candidate]
                score, best = min((self._cost([*others, m]), i) for i, m in enumerate(variants))
                asked = variants[best] == kept and self._asked([*others, kept], dropped)
                if score < self._cost(members) + MERGE_BIC and not asked:
                    return self._merged([*others, variants[best]])
                whole = self.pool.whole(kept)
                if whole != kept and self._holds([*others, whole], dropped):
                    return self._merged([*others, whole])
        return members

    def _asked(self, members: Sequence[Member], other: Member) -> bool:
        """Whether a candidate passes beside members."""
        return bool(self.standing(members).log_p[other.candidate] > self.threshold)

    def _holds(self, members: Sequence[Member], dropped: Member) -> bool:
        """Whether next to nothing of what the dropped could explain lies outside of members."""
        columns = self.pool.columns(dropped)
        bare, left = (outside(self.space_with(some), columns) for some in ([], members))
        return bool(np.sum(left**2) < HELD * np.sum(bare**2))

    def _cost(self, members: Sequence[Member]) -> float:
        """BIC of members: what they leave, their directions, and how many shapes were tried for each."""
        space = self.space_with(members)
        left = outside(space, self.residual)
        directions = (len(space) - len(self.base)) * float(np.log(self.size))
        return float(left @ left) + directions + float(sum(2 * np.log(self.pool.tries[m.candidate]) for m in members))

    def _forward(self, members: list[Member]) -> Member | None:
        now = self.standing(members)
        taken = {m.candidate for m in members} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        best: tuple[float, Member] | None = None
        for k in passing[:SHORTLIST]:
            gain, error = self.held_out.gain(members, [*members, now.best[k]])
            if gain > error and (best is None or gain > best[0] + ROUNDING):
                best = (gain, now.best[k])
        return best[1] if best else None

    def _forward_two(self, members: list[Member]) -> list[Member] | None:
        """Two at once, where one passes that predicts nothing by itself: what opposes it may be there as well."""
        now = self.standing(members)
        taken = {m.candidate for m in members} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        best: tuple[float, list[Member]] | None = None
        for k in passing[:SHORTLIST]:
            first = now.best[k]
            beside = self.standing([*members, first])
            score = np.where(np.isin(np.arange(beside.bic.size), [*taken, k]), -np.inf, beside.bic)
            other = ranked(score)[0]
            if not beside.log_p[other] > self.threshold:
                continue
            two = [first, beside.best[other]]
            gain, error = self.held_out.gain(members, [*members, *two])
            if gain > error and (best is None or gain > best[0] + ROUNDING):
                best = (gain, two)
        return best[1] if best else None

    def _opposed(self, members: list[Member]) -> list[Member] | None:
        """Two that cancel one another so far that none passes alone: each must pass beside the other.

        As any of the candidates may be the first of them, each must pass a threshold that is so many times as rare.
        """
        taken = {m.candidate for m in members} | self.banned
        free = [k for k, c in enumerate(self.pool.candidates) if c.named and k not in taken]
        if not free:
            return None
        limit = self.threshold + float(np.log10(len(free)))
        now = self.standing(members)
        best: tuple[float, list[Member]] | None = None
        for k in free:
            first = self.pool.whole(now.best[k])
            beside = self.standing([*members, first])
            other = max((i for i in free if i != k), key=lambda i: beside.bic[i], default=k)
            if other == k or not beside.log_p[other] > limit:
                continue
            back = self.standing([*members, beside.best[other]])
            two = [back.best[k], beside.best[other]]
            cost = self._cost([*members, *two])
            if back.log_p[k] > limit and (best is None or cost < best[0] - ROUNDING):
                best = (cost, two)
        if best is None:
            return None
        gain, error = self.held_out.gain(members, [*members, *best[1]])
        return best[1] if gain > error else None

    def _settle(self, members: list[Member]) -> list[Member]:
        """Swap a member for a better candidate, or drop it where it is not needed any more, until stable."""
        for _ in range(8):
            changed = False
            for member in members:
                if member in self.fixed:
                    continue
                others = [m for m in members if m != member]
                now = self.standing(others)
                taken = {m.candidate for m in others} | self.banned
                score = np.where(np.isin(np.arange(now.bic.size), list(taken)), -np.inf, now.bic)
                k = ranked(score)[0]
                own = now.log_p[member.candidate]
                if now.log_p[k] > self.threshold and score[k] > now.bic[member.candidate] + 1e-6:
                    members, changed = [*others, now.best[k]], True
                elif own <= self.threshold and len(members) > 1:
                    members, changed = others, True
                elif now.best[member.candidate] != member:
                    members, changed = [*others, now.best[member.candidate]], True
                if changed:
                    break
            if not changed:
                break
        return members


def ranked(score: Array) -> list[int]:
    """Numbers of scores, best first; of equal ones (but for rounding) the one that stands first in the library."""
    return [int(k) for k in np.argsort(-np.round(score, 3), kind="stable")]


def span_with(base: Array, columns: Array) -> Array:
    """Orthonormal basis of an orthonormal base and further columns."""
    if columns.shape[0] == 0:
        return base
    norm = np.linalg.norm(columns, axis=1, keepdims=True)
    bare = outside(base, columns / np.where(norm > 0, norm, 1.0))
    values, vectors = np.linalg.eigh(bare @ bare.T)
    good = values > VISIBLE**2
    added = (vectors[:, good] / np.sqrt(values[good])).T @ bare
    return np.vstack([base, outside(base, added)])

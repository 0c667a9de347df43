"""Which candidates the data ask for: family-wise calibrated tests, forward steps by held-out likelihood, swaps, drops.

A candidate passes where its F test is rarer than what the family of all candidates shows by chance in 1 % of sessions.
That threshold is taken from the rich residual with the signs of contiguous blocks flipped (all channels of a block
together, so that their correlation stays), and is never lower than Bonferroni's. Among those that pass, the best gain
of likelihood on held-out blocks wins; then each member is compared with each non-member by BIC until nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.held_out import Gains
from highside.diagnosis.core.policy import SELECTION
from highside.diagnosis.core.pool import Member, Pool, Standing, ranked, span_with, standing
from highside.diagnosis.core.regression import outside


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
    most: int = SELECTION.most
    """claims at which choosing ends"""
    starts: int = 1
    """candidates from each of which choosing begins; the cheapest in BIC and names is kept"""
    told: int = SELECTION.most
    """names that are told at most: another beginning that leads to more, where the first does not, is no better"""
    opposed: bool = False
    """whether two are sought that cancel one another, where none is asked for by itself"""
    known: dict[frozenset[Member], Standing] = field(default_factory=dict)
    """standings beside members that were asked for before"""

    def space_with(self, members: Sequence[Member]) -> Array:
        """Base and members."""
        return span_with(self.base, self.pool.stack(members))

    def standing(self, members: Sequence[Member]) -> Standing:
        """All candidates after base and members."""
        which = frozenset(members)
        if which not in self.known:
            self.known[which] = standing(self.pool, self.space_with(members), self.residual, self.freedom, self.size)
        return self.known[which]

    def select(self) -> list[Member]:
        """The claims, in the order in which they were found."""
        found = self._grown(list(self.fixed))
        if self.starts > 1 and len(found) > len(self.fixed):
            # one that stands between two true ones is found before them, and no single exchange leads on from it
            others = [m for m in self._from_others(found) if len(m) <= max(self.told, len(found))]
            grown = [found, *others]
            found = min(grown, key=lambda members: self._cost(members) + SELECTION.merge_bic * len(members))
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
        passing = [k for k in passing if now.bic[k] > SELECTION.promising * now.bic[passing[0]]]
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
                if score < self._cost(members) + SELECTION.merge_bic and not asked:
                    return self._merged([*others, variants[best]])
                whole = self.pool.whole(kept)
                if whole != kept and self.holds([*others, whole], dropped):
                    return self._merged([*others, whole])
        return members

    def _asked(self, members: Sequence[Member], other: Member) -> bool:
        """Whether a candidate passes beside members."""
        return bool(self.standing(members).log_p[other.candidate] > self.threshold)

    def holds(self, members: Sequence[Member], dropped: Member) -> bool:
        """Whether next to nothing of what the dropped could explain lies outside of members."""
        columns = self.pool.columns(dropped)
        bare, left = (outside(self.space_with(some), columns) for some in ([], members))
        return bool(np.sum(left**2) < SELECTION.held * np.sum(bare**2))

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
        for k in passing[: SELECTION.shortlist]:
            gain, error = self.held_out.gain(members, [*members, now.best[k]])
            if gain > error and (best is None or gain > best[0] + SELECTION.rounding):
                best = (gain, now.best[k])
        return best[1] if best else None

    def _forward_two(self, members: list[Member]) -> list[Member] | None:
        """Two at once, where one passes that predicts nothing by itself: what opposes it may be there as well."""
        now = self.standing(members)
        taken = {m.candidate for m in members} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        best: tuple[float, list[Member]] | None = None
        for k in passing[: SELECTION.shortlist]:
            first = now.best[k]
            beside = self.standing([*members, first])
            score = np.where(np.isin(np.arange(beside.bic.size), [*taken, k]), -np.inf, beside.bic)
            other = ranked(score)[0]
            if not beside.log_p[other] > self.threshold:
                continue
            two = [first, beside.best[other]]
            gain, error = self.held_out.gain(members, [*members, *two])
            if gain > error and (best is None or gain > best[0] + SELECTION.rounding):
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
            if back.log_p[k] > limit and (best is None or cost < best[0] - SELECTION.rounding):
                best = (cost, two)
        if best is None:
            return None
        gain, error = self.held_out.gain(members, [*members, *best[1]])
        return best[1] if gain > error else None

    def _settle(self, members: list[Member]) -> list[Member]:
        """Swap a member for a better candidate, or drop it where it is not needed any more, until stable."""
        for _ in range(SELECTION.swaps):
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
                if now.log_p[k] > self.threshold and score[k] > now.bic[member.candidate] + SELECTION.rounding:
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

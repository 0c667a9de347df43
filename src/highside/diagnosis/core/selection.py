"""Which candidates the data require: family-wise calibrated tests, forward steps by held-out likelihood, swaps, drops.

A candidate passes where its F test is rarer than what the family of all candidates shows by chance in 1 % of sessions.
That threshold is taken from the rich residual with the signs of contiguous blocks flipped (all channels of a block
together, so that their correlation stays), and is never lower than Bonferroni's. Among those that pass, the best gain
of likelihood on held-out blocks wins; then each term is compared with each non-term by BIC until nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import CandidateSet, Ranking, Term, ranked, ranking, span_with
from highside.diagnosis.core.held_out import Gains
from highside.diagnosis.core.policy import SELECTION
from highside.diagnosis.core.regression import outside


@dataclass(frozen=True)
class Selector:
    """Everything that choosing needs: candidates, the base's space, the residual, the threshold."""

    candidate_set: CandidateSet
    base: Array
    """(r, N) orthonormal"""
    residual: Array
    freedom: float
    threshold: float
    held_out: Gains
    size: int
    """number of readings, for BIC"""
    fixed: tuple[Term, ...] = ()
    """claims that were made before and stay"""
    banned: frozenset[int] = frozenset()
    """candidates that may not be chosen"""
    most: int = SELECTION.most
    """claims at which choosing ends"""
    starts: int = 1
    """candidates from each of which choosing begins; the cheapest in BIC and names is kept"""
    most_named: int = SELECTION.most
    """names that are reported at most: another beginning that leads to more, where the first does not, is no better"""
    opposed: bool = False
    """whether two are sought that cancel one another, where none is required by itself"""
    known: dict[frozenset[Term], Ranking] = field(default_factory=dict)
    """rankings beside terms that were computed before"""

    def space_with(self, terms: Sequence[Term]) -> Array:
        """Base and terms."""
        return span_with(self.base, self.candidate_set.stack(terms))

    def ranking(self, terms: Sequence[Term]) -> Ranking:
        """All candidates after base and terms."""
        which = frozenset(terms)
        if which not in self.known:
            self.known[which] = ranking(
                self.candidate_set, self.space_with(terms), self.residual, self.freedom, self.size
            )
        return self.known[which]

    def select(self) -> list[Term]:
        """The claims, in the order in which they were found."""
        found = self._grown(list(self.fixed))
        if self.starts > 1 and len(found) > len(self.fixed):
            # one that stands between two true ones is found before them, and no single exchange leads on from it
            others = [m for m in self._from_others(found) if len(m) <= max(self.most_named, len(found))]
            grown = [found, *others]
            found = min(grown, key=lambda terms: self._cost(terms) + SELECTION.merge_bic * len(terms))
        return self._merged(found)

    def _grown(self, terms: list[Term]) -> list[Term]:
        """Terms with what is required beside them."""
        visited = {frozenset(terms)}
        while len(terms) < self.most:
            step = self._forward(terms)
            steps = [step] if step is not None else self._forward_two(terms)
            if not steps and self.opposed:
                steps = self._opposed(terms)
            if not steps or len(terms) + len(steps) > self.most:
                break
            terms = self._settle([*terms, *steps])
            if frozenset(terms) in visited:
                # what was added is let go again, and would be for ever
                break
            visited.add(frozenset(terms))
        return terms

    def _from_others(self, found: Sequence[Term]) -> list[list[Term]]:
        """What grows from candidates that are not the first choice, if that is more than themselves."""
        now = self.ranking(self.fixed)
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

    def _merged(self, terms: list[Term]) -> list[Term]:
        """One name instead of two where another variant of the one explains nearly what both do, or holds all of both,
        or where a third explains as much.

        An effect that was let act in part leaves a rest, which something else may then be found to explain. What is
        required beside the very same variant is no such rest, however many amplitudes BIC charges for it.
        """
        for kept in terms:
            for dropped in terms:
                if kept == dropped or {kept, dropped} & set(self.fixed):
                    continue
                others = [m for m in terms if m not in (kept, dropped)]
                variants = [m for m in self.candidate_set.terms if m.candidate == kept.candidate]
                score, best = min((self._cost([*others, m]), i) for i, m in enumerate(variants))
                needed = variants[best] == kept and self._needed([*others, kept], dropped)
                if score < self._cost(terms) + SELECTION.merge_bic and not needed:
                    return self._merged([*others, variants[best]])
                other = self._one_for_two(others, kept, dropped)
                if other is not None and self._cost([*others, other]) < self._cost(terms) - SELECTION.rounding:
                    return self._merged([*others, other])
                whole = self.candidate_set.whole(kept)
                if whole != kept and self.holds([*others, whole], dropped):
                    return self._merged([*others, whole])
        return terms

    def _one_for_two(self, others: list[Term], one: Term, other: Term) -> Term | None:
        """The candidate that explains most in the place of two, that is neither of them."""
        now = self.ranking(others)
        taken = [m.candidate for m in (*others, one, other)]
        score = np.where(np.isin(np.arange(now.bic.size), [*taken, *self.banned]), -np.inf, now.bic)
        k = ranked(score)[0]
        return now.best[k] if np.isfinite(score[k]) and now.log_p[k] > self.threshold else None

    def _needed(self, terms: Sequence[Term], other: Term) -> bool:
        """Whether a candidate passes beside terms."""
        return bool(self.ranking(terms).log_p[other.candidate] > self.threshold)

    def holds(self, terms: Sequence[Term], dropped: Term) -> bool:
        """Whether next to nothing of what the dropped could explain lies outside of terms."""
        columns = self.candidate_set.columns(dropped)
        bare, left = (outside(self.space_with(subset), columns) for subset in ([], terms))
        return bool(np.sum(left**2) < SELECTION.held * np.sum(bare**2))

    def _cost(self, terms: Sequence[Term]) -> float:
        """BIC of terms: what they leave, their directions, and how many shapes were tried for each."""
        space = self.space_with(terms)
        left = outside(space, self.residual)
        directions = (len(space) - len(self.base)) * float(np.log(self.size))
        return (
            float(left @ left)
            + directions
            + float(sum(2 * np.log(self.candidate_set.tries[m.candidate]) for m in terms))
        )

    def _forward(self, terms: list[Term]) -> Term | None:
        now = self.ranking(terms)
        taken = {m.candidate for m in terms} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        best: tuple[float, Term] | None = None
        for k in passing[: SELECTION.shortlist]:
            gain, error = self.held_out.gain(terms, [*terms, now.best[k]])
            if gain > error and (best is None or gain > best[0] + SELECTION.rounding):
                best = (gain, now.best[k])
        return best[1] if best else None

    def _forward_two(self, terms: list[Term]) -> list[Term] | None:
        """Two at once, where one passes that predicts nothing by itself: what opposes it may be there as well."""
        now = self.ranking(terms)
        taken = {m.candidate for m in terms} | self.banned
        passing = [k for k in ranked(now.bic) if now.log_p[k] > self.threshold and k not in taken]
        best: tuple[float, list[Term]] | None = None
        for k in passing[: SELECTION.shortlist]:
            first = now.best[k]
            beside = self.ranking([*terms, first])
            score = np.where(np.isin(np.arange(beside.bic.size), [*taken, k]), -np.inf, beside.bic)
            other = ranked(score)[0]
            if not beside.log_p[other] > self.threshold:
                continue
            two = [first, beside.best[other]]
            gain, error = self.held_out.gain(terms, [*terms, *two])
            if gain > error and (best is None or gain > best[0] + SELECTION.rounding):
                best = (gain, two)
        return best[1] if best else None

    def _opposed(self, terms: list[Term]) -> list[Term] | None:
        """Two that cancel one another so far that none passes alone: each must pass beside the other.

        As any of the candidates may be the first of them, each must pass a threshold that is so many times as rare.
        """
        taken = {m.candidate for m in terms} | self.banned
        free = [k for k, c in enumerate(self.candidate_set.candidates) if c.named and k not in taken]
        if not free:
            return None
        limit = self.threshold + float(np.log10(len(free)))
        now = self.ranking(terms)
        best: tuple[float, list[Term]] | None = None
        for k in free:
            first = self.candidate_set.whole(now.best[k])
            beside = self.ranking([*terms, first])
            other = max((i for i in free if i != k), key=lambda i: beside.bic[i], default=k)
            if other == k or not beside.log_p[other] > limit:
                continue
            back = self.ranking([*terms, beside.best[other]])
            two = [back.best[k], beside.best[other]]
            cost = self._cost([*terms, *two])
            if back.log_p[k] > limit and (best is None or cost < best[0] - SELECTION.rounding):
                best = (cost, two)
        if best is None:
            return None
        gain, error = self.held_out.gain(terms, [*terms, *best[1]])
        return best[1] if gain > error else None

    def _settle(self, terms: list[Term]) -> list[Term]:
        """Swap a term for a better candidate, or drop it where it is not needed any more, until stable."""
        for _ in range(SELECTION.swaps):
            changed = False
            for term in terms:
                if term in self.fixed:
                    continue
                others = [m for m in terms if m != term]
                now = self.ranking(others)
                taken = {m.candidate for m in others} | self.banned
                score = np.where(np.isin(np.arange(now.bic.size), list(taken)), -np.inf, now.bic)
                k = ranked(score)[0]
                own = now.log_p[term.candidate]
                if now.log_p[k] > self.threshold and score[k] > now.bic[term.candidate] + SELECTION.rounding:
                    terms, changed = [*others, now.best[k]], True
                elif own <= self.threshold and len(terms) > 1:
                    terms, changed = others, True
                elif now.best[term.candidate] != term:
                    terms, changed = [*others, now.best[term.candidate]], True
                if changed:
                    break
            if not changed:
                break
        return terms

"""Where rows are known by inner products: is a claim there because the size of something changes over the session?

What a size does that changes is often given to something else: to a second claim that is slow, to a random walk, to a
name that is not the right one. So each claim is compared with effects whose size changes once or steadily, beside all
that is claimed otherwise and without any memory of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.finding_policy import STABILITY
from highside.diagnosis.core.memory import Channel
from highside.diagnosis.core.policy import RIVALS
from highside.diagnosis.core.problem import SelectionState
from highside.diagnosis.core.stability import Change, Stability, best_change, explained_by
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.gram import inner_by_parts
from highside.diagnosis.rows.inner_products import InnerProducts
from highside.diagnosis.rows.noise import RotationNoise, with_random_walk

Ints = NDArray[np.intp]


class RowsKnown(Protocol):
    """What is needed of a problem of rows."""

    @property
    def candidates(self) -> list[Candidate]: ...
    @property
    def products(self) -> InnerProducts: ...
    @property
    def design(self) -> Design: ...
    @property
    def noise(self) -> RotationNoise: ...
    @property
    def slow_ids(self) -> frozenset[str]: ...
    def numbers_of(self, term: Term) -> Ints: ...
    def likelihoods(self, terms: Sequence[Term]) -> list[Channel]: ...


def changing_instead(problem: RowsKnown, selection: SelectionState[RotationNoise], term: Term) -> Stability | None:
    """How the size of a claim changes, or that of what explains more in its place if its size may change; None where
    a constant explains as much. Where a random walk explains more than the change does, the claim stands in doubt."""
    others = [o for o in selection.terms if o != term]
    limit = memory_of_claim(problem, selection, term)
    gain = _explained(problem, others, [term])
    own = change_of(problem, others, term)
    if own is not None and own.added >= STABILITY.share * gain:
        if own.log_p > STABILITY.change_log_p and not limit:
            return own.stability
        if limit and own.added > limit - RIVALS.same_class_bic:
            # the random walk takes what a change of the size explains as well
            return own.chosen
    for other in others:
        # another claim takes it
        rest = [o for o in others if o != other]
        instead = change_of(problem, rest, term)
        if instead is None or instead.added < STABILITY.share * gain:
            continue
        claimed = _explained(problem, rest, [term, other]) - _cost(problem, selection, other)
        if instead.gain - _cost_of(selection, instead) > claimed - RIVALS.same_class_bic:
            return instead.chosen
    if limit or term.candidate in {k for k, c in enumerate(problem.candidates) if c.id in problem.slow_ids}:
        another = _another(problem, selection, others, term, gain + limit - _cost(problem, selection, term))
        if another is not None:
            return another
    if own is not None and limit and own.added >= STABILITY.share * gain and own.log_p > STABILITY.change_log_p:
        # a walk that explains more than the change does may be what the change leaves: which, one session cannot tell
        return replace(own.stability, limit=np.inf, beside_random_walk=True)
    return None


def _another(
    problem: RowsKnown, selection: SelectionState[RotationNoise], others: list[Term], term: Term, claimed: float
) -> Stability | None:
    """An effect that explains more in a slow claim's place, memory and all, if its size may change."""
    best: tuple[float, Stability] | None = None
    taken = {o.candidate for o in [*others, term]}
    for k, rival in enumerate(selection.selector.ranking(others).best):
        effect = problem.candidates[k].effect
        if k in taken or effect is None or any(shape.epoch for shape in effect.shapes):
            # what begins at a time of its own, and changes after, is any transient
            continue
        change = change_of(problem, others, rival)
        if change is None or change.added < STABILITY.share * change.gain:
            continue
        ahead = change.gain - _cost_of(selection, change) - _cost(problem, selection, rival) - claimed
        if ahead > max(RIVALS.same_class_bic, best[0] if best else 0.0):
            best = (ahead, replace(change.chosen, instead=problem.candidates[k].id))
    return best[1] if best else None


def memory_of_claim(problem: RowsKnown, selection: SelectionState[RotationNoise], term: Term) -> float:
    """-2 log likelihood that the memory gains beside the claims on the channels of one of them."""
    if not any(memory.upper for memory in selection.noise.memories):
        return 0.0
    shown = np.flatnonzero(np.any(problem.design.where[problem.numbers_of(term)] >= 0, axis=0))
    channels = problem.likelihoods(selection.terms)
    return float(sum(channels[int(c)].memory(np.empty(0, dtype=np.intp)).gain for c in shown))


def _blocks(problem: RowsKnown, terms: list[Term]) -> tuple[Array, list[Ints]]:
    """(P, m, m) inner products over consecutive parts of base, terms and residual, and where the columns of base and
    each term stand."""
    parts = [problem.design.base, *(problem.numbers_of(o) for o in terms)]
    numbers = np.concatenate(parts).astype(np.intp)
    white = with_random_walk(problem.noise, [])
    found = inner_by_parts(
        problem.design, problem.products.grams, problem.products.segments, numbers, lambda key: key[0], white
    )
    ends = np.cumsum([0, *(part.size for part in parts)])
    places = [np.arange(a, b) for a, b in pairwise(ends)]
    return np.stack([found[k, k] for k in range(len(found))]), places


def change_of(problem: RowsKnown, beside: list[Term], term: Term) -> Change | None:
    """The best change of the size of a term over the session, beside others and without any memory."""
    blocks, places = _blocks(problem, [*beside, term])
    return best_change(blocks, np.concatenate(places[:-1]), places[-1])


def _explained(problem: RowsKnown, beside: list[Term], terms: list[Term]) -> float:
    """Chi-square that terms explain beside others."""
    blocks, places = _blocks(problem, [*beside, *terms])
    whole = blocks.sum(axis=0)
    return explained_by(whole, np.concatenate(places)) - explained_by(whole, np.concatenate(places[: 1 + len(beside)]))


def _cost(problem: RowsKnown, selection: SelectionState[RotationNoise], term: Term) -> float:
    """What a claim costs in BIC."""
    tries = float(selection.selector.candidate_set.tries[term.candidate])
    return float(np.log(selection.selector.size)) * problem.numbers_of(term).size + 2 * float(np.log(tries))


def _cost_of(selection: SelectionState[RotationNoise], change: Change) -> float:
    """What one change of a size costs."""
    return float(np.log(selection.selector.size)) + 2 * float(np.log(change.courses))

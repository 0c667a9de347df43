"""Beside another program's output: is the size of a claim a constant of the instrument?

What is left there is not white, so by how much a size varies is learned from its second differences between
neighbouring blocks of rows, which no slow change of it reaches. A small claim beside a large one takes up what is left
of it here and there: it is dropped where its size changes, and the large one stands.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.policy import REGRESSION, RIVALS
from highside.diagnosis.core.problem import SelectionState
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.regression import solved
from highside.diagnosis.core.shares import shares_of
from highside.diagnosis.core.stability import Stability
from highside.diagnosis.rows.changing import RowsKnown, change_of, memory_of_claim
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE


class Constancies(RowsKnown, Protocol):
    """What is needed of a problem of rows beside a prediction."""

    @property
    def session(self) -> RotationSession: ...
    @property
    def residual(self) -> Array: ...
    @property
    def policy(self) -> ProblemPolicy: ...
    def over_parts(
        self, selection: SelectionState[RotationNoise], term: Term, excess: float = 1.0
    ) -> Stability | None: ...
    def stability(self, selection: SelectionState[RotationNoise], term: Term) -> Stability | None: ...
    def inner_products(self, numbers: NDArray[np.intp]) -> tuple[Array, Array]: ...


def stability_beside(problem: Constancies, selection: SelectionState[RotationNoise], term: Term) -> Stability | None:
    """Whether the size of a claim is a constant; no other name is compared in its place.

    What the library does not hold of another program's output departs by more than any of them.
    """
    excess = _excess(problem, selection, term)
    found = problem.over_parts(selection, term, excess)
    if found is None or not found.stable:
        return found
    change = change_of(problem, [o for o in selection.terms if o != term], term)
    if change is None:
        return found
    change = replace(change, excess=excess)
    random_walk = memory_of_claim(problem, selection, term)
    if not random_walk:
        return found if change.stability.stable else change.stability
    # the random walk takes what a change of the size explains as well
    instead = change.added / excess > random_walk - RIVALS.same_class_bic and not change.chosen.stable
    return change.chosen if instead else found


def steady_terms(
    problem: Constancies, selection: SelectionState[RotationNoise], terms: list[Term]
) -> tuple[list[Term], dict[str, Stability]]:
    """The terms without small ones whose sizes change, and how these do, by id; all where more than that changes."""
    kept, dropped, lost = list(terms), dict[str, Stability](), 0.0
    while len(kept) > 1:
        now = replace(selection, terms=kept)
        weights = shares_of(selection.selector, kept)
        found = [(float(w), m, problem.stability(now, m)) for w, m in zip(weights, kept, strict=True)]
        changing = [(w, m, s) for w, m, s in found if s is not None and not s.stable]
        if not changing:
            return kept, dropped
        share, term, steady = min(changing, key=lambda one: one[0])
        lost += share * (1.0 - lost)
        if lost > 1.0 - problem.policy.named_share:
            break
        kept, dropped = [m for m in kept if m != term], {**dropped, problem.candidates[term.candidate].id: steady}
    return (terms, {}) if lost > 1.0 - problem.policy.named_share else (kept, dropped)


def _excess(problem: Constancies, selection: SelectionState[RotationNoise], term: Term) -> float:
    """By how many times the noise between blocks of rows moves a claim's size more than white noise would, at least
    once: from second differences of the size between blocks, which no slow change of it reaches."""
    others = [problem.design.base, *(problem.numbers_of(o) for o in selection.terms if o != term)]
    own = problem.numbers_of(term)
    numbers = np.concatenate([*others, own]).astype(np.intp)
    gram, moment = problem.inner_products(numbers)
    first, sizes = numbers.size - own.size, solved(gram, moment)
    claim = gram[:, first:] @ sizes[first:]
    direction = np.concatenate([-solved(gram[:first, :first], claim[:first]), sizes[first:]])
    flip = problem.products.segments.flip
    starts = np.flatnonzero(np.diff(flip, prepend=-1))
    score, energy = np.zeros(starts.size), np.zeros(starts.size)
    for c, functions in enumerate(problem.design.functions(slice(0, problem.session.n), problem.residual)):
        at = problem.design.where[numbers, c]
        rows = functions[np.append(at[at >= 0], -1)]
        white = problem.noise.whiten(c, rows, slice(0, problem.session.n))
        along, left = direction[at >= 0] @ white[:-1], white[-1] - sizes[at >= 0] @ white[:-1]
        score += np.add.reduceat(along * left, starts)
        energy += np.add.reduceat(along**2, starts)
    kept = energy > REGRESSION.visible * energy.max(initial=0.0)
    if kept.sum() < SIMULATION_CHOICE.least_blocks:
        return 1.0
    size, variance = score[kept] / energy[kept], 1 / energy[kept]
    curvature = size[:-2] - 2 * size[1:-1] + size[2:]
    expected = variance[:-2] + 4 * variance[1:-1] + variance[2:]
    return max(1.0, float(np.median(curvature**2 / expected)) / SIMULATION_CHOICE.median_of_squares)

"""Which of the effects that were chosen are more than the remainder of a stronger one.

Of an effect that is a thousand times its noise, what no formula has exactly is still significant, and some name or
other explains a part of it. Such a name explains little of all, and of what the others leave no more than a part: an
effect without which a large misfit is left, and with which no more than noise, is none of that, however little it
explains of all. So the factor of the rates shows beside a motion that runs fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.memory import SlowEffect
from highside.diagnosis.core.problem import SelectionState
from highside.diagnosis.core.problem_policy import ProblemPolicy
from highside.diagnosis.core.rivals import rivalry
from highside.diagnosis.core.shares import gain_of, shares_of
from highside.diagnosis.rows.gram import Gram, RandomWalkGrams
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.simulation.constants import is_one_motion
from highside.diagnosis.simulation.design import SimulationDesign
from highside.diagnosis.simulation.policy import SIMULATION_CHOICE
from highside.diagnosis.simulation.session import SKEW
from highside.physics.channel_effect import OnChannels
from highside.physics.effects.gyro_scale import EFFECT as GYRO_SCALE


class Chosen(Protocol):
    """What is needed of a recording beside a prediction."""

    @property
    def design(self) -> SimulationDesign: ...
    @property
    def candidates(self) -> list[Candidate]: ...
    @property
    def policy(self) -> ProblemPolicy: ...
    @property
    def grams(self) -> list[Gram]: ...
    @property
    def random_walks(self) -> list[RandomWalkGrams]: ...
    def slow(self) -> list[SlowEffect]: ...
    def fit(self, terms: Sequence[Term], noise: RotationNoise) -> JointFit: ...


def more_than_remainders(
    problem: Chosen, selection: SelectionState[RotationNoise], terms: Sequence[Term]
) -> list[Term]:
    """The terms without those that explain no more than a part of what a stronger one leaves."""
    selector = selection.selector
    # beside a clock that was moved what a formula lacks looks like another delay, and no further effect
    moved = any(problem.candidates[m.candidate].id in problem.design.tangents for m in terms)
    beyond = max(_whole(problem, selection.noise) - selector.size, 0.0)
    kept, total = list(terms), gain_of(selector, terms)
    for term in reversed(terms):
        candidate = problem.candidates[term.candidate]
        delay = isinstance(candidate.effect, OnChannels) and candidate.effect.relinearised
        least = SIMULATION_CHOICE.least_named if candidate.named else SIMULATION_CHOICE.least_product
        if moved and isinstance(candidate.effect, OnChannels) and not delay:
            least *= SIMULATION_CHOICE.beside_clock
        others = [m for m in kept if m != term]
        without = gain_of(selector, others)
        own = gain_of(selector, kept) - without
        # a small delay beside a large one is what that lacks, however much of it
        to_the_noise = candidate.named and not delay and own > problem.policy.named_share * (beyond - without)
        small = total - without < least * total and not to_the_noise
        if others and small and not _of_the_motion(problem, selection, kept, term):
            kept = others
    return kept


def _of_the_motion(
    problem: Chosen, selection: SelectionState[RotationNoise], terms: Sequence[Term], term: Term
) -> bool:
    """Whether a term is the factor of the rates beside a motion that runs fast or slow by as much: no remainder has the
    size of what leaves it."""
    names = {problem.candidates[m.candidate].id for m in terms}
    if problem.candidates[term.candidate].id != GYRO_SCALE.id or SKEW not in names:
        return False
    found = problem.fit(terms, selection.noise).parameters
    return is_one_motion(found[SKEW]["eps"], found[GYRO_SCALE.id])


def without_doubtful(problem: Chosen, selection: SelectionState[RotationNoise], terms: Sequence[Term]) -> list[Term]:
    """The terms without small ones that a product without a name does as well: such a one is no name, and no reason to
    give none of the others."""
    kept, lost = list(terms), 0.0
    slow = {s.candidate for s in problem.slow()}
    unnamed = np.array([not c.named for c in problem.candidates])
    while len(kept) > 1:
        weights = shares_of(selection.selector, kept)
        doubtful = [
            (float(w), m)
            for w, m in zip(weights, kept, strict=True)
            if m.candidate not in slow
            and problem.candidates[m.candidate].named
            and lost + float(w) <= 1.0 - problem.policy.named_share
            and np.any(rivalry(selection.selector, kept, m).delta_bic[unnamed] < problem.policy.interaction_margin)
        ]
        if not doubtful:
            break
        share, term = min(doubtful, key=lambda one: one[0])
        lost += share
        kept = [m for m in kept if m != term]
    return kept


def _whole(problem: Chosen, noise: RotationNoise) -> float:
    """Energy of all rows beside the base in units of the noise, what no column reaches too."""
    found = 0.0
    for c, gram in enumerate(problem.grams):
        memory = noise.memories[c] if c < len(noise.memories) else None
        total = gram.total if memory is None or memory.upper == 0.0 else problem.random_walks[c].under(memory)
        found += float(total[-1, -1])
    return found

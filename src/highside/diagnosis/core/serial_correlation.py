"""Whether noise is serially correlated: colour, a random walk of an offset, or an effect of time or temperature that
beats a random walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import Generic

import numpy as np

from highside.arrays import AnyArray
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.memory import (
    Channel,
    Memory,
    SlowScore,
    SlowStage,
    beats_random_walk,
    plain_level,
    slow_effects,
    slow_scores,
)
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.problem import N, Problem, SelectionState
from highside.diagnosis.core.selection import Selector

RANDOM_WALK = "random_walk"
"""what stands for the length of its memory in `diagnosis.json`"""


@dataclass(frozen=True)
class SerialCorrelation(Generic[N]):
    """What is known of memory in the noise: whitening to judge by, whether offsets follow a random walk, slow effects
    that beat the random walk, and the ids of those that come near."""

    noise: N
    memories: list[Memory]
    random_walk: bool
    claimed: list[SlowScore]
    near: tuple[str, ...]
    admitted: frozenset[str]
    """slow effects that beat a random walk and may be claimed"""
    nearest: tuple[SlowScore, ...] = ()
    """of each slow effect with a time constant that comes near a random walk the best, the best first"""


def serial_correlation_beside(
    problem: Problem[N],
    selection: SelectionState[N],
    first: SelectionState[N],
    slow: frozenset[int],
    unnamed: frozenset[int],
) -> SerialCorrelation[N]:
    """Test for serial correlation beside what was claimed of the fast effects alone.

    Where time and the programme run alike, a slow effect is first taken for a fast one that resembles it. So the slow
    are also tested beside what is chosen where both may be, if they all hold there.
    """
    if problem.policy.slow_beside_fast:
        both = replace(selection.selector, banned=unnamed).select()
        chosen = {m.candidate for m in both} & slow
        if chosen:
            found = serial_correlation_of(problem, [m for m in both if m.candidate not in slow])
            if all(problem.candidates[k].id in found.admitted for k in chosen) or len(found.claimed) >= len(chosen):
                return found
    return serial_correlation_of(problem, first.terms)


def serial_correlation_of(problem: Problem[N], terms: Sequence[Term]) -> SerialCorrelation[N]:
    """Look for memory beside the base and what was claimed so far: coloured noise, a random walk, or something slow."""
    candidates = problem.candidates
    channels = problem.likelihoods(terms)
    slow = problem.slow()
    names = [candidates[s.candidate].id for s in slow]
    found = slow_effects(channels, slow, names, problem.policy.slow) if slow else SlowStage([], [], [])

    def upheld(scores: Sequence[SlowScore]) -> list[SlowScore]:
        return [s for s in scores if problem.holds_up(Term(s.effect.candidate, s.effect.variant))]

    found = replace(found, claimed=upheld(found.claimed), admitted=upheld(found.admitted))
    claimed = [score.effect for score in found.claimed]

    def on(c: int) -> AnyArray:
        own = [e.function[c - e.first] for e in claimed if e.first <= c < e.first + len(e.function)]
        return np.array(own) if own else problem.block([])[:, c]

    memories = [channel.memory(on(c)) for c, channel in enumerate(channels)]
    near = tuple(dict.fromkeys(candidates[s.effect.candidate].id for s in found.near))
    admitted = frozenset(candidates[s.effect.candidate].id for s in found.admitted)
    admitted |= {c.id for c in candidates if c.effect is not None and c.effect.next_order_of in admitted}
    if max(m.gain for m in memories) <= MEMORY.in_use:
        return SerialCorrelation(problem.noise, memories, False, [], near, admitted)
    noise = problem.with_memory(memories)
    if any(m.is_random_walk for m in memories):
        best: dict[int, SlowScore] = {}
        for score in sorted(found.near, key=lambda s: -s.score):
            effect = candidates[score.effect.candidate].effect
            if effect is not None and any(not p.epoch for p in effect.shapes):
                best.setdefault(score.effect.candidate, score)
        return SerialCorrelation(noise, memories, True, found.claimed, near, frozenset(), tuple(best.values()))
    return SerialCorrelation(noise, memories, False, [], near, admitted)


def no_serial_correlation(problem: Problem[N]) -> SerialCorrelation[N]:
    """What follows if noise is taken to remember nothing."""
    return SerialCorrelation(problem.noise, [], False, [], (), problem.slow_ids)


def slow_ranking(problem: Problem[N], beside: Sequence[Term], own: int) -> list[SlowScore]:
    """How the slow effects fare: candidate `own` where what it does beyond first order is taken out, the others on the
    readings as they are."""
    channels, slow = problem.likelihoods(beside), problem.slow()
    scores, _, _ = slow_scores(channels, slow)
    effect = problem.candidates[own].effect
    # without a shape of its own it is linear: nothing of it has been taken out
    shaped = effect is not None and bool(effect.shapes)
    whole = problem.relinearised(0.0, learn=False) if problem.has_second_order and shaped else None
    if whole is None:
        return scores
    all_read = whole.likelihoods(beside)
    theirs, _, _ = slow_scores(all_read, slow)
    # a score is the gain over nothing: over the same nothing
    shift = plain_level(channels, slow) - plain_level(all_read, slow)
    return [s for s in scores if s.effect.candidate == own] + [
        replace(s, score=s.score + more)
        for s, more in zip(theirs, shift.tolist(), strict=True)
        if s.effect.candidate != own
    ]


def needed_together(
    problem: Problem[N], selector: Selector, channels: Sequence[Channel], together: Sequence[Term]
) -> bool:
    """Whether several terms explain more than noise with memory does in the place of all of them.

    Beside the others each is needed, as these have left the noise no memory; and of so many sets this is the best one.
    """
    others = [m for m in selector.fixed if m not in together]
    dof = len(selector.space_with([*others, *together])) - len(selector.space_with(others))
    free = len(problem.candidates) - len(selector.banned)
    tries = comb(free, len(together)) * float(np.prod([selector.candidate_set.tries[m.candidate] for m in together]))
    return beats_random_walk(
        channels, problem.block(others), problem.block(together), dof, tries, problem.policy.certain
    )

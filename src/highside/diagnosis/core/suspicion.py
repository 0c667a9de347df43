"""Whether noise remembers: colour, an offset that walks, or an effect of time or temperature that beats a walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from highside.diagnosis.core.memory import Memory, SlowScore, SlowStage, plain_level, slow_effects, slow_scores
from highside.diagnosis.core.policy import MEMORY
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.scene import Judged, N, Scene


@dataclass(frozen=True)
class Suspicion(Generic[N]):
    """What is known of memory in the noise: whitening to judge by, whether offsets wander, slow effects that beat the
    walk, and the ids of those that come near."""

    noise: N
    memories: list[Memory]
    wanders: bool
    claimed: list[SlowScore]
    near: tuple[str, ...]
    admitted: frozenset[str]
    """slow effects that beat a walk and may be claimed"""
    nearest: tuple[SlowScore, ...] = ()
    """of each slow effect with a time constant that comes near a walk the best, the best first"""


def suspected(
    scene: Scene[N], judged: Judged[N], first: Judged[N], slow: frozenset[int], unnamed: frozenset[int]
) -> Suspicion[N]:
    """The suspicion beside what was claimed of the fast effects alone.

    Where time and the programme run alike, a slow effect is first taken for a fast one that resembles it. So the slow
    are also tested beside what is chosen where both may be, if they all hold there.
    """
    if scene.policy.slow_beside_fast:
        both = replace(judged.selector, banned=unnamed).select()
        chosen = {m.candidate for m in both} & slow
        if chosen:
            found = suspect(scene, [m for m in both if m.candidate not in slow])
            if all(scene.candidates[k].id in found.admitted for k in chosen) or len(found.claimed) >= len(chosen):
                return found
    return suspect(scene, first.members)


def suspect(scene: Scene[N], members: Sequence[Member]) -> Suspicion[N]:
    """Look for memory beside the base and what was claimed so far: coloured noise, a walk, or something slow."""
    candidates = scene.candidates
    channels = scene.likelihoods(members)
    slow = scene.slow()
    names = [candidates[s.candidate].id for s in slow]
    found = slow_effects(channels, slow, names, scene.policy.slow) if slow else SlowStage([], [], [])

    def upheld(scores: Sequence[SlowScore]) -> list[SlowScore]:
        return [s for s in scores if scene.holds_up(Member(s.effect.candidate, s.effect.variant))]

    found = replace(found, claimed=upheld(found.claimed), admitted=upheld(found.admitted))
    functions = [score.effect.function for score in found.claimed]
    memories = [
        channel.memory(
            np.array([f[c] for f in functions]) if functions and c < len(functions[0]) else scene.block([])[:, c]
        )
        for c, channel in enumerate(channels)
    ]
    near = tuple(dict.fromkeys(candidates[s.effect.candidate].id for s in found.near))
    admitted = frozenset(candidates[s.effect.candidate].id for s in found.admitted)
    admitted |= {c.id for c in candidates if c.effect is not None and c.effect.next_order_of in admitted}
    if max(m.gain for m in memories) <= MEMORY.suspect:
        return Suspicion(scene.noise, memories, False, [], near, admitted)
    noise = scene.with_memory(memories)
    if any(m.walks for m in memories):
        best: dict[int, SlowScore] = {}
        for score in sorted(found.near, key=lambda s: -s.score):
            effect = candidates[score.effect.candidate].effect
            if effect is not None and any(not p.epoch for p in effect.shapes):
                best.setdefault(score.effect.candidate, score)
        return Suspicion(noise, memories, True, found.claimed, near, frozenset(), tuple(best.values()))
    return Suspicion(noise, memories, False, [], near, admitted)


def unsuspecting(scene: Scene[N]) -> Suspicion[N]:
    """What follows if noise is taken to remember nothing."""
    return Suspicion(scene.noise, [], False, [], (), scene.slow_ids)


def slow_standing(scene: Scene[N], beside: Sequence[Member], own: int) -> list[SlowScore]:
    """How the slow effects fare: candidate `own` where what it does beyond first order is taken out, the others on the
    readings as they are."""
    channels, slow = scene.likelihoods(beside), scene.slow()
    scores, _, _ = slow_scores(channels, slow)
    effect = scene.candidates[own].effect
    # without a shape of its own it is linear: nothing of it has been taken out
    shaped = effect is not None and bool(effect.shapes)
    whole = scene.straightened(0.0, learn=False) if scene.bent and shaped else None
    if whole is None:
        return scores
    all_read = whole.likelihoods(beside)
    theirs, _, _ = slow_scores(all_read, slow)
    # a score is the gain over nothing: over the same nothing
    shift = plain_level(channels, slow) - plain_level(all_read, slow)
    return [s for s in scores if s.effect.candidate == own] + [
        replace(s, score=s.score + shift) for s in theirs if s.effect.candidate != own
    ]

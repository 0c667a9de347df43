"""The diagnosis of a recording with a known reference, from what it was prepared to (a `Scene`) to a verdict.

1. base fit (the effects that may be refitted anyway), 2. noise from what no candidate explains, 3. scan of the residual
outside of the base for places, 4. race of the candidates, 5. classes of what cannot be told apart, 6. joint refit with
intervals and a check that the values are plausible, 7. proof on held-out blocks, 8. scan of the remainder, verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.candidates import RING
from highside.diagnosis.core.conclusion import conclude, is_loud
from highside.diagnosis.core.exchange import exchanged, kept
from highside.diagnosis.core.memory import Channel, beats_the_walk, slow_scores
from highside.diagnosis.core.method import WHOLE, Method
from highside.diagnosis.core.policy import FITS, PROCEDURE, RIVALS
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.result import Diagnosis
from highside.diagnosis.core.scene import Judged, N, Picture, Scene
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.suspicion import Suspicion, slow_standing, suspect, suspected, unsuspecting
from highside.diagnosis.magnitude.scene import MagnitudeScene
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.diagnosis.poses.scene import PoseScene
from highside.diagnosis.poses.session import PoseSession
from highside.diagnosis.rotation.policy import SKETCH
from highside.diagnosis.rotation.scene import RotationScene
from highside.diagnosis.rotation.sketch import Sketch, may_bend
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.simulation.scene import SimulationScene
from highside.diagnosis.simulation.session import SimulationSession
from highside.physics.forward import ForwardModel

__all__ = ["Picture", "diagnose", "diagnose_magnitudes", "diagnose_poses", "diagnose_rotation", "diagnose_simulation"]


def diagnose_poses(
    session: PoseSession,
    model: ForwardModel,
    free: Sequence[str],
    *,
    seed: int = 1,
    version: str = "",
    method: Method = WHOLE,
) -> tuple[Diagnosis, Picture]:
    """Diagnose n poses against a model whose effects `free` may be refitted. The same seed gives the same answer."""
    return diagnose(PoseScene.of(session, model, tuple(free), seed, method), version)


def diagnose_rotation(
    session: RotationSession,
    model: ForwardModel,
    free: Sequence[str],
    *,
    seed: int = 1,
    version: str = "",
    method: Method = WHOLE,
) -> tuple[Diagnosis, Picture]:
    """As `diagnose_poses`, for the n rows of a continuous rotation.

    Of a long one some rows are diagnosed first: strong effects show there, and what they do beyond first order is known
    before all rows are passed through.
    """
    sketch = None
    if session.n > SKETCH.many_rows and may_bend(session, model, free, seed):
        rows = session.thinned(SKETCH.some_rows, seed)
        some, judged, _ = _straight(RotationScene.of(rows, model, tuple(free), seed, method))
        sketch = Sketch.of(rows, some, judged.members)
    scene = RotationScene.of(session, model, tuple(free), seed, method, sketch)
    return conclude(*_straight(scene, sketch.names if sketch else ()), version)


def diagnose_magnitudes(
    session: MagnitudeSession, model: ForwardModel, free: Sequence[str], *, seed: int = 1, version: str = ""
) -> tuple[Diagnosis, Picture]:
    """As `diagnose_poses`, for n still readings of which only the magnitude is known."""
    return diagnose(MagnitudeScene.of(session, model, tuple(free), seed), version)


def diagnose_simulation(
    session: SimulationSession, free: Sequence[str], *, seed: int = 1, version: str = ""
) -> tuple[Diagnosis, Picture]:
    """Diagnose channels beside another program's prediction of them; `free` are ids of effects that are refitted."""
    return diagnose(SimulationScene.beside(session, tuple(free), seed), version)


def diagnose(scene: Scene[N], version: str = "") -> tuple[Diagnosis, Picture]:
    """Choose, compare, prove and tell."""
    return conclude(*_straight(scene), version)


def _straight(scene: Scene[N], taken_out: Sequence[str] = ()) -> tuple[Scene[N], Judged[N], Suspicion[N]]:
    """What is chosen, and the scene in which it was; of effects `taken_out` its bend is already.

    Everything is chosen by what effects do to first order. Where those that are chosen do more than that, what they do
    beyond it at their fitted sizes is taken out of the readings, and it is chosen again: else the rest of a strong
    effect would be given a name of its own.
    """
    judged, suspicion = _judged(scene)
    judged = kept(scene, judged, taken_out)
    if suspicion.wanders and not suspicion.claimed:
        scene, judged, suspicion = _refined(scene, judged, suspicion)
    compared: set[int] = set()
    for _ in range(PROCEDURE.bent):
        named = [m for m in judged.members if scene.candidates[m.candidate].named]
        fit = scene.fit(named, judged.noise) if named else None
        judged = replace(judged, fit=fit)
        bends = fit is not None and fit.beyond >= FITS.bends and scene.straightens
        if fit is not None and bends and len(named) == len(judged.members) and _which(named) != compared:
            judged = exchanged(scene, judged, fit)
            compared = _which(judged.members)
        bend = 0.0 if judged.fit is None or judged.fit.bend is None else judged.fit.bend
        other = np.asarray(bend - scene.bend)
        if not other.any() or np.sum(scene.noise.white(other) ** 2) < FITS.bends:
            break
        straight = scene.straightened(bend)
        if straight is None:
            break
        scene = straight
        taken_out = [scene.candidates[m.candidate].id for m in judged.members]
        judged, suspicion = _judged(scene)
        judged = kept(scene, judged, taken_out)
    return scene, judged, suspicion


def _which(members: Sequence[Member]) -> set[int]:
    return {m.candidate for m in members}


def _judged(scene: Scene[N]) -> tuple[Judged[N], Suspicion[N]]:
    """What is chosen, and what was found of memory in the noise."""
    judged = scene.judge(scene.noise)
    channels = scene.likelihoods([])
    slow = frozenset(i for i, c in enumerate(scene.candidates) if c.id in scene.slow_ids)
    unnamed = frozenset(i for i, c in enumerate(scene.candidates) if not c.named)
    rings = frozenset(i for i in unnamed if scene.candidates[i].id.startswith(RING))
    # first what has a name and does not follow time, or one ring; then, beside that, whether anything slow beats a walk
    first = _choose(scene, judged, channels, (slow | unnamed) - rings)
    suspicion = suspected(scene, judged, first, slow, unnamed - rings) if scene.method.colour else unsuspecting(scene)
    doubtful = suspicion.wanders or any(m.candidate in rings for m in first.members)
    if doubtful and first.members and not (suspicion.claimed or suspicion.admitted):
        # what was chosen may stand in place of something slow: once more beside what is chosen where that may be too
        fast = [m for m in _choose(scene, judged, channels, unnamed - rings).members if m.candidate not in slow]
        if fast != first.members:
            again = suspect(scene, fast)
            suspicion = again if again.claimed or again.admitted else suspicion
    if suspicion.noise is not scene.noise:
        judged = scene.judge(suspicion.noise)
    fixed = tuple(Member(score.effect.candidate, score.effect.variant) for score in suspicion.claimed)
    barred = frozenset(
        i
        for i, c in enumerate(scene.candidates)
        if (i in slow and c.id not in suspicion.admitted) or (suspicion.wanders and c.id.startswith("shadow:time"))
    )
    if not scene.method.refusal:
        barred |= unnamed
    return _choose(scene, judged, channels, barred, fixed, slow), suspicion


def _refined(scene: Scene[N], judged: Judged[N], suspicion: Suspicion[N]) -> tuple[Scene[N], Judged[N], Suspicion[N]]:
    """The same, or what is chosen where a slow effect that comes near has the time constant that fits best.

    Time constants are tried at a few values. Of a strong effect what lies between them is louder than the noise, and
    wanders as slowly as a walk does.
    """
    for near in suspicion.nearest[: PROCEDURE.refined]:
        member = Member(near.effect.candidate, near.effect.variant)
        bend = scene.fit([member], scene.noise).bend
        straight = None if bend is None else scene.straightened(bend)
        if straight is None:
            continue
        known = suspect(straight, [])
        scores = slow_standing(straight, [], member.candidate)
        own = max(one.score for one in scores if one.effect.candidate == member.candidate)
        rival = max(one.score for one in scores if one.effect.candidate != member.candidate)
        believed = {one.effect.candidate for one in known.claimed}
        found = member.candidate in believed or scene.candidates[member.candidate].id in known.admitted
        if found and own > rival + RIVALS.same_class_evidence:
            return straight, *_judged(straight)
    return scene, judged, suspicion


def _as_a_slow_one(
    scene: Scene[N], selector: Selector, members: Sequence[Member], member: Member, slow: frozenset[int]
) -> bool:
    """Whether a member is a case of slow effects of which none would be believed in its place."""
    if not scene.policy.slow_beside_fast:
        # of poses and hands nothing that is fast elsewhere runs like time
        return False
    others = [m for m in members if m != member]
    best = selector.standing(others).best
    alike = {k for k in slow if selector.holds([*others, selector.pool.whole(best[k])], member)}
    tested = [one for one in scene.slow() if one.candidate in alike]
    if not tested:
        return False
    scores, _, evidence = slow_scores(scene.likelihoods(others), tested)
    return not any(
        scene.policy.slow.passes(
            scene.candidates[one.effect.candidate].id, one.log_p, one.remaining, evidence, one.score
        )
        for one in scores
    )


def _choose(
    scene: Scene[N],
    judged: Judged[N],
    channels: Sequence[Channel],
    banned: frozenset[int],
    fixed: tuple[Member, ...] = (),
    slow: frozenset[int] = frozenset(),
) -> Judged[N]:
    """Select among the candidates that are not banned; a named one that a walk explains as well is not believed.

    A walk may run like an effect of attitude where the session goes through the rings in order. And what is here a case
    of one of the `slow` is asked no less than they are.
    """
    selector = replace(judged.selector, banned=banned, fixed=fixed)
    members = selector.select()
    if is_loud(scene, replace(judged, selector=selector), members):
        # something is there: two effects that cancel one another may each be too small to be seen alone
        selector = replace(selector, opposed=True)
        members = selector.select()
    if not scene.method.colour:
        return replace(judged, selector=selector, members=members)

    def needed(some: Sequence[Member]) -> bool:
        others = [o for o in members if o not in some]
        dof = len(selector.space_with(members)) - len(selector.space_with(others))
        rings = [m for m in some if not scene.candidates[m.candidate].named]
        tries = float(np.prod([selector.pool.tries[m.candidate] for m in rings]))
        certain = scene.policy.certain + (PROCEDURE.ring_certain if rings else 0.0)
        return beats_the_walk(channels, scene.block(others), scene.block(some), dof, tries, certain)

    for _ in range(PROCEDURE.doubts):
        tested = [
            m
            for m in members
            if (scene.candidates[m.candidate].named or scene.candidates[m.candidate].id.startswith(RING))
            and scene.candidates[m.candidate].id not in scene.slow_ids
        ]
        doubted = [m for m in tested if not needed([m]) or _as_a_slow_one(scene, selector, members, m, slow)]
        # beside the one a walk takes the other's place; what both do together it may not
        if not doubted or (len(doubted) > 1 and needed(doubted)):
            break
        # what is chosen instead is asked the same
        selector = replace(selector, banned=selector.banned | {m.candidate for m in doubted})
        members = selector.select()
    return replace(judged, selector=selector, members=members)

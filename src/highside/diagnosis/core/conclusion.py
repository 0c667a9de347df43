"""From what was chosen to what is told: classes, refit, remainder, places, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import RING
from highside.diagnosis.core.exchange import beside_refits, refitted
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.policy import CONCLUSION
from highside.diagnosis.core.pool import Member
from highside.diagnosis.core.regression import log10_p, outside, span
from highside.diagnosis.core.result import Claim, Diagnosis, Fit, Location, Remainder, Rival, Verdict
from highside.diagnosis.core.rivals import Rivalry, beside_memory, rivalry, what_shows
from highside.diagnosis.core.scene import Judged, N, Picture, Scene
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.suspicion import Suspicion, slow_standing
from highside.diagnosis.core.untestable import what_splits

SLOW_COVARIATES = frozenset({"t_s", "temp_c"})


@dataclass(frozen=True)
class _Scanned:
    """The scan after some members: -log10 p (cells,), the loudest cell, and the best excess of each channel."""

    log_p: Array
    loudest: int
    excess: Array
    signal: Array
    """what the loudest cell would explain"""


def _scan(scene: Scene[N], judged: Judged[N], members: Sequence[Member]) -> _Scanned:
    space = judged.selector.space_with(members)
    residual = outside(space, judged.selector.residual)
    gains, dof = judged.scan.race.run(space, residual[None])
    log_p = log10_p(gains[:, 0], dof, judged.scan.freedom)
    loudest = int(np.argmax(log_p))
    over = np.maximum(gains[:, 0] - dof, 0.0)
    # the cells of one basis stand together, channel by channel
    excess = over.reshape(-1, len(scene.channels)).max(axis=0)
    group = span(outside(space, judged.scan.white[loudest]), tolerance=CONCLUSION.own)
    return _Scanned(log_p, loudest, excess, (group @ residual) @ group)


def is_loud(scene: Scene[N], judged: Judged[N], members: Sequence[Member]) -> bool:
    """Whether the scan finds more than chance beside members."""
    after = _scan(scene, judged, members)
    return bool(after.log_p[after.loudest] > judged.scan_threshold)


def conclude(scene: Scene[N], judged: Judged[N], suspicion: Suspicion[N], version: str) -> tuple[Diagnosis, Picture]:
    chosen = judged.members
    believed = scene.believed(judged, _widened(scene, judged))
    if believed != chosen:
        judged = replace(judged, members=believed, fit=None, refits={})
    members, selector, wanders = judged.members, judged.selector, suspicion.wanders
    named = [m for m in members if scene.candidates[m.candidate].named]
    after = _scan(scene, judged, members)
    loud = float(after.log_p[after.loudest]) > judged.scan_threshold
    fit = judged.fit if judged.fit is not None else scene.fit(named, judged.noise)
    rivalries = [_rivalry(scene, judged, m, fit) for m in members]
    explained = _gain(selector, members)
    heard = after.log_p.reshape(-1, len(scene.channels)).max(axis=0) > judged.scan_threshold
    left = float(after.excess[heard].sum()) if loud else 0.0
    share = explained / (explained + left) if explained + left > 0 else 1.0
    if loud and not members:
        # nothing but time or temperature is followed, and no slow effect beat the walk
        passing = np.flatnonzero(after.log_p > judged.scan_threshold)
        wanders |= all(judged.scan.bases[judged.scan.cells[i][1]].covariate in SLOW_COVARIATES for i in passing)
    clear = float(after.log_p[after.loudest]) > judged.scan_threshold + scene.policy.faint
    alone = [explained - _gain(selector, [o for o in members if o != m]) for m in members]
    manifest = not loud and sum(gain < CONCLUSION.manifest for gain in alone) <= 1
    verdict = _verdict(scene, members, rivalries, fit, wanders, loud, share if clear else 1.0, manifest)
    if verdict == "named_plus" and share < CONCLUSION.changing and _changes(scene, judged, members, after, share):
        verdict = "partial"
    proof = scene.proof(members, fit)
    if verdict in ("named", "named_plus") and scene.method.refusal and _worse(proof):
        verdict = "partial"

    resembles = tuple(scene.variant(m).label or scene.candidates[m.candidate].id for m in members)
    told = verdict in ("named", "named_plus")
    claims = tuple(_claim(scene, judged, m, r, fit) for m, r in zip(members, rivalries, strict=True)) if told else ()
    location = _located(scene, judged, members, share) if told else _located_whole(scene, judged, members, after, loud)
    remainder = Remainder(
        location=scene.locate_whole(judged, after.signal, members, _as_p(after), 1.0 - share) if loud else (),
        hints=_hints(scene, judged, after, loud, members, wanders),
        p=_as_p(after),
        resembles=() if told else (*resembles, *(n for n in suspicion.near if n not in resembles)),
    )
    lacking, smallest = what_shows(
        selector.pool, selector.base, scene.noise.freedom, selector.threshold, scene.blind, scene.free
    )
    noise = {
        **scene.told_of_noise(),
        "memory_evidence": [m.gain for m in suspicion.memories],
        "memory_poses": ["walk" if np.isinf(m.length) else m.length for m in suspicion.memories],
        "wanders": wanders,
        "threshold_log10_p": selector.threshold,
        "scan_threshold_log10_p": judged.scan_threshold,
    }
    diagnosis = Diagnosis(
        verdict,
        location,
        claims,
        proof,
        (),
        remainder,
        tuple(lacking),
        smallest,
        noise,
        scene.seed,
        version,
    )
    return scene.completed(diagnosis), scene.picture(fit if named else None)


def _rivalry(scene: Scene[N], judged: Judged[N], claim: Member, fit: JointFit) -> Rivalry:
    """How the candidates compare with a claim; slow ones with a slow one as noise that remembers lets them.

    What was taken out of the readings is what the claims do beyond first order. A rival has a right to all readings.
    """
    found = rivalry(judged.selector, judged.members, claim)
    slow = scene.slow() if scene.method.colour else []
    if claim.candidate not in {s.candidate for s in slow}:
        if not scene.bent:
            return found
        refits = judged.refits.get(claim) or refitted(scene, judged, claim, fit, found)
        return beside_refits(found, refits)
    others = [m for m in judged.members if m != claim]
    scores = slow_standing(scene, others, claim.candidate)
    return beside_memory(found, scores, claim, {m.candidate for m in others})


def _widened(scene: Scene[N], judged: Judged[N]) -> list[Member]:
    """The members; where the scan is loud beside them, with one told whole or exchanged, if that makes it quiet.

    The rest of an effect that was let act in part may be too small to be worth its parameters, and still be there; and
    of rivals that cannot be told apart, the one that leaves nothing is the better answer.
    """
    members, selector = judged.members, judged.selector

    def loud(some: list[Member]) -> bool:
        return is_loud(scene, judged, some)

    if not members or not loud(members):
        return members
    for m in members:
        if not scene.candidates[m.candidate].named or m in selector.fixed:
            continue
        shape, variants = scene.variant(m).shape, scene.candidates[m.candidate].variants
        tries = [Member(m.candidate, j) for j, v in enumerate(variants) if v.whole and v.shape == shape]
        r = rivalry(selector, members, m)
        tries += [r.best[k] for k in r.same[1:] if k not in selector.banned]
        for other in tries:
            changed = [other if o == m else o for o in members]
            if other != m and not loud(changed):
                return changed
    return members


def _as_p(scanned: _Scanned) -> float:
    return float(10.0 ** -scanned.log_p[scanned.loudest])


def _gain(selector: Selector, members: Sequence[Member]) -> float:
    left = outside(selector.space_with(members), selector.residual)
    return float(selector.residual @ selector.residual - left @ left)


def _verdict(
    scene: Scene[N],
    members: Sequence[Member],
    rivalries: Sequence[Rivalry],
    fit: JointFit,
    wanders: bool,
    loud: bool,
    share: float,
    manifest: bool,
) -> Verdict:
    if not members:
        return "wander" if wanders else ("unknown" if loud else "nothing_left_out")
    if not scene.method.refusal:
        return "named"
    candidates = scene.candidates
    if any(not candidates[m.candidate].named for m in members):
        return "unknown"
    if fit.outside_gate:
        return "implausible_fit"
    margin = np.array(
        [
            -np.inf if c.named else CONCLUSION.ring_margin if c.id.startswith(RING) else scene.policy.shadow_margin
            for c in candidates
        ]
    )
    for r in rivalries:
        if np.any(r.delta_bic < margin):
            # an interaction without a name explains it as well
            return "partial"
    if share < scene.policy.named_share or (len(members) > scene.policy.most_named and not manifest):
        return "partial"
    return "named_plus" if loud else "named"


def _worse(proof: Fit) -> bool:
    """Whether readings that were left out are told worse with the names than without: no finding, whatever its p."""
    before, after = proof.heldout_rmse_before, proof.heldout_rmse_after
    return before is not None and after is not None and after >= before


def _changes(scene: Scene[N], judged: Judged[N], members: Sequence[Member], after: _Scanned, share: float) -> bool:
    """Whether the loudest remainder is a product of covariates on a channel that a claim acts on: its size changes."""
    channel, basis = judged.scan.cells[after.loudest]
    if " x " not in judged.scan.bases[basis].covariate:
        return False
    return any(scene.channels[channel] in place.channels for place in _located(scene, judged, members, share))


def _located(scene: Scene[N], judged: Judged[N], members: Sequence[Member], share: float) -> tuple[Location, ...]:
    """Where each of the named members sits."""
    selector = judged.selector
    found: tuple[Location, ...] = ()
    for m in members:
        others = selector.space_with([o for o in members if o != m])
        own = span(outside(others, selector.pool.columns(m)), tolerance=CONCLUSION.own)
        signal = (own @ selector.residual) @ own
        total = max(_gain(selector, members), 1e-12)
        p = float(10.0 ** -selector.standing([o for o in members if o != m]).log_p[m.candidate])
        portion = min(1.0, share * float(signal @ signal) / total)
        found += scene.locate(judged, signal, selector.base, p, portion)
    return found


def _located_whole(
    scene: Scene[N], judged: Judged[N], members: Sequence[Member], after: _Scanned, loud: bool
) -> tuple[Location, ...]:
    """Where all of the mismatch sits, where it has no name: members that are not believed have no places of their own.

    What is not chance of it is taken to be what the members and the loudest cell of the scan explain.
    """
    if not members and not loud:
        return ()
    selector = judged.selector
    own = [selector.pool.stack(members)] + ([judged.scan.white[after.loudest]] if loud else [])
    explained = span(outside(selector.base, np.concatenate(own)), tolerance=CONCLUSION.own)
    signal = (explained @ selector.residual) @ explained
    log_p = [float(selector.standing([o for o in members if o != m]).log_p[m.candidate]) for m in members]
    p = float(10.0 ** -max([*log_p, float(after.log_p[after.loudest])]))
    return scene.locate_whole(judged, signal, [], p, 1.0)


def _hints(
    scene: Scene[N], judged: Judged[N], after: _Scanned, loud: bool, members: Sequence[Member], wanders: bool
) -> tuple[str, ...]:
    hints = [f"follows {scene.variant(m).label}" for m in members if not scene.candidates[m.candidate].named]
    if loud:
        channel, basis = judged.scan.cells[after.loudest]
        hints.append(f"{scene.channels[channel]} follows {judged.scan.bases[basis].covariate}")
    if wanders:
        hints.append("the zero offsets wander: slow effects cannot be told from that wandering here")
    return tuple(hints)


def _claim(scene: Scene[N], judged: Judged[N], member: Member, r: Rivalry, fit: JointFit) -> Claim:
    candidate = scene.candidates[member.candidate]
    effect = candidate.effect
    assert effect is not None
    candidates = scene.candidates
    p = 10.0 ** -judged.selector.standing([m for m in judged.members if m != member]).log_p[member.candidate]
    family = len(candidates)
    ruled_out = sorted(
        (
            Rival(c.id, float(r.delta_bic[k]))
            for k, c in enumerate(candidates)
            if c.named and k not in r.same and all(m.candidate != k for m in judged.members)
        ),
        key=lambda rival: rival.delta_bic,
    )
    shown = [
        rival for i, rival in enumerate(ruled_out) if i < CONCLUSION.ruled_out or rival.effect in effect.confused_with
    ]
    return Claim(
        effect=effect.id,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters=fit.parameters[effect.id],
        p_familywise=float(min(1.0, family * p)),
        equivalence_class=tuple(candidates[k].id for k in r.same),
        rivals_ruled_out=tuple(shown),
        next_manoeuvre=_advice(scene, member, r, fit),
    )


def _advice(scene: Scene[N], member: Member, r: Rivalry, fit: JointFit) -> str:
    """What to do next, in words: what splits the class, or what the library knows to split it."""
    effect = scene.candidates[member.candidate].effect
    assert effect is not None
    if len(r.same) == 1:
        return "none needed: no other effect of the library explains this recording as well"
    if effect.stage.value != "thermal":
        return scene.advice(member, r, fit)
    rivals = [e for k in r.same if k != member.candidate and (e := scene.candidates[k].effect) is not None]
    return what_splits(effect, rivals)

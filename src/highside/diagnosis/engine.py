"""The diagnosis of a pose-stepped session with known poses, from means to a verdict.

1. base fit (the effects that may be refitted anyway), 2. noise from what no candidate explains, 3. scan of the residual
outside of the base for places, 4. race of the candidates, 5. classes of what cannot be told apart, 6. joint refit with
intervals and a check that the values are plausible, 7. proof on held-out blocks, 8. scan of the remainder, verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis import noise as noise_model
from highside.diagnosis.candidates import CHANNELS, Blind, Candidate, Variant, pose_candidates, shadows
from highside.diagnosis.fit import JointFit, base_fit, joint_fit
from highside.diagnosis.location import Scan, locate, on_channel, pose_bases, scan_of
from highside.diagnosis.memory import (
    SUSPECT,
    Likelihoods,
    Memory,
    SlowEffect,
    SlowScore,
    SlowStage,
    beats_the_walk,
    slow_effects,
)
from highside.diagnosis.noise import PoseNoise
from highside.diagnosis.regression import log10_p, outside, span
from highside.diagnosis.result import Claim, Diagnosis, Fit, Location, Remainder, Rival, Verdict
from highside.diagnosis.rivals import Rivalry, next_poses, rivalry, what_shows
from highside.diagnosis.selection import (
    HeldOut,
    Member,
    Pool,
    Selector,
    pose_folds,
    threshold,
)
from highside.diagnosis.session import PoseSession
from highside.physics.forward import ForwardModel

Array = NDArray[np.float64]

NAMED_SHARE = 0.85
"""Share of the excess misfit that names must explain to be given."""
SLOW = (
    "bias_drift",
    "warmup",
    "thermal_lag",
    "bias_step",
    "thermal_hysteresis",
    "temperature_bias",
    "temperature_bias_curvature",
)
"""Effects that are functions of time or temperature alone: a walk may look like any of them."""
SLOW_COVARIATES = frozenset({"t_s", "temp_c"})
RICH_SHARE = 0.5
"""Of all readings, how many directions at most the rich model may take."""


@dataclass(frozen=True)
class Picture:
    """What a report draws: residuals (3, n) in g after the base fit alone, and with the claims."""

    session: PoseSession
    before: Array
    after: Array


@dataclass(frozen=True)
class _Scene:
    """All that is prepared before anything is chosen."""

    session: PoseSession
    model: ForwardModel
    free: tuple[str, ...]
    base: Array
    """(P, 3, n)"""
    residual: Array
    """(3, n) g after the base fit"""
    tangents: Array
    candidates: list[Candidate]
    blind: list[Blind]
    rich: Array
    noise: PoseNoise
    seed: int


@dataclass(frozen=True)
class _Judged:
    """What one noise model leads to."""

    noise: PoseNoise
    selector: Selector
    scan: Scan
    scan_threshold: float
    members: list[Member]


def diagnose_poses(
    session: PoseSession, model: ForwardModel, free: Sequence[str], *, seed: int = 1, version: str = ""
) -> tuple[Diagnosis, Picture]:
    """Diagnose n poses against a model whose effects `free` may be refitted. The same seed gives the same answer."""
    scene = _prepare(session, model, tuple(free), seed)
    judged = _judge(scene, scene.noise)
    channels = _likelihoods(scene, scene.base)
    slow = frozenset(i for i, c in enumerate(scene.candidates) if c.id in SLOW)
    unnamed = frozenset(i for i, c in enumerate(scene.candidates) if not c.named)
    # first what has a name and does not follow time; then, beside that, whether anything slow beats a walk
    first = _choose(scene, judged, channels, slow | unnamed)
    suspicion = _suspect(scene, first.members)
    if suspicion.noise is not scene.noise:
        judged = _judge(scene, suspicion.noise)
    fixed = tuple(Member(score.effect.candidate, score.effect.variant) for score in suspicion.claimed)
    barred = frozenset(
        i
        for i, c in enumerate(scene.candidates)
        if (i in slow and c.id not in suspicion.admitted) or (suspicion.wanders and c.id.startswith("shadow:time"))
    )
    return _conclude(scene, _choose(scene, judged, channels, barred, fixed), suspicion, version)


def _prepare(session: PoseSession, model: ForwardModel, free: tuple[str, ...], seed: int) -> _Scene:
    state = session.state
    model, base, residual = base_fit(model, state, session.mean, free)
    tangents = np.asarray(model.pose_sensitivity(state), dtype=float)[:, [0, 2]].transpose(1, 0, 2)
    candidates, blind = pose_candidates(model, state, free)
    force = np.asarray(model.chain(state).force, dtype=float)
    candidates += shadows(state, force)
    rich = _rich(base, candidates, session, force)
    return _Scene(
        session, model, free, base, residual, tangents, candidates, blind, rich,
        noise_model.estimate(residual, rich, tangents), seed,
    )  # fmt: skip


def _rich(base: Array, candidates: Sequence[Candidate], session: PoseSession, force: Array) -> Array:
    """Columns (P, 3, n) of everything that could be systematic, as many as the session affords."""
    whole = [[v.columns for v in c.variants if v.whole] for c in candidates if c.named]
    parts = [base, *(columns[0] for columns in whole if len(columns) == 1)]
    groups = [on_channel(b.functions, channel) for b in pose_bases(session.state, force) for channel in range(3)]
    shaped = [columns[i] for columns in whole if len(columns) > 1 for i in _spread(len(columns), 5)]
    room = int(RICH_SHARE * 3 * session.n)
    kept: list[Array] = []
    taken = 0
    for part in [*parts, *shaped, *groups]:
        if taken + len(part) <= room or not kept:
            kept.append(part)
            taken += len(part)
    return np.concatenate(kept)


def _spread(count: int, want: int) -> list[int]:
    return sorted({round(x) for x in np.linspace(0, count - 1, min(want, count))})


@dataclass(frozen=True)
class _Suspicion:
    """What is known of memory in the noise: whitening to judge by, whether offsets wander, slow effects that beat the
    walk, and the ids of those that come near."""

    noise: PoseNoise
    memories: list[Memory]
    wanders: bool
    claimed: list[SlowScore]
    near: tuple[str, ...]
    admitted: frozenset[str]
    """slow effects that beat a walk and may be claimed"""


def _choose(
    scene: _Scene,
    judged: _Judged,
    channels: Sequence[Likelihoods],
    banned: frozenset[int],
    fixed: tuple[Member, ...] = (),
) -> _Judged:
    """Select among the candidates that are not banned; a named one that a walk explains as well is not believed.

    A walk may run like an effect of attitude where the session goes through the rings in order.
    """
    selector = replace(judged.selector, banned=banned, fixed=fixed)
    members = selector.select()
    doubted = set()
    for m in members:
        candidate = scene.candidates[m.candidate]
        if not candidate.named or candidate.id in SLOW:
            continue
        others = [o for o in members if o != m]
        stack = np.concatenate(
            [np.empty((0, 3, scene.session.n)), *(_variant(scene.candidates, o).columns for o in others)]
        )
        dof = int(selector.standing(others).dof[m.candidate])
        if not beats_the_walk(channels, stack, _variant(scene.candidates, m).columns, dof):
            doubted.add(m.candidate)
    if doubted:
        selector = replace(selector, banned=banned | doubted)
        members = selector.select()
    return replace(judged, selector=selector, members=members)


def _likelihoods(scene: _Scene, explained: Array) -> list[Likelihoods]:
    variance = noise_model.white_variance(scene.noise, scene.tangents)
    t_s = scene.session.state.t_s
    return [Likelihoods(scene.residual[c], variance[c], explained[:, c], t_s) for c in range(3)]


def _suspect(scene: _Scene, members: Sequence[Member]) -> _Suspicion:
    """Look for memory beside the base and what was claimed so far: coloured noise, a walk, or something slow."""
    state, candidates = scene.session.state, scene.candidates
    explained = np.concatenate([scene.base, *(_variant(candidates, m).columns for m in members)])
    channels = _likelihoods(scene, explained)
    slow = [
        SlowEffect(i, j, np.broadcast_to(v.columns[0, 0], (3, state.n)))
        for i, c in enumerate(candidates)
        if c.id in SLOW
        for j, v in enumerate(c.variants)
        if v.whole
    ]
    tries = {i: sum(s.candidate == i for s in slow) for i in {s.candidate for s in slow}}
    found = slow_effects(channels, slow, tries) if slow else SlowStage([], [], [])
    functions = np.array([score.effect.function for score in found.claimed]).reshape(-1, 3, state.n)
    memories = [channel.memory(functions[:, c]) for c, channel in enumerate(channels)]
    near = tuple(dict.fromkeys(candidates[s.effect.candidate].id for s in found.near))
    admitted = frozenset(candidates[s.effect.candidate].id for s in found.admitted)
    if "temperature_bias" in admitted:
        admitted |= {"temperature_bias_curvature"}
    if max(m.gain for m in memories) <= SUSPECT:
        return _Suspicion(scene.noise, memories, False, [], near, admitted)
    noise = noise_model.with_memory(scene.noise, memories, scene.tangents, state.t_s)
    if any(m.walks for m in memories):
        return _Suspicion(noise, memories, True, found.claimed, near, frozenset())
    return _Suspicion(noise, memories, False, [], near, admitted)


def _judge(scene: _Scene, noise: PoseNoise) -> _Judged:
    """Prepare the race and the scan under a noise model, with their thresholds; nothing is chosen yet."""
    rng = np.random.default_rng(scene.seed)
    base = span(noise.white(scene.base))
    residual = outside(base, noise.white(scene.residual))
    pool = Pool(scene.candidates, [noise.white(v.columns) for c in scene.candidates for v in c.variants])
    rich = noise_model.rich_residual(noise, scene.residual, scene.rich)
    limit = threshold(pool.race, pool.owner, rich, base, noise.freedom, rng)
    held_out = HeldOut(noise.white(scene.base), noise.white(scene.residual), pose_folds(scene.session.n))
    selector = Selector(pool, base, residual, noise.freedom, limit, held_out)
    force = np.asarray(scene.model.chain(scene.session.state).force, dtype=float)
    bases = pose_bases(scene.session.state, force)
    cells = [(channel, b) for b in range(len(bases)) for channel in range(3)]
    scan = scan_of(bases, [noise.white(on_channel(bases[b].functions, c)) for c, b in cells], cells)
    scan_limit = threshold(scan.race, np.arange(len(cells)), rich, base, noise.freedom, rng)
    return _Judged(noise, selector, scan, scan_limit, [])


def _variant(candidates: Sequence[Candidate], member: Member) -> Variant:
    return candidates[member.candidate].variants[member.variant]


@dataclass(frozen=True)
class _Scanned:
    """The scan after some members: -log10 p (cells,), the loudest cell, and the best excess of each channel."""

    log_p: Array
    loudest: int
    excess: Array
    signal: Array
    """(3 n,) what the loudest cell would explain"""


def _scan(judged: _Judged, members: Sequence[Member]) -> _Scanned:
    space = judged.selector.space_with(members)
    residual = outside(space, judged.selector.residual)
    gains, dof = judged.scan.race.run(space, residual[None])
    log_p = log10_p(gains[:, 0], dof, judged.noise.freedom)
    loudest = int(np.argmax(log_p))
    over = np.maximum(gains[:, 0] - dof, 0.0)
    # the cells of one basis stand together, channel by channel
    excess = over.reshape(-1, 3).max(axis=0)
    group = span(outside(space, judged.scan.white[loudest]), tolerance=5e-3)
    return _Scanned(log_p, loudest, excess, (group @ residual) @ group)


def _conclude(scene: _Scene, judged: _Judged, suspicion: _Suspicion, version: str) -> tuple[Diagnosis, Picture]:
    members, selector, wanders = judged.members, judged.selector, suspicion.wanders
    named = [m for m in members if scene.candidates[m.candidate].named]
    after = _scan(judged, members)
    loud = float(after.log_p[after.loudest]) > judged.scan_threshold
    rivalries = [rivalry(selector, members, m) for m in members]
    fit = joint_fit(scene.model, scene.session, scene.free, scene.candidates, named, judged.noise, scene.noise.freedom)
    explained = _gain(selector, members)
    left = float(after.excess[after.log_p.reshape(-1, 3).max(axis=0) > judged.scan_threshold].sum()) if loud else 0.0
    share = explained / (explained + left) if explained + left > 0 else 1.0
    if loud and not members:
        # nothing but time or temperature is followed, and no slow effect beat the walk
        passing = np.flatnonzero(after.log_p > judged.scan_threshold)
        wanders |= all(judged.scan.bases[judged.scan.cells[i][1]].covariate in SLOW_COVARIATES for i in passing)
    verdict = _verdict(scene, members, rivalries, fit, wanders, loud, share)

    resembles = tuple(
        _variant(scene.candidates, m).label or scene.candidates[m.candidate].id for m in members
    )  # fmt: skip
    told = verdict in ("named", "named_plus")
    claims = tuple(_claim(scene, judged, m, r, fit) for m, r in zip(members, rivalries, strict=True)) if told else ()
    location = _located(judged, members, after, loud, share)
    remainder = Remainder(
        location=locate(judged.scan, after.signal, selector.space_with(members), _as_p(after), 1.0 - share)
        if loud
        else (),
        hints=_hints(scene, judged, after, loud, members, wanders),
        p=_as_p(after),
        resembles=() if told else (*resembles, *(n for n in suspicion.near if n not in resembles)),
    )
    lacking, smallest = what_shows(
        selector.pool, selector.base, judged.noise.freedom, selector.threshold, scene.blind, scene.free
    )
    noise = {
        "model": "per channel and pose" if scene.noise.inc or scene.noise.tf else "per channel",
        "sigma_g": [float(s) for s in scene.noise.sigma],
        "bench_inclination_rad": scene.noise.inc,
        "bench_toolface_rad": scene.noise.tf,
        "degrees_of_freedom": scene.noise.freedom,
        "memory_evidence": [m.gain for m in suspicion.memories],
        "memory_poses": ["walk" if np.isinf(m.length) else m.length for m in suspicion.memories],
        "wanders": wanders,
        "threshold_log10_p": selector.threshold,
        "scan_threshold_log10_p": judged.scan_threshold,
    }
    after_fit = fit.residual if named else scene.residual
    diagnosis = Diagnosis(
        verdict, location, claims, _proof(scene, judged, members, after_fit), (), remainder, tuple(lacking), smallest,
        noise, scene.seed, version,
    )  # fmt: skip
    return diagnosis, Picture(scene.session, scene.residual, after_fit)


def _as_p(scanned: _Scanned) -> float:
    return float(10.0 ** -scanned.log_p[scanned.loudest])


def _gain(selector: Selector, members: Sequence[Member]) -> float:
    left = outside(selector.space_with(members), selector.residual)
    return float(selector.residual @ selector.residual - left @ left)


def _verdict(
    scene: _Scene,
    members: Sequence[Member],
    rivalries: Sequence[Rivalry],
    fit: JointFit,
    wanders: bool,
    loud: bool,
    share: float,
) -> Verdict:
    if not members:
        return "wander" if wanders else ("unknown" if loud else "nothing_left_out")
    candidates = scene.candidates
    if any(not candidates[m.candidate].named for m in members):
        return "unknown"
    if fit.outside_gate:
        return "implausible_fit"
    for r in rivalries:
        shadow = [not c.named for c in candidates]
        if np.any(r.delta_bic[shadow] < 6.0):
            # an interaction without a name explains it as well
            return "partial"
    if share < NAMED_SHARE:
        return "partial"
    return "named_plus" if loud else "named"


def _located(
    judged: _Judged, members: Sequence[Member], after: _Scanned, loud: bool, share: float
) -> tuple[Location, ...]:
    selector = judged.selector
    found: tuple[Location, ...] = ()
    for m in members:
        others = selector.space_with([o for o in members if o != m])
        own = span(outside(others, selector.pool.columns(m)), tolerance=5e-3)
        signal = (own @ selector.residual) @ own
        total = max(_gain(selector, members), 1e-12)
        p = float(10.0 ** -selector.standing([o for o in members if o != m]).log_p[m.candidate])
        found += locate(judged.scan, signal, selector.base, p, min(1.0, share * float(signal @ signal) / total))
    if not members and loud:
        found += locate(judged.scan, after.signal, selector.base, _as_p(after), 1.0)
    return found


def _hints(
    scene: _Scene, judged: _Judged, after: _Scanned, loud: bool, members: Sequence[Member], wanders: bool
) -> tuple[str, ...]:
    hints = [
        f"follows the product {_variant(scene.candidates, m).label}"
        for m in members
        if not scene.candidates[m.candidate].named
    ]
    if loud:
        channel, basis = judged.scan.cells[after.loudest]
        hints.append(f"{CHANNELS[channel]} follows {judged.scan.bases[basis].covariate}")
    if wanders:
        hints.append("the zero offsets wander: slow effects cannot be told from that wandering here")
    return tuple(hints)


def _claim(scene: _Scene, judged: _Judged, member: Member, r: Rivalry, fit: JointFit) -> Claim:
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
    shown = [rival for i, rival in enumerate(ruled_out) if i < 3 or rival.effect in effect.confused_with]
    return Claim(
        effect=effect.id,
        story=effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        parameters=fit.parameters[effect.id],
        p_familywise=float(min(1.0, family * p)),
        equivalence_class=tuple(candidates[k].id for k in r.same),
        rivals_ruled_out=tuple(shown),
        next_manoeuvre=_advice(scene, judged, member, r, fit),
    )


def _advice(scene: _Scene, judged: _Judged, member: Member, r: Rivalry, fit: JointFit) -> str:
    """What to do next, in words: poses that split the class, or what the library knows to split it."""
    candidate = scene.candidates[member.candidate]
    assert candidate.effect is not None
    if len(r.same) == 1:
        return "none needed: no other effect of the library explains this recording as well"
    if scene.session.state.temp_c.size and candidate.effect.stage.value == "thermal":
        return candidate.effect.splitter
    rivals = [
        (scene.candidates[k], _variant(scene.candidates, r.best[k]).shape) for k in r.same if k != member.candidate
    ]
    amplitude = np.array([fit.parameters[candidate.id][name].value for name in candidate.amplitudes])
    advice = next_poses(
        scene.model, scene.session.state, scene.free,
        (candidate, _variant(scene.candidates, member).shape, amplitude), rivals, scene.base, 1.0 / scene.noise.sigma,
    )  # fmt: skip
    if advice.after < max(2 * advice.before, 12.0):
        return candidate.effect.splitter
    words = ", ".join(f"({inc:g}, {tf:g}{', from the other side' if d < 0 else ''})" for inc, tf, d in advice.poses)
    return f"measure these poses (inclination, toolface in deg): {words}; otherwise: {candidate.effect.splitter}"


def _proof(scene: _Scene, judged: _Judged, members: Sequence[Member], after: Array) -> Fit:
    """In-sample and held-out misfit, in g; the gain with its 95 % interval over blocks."""
    columns = [_variant(scene.candidates, m).columns for m in members]
    flat = scene.residual.reshape(-1)
    base = scene.base.reshape(scene.base.shape[0], -1)
    folds = pose_folds(scene.session.n)
    plain = HeldOut(base, flat, folds)
    claimed = np.concatenate(columns).reshape(-1, flat.size) if columns else np.empty((0, flat.size))
    before = plain.errors(np.empty((0, flat.size)))
    held = plain.errors(claimed)

    def rms(parts: list[Array]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    by_block = np.array([np.mean(b**2) - np.mean(a**2) for b, a in zip(before, held, strict=True)])
    relative = by_block / np.mean(np.concatenate(before) ** 2)
    half = 1.96 * float(relative.std(ddof=1) / np.sqrt(relative.size))
    return Fit(
        unit="g",
        rmse_before=float(np.sqrt(np.mean(scene.residual**2))),
        rmse_after=float(np.sqrt(np.mean(after**2))),
        heldout_rmse_before=rms(before),
        heldout_rmse_after=rms(held),
        heldout_gain_low=float(relative.mean()) - half,
        heldout_gain_high=float(relative.mean()) + half,
        noise_floor=float(np.sqrt(np.mean(scene.noise.sigma**2))),
        how_held_out=f"{len(folds)} contiguous blocks of poses; gain = share of the held-out mean square removed",
    )

"""What a recording cannot tell: effects that explain it as well as the claim, and effects that leave no trace in it.

Two candidates are one class where replacing one by the other costs less than 6 in BIC (of slow effects: with noise that
may be serially correlated), or where what the claim adds beyond the rival is expected to show with less than 12 in
chi-square (a rival that contains the claim is such a case). An effect is testable where its largest plausible size
would be detected with 80 % probability beside the base parameters.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term, span_with
from highside.diagnosis.core.candidates import Candidate, Unobservable, columns_of
from highside.diagnosis.core.memory import SlowScore
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.policy import REGRESSION, RIVALS
from highside.diagnosis.core.regression import outside
from highside.diagnosis.core.result import Detectable, NotTestable
from highside.diagnosis.core.selection import Selector
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from highside.special import fdtri


@dataclass(frozen=True)
class Rivalry:
    """How the candidates compare with one claim, all others of the claims kept: `delta_bic` (candidates,)."""

    delta_bic: Array
    best: list[Term]
    same: tuple[int, ...]


@dataclass(frozen=True)
class Refitted:
    """A rival in the place of a strong claim, fitted in full: how far it is behind in BIC."""

    rival: Term
    delta_bic: float


def rivalry(selector: Selector, terms: Sequence[Term], claim: Term) -> Rivalry:
    """Replace one claim by each other candidate."""
    others = [m for m in terms if m != claim]
    now = selector.ranking(others)
    delta = now.bic[claim.candidate] - now.bic
    space = selector.space_with(others)
    own = outside(space, selector.candidate_set.columns(claim))
    amplitude = np.linalg.lstsq(own.T, selector.residual, rcond=REGRESSION.visible)[0]
    signal = amplitude @ own
    taken = {m.candidate for m in others}
    same = [claim.candidate]
    for k in np.argsort(delta):
        if k == claim.candidate or k in taken or not selector.candidate_set.candidates[k].named:
            continue
        if now.log_p[k] < RIVALS.rival_log_p:
            # it explains nothing of this
            continue
        # the rival's best may be a part of it; the whole may contain the claim
        beyond = min(
            float(np.sum(outside(span_with(space, selector.candidate_set.columns(m)), signal) ** 2))
            for m in {now.best[k], selector.candidate_set.whole(now.best[k])}
        )
        if delta[k] < RIVALS.same_class_bic or beyond < RIVALS.same_class_evidence:
            same.append(int(k))
    return Rivalry(delta, now.best, tuple(same))


def beside_memory(found: Rivalry, scores: Sequence[SlowScore], claim: Term, taken: Container[int]) -> Rivalry:
    """The rivalry of a slow effect with other slow ones (`scores`) where the noise may have any memory.

    What two slow effects differ by is slow itself, and so may be wandering: a difference that white noise would make
    decisive counts only for what it is worth with the memory chosen anew beside each of the two.
    """
    best: dict[int, SlowScore] = {}
    for one in scores:
        k = one.effect.candidate
        if k not in best or one.score > best[k].score:
            best[k] = one
    delta, terms, same = found.delta_bic.copy(), list(found.best), list(found.same)
    for k, one in best.items():
        if k == claim.candidate or k in taken:
            continue
        apart = best[claim.candidate].score - one.score
        if apart < delta[k]:
            delta[k], terms[k] = apart, Term(k, one.effect.variant)
        if apart < RIVALS.same_class_bic and one.log_p > MEMORY.near_log_p and k not in same:
            same.append(k)
    return Rivalry(delta, terms, tuple(same))


def evidence_80(dof: int, freedom: float, threshold: float) -> float:
    """Strength (noncentrality) at which an F test with `dof` directions passes the threshold in 80 % of cases."""
    limit = dof * float(fdtri(dof, freedom, 1 - 10 ** -min(threshold, RIVALS.most_log_p)))
    # chi-square with noncentrality l: mean dof + l, variance 2 dof + 4 l; solve mean - 0.84 std = limit
    excess, z2 = limit - dof, RIVALS.power_80**2
    return float(excess + 2 * z2 + np.sqrt((excess + 2 * z2) ** 2 - excess**2 + 2 * dof * z2))


def what_shows(
    candidate_set: CandidateSet,
    base: Array,
    freedom: float,
    threshold: float,
    unobservable: Sequence[Unobservable],
    absorbing: Sequence[str],
) -> tuple[list[NotTestable], dict[str, Detectable]]:
    """Effects that this recording cannot show, and the smallest size it would have shown of the others.

    `absorbing` are the ids of the base fit's effects.
    """
    lacking = [NotTestable(b.effect.id, b.why, b.effect.splitter) for b in unobservable]
    smallest: dict[str, Detectable] = {}
    for k, candidate in enumerate(candidate_set.candidates):
        if candidate.effect is None:
            continue
        variants = [
            i
            for i in np.flatnonzero(candidate_set.owner == k)
            if candidate.variants[candidate_set.terms[i].variant].whole
        ]
        sizes = np.array([_smallest(candidate_set.blocks[i], base, freedom, threshold) for i in variants])
        amplitudes = [p for p in candidate.effect.parameters if not p.shape]
        gates = np.array([max(abs(p.gate[0]), abs(p.gate[1])) for p in amplitudes])
        ratio = np.min(sizes, axis=0) / gates
        detectable = ratio < 1
        if not detectable.any():
            why = _why(np.min(sizes, axis=0), gates, [p.unit for p in amplitudes], absorbing)
            lacking.append(NotTestable(candidate.id, why, candidate.effect.splitter))
            continue
        # amplitudes of one unit are comparable: the figure is of the first kind that shows
        unit = amplitudes[int(np.argmax(detectable))].unit
        alike = detectable & np.array([p.unit == unit for p in amplitudes])
        smallest[candidate.id] = Detectable(float(np.median(np.min(sizes, axis=0)[alike])), unit)
    return lacking, smallest


def _why(sizes: Array, gates: Array, units: Sequence[str], absorbing: Sequence[str]) -> str:
    """Why amplitudes (k,) do not show: absorbed whatever their size, or too small wherever they are plausible."""
    k = int(np.argmin(sizes / gates))
    if sizes[k] < RIVALS.beyond_reason * gates[k]:
        return f"it would show from {sizes[k]:.2g} {units[k]} on, and is not plausible beyond {gates[k]:.2g} {units[k]}"
    if absorbing:
        return f"whatever its size, it is absorbed by {', '.join(absorbing)}"
    return "whatever its size, these readings do not respond to it"


def _smallest(columns: Array, base: Array, freedom: float, threshold: float) -> Array:
    """(k,) size of each amplitude alone that would be detected with 80 % probability; infinite where it is absorbed."""
    left = np.linalg.norm(outside(base, columns), axis=1)
    full = np.linalg.norm(columns, axis=1)
    needed = np.sqrt(evidence_80(columns.shape[0], freedom, threshold))
    shows = left > REGRESSION.visible * full
    return np.where(shows, needed / np.where(shows, left, 1.0), np.inf)


@dataclass(frozen=True)
class PoseAdvice:
    """Poses (inclination deg, toolface deg, direction) and by how much they raise the evidence between the rivals."""

    poses: tuple[tuple[float, float, int], ...]
    before: float
    after: float


def next_poses(
    model: ForwardModel,
    state: ChainState,
    free: Sequence[str],
    claim: tuple[Candidate, dict[str, float], Array],
    rivals: Sequence[tuple[Candidate, dict[str, float]]],
    base: Array,
    white_per_g: Array,
    count: int = RIVALS.next_poses,
) -> PoseAdvice:
    """Poses, chosen one by one and each once, that raise most the smallest evidence of the claim against any rival.

    `claim` is the candidate, its shape and the fitted amplitudes; `base` (P, 3, n) and `white_per_g` (3,) (1 / noise of
    a channel) describe what has been measured. Time, temperature and vibration stay as they were at the end.
    """
    offered, new = _offered(state)
    candidate, shape, amplitude = claim
    assert candidate.effect is not None

    def signal(where: ChainState) -> Array:
        assert candidate.effect is not None
        return np.tensordot(amplitude, columns_of(model, where, candidate.effect, shape), 1)[None]

    nothing = np.empty((0, 3, new.n))
    base_new = np.asarray(model.jacobian(new, list(free)), dtype=float) if free else nothing
    pairs = []
    for rival, rival_shape in rivals:
        assert rival.effect is not None
        old = np.concatenate([signal(state), base, columns_of(model, state, rival.effect, rival_shape)])
        fresh = np.concatenate([signal(new), base_new, columns_of(model, new, rival.effect, rival_shape)])
        scale = white_per_g[:, None]
        rows = (old * scale).reshape(old.shape[0], -1)
        pairs.append((rows @ rows.T, np.einsum("pin,qin->npq", fresh * scale, fresh * scale)))
    grams = [gram for gram, _ in pairs]
    before = min(beyond(gram[None])[0] for gram in grams)
    chosen: list[int] = []
    taken = np.zeros(new.n, dtype=bool)
    for _ in range(count):
        worst = np.min([beyond(gram[None] + new) for gram, (_, new) in zip(grams, pairs, strict=True)], axis=0)
        worst[taken] = -np.inf
        best = int(np.argmax(worst))
        chosen.append(best)
        taken[best] = True
        if offered[0, best] in (0.0, 180.0):
            # upright a turn may change nothing that is read: that is the same pose once more
            largest = [REGRESSION.independent * np.abs(new[best]).max() for _, new in pairs]
            alike = [
                np.all(np.abs(new - new[best]) <= x, axis=(1, 2)) for x, (_, new) in zip(largest, pairs, strict=True)
            ]
            taken |= np.all(alike, axis=0) & np.all(offered[::2] == offered[::2, [best]], axis=0)
        grams = [gram + new[best] for gram, (_, new) in zip(grams, pairs, strict=True)]
    after = min(beyond(gram[None])[0] for gram in grams)
    poses = tuple((float(inc), float(tf), int(direction)) for inc, tf, direction in offered[:, chosen].T)
    return PoseAdvice(poses, float(before), float(after))


def _offered(state: ChainState) -> tuple[Array, ChainState]:
    """The poses to choose from: (3, n) of inclination and toolface, deg, and direction, and the states in them."""
    grid = [
        (i, t, d)
        for i in range(0, 180 + 1, RIVALS.inclinations_deg)
        for t in np.arange(0, 360, RIVALS.toolfaces_deg)
        for d in (1, -1)
    ]
    if not np.ptp(state.direction):
        # a session that came from one side goes on so
        grid = [(i, t, int(state.direction[0])) for i, t, d in grid if d > 0]
    inc, tf, direction = (np.array(column, dtype=float) for column in zip(*grid, strict=True))
    return np.stack([inc, tf, direction]), ChainState.build(
        np.radians(inc),
        np.radians(tf),
        t_s=np.full(inc.size, float(state.t_s[-1])),
        direction=direction,
        temp_c=float(state.temp_c[-1]),
        vibration_rms_g=float(state.vibration_rms_g[-1]),
        gravity_mps2=state.gravity_mps2,
    )


def beyond(grams: Array) -> Array:
    """Energy (B,) of the first column outside of the others, from Gram matrices (B, P, P)."""
    inner, cross = grams[:, 1:, 1:], grams[:, 1:, 0]
    size = np.sqrt(np.maximum(np.einsum("bii->bi", inner), 1e-30))
    scaled = inner / (size[:, :, None] * size[:, None, :]) + 1e-9 * np.eye(inner.shape[1])
    solved = np.linalg.solve(scaled, (cross / size)[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(grams[:, 0, 0] - np.sum(solved * cross / size, axis=1), 0.0))

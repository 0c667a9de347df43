"""From what was chosen to what is reported: classes, refit, remainder, places, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import INCLINATION_STATION
from highside.diagnosis.core.checked import checked, without_rounding
from highside.diagnosis.core.effect_scores import effect_scores
from highside.diagnosis.core.fit import JointFit
from highside.diagnosis.core.policy import CONCLUSION
from highside.diagnosis.core.problem import N, Problem, ReportData, SelectionState
from highside.diagnosis.core.regression import log10_p, outside, p_of, span
from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location, Remainder, Rival, Verdict
from highside.diagnosis.core.rival_refit import beside_refits, refitted
from highside.diagnosis.core.rivals import Rivalry, beside_memory, rivalry, what_shows
from highside.diagnosis.core.selection import Selector
from highside.diagnosis.core.serial_correlation import RANDOM_WALK, SerialCorrelation, slow_ranking
from highside.diagnosis.core.untestable import what_splits

SLOW_COVARIATES = frozenset({"t_s", "temp_c"})


@dataclass(frozen=True)
class _Scanned:
    """The scan after some terms: -log10 p (cells,), the most significant cell, and the best excess of each channel."""

    log_p: Array
    most_significant: int
    excess: Array
    signal: Array
    """what the most significant cell would explain"""


def _scan(problem: Problem[N], selection: SelectionState[N], terms: Sequence[Term]) -> _Scanned:
    space = selection.selector.space_with(terms)
    residual = outside(space, selection.selector.residual)
    gains, dof = selection.scan.score_test.run(space, residual[None])
    log_p = log10_p(gains[:, 0], dof, selection.scan.freedom)
    for k in np.flatnonzero(log_p > selection.scan_threshold):
        if not problem.beyond_memory(selection, terms, int(k), int(dof[k])):
            log_p[k] = selection.scan_threshold
    most_significant = int(np.argmax(log_p))
    over = np.maximum(gains[:, 0] - dof, 0.0)
    # the cells of one basis stand together, channel by channel
    excess = over.reshape(-1, len(problem.channels)).max(axis=0)
    group = span(outside(space, selection.scan.white[most_significant]), tolerance=CONCLUSION.own)
    return _Scanned(log_p, most_significant, excess, (group @ residual) @ group)


def is_significant(problem: Problem[N], selection: SelectionState[N], terms: Sequence[Term]) -> bool:
    """Whether the scan finds more than chance beside terms."""
    after = _scan(problem, selection, terms)
    return bool(after.log_p[after.most_significant] > selection.scan_threshold)


def conclude(
    problem: Problem[N],
    selection: SelectionState[N],
    correlation: SerialCorrelation[N],
    version: str,
    many: bool = False,
) -> tuple[DiagnosisResult, ReportData]:
    """What is reported of the terms chosen, and the data of figures; `many`: names of any number, laws will compete."""
    believed = problem.believed(selection, _widened(problem, selection))
    believed, changing = problem.steady(selection, believed) if problem.method.refusal else (believed, {})
    if believed != selection.terms:
        selection = replace(selection, terms=believed, fit=None, refits={})
    terms, selector = selection.terms, selection.selector
    named = [m for m in terms if problem.candidates[m.candidate].named]
    after = _scan(problem, selection, terms)
    significant = float(after.log_p[after.most_significant]) > selection.scan_threshold
    fit = selection.fit if selection.fit is not None else problem.fit(named, selection.noise)
    rivalries = [_rivalry(problem, selection, m, fit) for m in terms]
    share = _explained_share(problem, selection, after) if significant else 1.0
    random_walk = correlation.random_walk or (significant and not terms and _follows_slow_alone(selection, after))
    clear = float(after.log_p[after.most_significant]) > selection.scan_threshold + problem.policy.marginal
    manifest = many or (not significant and _each_manifest(selector, terms))
    verdict = _verdict(problem, terms, rivalries, fit, random_walk, significant, share if clear else 1.0, manifest)
    if verdict == "named_plus" and share < CONCLUSION.changing and _changes(problem, selection, terms, after, share):
        verdict = "partial"
    proof = problem.proof(terms, fit)
    if verdict in ("named", "named_plus") and problem.method.refusal and _worse(proof):
        verdict = "partial"

    resembles = tuple(problem.variant(m).label or problem.candidates[m.candidate].id for m in terms)
    claiming = verdict in ("named", "named_plus")
    claims, withheld = _claims(problem, selection, rivalries, fit, verdict)
    location = (
        _located(problem, selection, terms, share)
        if claiming
        else _located_whole(problem, selection, terms, after, significant)
    )
    remainder = Remainder(
        location=problem.locate_whole(selection, after.signal, terms, _as_p(after), 1.0 - share) if significant else (),
        hints=_hints(problem, selection, after, significant, terms, random_walk),
        p=_as_p(after),
        resembles=() if claiming else (*resembles, *(n for n in correlation.near if n not in resembles)),
    )
    lacking, smallest = what_shows(
        selector.candidate_set,
        selector.base,
        problem.noise.freedom,
        selector.threshold,
        problem.unobservable,
        problem.free,
    )
    noise = _noise_summary(problem, selection, correlation, random_walk)
    diagnosis = DiagnosisResult(
        verdict, location, claims, proof, (), remainder, tuple(lacking), smallest, noise, problem.seed, version
    )
    diagnosis = checked(problem, selection, diagnosis, correlation.memories, changing)
    scores = effect_scores(selector, problem.pooled_laws(selection.noise))
    report_data = replace(problem.report_data(fit if named else None), scores=scores, withheld=withheld)
    return without_rounding(problem, problem.completed(diagnosis)), report_data


def _claims(
    problem: Problem[N], selection: SelectionState[N], rivalries: Sequence[Rivalry], fit: JointFit, verdict: Verdict
) -> tuple[tuple[Claim, ...], tuple[Claim, ...]]:
    """What is claimed, and what is withheld because its size is not plausible."""
    if verdict not in ("named", "named_plus", "implausible_fit"):
        return (), ()
    pairs = zip(selection.terms, rivalries, strict=True)
    found = tuple(_claim(problem, selection, term, rivals, fit) for term, rivals in pairs)
    return ((), found) if verdict == "implausible_fit" else (found, ())


def _explained_share(problem: Problem[N], selection: SelectionState[N], after: _Scanned) -> float:
    """What the terms explain of all that is not chance, the scan being significant beside them."""
    explained = _gain(selection.selector, selection.terms)
    significant_bases = after.log_p.reshape(-1, len(problem.channels)).max(axis=0) > selection.scan_threshold
    left = float(after.excess[significant_bases].sum())
    return explained / (explained + left) if explained + left > 0 else 1.0


def _follows_slow_alone(selection: SelectionState[N], after: _Scanned) -> bool:
    """Whether nothing but time or temperature is followed. Without a term: no slow effect beat the random walk."""
    passing = np.flatnonzero(after.log_p > selection.scan_threshold)
    return all(selection.scan.bases[selection.scan.cells[i][1]].covariate in SLOW_COVARIATES for i in passing)


def _each_manifest(selector: Selector, terms: Sequence[Term]) -> bool:
    """Whether all terms but one at most are large beside what chance explains."""
    explained = _gain(selector, terms)
    alone = [explained - _gain(selector, [o for o in terms if o != m]) for m in terms]
    return sum(gain < CONCLUSION.manifest for gain in alone) <= 1


def _noise_summary(
    problem: Problem[N], selection: SelectionState[N], correlation: SerialCorrelation[N], random_walk: bool
) -> dict[str, Any]:
    return {
        **problem.noise_summary(),
        "memory_evidence": [m.gain for m in correlation.memories],
        "memory_poses": [RANDOM_WALK if np.isinf(m.length) else m.length for m in correlation.memories],
        "memory_lead": [m.lead for m in correlation.memories],
        "random_walk": random_walk,
        "threshold_log10_p": selection.selector.threshold,
        "scan_threshold_log10_p": selection.scan_threshold,
    }


def _rivalry(problem: Problem[N], selection: SelectionState[N], claim: Term, fit: JointFit) -> Rivalry:
    """How the candidates compare with a claim; slow ones with a slow one as serially correlated noise lets them.

    What was taken out of the readings is what the claims do beyond first order. A rival has a right to all readings.
    """
    found = rivalry(selection.selector, selection.terms, claim)
    slow = problem.slow() if problem.method.colour else []
    if selection.to_the_floor or claim.candidate not in {s.candidate for s in slow}:
        if not problem.has_second_order:
            return found
        refits = selection.refits.get(claim) or refitted(problem, selection, claim, fit, found)
        return beside_refits(found, refits)
    others = [m for m in selection.terms if m != claim]
    scores = slow_ranking(problem, others, claim.candidate)
    return beside_memory(found, scores, claim, {m.candidate for m in others})


def _widened(problem: Problem[N], selection: SelectionState[N]) -> list[Term]:
    """The terms; where the scan is significant beside them, with one with all its amplitudes or replaced, if that makes
    it quiet.

    The rest of an effect that was let act in part may be too small to be worth its parameters, and still be there; and
    of rivals that cannot be distinguished, the one that leaves nothing is the better answer.
    """
    terms, selector = selection.terms, selection.selector

    def significant(subset: list[Term]) -> bool:
        return is_significant(problem, selection, subset)

    if not terms or not significant(terms):
        return terms
    for m in terms:
        if not problem.candidates[m.candidate].named or m in selector.fixed:
            continue
        shape, variants = problem.variant(m).shape, problem.candidates[m.candidate].variants
        tries = [Term(m.candidate, j) for j, v in enumerate(variants) if v.whole and v.shape == shape]
        r = rivalry(selector, terms, m)
        tries += [r.best[k] for k in r.same[1:] if k not in selector.banned]
        for other in tries:
            changed = [other if o == m else o for o in terms]
            if other != m and not significant(changed):
                return changed
    return terms


def _as_p(scanned: _Scanned) -> float:
    return p_of(float(scanned.log_p[scanned.most_significant]))


def _gain(selector: Selector, terms: Sequence[Term]) -> float:
    left = outside(selector.space_with(terms), selector.residual)
    return float(selector.residual @ selector.residual - left @ left)


def _verdict(
    problem: Problem[N],
    terms: Sequence[Term],
    rivalries: Sequence[Rivalry],
    fit: JointFit,
    random_walk: bool,
    significant: bool,
    share: float,
    manifest: bool,
) -> Verdict:
    if not terms:
        return "wander" if random_walk else ("unknown" if significant else "nothing_left_out")
    if not problem.method.refusal:
        return "named"
    candidates = problem.candidates
    if any(not candidates[m.candidate].named for m in terms):
        return "unknown"
    if fit.outside_gate:
        return "implausible_fit"
    margin = np.array(
        [
            -np.inf
            if c.named
            else CONCLUSION.station_margin
            if c.id.startswith(INCLINATION_STATION)
            else problem.policy.interaction_margin
            for c in candidates
        ]
    )
    for r in rivalries:
        if np.any(r.delta_bic < margin):
            # an interaction without a name explains it as well
            return "partial"
    if share < problem.policy.named_share or (len(terms) > problem.policy.most_named and not manifest):
        return "partial"
    return "named_plus" if significant else "named"


def _worse(proof: Fit) -> bool:
    """Whether held-out readings are predicted worse with the names than without: no finding, whatever its p."""
    before, after = proof.heldout_rmse_before, proof.heldout_rmse_after
    return before is not None and after is not None and after >= before


def _changes(
    problem: Problem[N], selection: SelectionState[N], terms: Sequence[Term], after: _Scanned, share: float
) -> bool:
    """Whether the most significant remainder is a product of covariates on a channel that a claim acts on: its size
    changes."""
    channel, basis = selection.scan.cells[after.most_significant]
    if " x " not in selection.scan.bases[basis].covariate:
        return False
    return any(problem.channels[channel] in place.channels for place in _located(problem, selection, terms, share))


def _located(
    problem: Problem[N], selection: SelectionState[N], terms: Sequence[Term], share: float
) -> tuple[Location, ...]:
    """Where each of the named terms sits."""
    selector = selection.selector
    found: tuple[Location, ...] = ()
    for m in terms:
        others = selector.space_with([o for o in terms if o != m])
        own = span(outside(others, selector.candidate_set.columns(m)), tolerance=CONCLUSION.own)
        signal = (own @ selector.residual) @ own
        total = max(_gain(selector, terms), 1e-12)
        p = p_of(float(selector.ranking([o for o in terms if o != m]).log_p[m.candidate]))
        portion = min(1.0, share * float(signal @ signal) / total)
        found += problem.locate(selection, signal, selector.base, p, portion)
    return found


def _located_whole(
    problem: Problem[N], selection: SelectionState[N], terms: Sequence[Term], after: _Scanned, significant: bool
) -> tuple[Location, ...]:
    """Where all of the mismatch sits, where it has no name: terms that are not believed have no places of their own.

    What is not chance of it is taken to be what the terms and the most significant cell of the scan explain.
    """
    if not terms and not significant:
        return ()
    selector = selection.selector
    own = [selector.candidate_set.stack(terms)] + (
        [selection.scan.white[after.most_significant]] if significant else []
    )
    explained = span(outside(selector.base, np.concatenate(own)), tolerance=CONCLUSION.own)
    signal = (explained @ selector.residual) @ explained
    log_p = [float(selector.ranking([o for o in terms if o != m]).log_p[m.candidate]) for m in terms]
    p = p_of(max([*log_p, float(after.log_p[after.most_significant])]))
    return problem.locate_whole(selection, signal, [], p, 1.0)


def _hints(
    problem: Problem[N],
    selection: SelectionState[N],
    after: _Scanned,
    significant: bool,
    terms: Sequence[Term],
    random_walk: bool,
) -> tuple[str, ...]:
    hints = [f"follows {problem.variant(m).label}" for m in terms if not problem.candidates[m.candidate].named]
    if significant:
        channel, basis = selection.scan.cells[after.most_significant]
        hints.append(f"{problem.channels[channel]} follows {selection.scan.bases[basis].covariate}")
    if random_walk:
        hints.append("the zero offsets follow a random walk: slow effects cannot be distinguished from it here")
    return tuple(hints)


def _claim(problem: Problem[N], selection: SelectionState[N], term: Term, r: Rivalry, fit: JointFit) -> Claim:
    candidate = problem.candidates[term.candidate]
    effect = candidate.effect
    assert effect is not None
    candidates = problem.candidates
    p = p_of(float(selection.selector.ranking([m for m in selection.terms if m != term]).log_p[term.candidate]))
    family = len(candidates)
    ruled_out = sorted(
        (
            Rival(c.id, float(r.delta_bic[k]))
            for k, c in enumerate(candidates)
            if c.named and k not in r.same and all(m.candidate != k for m in selection.terms)
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
        next_manoeuvre=_advice(problem, term, r, fit),
    )


def _advice(problem: Problem[N], term: Term, r: Rivalry, fit: JointFit) -> str:
    """What to do next, in words: what splits the class, or what the library knows to split it."""
    effect = problem.candidates[term.candidate].effect
    assert effect is not None
    if len(r.same) == 1:
        return "none needed: no other effect of the library explains this recording as well"
    if effect.stage.value != "thermal":
        return problem.advice(term, r, fit)
    rivals = [e for k in r.same if k != term.candidate and (e := problem.candidates[k].effect) is not None]
    return what_splits(effect, rivals)

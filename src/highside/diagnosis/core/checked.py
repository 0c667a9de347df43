"""The rules of honesty, applied to a concluded diagnosis before it is reported.

Claims get their share of what is explained and are ordered by it; a size that changes over the recording is no constant
and is not named; sizes beside a large remainder are as wide as the remainder makes them; scatter above the noise floor
is reported; and the answer says how much of the library and of the recording it rests on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.finding_policy import CHECKED
from highside.diagnosis.core.memory import Memory
from highside.diagnosis.core.problem import N, Problem, SelectionState
from highside.diagnosis.core.result import Claim, Coverage, DiagnosisResult, FittedParameter, Remainder, Verdict
from highside.diagnosis.core.shares import shares_of
from highside.diagnosis.core.stability import Stability
from highside.diagnosis.core.unexplained import hinted, unexplained, with_excess, with_lattice


def checked(
    problem: Problem[N],
    selection: SelectionState[N],
    diagnosis: DiagnosisResult,
    memories: Sequence[Memory],
    dropped: Mapping[str, Stability] | None = None,
) -> DiagnosisResult:
    """The diagnosis by the rules; claims and locations stand in the order of the selected terms. Of `dropped` effects,
    which were small, the sizes change."""
    if diagnosis.claims and len(diagnosis.claims) == len(selection.terms):
        diagnosis = _weighed(problem, selection, diagnosis)
    elif problem.method.refusal:
        diagnosis = _with_changing(problem, selection, diagnosis)
    if dropped:
        more: Verdict = "named_plus" if diagnosis.verdict == "named" else diagnosis.verdict
        diagnosis = replace(diagnosis, verdict=more, remainder=_noted_as_changing(diagnosis.remainder, dropped))
    if problem.method.refusal:
        found = unexplained(problem.floor_excess(selection.terms), memories)
        diagnosis = with_excess(diagnosis, found, problem.readings, problem.policy.floor_ratio)
    return _as_far_as_covered(replace(diagnosis, coverage=_coverage(problem, diagnosis)))


def _as_far_as_covered(diagnosis: DiagnosisResult) -> DiagnosisResult:
    """Nothing left out of the lesser part of a session says nothing of the session."""
    covered = diagnosis.coverage
    if covered is None or covered.intervals_used is None or covered.intervals_expected is None:
        return diagnosis
    used, expected = covered.intervals_used, covered.intervals_expected
    if diagnosis.verdict != "nothing_left_out" or used >= CHECKED.covered * expected:
        return diagnosis
    words = f"only {used} of about {expected} holds were still enough to be read: hold the tool still, on a rest"
    return hinted(replace(diagnosis, verdict="not_testable"), words)


def without_rounding(problem: Problem[N], diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis where what is left without a name may be the rounding of a coarse converter."""
    if problem.in_steps is None or not problem.method.refusal:
        return diagnosis
    return with_lattice(diagnosis, *problem.in_steps, problem.channels)


def _weighed(problem: Problem[N], selection: SelectionState[N], diagnosis: DiagnosisResult) -> DiagnosisResult:
    """Claims with shares, channels and stability, the largest first; withdrawn where a size is no constant."""
    terms = selection.terms
    shares = shares_of(selection.selector, terms)
    stabilities = (
        [problem.stability(selection, term) for term in terms] if problem.method.refusal else [None] * len(terms)
    )
    places = diagnosis.location if len(diagnosis.location) == len(terms) else None
    claims = [
        replace(
            claim,
            share=float(share),
            channels=places[k].channels if places else (),
            stable=None if steady is None else steady.stable,
        )
        for k, (claim, share, steady) in enumerate(zip(diagnosis.claims, shares, stabilities, strict=True))
    ]
    changing = [k for k, steady in enumerate(stabilities) if steady is not None and not steady.stable]
    if changing:
        return _withdrawn(diagnosis, {claims[k].effect: s for k in changing if (s := stabilities[k]) is not None})
    known = [(c.effect, s) for c, s in zip(claims, stabilities, strict=True) if s is not None]
    doubts = [steady.doubt_for(effect) for effect, steady in known if steady.beside_random_walk]
    if doubts:
        remainder = replace(diagnosis.remainder, hints=(*doubts, *diagnosis.remainder.hints))
        diagnosis = replace(diagnosis, remainder=remainder)
    order = [int(k) for k in np.argsort(-shares, kind="stable")]
    location = tuple(places[k] for k in order) if places else diagnosis.location
    found = replace(diagnosis, claims=tuple(claims[k] for k in order), location=location)
    return _widened(found, problem.mean_square_left(selection), [stabilities[k] for k in order])


def _with_changing(problem: Problem[N], selection: SelectionState[N], diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis where names are withdrawn already: those whose sizes change are reported as such."""
    named = [m for m in selection.terms if problem.candidates[m.candidate].named]
    found = {problem.candidates[m.candidate].id: problem.stability(selection, m) for m in named}
    changing = {name: steady for name, steady in found.items() if steady is not None and not steady.stable}
    return replace(diagnosis, remainder=_noted_as_changing(diagnosis.remainder, changing)) if changing else diagnosis


def _withdrawn(diagnosis: DiagnosisResult, changing: Mapping[str, Stability]) -> DiagnosisResult:
    """Names are not given where one of them has no constant size."""
    remainder = replace(diagnosis.remainder, resembles=tuple(claim.effect for claim in diagnosis.claims))
    remainder = _noted_as_changing(remainder, changing)
    return replace(diagnosis, verdict="partial", claims=(), remainder=remainder)


def _noted_as_changing(remainder: Remainder, changing: Mapping[str, Stability]) -> Remainder:
    hints = tuple(steady.hint_for(effect) for effect, steady in changing.items())
    instead = (steady.instead for steady in changing.values() if steady.instead)
    return replace(
        remainder,
        hints=(*hints, *remainder.hints),
        resembles=tuple(dict.fromkeys((*instead, *remainder.resembles))),
        changing=tuple(dict.fromkeys((*changing, *remainder.changing))),
    )


def _widened(
    diagnosis: DiagnosisResult, left: float | None, stabilities: Sequence[Stability | None]
) -> DiagnosisResult:
    """Sizes beside a remainder of `left` noise variances a reading: their intervals hold what it does to them."""
    if left is None or left < CHECKED.remainder:
        return diagnosis
    factor = float(np.sqrt(left))
    claims = tuple(replace(claim, parameters=_wider(claim, factor)) for claim in diagnosis.claims)
    words = [
        f"{claim.effect} beside a remainder of {factor:.1f} times the noise: {steady.words}"
        for claim, steady in zip(claims, stabilities, strict=True)
        if steady is not None
    ]
    remainder = replace(diagnosis.remainder, hints=(*diagnosis.remainder.hints, *words))
    return replace(diagnosis, claims=claims, remainder=remainder)


def _wider(claim: Claim, factor: float) -> dict[str, FittedParameter]:
    return {
        name: replace(
            p,
            std=factor * p.std,
            low=p.value - factor * (p.value - p.low),
            high=p.value + factor * (p.high - p.value),
        )
        for name, p in claim.parameters.items()
    }


def _coverage(problem: Problem[N], diagnosis: DiagnosisResult) -> Coverage:
    """How many effects could be tested of those that act on such recordings, and the still intervals behind it."""
    known = {c.id for c in problem.candidates if c.named} | {b.effect.id for b in problem.unobservable}
    lacking = {entry.effect for entry in diagnosis.not_testable}
    used, expected = problem.intervals or (None, None)
    return Coverage(len(known - lacking), len(known), used, expected)

"""Names and laws side by side: which of them a recording supports, and what is reported.

What the library explains is chosen already. Then smooth laws compete: beside the names, with these fixed; and against
them, as groups of the same evidence. The higher evidence is reported. A law that stands where a name stood says which
name it resembles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, Fit, Location, Remainder, Verdict
from highside.diagnosis.law_sessions import LawSession, linear
from highside.diagnosis.laws.claims import ReportedLaw, cases_of_laws, heldout_of, named_claim, reported_laws
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.diagnosis.laws.search import Found, Search
from highside.physics import effects as library
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel
from highside.physics.law import PREFIX, Law

UNTOUCHED = frozenset({"bad_data", "not_testable"})
"""verdicts of which nothing is to be reported"""

COLUMNS = {
    "tf": "tf_ref_deg",
    "inc": "inc_ref_deg",
    "temp": "temp_c",
    "time": "t_s",
    "rate": "rotor_rate_dps",
    "vibration": "vibration_rms_g",
}
"""columns of a recording that covariates of laws are"""
OFFSETS = frozenset({"offset", "gyro_offset"})
"""places in which a random walk of the zero offset acts"""
SLOW = frozenset({"time", "temp", "temp_rate", "temp_filtered_300", "temp_filtered_1200"})
"""covariates that run as slowly as such a random walk"""


@dataclass(frozen=True)
class _Outcome:
    """What was chosen: names that stay, laws, and the search that found them."""

    names: tuple[Claim, ...]
    laws: tuple[ReportedLaw, ...]
    found: Found


def with_laws(
    session: LawSession, model: ForwardModel, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with the laws that the recording supports beside its names or in their place.

    `model` is the one against which it was diagnosed, its free effects fitted.
    """
    if diagnosis.verdict in UNTOUCHED:
        return diagnosis, report
    left, given = float(np.sum(report.after**2)), float(np.sum(report.before**2))
    if diagnosis.claims and left < LAW_VERDICT.least_share * given:
        # no law of what is left could have the least share
        return diagnosis, report
    chain = tuple(c for c in diagnosis.claims if not library.registry()[c.effect].random)
    changing = diagnosis.remainder.changing
    near = [name for name in diagnosis.remainder.resembles if name not in changing]
    outcome = _chosen(session, model, chain, near)
    if outcome is None:
        return diagnosis, report
    random_walk = diagnosis.verdict == "wander"
    outcome = replace(outcome, laws=tuple(one for one in outcome.laws if _believed(one, outcome, random_walk)))
    if not outcome.laws:
        return diagnosis, report
    # rounding is a function of the reading too: what is below half its step is no law
    large = [np.any(np.abs(one.effect) > session.lattice[:, None] / 2) for one in outcome.laws]
    if not all(large):
        return diagnosis, report
    others = tuple(c for c in diagnosis.claims if c not in chain)
    laws = tuple(
        replace(one.claim, resembles=_resembled(session, model, outcome.found, one.effect)) for one in outcome.laws
    )
    claims = (*others, *outcome.names, *laws)
    verdict: Verdict = "named_plus" if outcome.names or others else "law"
    final = _final(session, model, outcome)
    after = np.asarray(session.observed.residual(final))
    places = tuple(location_of(c) for c in laws)
    kept = tuple(place for place in diagnosis.location if outcome.names and diagnosis.claims)
    made = replace(
        diagnosis,
        verdict=verdict,
        location=(*kept, *places),
        claims=claims,
        fit=_fit(session, outcome.found, report, after, diagnosis.fit),
        remainder=beside_laws(diagnosis.remainder),
        noise={**diagnosis.noise, "beside_laws": outcome.found.noise.summary()},
    )
    parts = {name: part for name, part in report.parts.items() if any(c.effect == name for c in outcome.names)}
    for one in outcome.laws:
        lacking = final.without(one.law.id)
        parts[one.law.id] = np.asarray(session.observed.residual(lacking) - after)
    return made, replace(report, after=after, parts=parts)


def names_before_laws(
    session: LawSession, model: ForwardModel, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData] | None:
    """A diagnosis of many names with the laws beside them; None unless every name stays where laws compete with it."""
    if diagnosis.verdict not in ("named", "named_plus"):
        return None
    made, data = with_laws(session, model, diagnosis, report)
    names = {c.effect for c in made.claims}
    return (made, data) if {c.effect for c in diagnosis.claims} <= names else None


def beside_laws(remainder: Remainder) -> Remainder:
    """What is told where laws are claimed: what they resemble, and which names have no constant size."""
    return Remainder(
        hints=remainder.hints[: len(remainder.changing)],
        resembles=tuple(name for name in remainder.resembles if name in library.registry()),
        changing=remainder.changing,
    )


def location_of(law: Claim) -> Location:
    """Where a law acts, by the columns of a recording: along its first covariate where its curve is large."""
    along = " x ".join(COLUMNS.get(name, name) for name in law.depends_on)
    intervals: tuple[tuple[float, float], ...] = law.range[:1]
    if law.curve is not None and len(law.depends_on) == 1:
        value = np.asarray(law.curve.value) - np.median(law.curve.value)
        large = np.abs(value) >= LAW_VERDICT.large * np.abs(value).max(initial=0.0)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], large, [False]]).astype(int)))
        grid = law.curve.grid
        intervals = tuple((grid[a], grid[b - 1]) for a, b in zip(edges[::2], edges[1::2], strict=True))
    return Location(law.channels, along, intervals, None, law.share or 0.0, law.p_familywise)


def _believed(one: ReportedLaw, outcome: _Outcome, random_walk: bool) -> bool:
    """Whether a law is more than what strong names leave of themselves, or than a random walk that was found."""
    claim = one.claim
    if outcome.names and (claim.share or 0.0) < LAW_VERDICT.least_share:
        return False
    # at one inclination an element of the load matrix is an offset: what may be one is judged as one
    shifts = claim.place in OFFSETS or any(
        id_.startswith(tuple(f"{PREFIX}{place}_" for place in OFFSETS)) for id_ in claim.equivalence_class
    )
    slow = shifts and SLOW.issuperset(claim.depends_on)
    return not (random_walk and slow) or claim.p_familywise <= np.exp(-LAW_VERDICT.beside_random_walk)


# --- the choice ----------------------------------------------------------------------------------------------


def _chosen(session: LawSession, model: ForwardModel, claims: Sequence[Claim], near: Sequence[str]) -> _Outcome | None:
    """The names that stay and the laws; None where there is no law."""
    if not claims:
        return _alone(session, model, near)
    values = {c.effect: _values(session, model, c) for c in claims}
    named = model.with_effects(values)
    # a name has a right to all that a fit may move of it, its time constants too
    names = [f"{c.effect}.{p.name}" for c in claims for p in named.effect(c.effect).parameters if p.fitted]
    alone = session.problem(named, session.residual(named), names)
    around = [_around(session, named, c.effect, values[c.effect]) for c in claims]
    beside = Search(replace(alone, free=np.concatenate([alone.free, *around]))).run()
    if not beside.terms and len(claims) == 1 and beside.next_gain < LAW_VERDICT.beside:
        return None
    # against the names: their own columns among the groups, all to first order about the base
    columns = {c.effect: session.effect_columns(model, c.effect, values[c.effect]) for c in claims}
    moved = np.zeros_like(session.floor)
    for effect, (table, sizes) in columns.items():
        # what the model has of an effect stays in it: the name stands for the rest
        moved += np.tensordot(sizes - _sizes_in(session, model, effect), table, 1)
    problem = session.problem(model, session.residual(named) + moved)
    own = [EffectGroup.of(name, table, session.floor) for name, (table, _) in columns.items()]
    search = Search(problem, [*groups_of(problem), *own])
    kept = search.beside(own, beside.terms)
    # a search that begins with a name may not find its way to the one law that stands for it and the rest
    tried = [kept, search.run(), search.without_effects().run()]

    def worth(found: Found) -> float:
        whole = {t.group.effect for t in found.terms if t.group.effect} == {c.effect for c in claims}
        return found.evidence - LAW_VERDICT.each * len(found.terms) + (LAW_VERDICT.margin if whole else 0.0)

    chosen = max(tried, key=worth)
    cases = cases_of_laws(chosen)
    if cases:
        # a law of the same covariate in the same place says more than the name: the name is a case of it
        laws_alone = [t for t in chosen.terms if t.group.effect not in cases]
        chosen = search.beside([t.group for t in laws_alone if t.group.effect], laws_alone)
    staying = {t.group.effect for t in chosen.terms if t.group.effect}
    laws = tuple(reported_laws(chosen))
    return _Outcome(tuple(c for c in claims if c.effect in staying), laws, chosen)


def _alone(session: LawSession, model: ForwardModel, near: Sequence[str]) -> _Outcome | None:
    """Laws where nothing has a name; strong ones again with what they do beyond first order taken out.

    Names that came `near` and were not believed are among the groups: beside a law they may be right.
    """
    residual = session.residual(model)

    def searched(left: Array) -> Found:
        posed = session.problem(model, left)
        own = [g for name in near for g in _plain_groups(session, model, name)]
        return Search(posed, [*groups_of(posed), *own]).run()

    found = searched(residual)
    for _ in range(LAW_VERDICT.turns):
        if not found.terms:
            return None
        laws = [one.law for one in reported_laws(found)]
        beyond = residual - session.residual(model.with_laws(laws)) - linear(session, model, laws)
        if float(np.sum((beyond / session.floor / found.noise.factor[:, None]) ** 2)) < LAW_VERDICT.second_order:
            break
        found = searched(residual - beyond)
    if not found.terms:
        return None
    known = model.parameters()
    names = tuple(
        named_claim(found, k, library.get(t.group.effect), known.get(t.group.effect, {}))
        for k, t in enumerate(found.terms)
        if t.group.effect
    )
    changing = {claim.effect for claim in names if not claim.stable}
    if changing:
        # beside laws too a size that is no constant has no name
        return _alone(session, model, [name for name in near if name not in changing])
    return _Outcome(names, tuple(reported_laws(found)), found)


def _sizes_in(session: LawSession, model: ForwardModel, effect: str) -> Array:
    """(k,) the amplitudes of an effect in the model; zero where it lacks the effect."""
    return session.effect_columns(model, effect, model.parameters().get(effect, {}))[1]


def _plain_groups(session: LawSession, model: ForwardModel, name: str) -> list[EffectGroup]:
    """An effect of the library as a group, if nothing but its sizes is to be found."""
    effect = library.all_effects().get(name)
    if effect is None or effect.random or effect.shapes or name in session.free:
        return []
    columns = session.effect_columns(model, name, {})[0]
    return [EffectGroup.of(name, columns, session.floor)] if np.any(columns) else []


def _around(session: LawSession, model: ForwardModel, effect: str, values: dict[str, float]) -> Array:
    """(k, C, m) what an effect does more if its onset is a value earlier or later: that is searched, and not fitted."""
    epochs = [p.name for p in model.effect(effect).parameters if p.epoch]
    parts = [np.empty((0, *session.floor.shape))]
    for name in epochs:
        for step in (-session.step_s, session.step_s):
            moved = session.effect_columns(model, effect, {**values, name: values[name] + step})[0]
            parts.append(moved - session.effect_columns(model, effect, values)[0])
    return np.concatenate(parts)


def _values(session: LawSession, model: ForwardModel, claim: Claim) -> dict[str, float]:
    """The values of a claim's parameters where time is counted from the session's first value."""
    effect = model.effect(claim.effect)
    known = model.parameters().get(claim.effect, {})
    reported = np.array(
        [
            claim.parameters[p.name].value if p.name in claim.parameters else known.get(p.name, p.default)
            for p in effect.parameters
        ]
    )
    factors, later = effect.restarted(reported, session.delay_s)
    return dict(zip((p.name for p in effect.parameters), ((reported - later) / factors).tolist(), strict=True))


# --- what is reported --------------------------------------------------------------------------------------------


def _final(session: LawSession, model: ForwardModel, outcome: _Outcome) -> ForwardModel:
    """Base, names and laws, the base fitted once more."""
    named = {c.effect: _values(session, model, c) for c in outcome.names}
    final = (model.with_effects(named) if named else model).with_laws([one.law for one in outcome.laws])
    return base_fit(final, session.observed, session.free)[0]


def _fit(session: LawSession, found: Found, report: ReportData, after: Array, before: Fit | None) -> Fit:
    held = heldout_of(found)
    floor = float(np.sqrt(np.mean((found.noise.factor[:, None] * session.floor)[:3] ** 2)))
    return Fit(
        unit="g",
        rmse_before=float(np.sqrt(np.mean(report.before[:3] ** 2))),
        rmse_after=float(np.sqrt(np.mean(after[:3] ** 2))),
        heldout_rmse_before=floor * held.before,
        heldout_rmse_after=floor * held.after,
        heldout_gain_low=held.low,
        heldout_gain_high=held.high,
        noise_floor=floor,
        how_held_out=held.words,
        row_noise=None if before is None else before.row_noise,
    )


def _resembled(session: LawSession, model: ForwardModel, found: Found, effect: Array) -> tuple[str, ...]:
    """Names of the library's effects that do nearly the same here, the nearest first."""
    problem = found.problem
    scale = session.floor * found.noise.factor[:, None]

    def white(columns: Array) -> Array:
        return (columns / scale).reshape(len(columns), -1)

    free = _span(white(problem.free))
    target = white(effect[None])[0]
    target = target - free.T @ (free @ target)
    size = float(target @ target)
    known = {*model.ids, *session.free}
    scores: dict[str, float] = {}
    wanted: list[tuple[Effect, Array]] = []
    for one in library.all_effects().values():
        if not one.random and one.id not in known:
            wanted += [(one, p) for p in _shapes(one)]
    made = session.derivatives(model, wanted)
    for (one, _), derivative in zip(wanted, made, strict=True):
        columns = white(np.asarray(derivative, dtype=float)[list(one.amplitudes)])
        if not np.isfinite(columns).all():
            continue
        columns = columns - (columns @ free.T) @ free
        basis = _span(columns)
        share = float(np.sum((basis @ target) ** 2)) / max(size, 1e-300)
        scores[one.id] = max(scores.get(one.id, 0.0), share)
    near = sorted((name for name in scores if scores[name] > LAW_VERDICT.resembles), key=lambda n: -scores[n])
    return tuple(near[: LAW_VERDICT.names])


def _shapes(effect: Effect) -> list[Array]:
    """Parameter vectors at which an effect's columns are looked at: a shape at each value of its grid."""
    vectors = [effect.vector()]
    for k, parameter in enumerate(effect.parameters):
        if parameter.shape:
            values = parameter.grid or (parameter.typical,)
            vectors = [_put(v, k, float(value)) for v in vectors for value in values]
    return vectors[: LAW_VERDICT.most_shapes]


def _put(vector: Array, k: int, value: float) -> Array:
    result = vector.copy()
    result[k] = value
    return result


def _span(rows: Array) -> Array:
    """Orthonormal rows that span these."""
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)]
    if not len(rows):
        return rows
    _, values, basis = np.linalg.svd(rows / np.linalg.norm(rows, axis=1, keepdims=True), full_matrices=False)
    return np.asarray(basis[values > 1e-9 * values[0]])


def laws_of(diagnosis: DiagnosisResult) -> tuple[Law, ...]:
    """The laws that a diagnosis claims."""
    return tuple(Law.from_dict(c.law) for c in diagnosis.claims if c.law is not None and c.effect.startswith(PREFIX))

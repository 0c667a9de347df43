"""Names and laws side by side: which of them a recording supports, and what is reported.

What the library explains is chosen already. Then smooth laws compete: beside the names, with these fixed; and against
them, as groups of the same evidence. The higher evidence is reported. A law that stands where a name stood says which
name it resembles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.claimed_values import (
    around_onsets,
    beyond_first_order,
    is_beyond_first_order,
    is_large,
    shows_beyond_first_order,
    sizes_in,
    values_of_claim,
)
from highside.diagnosis.core.finding_policy import BESIDE, FLOOR
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, Remainder, Verdict
from highside.diagnosis.identified_noise import (
    angles_may_hide_a_law,
    names_beside_set_angles,
    with_identified_noise,
    with_set_angles,
)
from highside.diagnosis.law_answers import (
    beside_laws,
    explained,
    fit_beside,
    location_of,
    told_implausible,
    told_unnamed,
)
from highside.diagnosis.law_outcomes import (
    Outcome,
    above_rounding,
    beside_random_walk,
    explains_nothing,
    without_leftovers,
)
from highside.diagnosis.law_sessions import ChainSession, LawSession
from highside.diagnosis.laws.cases import cases_of_laws
from highside.diagnosis.laws.claims import ReportedLaw, proved, reported_laws
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.free_rivals import (
    as_rivals,
    doubted_of,
    is_clear,
    leaves_most,
    with_free_rivals,
    worth_of,
)
from highside.diagnosis.laws.groups import groups_of
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Search
from highside.diagnosis.name_groups import name_groups, resembled
from highside.diagnosis.names_instead import (
    alike_of,
    from_names,
    implausible,
    names_of,
    resized,
    sudden,
    with_names_instead,
)
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.law import PREFIX

UNTOUCHED = frozenset({"bad_data", "not_testable"})
"""verdicts of which nothing is to be reported"""


def with_laws(
    session: LawSession, model: ForwardModel, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with the laws that the recording supports beside its names or in their place.

    `model` is the one against which it was diagnosed, its free effects fitted.
    """
    if diagnosis.verdict in UNTOUCHED or explained(diagnosis, report):
        return diagnosis, report
    chain = tuple(c for c in diagnosis.claims if not library.registry()[c.effect].random)
    known = {c.effect for c in chain}
    near = [name for name in diagnosis.remainder.resembles if name not in diagnosis.remainder.changing]
    refused, instead = _refused_by_name(session, model, diagnosis, report.withheld)
    if refused is not None:
        return refused, report
    outcome = _chosen(session, model, chain, near, frozenset()) if instead is None or chain else instead
    if diagnosis.verdict == "wander" and not chain:
        outcome = beside_random_walk(outcome, model)
    if outcome.names:
        large = tuple(one for one in outcome.laws if one.share >= LAW_VERDICT.least_share)
        outcome = replace(outcome, laws=large)
    outcome = without_leftovers(outcome, model, known)
    if outcome.implausible and outcome.names:
        return told_implausible(diagnosis, outcome.names), report
    if (unnamed := _unnamed(session, model, diagnosis, report, outcome, frozenset(known))) is not None:
        return unnamed
    outcome = _without_chance(session, model, outcome, chain)
    if not (outcome.laws or outcome.renamed or outcome.doubted) and all(c.effect in known for c in outcome.names):
        return _unchanged(diagnosis, outcome), report
    if outcome.laws:
        outcome = above_rounding(outcome, model, session.rounding(_final(session, model, outcome)))
        if not (outcome.laws or outcome.names):
            return told_unnamed(diagnosis, report, outcome.doubted) if outcome.doubted else (diagnosis, report)
    others = tuple(c for c in diagnosis.claims if c not in chain)
    laws = tuple(_resembling(session, model, outcome, one) for one in outcome.laws)
    claims = (*others, *outcome.names, *laws)
    verdict: Verdict = "law" if laws else "named"
    if laws and (outcome.names or others):
        verdict = "named_plus"
    final = _final(session, model, outcome)
    after = np.asarray(session.observed.residual(final))
    fit = fit_beside(session.floor, outcome.found, report, after, diagnosis.fit)
    if not (diagnosis.claims or outcome.names) and explains_nothing(session.floor, outcome, report.before, after):
        # what is left beside none of them is judged as where none was found
        return _unchanged(diagnosis, replace(outcome, laws=(), found=outcome.found.only([]))), report
    kept = diagnosis.location if outcome.names and (diagnosis.claims or not laws) else ()
    made = replace(
        diagnosis,
        verdict=verdict,
        location=(*kept, *(location_of(c) for c in laws)),
        claims=claims,
        fit=fit,
        remainder=_remainder(diagnosis, claims),
        noise={**diagnosis.noise, "beside_laws": outcome.found.noise.summary()},
    )
    parts = {name: part for name, part in report.parts.items() if any(c.effect == name for c in outcome.names)}
    for part in [*(c.effect for c in outcome.names if c.effect not in known), *(one.law.id for one in outcome.laws)]:
        parts[part] = np.asarray(session.observed.residual(final.without(part)) - after)
    data = replace(report, after=after, parts=parts, sigma=_noise_beside(session, report, outcome.found))
    return with_set_angles(made, outcome.found), data


def _unchanged(diagnosis: DiagnosisResult, outcome: Outcome) -> DiagnosisResult:
    """The diagnosis with its names as they stand beside laws, and with the noise that was learned there. Nothing
    resembles any name where nothing is left."""
    told = {c.effect: c for c in outcome.names}
    diagnosis = replace(diagnosis, claims=tuple(told.get(c.effect, c) for c in diagnosis.claims))
    made = with_set_angles(with_identified_noise(diagnosis, outcome.found), outcome.found)
    if made.verdict == "nothing_left_out":
        made = replace(made, remainder=replace(made.remainder, resembles=()))
    return made


def _remainder(diagnosis: DiagnosisResult, claims: Sequence[Claim]) -> Remainder:
    """What is told of the rest: what was, where some of the names stay and nothing new stands beside them."""
    names = {c.effect for c in claims}
    if names <= {c.effect for c in diagnosis.claims}:
        return diagnosis.remainder
    return beside_laws(diagnosis.remainder, names)


def _without_chance(session: LawSession, model: ForwardModel, outcome: Outcome, chain: Sequence[Claim]) -> Outcome:
    """The outcome without laws in which some of several names stay, and each of the others may be chance: rounding or
    scatter of the set angles, which are learnt beside laws, are as likely. Where only |g| is known neither is, and
    closed forms compete."""
    if not isinstance(session, ChainSession):
        return outcome
    staying = {c.effect for c in outcome.names}
    lost = [c for c in chain if c.effect not in staying]
    if outcome.laws or outcome.doubted or not (staying and lost) or any(c.p_familywise <= BESIDE.certain for c in lost):
        return outcome
    return replace(outcome, names=resized(outcome.names, outcome.found, model), renamed=True)


def _noise_beside(session: LawSession, report: ReportData, found: Found) -> tuple[float, ...]:
    """Noise of one row of each channel, that learnt beside the laws where these leave less: without them a law of poses
    was in it. Where a value stands for many rows it stays what it was."""
    if session.floor.shape != report.before.shape or len(report.sigma) != len(session.floor):
        return report.sigma
    own = found.noise.times_the_floor(found.problem) * np.sqrt(np.mean(session.floor**2, axis=1))
    return tuple(float(min(one, known)) for one, known in zip(own, report.sigma, strict=True))


def _unnamed(
    session: LawSession,
    model: ForwardModel,
    diagnosis: DiagnosisResult,
    report: ReportData,
    outcome: Outcome,
    known: frozenset[str],
) -> tuple[DiagnosisResult, ReportData] | None:
    """The answer where none of the `known` names stays and no law stands in their place, or where the names that stay
    are not to be told; else None."""
    if outcome.laws:
        return None
    if outcome.names:
        if not angles_may_hide_a_law(outcome.found):
            return None
        after = np.asarray(session.observed.residual(_final(session, model, outcome)))
        names = frozenset(c.effect for c in outcome.names)
        return names_beside_set_angles(diagnosis, report, outcome.found, names, after)
    if outcome.is_noise:
        unnamed, report = told_unnamed(diagnosis, report, known, left=True)
        made = with_identified_noise(replace(unnamed, location=()), outcome.found)
        if made.verdict in ("nothing_left_out", "wander"):
            # all of it is noise: nothing is left that would resemble a name
            hints = tuple(one for one in made.remainder.hints if one != unnamed.remainder.hints[0])
            remainder = replace(made.remainder, hints=hints, resembles=diagnosis.remainder.resembles)
            made = replace(made, remainder=remainder)
        return made, report
    worthless = outcome.doubted or (known if leaves_most(outcome.found) else frozenset())
    left = not outcome.doubted or outcome.behind <= 0.0
    return told_unnamed(diagnosis, report, worthless, left=left) if worthless else None


def _resembling(session: LawSession, model: ForwardModel, outcome: Outcome, law: ReportedLaw) -> Claim:
    """The claim of a law with the names that it resembles, those that have given way first."""
    names = resembled(session, model, outcome.found, law.effect)
    return replace(law.claim, resembles=tuple(dict.fromkeys((*sorted(outcome.doubted), *names))))


def names_before_laws(
    session: LawSession, model: ForwardModel, diagnosis: DiagnosisResult, report: ReportData
) -> tuple[DiagnosisResult, ReportData] | None:
    """A diagnosis of many names with the laws beside them; None unless every name stays where laws compete with it."""
    if diagnosis.verdict not in ("named", "named_plus"):
        return None
    made, data = with_laws(session, model, diagnosis, report)
    names = {c.effect for c in made.claims}
    return (made, data) if {c.effect for c in diagnosis.claims} <= names else None


def _refused_by_name(
    session: LawSession, model: ForwardModel, diagnosis: DiagnosisResult, withheld: Sequence[Claim]
) -> tuple[DiagnosisResult | None, Outcome | None]:
    """What one name explains at a size that no instrument has; or the laws alone that do more, or the same.

    That its size is not plausible gives laws no right to what a name explains. Several such names may bend together as
    one law does, and stand for it.
    """
    if len(withheld) != 1 or diagnosis.remainder.changing:
        return None, None
    outcome = _chosen(session, model, withheld, diagnosis.remainder.resembles, frozenset())
    tied = any(one.startswith(PREFIX) for claim in outcome.names for one in claim.equivalence_class)
    if outcome.laws or tied or not outcome.names:
        return None, outcome if outcome.laws and not outcome.names else None
    return told_implausible(diagnosis, outcome.names), None


# --- the choice ----------------------------------------------------------------------------------------------


def _chosen(
    session: LawSession, model: ForwardModel, claims: Sequence[Claim], near: Sequence[str], refused: frozenset[str]
) -> Outcome:
    """The names that stay, with the laws that fit as well, and the laws beside them; none of those `refused`."""
    if not claims:
        return _alone(session, model, near, refused)
    bare = model
    values = {c.effect: values_of_claim(session, model, c) for c in claims}
    model = session.beside(model, values)
    named = model.with_effects(values)
    # a name has a right to all that a fit may move of it, its time constants too
    fitted = [f"{c.effect}.{p.name}" for c in claims for p in named.effect(c.effect).parameters if p.fitted]
    alone = session.problem(named, session.residual(named), fitted)
    around = [around_onsets(session, named, c.effect, values[c.effect]) for c in claims]
    first = Search(replace(alone, free=np.concatenate([alone.free, *around])))
    beside = first.run()
    # against the names: their own columns among the groups, all to first order about the base
    columns = {c.effect: session.effect_columns(model, c.effect, values[c.effect]) for c in claims}
    moved = np.zeros_like(session.floor)
    for effect, (table, sizes) in columns.items():
        # what the model has of an effect stays in it: the name stands for the rest
        moved += np.tensordot(sizes - sizes_in(session, model, effect), table, 1)
    problem = session.problem(model, session.residual(named) + moved)
    own = [EffectGroup.of(name, table, session.floor) for name, (table, _) in columns.items()]
    single, is_clear_of_laws = _single(problem, claims, beside, first, own)
    if single is not None and is_clear_of_laws:
        return single
    search = Search(problem, [*groups_of(problem), *own])
    kept = search.beside(own, beside.terms)
    # a search that begins with a name may not find its way to the one law that stands for it and the rest
    whole = search.run(kept)
    # a search among all that ends without a name is one among laws alone
    mixed = any(t.group.effect for t in whole.terms)
    tried = [kept, whole, *([search.without_effects().run(kept)] if mixed else [])]
    every = {c.effect for c in claims}
    quietest = min(float(found.noise.factor.max()) for found in tried)
    chosen = max(tried, key=lambda one: _worth(one, every, quietest))
    if single is not None and not chosen.terms:
        # what its test finds is worth too little here for any claim: the name stays, unless it is worth nothing beside
        # this noise, or a law would do better
        if single.is_noise:
            return replace(single, names=(), found=chosen)
        return _given_way(session, bare, claims, refused, single)
    cases = cases_of_laws(chosen)
    if cases:
        # a law of the same covariate in the same place says more than the name: the name is a case of it
        laws_alone = [t for t in chosen.terms if t.group.effect not in cases]
        chosen = search.beside([t.group for t in laws_alone if t.group.effect], laws_alone)
    found = from_names(session, model, search, chosen, refused)
    found = with_names_instead(session, model, found, [c.effect for c in claims], refused)
    staying = {t.group.effect for t in found.terms if t.group.effect}
    names = [c for c in claims if c.effect in staying]
    names += [c for c in names_of(found, model) if c.effect not in {own.effect for own in names}]
    left = proved(found)
    told, ahead = with_free_rivals(names, left)
    if not names and is_beyond_first_order(session, bare, left):
        return _alone(session, bare, [c.effect for c in claims], refused, left)
    laws, behind = tuple(reported_laws(left, model.ids)), -min(ahead.values(), default=np.inf)
    outcome = Outcome(told, laws, left, found is not chosen, doubted_of(left, ahead), behind=behind)
    return _given_way(session, bare, claims, refused, outcome)


def _single(
    problem: LawProblem, claims: Sequence[Claim], beside: Found, first: Search, own: Sequence[EffectGroup]
) -> tuple[Outcome | None, bool]:
    """One name, `beside` which no law gains, with its class; and whether it is clear of every law in its place. So
    several, where they explain so much that laws which they stand for would leave what gains."""
    if beside.terms or beside.next_gain >= LAW_VERDICT.beside:
        return None, False
    found = as_rivals(problem, beside, first.families, own)
    if len(claims) > 1 and (problem.every_pair or worth_of(found) < LAW_VERDICT.no_stand_in):
        return None, False
    told, ahead = with_free_rivals(claims, found)
    is_noise = worth_of(found) < LAW_VERDICT.worth
    behind = -min(ahead.values())
    single = Outcome(told, (), beside, doubted=doubted_of(found, ahead), is_noise=is_noise, behind=behind)
    if not is_clear(found, ahead) or is_noise:
        return single, False
    return replace(single, doubted=frozenset()), True


def _worth(found: Found, names: set[str], quietest: float) -> float:
    """Evidence less what each term must be worth; of the `names`, where they explain it all, laws must be ahead by a
    margin. They do not where laws stand beside them, or where they leave more than the `quietest` noise beside others
    (in units of the floor)."""
    whole = {t.group.effect for t in found.terms} == names
    margin = whole and float(found.noise.factor.max()) <= FLOOR.ratio * quietest
    return found.evidence - LAW_VERDICT.each * len(found.terms) + (LAW_VERDICT.margin if margin else 0.0)


def _given_way(
    session: LawSession, model: ForwardModel, claims: Sequence[Claim], refused: frozenset[str], outcome: Outcome
) -> Outcome:
    """What is found without the names in whose place one law does better; where that is nothing, these with their
    classes, unless most of what is there is left or a law is far better, though worth no claim itself."""
    doubted = outcome.doubted
    if not doubted:
        return outcome
    staying = [c.effect for c in claims if c.effect not in doubted]
    found = _alone(session, model, staying, refused | doubted)
    compared = bool(outcome.found.terms) and _explains_less(found.found, outcome.found)
    if found.laws and not found.names and compared and outcome.behind < 0.0:
        # the names are ahead of every law in their place, and of all laws together
        return replace(outcome, doubted=frozenset())
    if found.names and not found.laws:
        # names explain it all, and those that were doubted beside laws may be among them
        again = _alone(session, model, [c.effect for c in claims], refused)
        if again.names and not again.laws and not _explains_less(again.found, found.found):
            return replace(again, renamed=True)
    if found.names or found.laws or leaves_most(outcome.found) or outcome.behind >= LAW_VERDICT.beside:
        return replace(found, doubted=doubted, behind=outcome.behind)
    return replace(outcome, doubted=frozenset())


def _explains_less(found: Found, than: Found) -> bool:
    """Whether terms and the noise beside them explain less than others do, less what each term must be worth."""
    cost = LAW_VERDICT.each * (len(found.terms) - len(than.terms))
    return found.evidence - cost < than.evidence


def _alone(
    session: LawSession,
    model: ForwardModel,
    near: Sequence[str],
    refused: frozenset[str] = frozenset(),
    begun: Found | None = None,
) -> Outcome:
    """Laws, or names, where nothing has a name yet; strong ones again with what they do beyond first order taken out.

    Names that came `near` and were not believed are among the groups, and then those that the laws resemble: in noise
    whose colour is learnt beside them they may be right, alone or beside a law. Those `refused` are not. What has
    `begun` elsewhere, about what names of large size do, goes on here if that explains more.
    """
    residual = session.residual(model)
    posed = session.problem(model, residual)
    offered = [name for name in dict.fromkeys([*near, *sudden()]) if name not in refused]
    search = Search(posed, [*groups_of(posed), *(g for name in offered for g in name_groups(session, model, name))])
    if is_large(session, residual) and (first := search.strongest()).terms:
        # beside what a tilt of some degrees does beyond first order a search takes that for laws
        search = search.of_residual(residual - beyond_first_order(session, model, first, residual))
    found = search.run()
    if begun is not None:
        other = search.of_residual(residual - beyond_first_order(session, model, begun, residual))
        resumed = other.resumed(other.beside([], begun.terms))
        if _explains_less(found, resumed):
            search, found = other, resumed
    for _ in range(LAW_VERDICT.turns):
        if not found.terms:
            return Outcome((), (), found)
        alike = [name for name in alike_of(session, model, found) if name not in offered and name not in refused]
        if alike:
            offered += alike
            search = search.beside_names([g for name in alike for g in name_groups(session, model, name)])
            found = search.resumed(found)
        if (beyond := shows_beyond_first_order(session, model, found, residual)) is not None:
            search = search.of_residual(residual - beyond)
            found = search.resumed(found)
        elif not alike:
            break
    if not found.terms:
        return Outcome((), (), found)
    found = from_names(session, model, search, found, refused)
    found = proved(with_names_instead(session, model, unproved := found, offered, refused))
    if not found.terms and any(len(t.group.axes) > 1 for t in unproved.terms):
        # a surface may reproduce a few values and predict none of them: what curves do is behind it, and may be right
        found = proved(with_names_instead(session, model, search.without_products().run(), offered, refused))
    names = names_of(found, model)
    outside = frozenset(claim.effect for claim in names if implausible(claim))
    told, ahead = with_free_rivals(names, found)
    unfit = {claim.effect for claim in names if not claim.stable} | cases_of_laws(found) | doubted_of(found, ahead)
    if outside and len(names) == len(found.terms) and not unfit:
        # names explain it all, at a size that no instrument has: that is said, and nothing else takes their place
        return Outcome(names, (), found, implausible=True)
    if unfit | outside:
        # beside laws too a size that is no constant, or none that an instrument has, gets no name; nor do others for it
        kept = [claim.effect for claim in names if claim.effect not in unfit | outside]
        return _alone(session, model, kept, frozenset(library.all_effects()) - set(kept))
    return Outcome(told, tuple(reported_laws(found, model.ids)), found)


# --- what is reported --------------------------------------------------------------------------------------------


def _final(session: LawSession, model: ForwardModel, outcome: Outcome) -> ForwardModel:
    """Base, names and laws, the base fitted once more."""
    named = {c.effect: values_of_claim(session, model, c) for c in outcome.names}
    final = (model.with_effects(named) if named else model).with_laws([one.law for one in outcome.laws])
    return base_fit(final, session.observed, session.free)[0]

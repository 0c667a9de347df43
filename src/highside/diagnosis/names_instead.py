"""Names among the terms of a search, which of them a law resembles, and names that are told instead of laws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.result import Claim
from highside.diagnosis.law_sessions import ChainSession, LawSession
from highside.diagnosis.laws.claims import effects_of, named_claim
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.instead import names_instead
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.state import worth
from highside.diagnosis.name_groups import name_groups, resembled
from highside.physics import effects as library
from highside.physics.forward import ForwardModel


def with_names_instead(
    session: LawSession, model: ForwardModel, found: Found, near: Sequence[str], refused: frozenset[str]
) -> Found:
    """A search with names in the place of its laws: those that these resemble, and those that came `near`, where they
    fit about as well; none of those `refused`, nor any of a size that is not constant, or that no instrument has.

    Of stepped sessions: where only |g| is known, closed forms are held beside a name, which would be withdrawn without
    the law for which it stands; cells of a rotation were not tried.
    """
    if not found.problem.every_pair or all(term.group.effect for term in found.terms):
        return found
    names = dict.fromkeys([*alike_of(session, model, found), *near])
    offered = [name_groups(session, model, name) for name in names if name not in refused]

    def believed(made: Found, k: int) -> bool:
        (claim,) = (c for c in names_of(made, model) if c.effect == made.terms[k].group.effect)
        return bool(claim.stable) and not implausible(claim)

    return names_instead(found, offered, believed)


def from_names(
    session: LawSession, model: ForwardModel, search: Search, found: Found, refused: frozenset[str]
) -> Found:
    """What a search found, or what begins with names alone, of all that the library has, goes on among names and laws,
    and does better; none of those `refused`.

    Of several effects a curve or a surface holds parts of two, and bars the names of both: of a rotation a surface,
    where the columns of all effects take their time. Where only |g| is known, closed forms are held beside a name.
    """
    laws = [term.group for term in found.terms if not term.group.effect]
    surface = any(len(group.axes) > 1 for group in laws)
    several = surface or (found.problem.every_pair and len(found.terms) > 1)
    if not (isinstance(session, ChainSession) and laws and several):
        return found
    offered = [name for name in library.all_effects() if name not in refused]
    names: list[LawGroup] = [group for name in offered for group in name_groups(session, model, name)]
    start = Search(search.problem, names, variants=False).run()
    own, least = {term.group.effect for term in start.terms}, worth(found.evidence, found.terms)
    if not own or worth(start.evidence, start.terms) < least - LAW_SEARCH.hopeless:
        return found
    made = search.beside_names([g for g in names if g.effect in own]).resumed(start)
    ahead = worth(made.evidence, made.terms) >= least + LAW_VERDICT.margin
    return made if ahead and all(claim.stable and not implausible(claim) for claim in names_of(made, model)) else found


def names_of(found: Found, model: ForwardModel) -> tuple[Claim, ...]:
    """The library's effects among the terms of a search, as they are claimed."""
    known = model.parameters()
    return tuple(
        named_claim(found, k, library.get(t.group.effect), known.get(t.group.effect, {}))
        for k, t in enumerate(found.terms)
        if t.group.effect
    )


def resized(claims: Sequence[Claim], found: Found, model: ForwardModel) -> tuple[Claim, ...]:
    """Claims with the sizes and shares that their names have in a search: another name that stood beside them, and that
    it has not kept, may have taken a part."""
    again = {c.effect: c for c in names_of(found, model)}

    def sized(claim: Claim) -> Claim:
        if (one := again.get(claim.effect)) is None:
            return claim
        effect = library.get(claim.effect)
        sizes = {effect.parameters[i].name: one.parameters[effect.parameters[i].name] for i in effect.amplitudes}
        return replace(claim, parameters={**claim.parameters, **sizes}, share=one.share)

    return tuple(sized(claim) for claim in claims)


def alike_of(session: LawSession, model: ForwardModel, found: Found) -> list[str]:
    """Names that do nearly what one of the terms does, law or name, or what all of the laws do together; and those that
    a name among them is known to be confused with: beside slow noise they need not look alike."""
    effects = list(effects_of(found).values())
    if len(effects) > 1:
        effects.append(np.sum(effects, axis=0))
    # a name may be a case of another: a hysteresis wider than the range is a coefficient
    effects += [one for k, one in effects_of(found, names=True).items() if found.terms[k].group.effect]
    alike = [name for effect in effects for name in resembled(session, model, found, effect)]
    confused = [name for t in found.terms if t.group.effect for name in library.get(t.group.effect).confused_with]
    return list(dict.fromkeys([*alike, *(name for name in confused if name in library.all_effects())]))


def sudden() -> list[str]:
    """Names that set in at some time: no smooth function is one, so that no law may resemble it."""
    return [effect.id for effect in library.all_effects().values() if any(p.epoch for p in effect.shapes)]


def implausible(claim: Claim) -> bool:
    """Whether a size is beyond what instruments have."""
    effect = library.get(claim.effect)
    vector = [claim.parameters[p.name].value if p.name in claim.parameters else p.default for p in effect.parameters]
    return bool(effect.outside_gate(np.array(vector)))

"""Laws that fit what a name, or several names together, explain: told with the name, for this session cannot tell.

A name is one curve, and a smooth function of something else in the same place, or in another, may fit it as well: of
few poses, where the temperature follows the ring, or where two names bend as one law does. Such laws are in the class
of the claim. A law of which the name is nothing but a case is among them only where it is about as likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.result import Claim
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import Families, LawTerm, Whitened
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.policy import LAW_SEARCH
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.search import Found, independent
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX


def as_rivals(problem: LawProblem, beside: Found, groups: list[LawGroup], own: Sequence[EffectGroup]) -> Found:
    """The names `own` as the terms of a search among `groups`, in the noise that was learnt beside them."""
    problem = replace(problem, free=independent(problem.free, problem.floor))
    families = Families(problem, groups)
    white = Whitened(families, Whitener(problem, beside.noise), problem.residual)
    _, priors = white.scores([], within=np.inf)
    terms = tuple(LawTerm(group, priors[groups.index(group)]) for group in own)
    return Found(problem, terms, beside.noise, 0.0, (), (), problem.residual, families)


def with_free_rivals(claims: Sequence[Claim], found: Found) -> tuple[Claim, ...]:
    """The claims of names, their classes with the laws that this session cannot tell from them, one by one and all
    together."""
    white, terms = found.whitened(), list(found.terms)
    places = {term.group.effect: k for k, term in enumerate(terms) if term.group.effect}
    together = _rivals(white, terms, list(places.values())) if len(places) > 1 else []
    told = []
    for claim in claims:
        if claim.effect not in places:
            told.append(claim)
            continue
        laws = [*_rivals(white, terms, [places[claim.effect]]), *together]
        more = tuple(dict.fromkeys((*claim.equivalence_class, *laws)))
        # advice that was given before the laws were known: no other *name* explains it as well
        needless = claim.next_manoeuvre.startswith("none needed") and len(more) > 1
        advice = all_effects()[claim.effect].splitter if needless else claim.next_manoeuvre
        told.append(replace(claim, equivalence_class=more, next_manoeuvre=advice))
    return tuple(told)


def _rivals(white: Whitened, terms: list[LawTerm], which: list[int]) -> list[str]:
    """Laws that stand for these of the terms as well, the best first."""
    others = [t for i, t in enumerate(terms) if i not in which]
    gains, _ = white.scores(others, within=np.inf)
    worth = white.total(terms) - white.total(others)
    does = white.left_of(terms, which)
    told: dict[tuple[object, ...], str] = {}
    for i in np.argsort(-gains):
        group, behind = white.families.groups[int(i)], worth - float(gains[i])
        if behind > LAW_SEARCH.same_confounded or len(told) >= LAW_SEARCH.most_rivals:
            break
        if group.effect or group.kind in told:
            continue
        if behind <= LAW_SEARCH.same or (len(which) > 1 and white.reproduces(does, group)):
            told[group.kind] = f"{PREFIX}{group.label}"
    return list(told.values())

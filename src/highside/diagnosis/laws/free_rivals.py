"""Laws that fit what a name, or several names together, explain: told with the name, for this session cannot tell.

A name is one curve, and a smooth function of something else in the same place, or in another, may fit it as well: of
few poses, where the temperature follows the ring, or where two names bend as one law does. Such laws are in the class
of the claim. A law of which the name is nothing but a case is among them only where it is about as likely.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.result import Claim
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT
from highside.diagnosis.laws.problem import LawProblem, independent
from highside.diagnosis.laws.set_angles import may_hide_a_law
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX

BUILT_IN = f"{all_effects.__module__}."
"""what the modules of the effects that come with this package begin with"""


def as_rivals(problem: LawProblem, beside: Found, among: Families, own: Sequence[EffectGroup]) -> Found:
    """The names `own` as the terms of a search `among` groups, in the noise that was learnt beside them."""
    problem = replace(problem, free=independent(problem.free, problem.floor))
    families = among.beside(problem)
    families = families.of([*families.groups, *own])
    white = Whitened(families, Whitener(problem, beside.noise), problem.residual)
    _, priors = white.of_groups(list(own)).scores([], within=np.inf)
    terms = [LawTerm(group, prior) for group, prior in zip(own, priors, strict=True)]
    for k, group in enumerate(own if len(own) > 1 else ()):
        # of several each is as large as it is beside the others
        _, (prior,) = white.of_groups([group]).scores([t for i, t in enumerate(terms) if i != k], within=np.inf)
        terms[k] = LawTerm(group, prior)
    return Found(problem, tuple(terms), beside.noise, 0.0, (), (), problem.residual, families)


def worth_of(found: Found) -> float:
    """Nats that the terms of a search gain together, the noise kept."""
    white = found.whitened()
    return white.total(list(found.terms)) - white.total([])


def with_free_rivals(claims: Sequence[Claim], found: Found) -> tuple[tuple[Claim, ...], dict[str, float]]:
    """The claims of names, their classes with the laws that this session cannot tell from them, one by one and all
    together; and by how many nats each is ahead of the best law in its place, the noise kept."""
    white, terms = found.whitened(), list(found.terms)
    places = {term.group.effect: k for k, term in enumerate(terms) if term.group.effect}
    together = _rivals(white, terms, list(places.values()))[0] if len(places) > 1 else []
    told, ahead = [], {}
    for claim in claims:
        if claim.effect not in places:
            told.append(claim)
            continue
        alone, nats = _rivals(white, terms, [places[claim.effect]])
        # a name with a shape of its own stands here at one value of it, and may do better at another; the curve of an
        # effect that somebody learned is known as well as their session told, and a law has one of its own here
        effect = all_effects()[claim.effect]
        settled = type(effect).__module__.startswith(BUILT_IN) and (not effect.shapes or beside_laws(found))
        ahead[claim.effect] = nats if settled else np.inf
        laws = [*alone, *together]
        more = tuple(dict.fromkeys((*claim.equivalence_class, *laws)))
        # advice that was given before the laws were known: no other *name* explains it as well
        needless = claim.next_manoeuvre.startswith("none needed") and len(more) > 1
        advice = all_effects()[claim.effect].splitter if needless else claim.next_manoeuvre
        told.append(replace(claim, equivalence_class=more, next_manoeuvre=advice))
    return tuple(told), ahead


def is_clear(found: Found, ahead: Mapping[str, float]) -> bool:
    """Whether names need no search without them: each is far ahead of every law, or none is behind and they leave the
    noise floor alone, so that no noise stands in the place of anything.

    Of readings that are one row each no floor is known: it is the same, the least, for all.
    """
    noise, unknown = found.noise, float(np.ptp(found.problem.floor)) == 0.0
    plain = not np.any(noise.jitter > 0) and not noise.remembers
    floor = plain and (unknown or float(noise.factor.max()) <= FLOOR.ratio)
    least = -LAW_VERDICT.ahead if floor else LAW_SEARCH.gain
    return not found.problem.every_pair or min(ahead.values(), default=np.inf) >= least


def doubted_of(found: Found, ahead: Mapping[str, float]) -> frozenset[str]:
    """The names that are to give way, as one law does better in their place: of stepped sessions, where that was tried.

    Where most of it is left, a name must itself be clearly better than each: what stands in its place may leave
    nothing. And so a name with a shape of its own, of which many were tried, beside laws, which say that the library
    does not hold it all.
    """
    if not found.problem.every_pair:
        return frozenset()
    plain = LAW_SEARCH.gain if leaves_most(found) else -LAW_VERDICT.ahead
    shaped = max(plain, LAW_VERDICT.beside) if beside_laws(found) else plain
    return frozenset(n for n, nats in ahead.items() if nats < (shaped if all_effects()[n].shapes else plain))


def beside_laws(found: Found) -> bool:
    """Whether laws are among the terms of a search."""
    return any(not term.group.effect for term in found.terms)


def leaves_most(found: Found) -> bool:
    """Whether a law may be hidden in what was learned as noise: in errors of the set angles larger than a bench makes,
    or in readings that scatter far more than their floor says, where that is known. Of stepped sessions."""
    known = found.problem.every_pair and found.problem.measured
    far = known and float(found.noise.factor.max()) > LAW_VERDICT.most_left
    return far or may_hide_a_law(found.noise, found.problem.n)


def _fewer_gain(white: Whitened, terms: list[LawTerm], which: list[int]) -> float:
    """Nats that one name gains where some of its amplitudes are none: a law of one channel is held beside a name that
    has an amplitude for each. They are left out one by one, as long as that gains, and which are is as a choice among
    all sets of them."""
    group = terms[which[0]].group
    if len(which) > 1 or not isinstance(group, EffectGroup) or group.size < 2:
        return 0.0
    others = [t for i, t in enumerate(terms) if i not in which]
    whole = kept = white.total(terms)
    best = group
    while best.size > 1:
        fewer = [best.without(k) for k in range(best.size)]
        gains, priors = white.of_groups(list(fewer)).scores(others, within=np.inf)
        k = int(np.argmax(gains))
        found = white.total([*others, LawTerm(fewer[k], priors[k])])
        if found <= kept:
            break
        best, kept = fewer[k], found
    return max(kept - whole - float(np.log(2.0**group.size - 1.0)), 0.0)


def _rivals(white: Whitened, terms: list[LawTerm], which: list[int]) -> tuple[list[str], float]:
    """Laws that stand for these of the terms as well, the best first; and how far these are ahead of the best, nats."""
    others = [t for i, t in enumerate(terms) if i not in which]
    worth = white.total(terms) - white.total(others) + _fewer_gain(white, terms, which)
    # those further behind are in no class, and set no limit
    gains, _ = white.scores(others, within=LAW_SEARCH.hopeless, down_to=worth - LAW_CLASS.same_confounded)
    does = white.left_of(terms, which)
    told: dict[tuple[object, ...], str] = {}
    laws = [float(gain) for gain, group in zip(gains, white.families.groups, strict=True) if not group.effect]
    for i in np.argsort(-gains):
        group, behind = white.families.groups[int(i)], worth - float(gains[i])
        if behind > LAW_CLASS.same_confounded or len(told) >= LAW_SEARCH.most_rivals:
            break
        if group.effect or group.kind in told:
            continue
        if behind <= LAW_CLASS.same or (len(which) > 1 and white.reproduces(does, group)):
            told[group.kind] = f"{PREFIX}{group.label}"
    ahead = worth - max(laws, default=-np.inf)
    # the prior of a strong name costs it a share of what it explains: nothing is decided by that
    costs = LAW_VERDICT.ahead < -ahead < LAW_VERDICT.shrunk * worth
    return list(told.values()), np.inf if costs else ahead

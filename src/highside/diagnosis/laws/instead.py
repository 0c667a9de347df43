"""Names in the place of laws that were found: an effect of the library that does the same is said by its name.

A search finds a law where the effect was not among its groups, or only at shapes (a time constant, a time of onset)
beside the best ones. A name claims less than a law: where it fits about as well, in the place of one law or of several,
and leaves nothing that any law would gain, it has the claim. The law stays in its class.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from highside.diagnosis.laws.classes import classes_of
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT

Believed = Callable[[Found, int], bool]
"""whether the name that is a term of a search has a constant size, and one that an instrument may have"""


def names_instead(found: Found, offered: Sequence[Sequence[EffectGroup]], believed: Believed) -> Found:
    """The search with effects in the place of its laws, one by one, as long as one fits about as well and is believed.

    Of each effect that is `offered` there is a group at each value of its shapes that is tried.
    """
    made = _named(found, offered, believed, LAW_VERDICT.margin)
    if all(term.group.effect for term in made.terms):
        return made
    # where laws stay beside it, the library does not hold it all: a name has no right to a margin then
    return _named(found, offered, believed, 0.0)


def _named(found: Found, offered: Sequence[Sequence[EffectGroup]], believed: Believed, margin: float) -> Found:
    """The search with names that are behind what they stand for by a margin (nats) at most."""
    for _ in range(len(found.terms)):
        made = _one_instead(found, offered, believed, margin)
        if made is None:
            break
        found = made
    return found


def _one_instead(
    found: Found, offered: Sequence[Sequence[EffectGroup]], believed: Believed, margin: float
) -> Found | None:
    white, terms = found.whitened(), list(found.terms)
    taken = {term.group.effect for term in terms if term.group.effect}
    names = [groups for groups in offered if groups and groups[0].effect not in taken]
    near: list[tuple[float, list[LawTerm], LawTerm, list[LawGroup]]] = []
    for which in _sets(found) if names else ():
        others = [term for k, term in enumerate(terms) if k not in which]
        laws = white.total(terms) - white.total(others) - sum(np.log(terms[k].group.tries) for k in which)
        best = [_sharpened(white, others, groups) for groups in names]
        tied = [term.group for term, _ in best]
        near += [(gain - laws + LAW_SEARCH.each * (len(which) - 1), others, term, tied) for term, gain in best]
    # the noise learnt again may bring one nearer, but not from far behind
    near = [one for one in sorted(near, key=lambda one: -one[0]) if one[0] > -LAW_CLASS.same_confounded]
    made = [(_learnt(found, [*others, term]), tied) for _, others, term, tied in near[: LAW_VERDICT.names]]
    least = _worth(found) - margin
    for one, tied in sorted(made, key=lambda one: -_worth(one[0])):
        if _worth(one) < least:
            break
        one = _as_found(one, tied)
        fits = _worth(one) >= least and min(one.gains) >= LAW_SEARCH.gain > one.next_gain
        if fits and believed(one, len(one.terms) - 1):
            return one
    return None


def _worth(found: Found) -> float:
    """Evidence less what each name or law must be worth, and less what the number of those tried like it makes."""
    tries = sum(float(np.log(term.group.tries)) for term in found.terms)
    return found.evidence - tries - LAW_SEARCH.each * len(found.terms)


def _sets(found: Found) -> list[tuple[int, ...]]:
    """Laws that one effect may do: each, two of the same kind, and all."""
    laws = [k for k, term in enumerate(found.terms) if not term.group.effect]
    kinds = [term.group.kind for term in found.terms]
    pairs = [pair for pair in combinations(laws, 2) if kinds[pair[0]] == kinds[pair[1]]]
    every = [tuple(laws)] if len(laws) > 2 else [pair for pair in [tuple(laws)] if len(pair) == 2 and pair not in pairs]
    return [*((k,) for k in laws), *pairs, *every]


def _sharpened(white: Whitened, others: list[LawTerm], groups: Sequence[EffectGroup]) -> tuple[LawTerm, float]:
    """The best of an effect's groups beside other terms, its shapes refined, and what it gains."""
    best, gain = _best(white, others, groups)
    for _ in range(LAW_SEARCH.shape_rounds):
        finer = best.group.finer() if isinstance(best.group, EffectGroup) else []
        if not finer:
            break
        best, gain = _best(white, others, finer)
    return best, gain


def _best(white: Whitened, others: list[LawTerm], groups: Sequence[EffectGroup]) -> tuple[LawTerm, float]:
    gains, priors = white.of_groups(list(groups)).scores(others, within=np.inf)
    at = int(np.argmax(gains))
    return LawTerm(groups[at], priors[at]), float(gains[at])


def _learnt(found: Found, terms: list[LawTerm]) -> Found:
    """The search with other terms, the noise learnt again and with it their priors."""
    noise, _ = found.learner.learn(terms, found.residual)
    white = replace(found, terms=tuple(terms), noise=noise).whitened()
    for k, term in enumerate(terms):
        others = [t for i, t in enumerate(terms) if i != k]
        gains, priors = white.of_groups([term.group]).scores(others)
        if np.isfinite(gains[0]):
            terms[k] = LawTerm(term.group, priors[0])
    return replace(found, terms=tuple(terms), noise=noise, evidence=white.total(terms))


def _as_found(found: Found, names: Sequence[LawGroup]) -> Found:
    """The same with the gains of the terms and their classes, of which other `names` that were tried may be members."""
    noise, evidence = found.learner.learn(found.terms, found.residual)
    families = found.families.of([*found.families.groups, *names])
    made = replace(found, noise=noise, evidence=evidence, families=families)
    gains = tuple(made.gain_of([k]) for k in range(len(made.terms)))
    return replace(made, classes=classes_of(made.whitened(), made.terms), gains=gains)

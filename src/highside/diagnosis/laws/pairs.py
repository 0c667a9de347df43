"""Products with what was found: of a session of many values only listed pairs of covariates are tried in every place,
and every other pair where a law follows one of the two.

All pairs in all places would be most of such a search. A law of two covariates is found as one of either first, or as
several, in the place where it acts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.groups import (
    ONE_QUANTITY,
    SETS_IN,
    Bases,
    LawGroup,
    each_place,
    product_group,
    same_angle,
)
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.diagnosis.laws.problem import LawProblem, PlaceField
from highside.physics.covariates import COVARIATES, lag_of
from highside.physics.effect import AXES

TURNED = frozenset({"toolface", "timing"})
"""places that do the same where a rate is among what they follow"""


def further_pairs(problem: LawProblem, groups: Sequence[LawGroup], terms: Sequence[LawTerm]) -> list[LawGroup]:
    """Products, not among the groups, of what a term follows and every other covariate, in the places that act on its
    channels as it does."""
    bases = Bases(problem)
    have = {(g.place, g.units[0].channel, frozenset(g.depends_on)) for g in groups if len(g.axes) == 2}
    made: list[LawGroup] = []
    for term in terms:
        group = term.group
        if group.effect or len(group.units) > 1 or group.axes[0].functions[0].kind in SETS_IN:
            continue
        for unit in _alike(problem, group):
            known = {name: (values, distinct) for name, values, distinct in bases.varying((unit,))}
            tries = max(LAW_GROUPS.pairs, len(known) * (len(known) - 1) // 2)
            for pair in _pairs(group, list(known)):
                key = unit.place, unit.channel, frozenset(pair)
                if key not in have and known.keys() >= set(pair):
                    have.add(key)
                    made.append(product_group((unit,), pair, known, bases, tries))
    return made


def on_all_axes(problem: LawProblem, terms: Sequence[LawTerm]) -> list[LawGroup]:
    """Products of what laws of the zero offset follow and every other covariate but loads, on all axes together, each
    in its own way; none where there is one such law, of one axis."""
    units = tuple(place for place in problem.places if place.place == "offset")
    own = [term.group for term in terms if term.group.place == "offset" and not term.group.effect]
    if len(units) < len(AXES) or len(own) < 2 - any(len(group.units) > 1 for group in own):
        return []
    bases = Bases(problem)
    known = {
        name: (values, distinct)
        for name, values, distinct in bases.varying(units)
        if not name.startswith(("load", "previous_load"))
    }
    followed = dict.fromkeys(name for group in own for name in group.depends_on if name in known)
    tries = max(LAW_GROUPS.pairs, len(known) * (len(known) - 1) // 2)
    pairs = dict.fromkeys(pair for name in followed for pair in _pairs_of(name, known))
    return [product_group(units, pair, known, bases, tries) for pair in pairs]


def elsewhere(problem: LawProblem, groups: Sequence[LawGroup], terms: Sequence[LawTerm]) -> list[LawGroup]:
    """The functions of terms in other places that act on the same channels: what is not among the groups."""
    bases = Bases(problem)
    have = {(g.place, g.units[0].channel, g.axes) for g in groups if not g.effect}
    made: list[LawGroup] = []
    for group in (term.group for term in terms):
        if group.effect or len(group.units) > 1:
            continue
        for unit in _alike(problem, group):
            known = {name for name, _, _ in bases.varying((unit,))}
            if (unit.place, unit.channel, group.axes) not in have and known.issuperset(set(group.depends_on)):
                made.append(bases.group((unit,), group.axes, group.order, group.tries))
    return made


def _alike(problem: LawProblem, group: LawGroup) -> Iterator[PlaceField]:
    """The place of a group, and others that act on the same channel or turn the tool as well."""
    own = group.units[0]
    for units in each_place(problem.places):
        (unit,) = units if len(units) == 1 else (None,)
        if unit is None or not unit.channels:
            continue
        turned = {unit.place, own.place} <= TURNED
        if (
            unit is own
            or turned
            or (unit.channels == own.channels and not same_angle(unit, own) and len(unit.channels) == 1)
        ):
            yield unit


def _pairs(group: LawGroup, known: Sequence[str]) -> Iterator[tuple[str, str]]:
    """What a group follows and each other covariate; a product itself in every place."""
    followed = [name for name in group.depends_on if name != "tf_fraction"]
    for one in followed:
        yield from _pairs_of(one, [name for name in (*followed, *known) if name in followed or not lag_of(name)])


def _pairs_of(one: str, known: Iterable[str]) -> Iterator[tuple[str, str]]:
    """A covariate and each other."""
    places = {name: k for k, name in enumerate(COVARIATES)}
    for other in known:
        # a surface over the session's time is whatever happened in it
        same = any({one, other} <= quantity for quantity in ONE_QUANTITY)
        if one != "time" and other not in (one, "tf_fraction", "time") and not same:
            first, second = sorted((one, other), key=lambda name: places.get(name, len(places)))
            yield first, second

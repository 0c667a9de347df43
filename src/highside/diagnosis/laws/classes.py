"""The class of a law: groups that this session cannot tell from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import raw_columns_of
from highside.diagnosis.laws.groups import (
    LAGGING,
    LawGroup,
    confounded,
    one_quantity,
    product_of,
    same_angle,
    values_of,
)
from highside.diagnosis.laws.problem import LawProblem
from highside.physics.covariates import lag_of
from highside.physics.law import Axis
from highside.physics.law_functions import Function

Class = Callable[[], tuple[LawGroup, ...]]
"""the class of a law, sought when it is asked for first: most of what a search finds on its way is never told"""


def classes_of(
    white: Whitened, terms: Sequence[LawTerm], others: Sequence[Sequence[LawTerm]] = ()
) -> tuple[Class, ...]:
    """The class of each of these terms among all groups; `others`: sets of terms that are as likely as these."""
    kinds = {_told_as(term.group) for term in terms}
    only = [[term.group for term in one if _told_as(term.group) not in kinds] for one in others]
    known = [{_told_as(term.group) for term in one} for one in others]
    instead = [
        [group for has, own in zip(known, only, strict=True) if _told_as(term.group) not in has for group in own]
        for term in terms
    ]
    return tuple(cache(partial(_class_of, white, list(terms), k, instead[k])) for k in range(len(terms)))


def _in_its_place(own: LawGroup, instead: Sequence[LawGroup]) -> list[LawGroup]:
    """Of laws that another set has instead, those that may be there for this one: on a channel of it, but not what
    follows all that it does and more."""
    return [
        group
        for group in instead
        if not group.effect
        and set(group.channels) & set(own.channels)
        and not (group.place == own.place and set(own.depends_on) < set(group.depends_on))
    ]


def _class_of(white: Whitened, terms: list[LawTerm], k: int, instead: Sequence[LawGroup]) -> tuple[LawGroup, ...]:
    """Groups of which this session cannot tell one from another, one of each kind."""
    problem, groups, own = white.families.problem, white.families.groups, terms[k].group
    gains, _ = white.scores([t for i, t in enumerate(terms) if i != k], within=LAW_CLASS.same_reproduced)
    does = white.left_of(terms, [k])
    asked = white.may_reproduce(does)
    best = float(gains.max())
    found: list[LawGroup] = [own, *_twins(problem, own), *_set_in_with(white, terms, k)]
    for group in _in_its_place(own, instead):
        if not any(group.kind == one.kind for one in found):
            found.append(group)
    for i in np.argsort(-gains):
        group = groups[int(i)]
        behind = best - float(gains[i])
        if behind > LAW_CLASS.same_reproduced or len(set(map(_told_as, found))) >= LAW_CLASS.most_class:
            break
        if any(group.kind == g.kind for g in found):
            continue
        near = behind <= LAW_CLASS.same_confounded
        if not near and _adds(problem, own, group):
            continue
        ran_along = near and ran_together(problem, own, group)
        if behind <= LAW_CLASS.same or ran_along or (asked[i] and white.reproduces(does, group)):
            found.append(group)
    return tuple(found)


def _told_as(group: LawGroup) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """What a reader takes for one member of a class: temperatures that lag by different times are."""
    place, channels, names = group.kind
    return place, channels, tuple(LAGGING[0] if lag_of(name) else name for name in names)


def _twins(problem: LawProblem, own: LawGroup) -> list[LawGroup]:
    """The same functions in a place of which one unit does the same: it is not tried by itself."""
    if own.effect or len(own.units) != 1:
        return []
    places = [p for p in problem.places if same_angle(own.units[0], p)]
    twins = [replace(own, units=(place,)) for place in places]
    twins += [replace(own, axes=axes) for axes in _same_quantities(problem, own)]
    return twins + _turned_by_the_rate(problem, own)


def _set_in_with(white: Whitened, terms: list[LawTerm], k: int) -> list[LawGroup]:
    """Of what sets in at some time: the same where another quantity is beyond some value, if that differs nowhere by
    what shows, as in a session that goes from one inclination to the next."""
    problem, own = white.families.problem, terms[k].group
    at = next((i for i, axis in enumerate(own.axes) if axis.sets_in), None)
    if at is None or len(own.axes) < 2:
        return []
    kept = (*own.axes[:at], *own.axes[at + 1 :])
    lasting = replace(own, axes=kept, basis=product_of(problem, own.units, kept))
    start = len(white.free) + sum(term.group.size for term in terms[:k])
    sizes = white.posterior(terms)[0][start : start + own.size]
    does = np.tensordot(sizes, raw_columns_of(problem, lasting), 1)
    shows = np.sum(white.whitener.white(does[None])[0] ** 2, axis=0)
    later = problem.covariates["time"] >= own.axes[at].functions[0].numbers[0]
    made, unit = [], own.units[0]
    for name, every in problem.covariates.items():
        if name == "time" or name in own.depends_on or (every.ndim == 2 and unit.own < 0):
            continue
        values = values_of(problem, name, unit)
        edges = np.unique(values)
        for edge in (edges[1:] + edges[:-1]) / 2:
            beyond = values > edge
            if min(shows[beyond != later].sum(), shows[beyond == later].sum()) < LAW_CLASS.reproduced:
                step = Axis(name, float(edges[0]), float(edges[-1]), (Function("step", (float(edge),)),))
                made.append(replace(own, axes=(*kept, step)))
                break
    followed = [values_of(problem, axis.covariate, unit)[later] for axis in kept]
    if all(confounded(values, problem.covariates["time"][later], LAW_CLASS.function) for values in followed):
        # what it follows from then on is a function of the time: a curve of that does the same
        made += [group for group in white.families.groups if group.kind == (*own.kind[:2], ("time",))][:1]
    return made


def _turned_by_the_rate(problem: LawProblem, own: LawGroup) -> list[LawGroup]:
    """A time that is off turns the tool by the rate times that: an error of the toolface that is straight in the rate.
    As a surface over two quantities it may be far behind."""
    rate = problem.covariates.get("rate")
    if own.place != "timing" or "rate" in own.depends_on or rate is None or np.ptp(rate) == 0.0:
        return []
    straight = Axis("rate", float(rate.min()), float(rate.max()), (Function("straight"),))
    places = [p for p in problem.places if p.place == "toolface"]
    return [replace(own, units=(place,), axes=(*own.axes, straight)) for place in places]


def _same_quantities(problem: LawProblem, own: LawGroup) -> list[tuple[Axis, ...]]:
    """The axes of a law with another covariate that is one quantity with its own in this session, as the load along
    the tool is with the inclination: a function of the one is a function of the other, and may not be tried."""
    made, unit = [], own.units[0]
    for k, axis in enumerate(own.axes):
        values = values_of(problem, axis.covariate, unit)
        for name, every in problem.covariates.items():
            if name in own.depends_on or (every.ndim == 2 and unit.own < 0):
                continue
            other = values_of(problem, name, unit)
            if one_quantity(values, other, LAW_CLASS.one_quantity):
                renamed = replace(axis, covariate=name, low=float(other.min()), high=float(other.max()))
                made.append((*own.axes[:k], renamed, *own.axes[k + 1 :]))
    return made


def _adds(problem: LawProblem, own: LawGroup, other: LawGroup) -> bool:
    """Whether a group follows all that the law does and something else, which did not run along with any of it: it can
    do what the law does whatever the readings say."""
    its = [name for name in other.depends_on if name not in own.depends_on]
    if own.effect or not its or not set(own.depends_on) <= set(other.depends_on):
        return False
    unit = own.units[0]
    mine = [values_of(problem, name, unit) for name in own.depends_on]
    return not any(confounded(values_of(problem, name, unit), one, LAW_CLASS.ran_along) for name in its for one in mine)


def ran_together(problem: LawProblem, one: LawGroup, other: LawGroup) -> bool:
    """Whether what sets two groups apart are covariates of which one is a function of the other here."""
    if one.effect or other.effect:
        return False
    mine = [name for name in one.depends_on if name not in other.depends_on]
    its = [name for name in other.depends_on if name not in one.depends_on]
    if one.place != other.place or len(mine) != len(its) or not mine:
        return False
    first, second = one.units[0], other.units[0]
    return all(
        confounded(values_of(problem, a, first), values_of(problem, b, second), LAW_CLASS.function)
        for a, b in zip(mine, its, strict=True)
    )

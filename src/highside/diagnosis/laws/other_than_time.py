"""In the place of the session's own time, what this session cannot tell from it and another session can vary.

Whatever changes slowly runs with the time of one session: a temperature that rises, a supply that falls, an inclination
that is stepped through. A law of time cannot be confirmed by another session and predicts nothing there; a law of what
runs with it can and does. So where the two explain as much, the law is that of the other, and the time is told as what
this session cannot tell it from.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.between import best_between, is_temperature, lagging
from highside.diagnosis.laws.classes import ran_together
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.variants import finer
from highside.physics.covariates import lag_of

TIME = "time"


def instead_of_time(problem: LawProblem, groups: Sequence[LawGroup], own: LawGroup) -> list[LawGroup]:
    """The laws of as many quantities as `own`, in its place, with another quantity for the time; none where it does not
    follow the time, or sets in at one. Of temperatures each lag is tried, of pairs finer functions too."""
    if own.effect or own.depends_on.count(TIME) != 1 or any(axis.sets_in for axis in own.axes if len(own.axes) > 1):
        return []
    beside = [name for name in own.depends_on if name != TIME]
    tried: list[LawGroup] = []
    for group in groups:
        if group.effect or group.kind[:2] != own.kind[:2]:
            continue
        other = [name for name in group.depends_on if name not in beside]
        smooth = all(len(axis.functions) > LAW_GROUPS.few for axis in group.axes)
        # a temperature and its lag are one quantity, that goes another way up than down
        warms = len(other) == 2 and all(map(is_temperature, other))
        if len(group.axes) != len(own.axes) + (1 if warms else 0):
            continue
        if not (warms or len(other) == 1) or other[0] == TIME or not smooth:
            continue
        tried.append(group)
        known = any(is_temperature(name) for g in tried[:-1] for name in g.depends_on)
        if is_temperature(other[0]) and not known:
            tried += lagging(problem, group)
    return [*tried, *(fine for group in tried for fine in finer(problem, group))]


def without_time(
    problem: LawProblem, whitener: Whitener, residual: Array, groups: Sequence[LawGroup], terms: Sequence[LawTerm]
) -> list[LawTerm]:
    """The terms, each that follows the time replaced where this session cannot tell it from another quantity."""
    made = list(terms)
    for k, term in enumerate(terms):
        tried = instead_of_time(problem, groups, term.group)
        if tried:
            among = Whitened(Families(problem, [term.group, *tried]), whitener, residual)
            # a strong law of a temperature shows a lag that is between those of the list
            others = [t for i, t in enumerate(made) if i != k]
            lagged = [g for g in tried if any(lag_of(name) for name in g.depends_on)]
            for axes in sorted({len(g.axes) for g in lagged}):
                best = best_between(among, others, [g for g in lagged if len(g.axes) == axes])
                tried += [best[0]] if best is not None and best[0] not in tried else []
            among = Whitened(Families(problem, [term.group, *tried]), whitener, residual)
            made[k] = _as_good(among, made, k) or term
    return made


def one_for_several(
    problem: LawProblem, whitener: Whitener, residual: Array, groups: Sequence[LawGroup], terms: Sequence[LawTerm]
) -> list[LawTerm] | None:
    """The terms with one law of another quantity for several of the time alone in one place: two functions of the time
    follow what a quantity does, which is not known to the last digit, closer than a function of that. None where no two
    are."""
    of_time = [term for term in terms if term.group.depends_on == (TIME,) and not term.group.effect]
    several = next((own for term in of_time if len(own := _beside(term, of_time)) > 1), None)
    tried = instead_of_time(problem, groups, several[0].group) if several else []
    if several is None or not tried:
        return None
    others = [term for term in terms if not any(term is one for one in several)]
    gains, priors = Whitened(Families(problem, tried), whitener, residual).scores(others)
    best = int(np.argmax(gains))
    return [*others, LawTerm(tried[best], priors[best])] if np.isfinite(gains[best]) else None


def _beside(term: LawTerm, terms: Sequence[LawTerm]) -> list[LawTerm]:
    return [one for one in terms if one.group.kind[:2] == term.group.kind[:2]]


def _as_good(among: Whitened, terms: list[LawTerm], k: int) -> LawTerm | None:
    """The best of the groups in the place of a term, the first of them, that is in the class of it."""
    own, *tried = among.families.groups
    gains, priors = among.scores([term for i, term in enumerate(terms) if i != k])
    if not np.isfinite(gains[0]):
        return None
    does = among.left_of(terms, [k])
    for i in np.argsort(-gains[1:]):
        behind, other = float(gains[0] - gains[1 + i]), tried[int(i)]
        if behind > LAW_CLASS.same_confounded:
            return None
        if sum(map(is_temperature, other.depends_on)) > 1 and behind > 0.0:
            # a surface over what follows the time does whatever a law of that does
            continue
        near = behind <= LAW_CLASS.same or ran_together(among.families.problem, own, other)
        if near or among.reproduces(does, other):
            return LawTerm(other, priors[1 + int(i)])
    return None

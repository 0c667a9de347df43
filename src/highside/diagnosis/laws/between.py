"""Numbers of a law that was found between those that are tried: the lag of a temperature, an order of the toolface.

A curve of a temperature whose lag is off by a tenth leaves a hundredth of what it does, which of a strong law is more
than all noise, and is then given to something else. So what the list holds is tried, and between the neighbours of
the best one ever finer, by the evidence. What a lag costs is the logarithm of the number of lags in the list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.between_policy import LAW_LAGS
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import LawGroup, axis_of, distinct_of, is_wave, product_of, values_of, wave_of
from highside.diagnosis.laws.noise import Whitener
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_SEARCH
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import CovariateValues, LawProblem
from highside.physics.covariates import FILTERED, lag_of, lagging_name
from highside.physics.law_functions import Function
from highside.physics.places import PLACES

TEMPERATURES = ("temp", *FILTERED)
"""one quantity, as it lags or not"""


def is_temperature(name: str) -> bool:
    """Whether a covariate is the temperature, or one that lags."""
    return name == "temp" or lag_of(name) > 0


def lagging(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """The law of a temperature with each of the time constants of the list, or with none, in the place of its own. Of a
    temperature beside one that lags the latter alone is another."""
    both = all(is_temperature(axis.covariate) for axis in group.axes[:2]) and len(group.axes) > 1
    return [
        other
        for k, axis in enumerate(group.axes)
        if is_temperature(axis.covariate) and not (both and axis.covariate == "temp")
        for name in (FILTERED if both else TEMPERATURES)
        if name in problem.covariates and (other := _with_lag(problem, group, k, name)) is not None
    ]


def alone(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """Of a product that follows a temperature: the temperature by itself, at each lag."""
    names = [axis.covariate for axis in group.axes if is_temperature(axis.covariate)]
    if len(group.axes) != 2 or not names or any(len(axis.functions) < LAW_GROUPS.few for axis in group.axes):
        return []
    values = values_of(problem, names[0], group.units[0])
    count = min(LAW_GROUPS.cosines, distinct_of(values) - 1)
    axis, order = axis_of(names[0], values, count, constant=PLACES[group.place].constant, turns=1)
    single = replace(group, axes=(axis,), order=order, basis=product_of(problem, group.units, [axis]), tries=1)
    return [single, *lagging(problem, single)]


def between_of(problem: LawProblem, group: LawGroup) -> list[list[LawGroup]]:
    """Sets of laws, of each of which the best is sought between its members too."""
    if group.effect:
        return []
    one_order = [group] if _fraction(group) or period_of(group) else []
    return [tried for tried in (lagging(problem, group), alone(problem, group), one_order) if tried]


def _fraction(group: LawGroup) -> float:
    """The order of the toolface of a law of one that is no whole number; 0 of every other."""
    first = group.axes[0].functions[0]
    return first.numbers[0] if group.depends_on == ("tf_fraction",) and first.kind in ("cos", "sin") else 0.0


def period_of(group: LawGroup) -> float:
    """The period in s of an offset that is a wave of time; 0 of every other law."""
    axis = group.axes[0]
    return axis.functions[0].numbers[0] if axis.covariate == "time" and is_wave(axis) else 0.0


def best_between(
    among: Whitened, others: Sequence[LawTerm], tried: list[LawGroup]
) -> tuple[LawGroup, float, Prior] | None:
    """The best of laws that differ in one number, and of what lies between it and its neighbours: the group, nats that
    it gains beside the other terms, and its prior. None where nothing is left of any, or there are none."""
    problem, best = among.families.problem, None
    if not tried:
        return None
    for step in (1.0, *(LAW_LAGS.steps_of_wave if period_of(tried[0]) else LAW_LAGS.steps)):
        if not tried:
            break
        gains, priors = among.of_groups(tried).scores(list(others))
        at = int(np.argmax(gains))
        if np.isfinite(gains[at]) and (best is None or gains[at] > best[1]):
            best = tried[at], float(gains[at]), priors[at]
        if best is None:
            break
        tried = _near(problem, best[0], step * LAW_LAGS.finer)
    return best


def refined(white: Whitened, terms: Sequence[LawTerm], best: float) -> list[tuple[LawGroup, float, Prior]]:
    """Where the best group gains so many nats, of groups that come near and have a number between those that are tried
    the best of each kind, that number sought: the group, what it gains beside the terms, and its prior.

    A line whose order is off by a twentieth, or a lag by a tenth, leaves a hundredth of what it does. Of a large law
    that is more than a surface of many functions leaves, which then takes its place.
    """
    if best < LAW_LAGS.large:
        return []
    groups, most = white.families.groups, white.bounds(list(terms))
    first: dict[object, int] = {}
    for i in np.argsort(-most):
        if most[i] < LAW_LAGS.near * best or len(first) == LAW_LAGS.refined:
            break
        if (kind := _kind(groups[i])) is not None:
            first.setdefault(kind, int(i))
    found = [best_between(white, terms, [groups[i]]) for i in first.values()]
    return [one for one in found if one is not None and one[0] not in groups]


def _kind(group: LawGroup) -> object:
    """What groups have in common that differ in a number between those that are tried; None of others."""
    if group.effect:
        return None
    if _fraction(group) or period_of(group):
        return group.place, group.channels, group.depends_on
    names = tuple("lag" if lag_of(name) else name for name in group.depends_on)
    return (group.place, group.channels, names) if "lag" in names else None


def with_plain_temperature(
    problem: LawProblem, whitener: Whitener, residual: Array, terms: Sequence[LawTerm]
) -> list[LawTerm]:
    """The terms, each that follows a temperature that lags, or its rate, as a law of the temperature itself where this
    session does not show the difference: a lag is a further claim."""
    made = list(terms)
    for k, term in enumerate(terms):
        at = next((i for i, axis in enumerate(term.group.axes) if _derived(axis.covariate)), None)
        if term.group.effect or at is None or any(axis.covariate == "temp" for axis in term.group.axes):
            continue
        if (plain := _with_lag(problem, term.group, at, "temp")) is None:
            continue
        among = Whitened(Families(problem, [term.group, plain]), whitener, residual)
        gains, priors = among.scores([one for i, one in enumerate(made) if i != k])
        if np.isfinite(gains).all() and gains[1] > gains[0] - LAW_SEARCH.each:
            made[k] = LawTerm(plain, priors[1])
    return made


def _derived(name: str) -> bool:
    return lag_of(name) > 0 or name == "temp_rate"


def _near(problem: LawProblem, group: LawGroup, step: float) -> list[LawGroup]:
    """The law with time constants about its own, a step of the list's ratio divided by so much apart."""
    made: list[LawGroup | None] = []
    if order := _fraction(group):
        away = LAW_GROUPS.fraction_step * step * np.arange(-LAW_LAGS.each_side, LAW_LAGS.each_side + 1)
        # of an order of nothing it is a constant
        lowest = LAW_GROUPS.fraction_step - LAW_GROUPS.distinct
        near = [order + float(one) for one in away if one and order + one > lowest]
        made += [_of_order(problem, group, one) for one in near]
    if period := period_of(group):
        span = group.axes[0].high - group.axes[0].low
        away = LAW_GROUPS.wave_step * step * np.arange(-LAW_LAGS.each_side, LAW_LAGS.each_side + 1)
        made += [_of_functions(problem, group, wave_of(span / (span / period + float(one)))) for one in away if one]
    if not isinstance(problem.covariates, CovariateValues):
        return [one for one in made if one is not None]
    for k, axis in enumerate(group.axes):
        if own := lag_of(axis.covariate):
            ratios = LAW_LAGS.ratio ** (step * np.arange(-LAW_LAGS.each_side, LAW_LAGS.each_side + 1))
            lags = sorted({round(own * float(ratio)) for ratio in ratios} - {own, 0})
            made += [_with_lag(problem, group, k, lagging_name(lag)) for lag in lags]
    return [one for one in made if one is not None]


def _of_order(problem: LawProblem, group: LawGroup, order: float) -> LawGroup:
    return _of_functions(problem, group, tuple(Function(f.kind, (order,)) for f in group.axes[0].functions))


def _of_functions(problem: LawProblem, group: LawGroup, functions: tuple[Function, ...]) -> LawGroup:
    axis = replace(group.axes[0], functions=functions)
    return replace(group, axes=(axis,), basis=product_of(problem, group.units, [axis]))


def _with_lag(problem: LawProblem, group: LawGroup, k: int, name: str) -> LawGroup | None:
    """The law with another temperature on its k-th axis; None for its own, or one that does not vary."""
    axis = group.axes[k]
    values = values_of(problem, name, group.units[0])
    low, high = float(values.min()), float(values.max())
    if name == axis.covariate or high - low <= LAW_GROUPS.constant * max(abs(low), abs(high), 1.0):
        return None
    axes = [*group.axes]
    axes[k] = replace(axis, covariate=name, low=low, high=high)
    tries = max(group.tries // _tries(axis.covariate), 1) * _tries(name)
    return replace(group, axes=tuple(axes), basis=product_of(problem, group.units, axes), tries=tries)


def _tries(name: str) -> int:
    return len(FILTERED) if lag_of(name) else 1

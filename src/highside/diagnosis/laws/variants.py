"""Variants of a law that was found: one that sets in midway, a step or decay between the times that are tried, a
product with finer functions, one that is straight or bent once in one
of its two quantities, a scale factor that follows another load.

They are tried in the place of a group that was chosen, not of every group: a hundred onsets of each would be most of a
search, and a group that acts for a part of the session, or is drawn too smooth, is found as itself first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.classes_policy import LAW_CLASS
from highside.diagnosis.laws.groups import (
    SETS_IN,
    LawGroup,
    axis_of,
    distinct_of,
    one_quantity,
    product_of,
    values_of,
)
from highside.diagnosis.laws.onsets_policy import EDGES
from highside.diagnosis.laws.policy import LAW_GROUPS
from highside.diagnosis.laws.problem import LawProblem, functions_of
from highside.physics.covariates import COVARIATES
from highside.physics.law import Axis
from highside.physics.law_functions import Function
from highside.physics.places import PLACES

ONSET = "step"


def variants_of(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """What is tried in the place of a group; nothing for effects of the library and for what has variants already."""
    if group.effect:
        return []
    if len(group.axes) == 1 and group.axes[0].functions[0].kind in SETS_IN:
        return moved(problem, group)
    if any(f.kind == ONSET for axis in group.axes for f in axis.functions):
        return []
    return [
        *_onsets(problem, group),
        *finer(problem, group),
        *_factors(problem, group),
        *_simple_in_one(problem, group),
        *_as_scale(problem, group),
    ]


def moved(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """A step, ramp or decay that begins elsewhere up to the next place that was tried; a decay of other time constants
    as well."""
    (axis,) = group.axes
    kind, (at, *constants) = axis.functions[0].kind, axis.functions[0].numbers
    values = np.unique(values_of(problem, axis.covariate, group.units[0]))
    middle = (values[1:] + values[:-1]) / 2
    tried = LAW_GROUPS.steps if axis.covariate == "time" else EDGES.steps_over
    every = -(-middle.size // max(tried - 1, 1))
    at_middle = int(np.searchsorted(middle, at))
    near = middle[max(at_middle - every, 0) : at_middle + every + 1]
    if near.size > LAW_GROUPS.onsets_between:
        near = near[np.unique(np.linspace(0, near.size - 1, LAW_GROUPS.onsets_between).astype(int))]
    shapes = [(float(onset), *constants) for onset in near if onset != at]
    shapes += [(at, tau * factor) for tau in constants for factor in LAW_GROUPS.decays_between]
    made = []
    for numbers in shapes:
        other = replace(axis, functions=(Function(kind, numbers),))
        basis, _ = _product(problem, group, [other])
        made.append(replace(group, axes=(other,), basis=basis))
    return made


def as_simple(group: LawGroup, other: LawGroup) -> bool:
    """Whether a variant claims no more than the group does: of as many covariates, with no more functions, no onset."""
    return len(other.axes) <= len(group.axes) and other.size <= group.size


def onset_knots(t_s: Array, values: int = LAW_GROUPS.onset_values, before: int | None = None) -> Array:
    """Times between values at which something may set in, with so many values after it, and that many or `before`."""
    t = np.unique(t_s - t_s[:1])
    middle = (t[1:] + t[:-1]) / 2
    inner = middle[(values if before is None else before) - 1 : middle.size - values + 1]
    if not inner.size:
        return inner
    return np.asarray(inner[np.unique(np.linspace(0, inner.size - 1, LAW_GROUPS.steps).astype(int))])


def _onsets(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """The law from some time on; of one that follows time and something else, the something from some time on."""
    axes = [axis for axis in group.axes if axis.covariate != "time"]
    time = problem.covariates.get("time")
    if len(axes) != 1 or time is None or not np.ptp(time):
        # a surface from some time on follows anything
        return []
    # what is free takes the mean of a law, but not of one that acts for a part of the session
    axes = [axis if axis.functions[0].kind == "one" else _with_constant(axis) for axis in axes]
    basis, order = _product(problem, group, axes)
    low, high = float(time.min()), float(time.max())
    knots = onset_knots(problem.t_s)
    made = []
    for at in knots:
        step = Axis("time", low, high, (Function(ONSET, (float(at),)),))
        acts = functions_of(problem.covariates, step)[0]
        made.append(replace(group, axes=(*axes, step), order=order, basis=basis * acts, tries=2 * len(knots)))
    return made


def finer(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """A product of smooth functions with more of them."""
    if len(group.axes) != 2 or any(len(axis.functions) < LAW_GROUPS.few for axis in group.axes):
        return []
    axes = fine_axes(problem, group)
    if [len(axis.functions) for axis in axes] == [len(axis.functions) for axis in group.axes]:
        return []
    basis, order = _product(problem, group, [*axes])
    return [replace(group, axes=axes, order=order, basis=basis)]


def fine_axes(problem: LawProblem, group: LawGroup) -> tuple[Axis, ...]:
    """The axes of a group with the most functions that one of two has."""
    axes = []
    for axis in group.axes:
        values = values_of(problem, axis.covariate, group.units[0])
        distinct = distinct_of(values)
        count = min(LAW_GROUPS.finer_orders, distinct - 1)
        turns = min(LAW_GROUPS.finer_turns, max(1, distinct // 2))
        axes.append(axis_of(axis.covariate, values, count, constant=True, turns=turns)[0])
    return tuple(axes)


def _simple_in_one(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """A product that is a straight line, or bent once, in one quantity and a fine curve in the other: a coefficient of
    temperature that follows the load. Few functions where many would follow the noise."""
    if len(group.axes) != 2 or any(len(axis.functions) < LAW_GROUPS.few for axis in group.axes):
        return []
    made = []
    for k, axis in enumerate(group.axes):
        known = COVARIATES.get(axis.covariate)
        if known is not None and known.periodic:
            continue
        fine = _finest(problem, group, group.axes[1 - k])
        for shapes in (("one", "straight"), ("one", "straight", "square")):
            simple = replace(axis, functions=tuple(Function(kind) for kind in shapes))
            axes = (simple, fine) if k == 0 else (fine, simple)
            basis, order = _product(problem, group, list(axes))
            made.append(replace(group, axes=axes, order=order, basis=basis))
    return made


def _finest(problem: LawProblem, group: LawGroup, axis: Axis) -> Axis:
    """As many functions of a covariate as a law of it alone has, and a constant."""
    values = values_of(problem, axis.covariate, group.units[0])
    distinct = distinct_of(values)
    count = min(LAW_GROUPS.cosines, distinct - 1)
    turns = min(LAW_GROUPS.finer_turns, max(1, distinct // 2))
    return axis_of(axis.covariate, values, count, constant=True, turns=turns)[0]


def _factors(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """Each factor of a product alone, with finer functions: a product may stand in for an edge of one of them."""
    if len(group.axes) != 2:
        return []
    made = []
    for axis in group.axes:
        known = COVARIATES.get(axis.covariate)
        if len(axis.functions) < LAW_GROUPS.few or (known is not None and known.periodic):
            continue
        values = values_of(problem, axis.covariate, group.units[0])
        distinct = distinct_of(values)
        count = min(2 * LAW_GROUPS.cosines, distinct - 1)
        constant = PLACES[group.place].constant
        fine, _ = axis_of(axis.covariate, values, count, constant=constant, turns=1)
        basis, order = _product(problem, group, [fine])
        made.append(replace(group, axes=(fine,), order=order, basis=basis, tries=2))
    return made


def _as_scale(problem: LawProblem, group: LawGroup) -> list[LawGroup]:
    """An offset that follows the own load and another one, as a scale factor that follows the other alone.

    Scale factors are not tried with loads: most of such laws are nonlinearities, which the product of two loads holds.
    """
    if group.place != "offset" or len(group.units) != 1 or len(group.axes) != 2 or "load" not in problem.covariates:
        return []
    unit = group.units[0]
    scale = next((p for p in problem.places if p.place == "scale" and p.channel == unit.channel), None)
    if scale is None or scale.own < 0:
        return []
    own, made = values_of(problem, "load", unit), []
    for first, other in (group.axes, group.axes[::-1]):
        values = values_of(problem, first.covariate, unit)
        if not other.covariate.startswith("load") or not one_quantity(values, own, LAW_CLASS.one_quantity):
            continue
        values = values_of(problem, other.covariate, unit)
        distinct = distinct_of(values)
        count = min(LAW_GROUPS.cosines, distinct - 1)
        axis, _ = axis_of(other.covariate, values, count, constant=PLACES["scale"].constant, turns=1)
        basis, order = _product(problem, group, [axis])
        made.append(replace(group, units=(scale,), axes=(axis,), order=order, basis=basis, tries=2))
    return made


def _with_constant(axis: Axis) -> Axis:
    return replace(axis, functions=(Function("one"), *axis.functions))


def _product(problem: LawProblem, group: LawGroup, axes: list[Axis]) -> tuple[Array, Array]:
    """(u, m, n) the products of all functions of the axes for each unit, and their orders (m,)."""
    orders = [orders_of(axis) for axis in axes]
    order = orders[0]
    for more in orders[1:]:
        order = np.hypot(order[:, None], more[None]).reshape(-1)
    return product_of(problem, group.units, axes), order


def orders_of(axis: Axis) -> Array:
    """(m,) order of each function of an axis: of a whole smooth set its number, of single shapes none."""
    smooth = len(axis.functions) > LAW_GROUPS.few
    known = COVARIATES.get(axis.covariate)
    kinds = {"cosine", "wide_cosine"} | ({"cos", "sin"} if known is not None and known.periodic else set())
    return np.array([f.numbers[0] if smooth and f.kind in kinds else 0.0 for f in axis.functions])

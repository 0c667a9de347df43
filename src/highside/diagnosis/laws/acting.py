"""A law that sets in midway is known where it acted: at the values that its covariates took from then on.

Its functions reach over all that the session visited. What a curve does at temperatures that were there before it set
in alone is nothing that was learnt, and the model of the next recording has the law from its start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.groups import LawGroup, values_of
from highside.diagnosis.laws.policy import LAW_REPORT
from highside.diagnosis.laws.problem import LawProblem
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function

OF_THE_RANGE = frozenset({"cosine", "wide_cosine", "straight", "square"})
"""functions that are drawn over the range of their axis"""


def known_where_it_acted(problem: LawProblem, group: LawGroup, law: Law) -> Law:
    """The law with the ranges that were visited while it acted, its curve over these as it was; beyond, it falls off as
    any law does. A law that acts all the time is itself."""
    if law.sets_in_s is None:
        return law
    acts = problem.covariates["time"] >= law.sets_in_s
    axes: list[Axis] = []
    turn: Array = np.eye(1)
    for axis in law.axes:
        own, by_axis = _over(axis, values_of(problem, axis.covariate, group.units[0])[acts])
        axes.append(own)
        turn = np.asarray(np.kron(turn, by_axis), dtype=float)
    whole = np.kron(np.eye(len(law.channels)), turn)
    return replace(
        law,
        axes=tuple(axes),
        coefficients=tuple(tuple(map(float, row)) for row in np.asarray(law.coefficients) @ turn),
        covariance=tuple(tuple(map(float, row)) for row in whole.T @ np.asarray(law.covariance) @ whole)
        if law.covariance
        else (),
    )


def _over(axis: Axis, values: Array) -> tuple[Axis, Array]:
    """The axis over the range of values (n,), and what turns coefficients (m,) of its functions into those of the new
    ones (m, k)."""
    none = np.eye(len(axis.functions))
    if axis.periodic or axis.sets_in or values.size < 2:
        return axis, none
    low, high = max(axis.low, float(values.min())), min(axis.high, float(values.max()))
    if low >= high or (low, high) == (axis.low, axis.high):
        return axis, none
    own = replace(axis, low=low, high=high)
    if not any(f.kind in OF_THE_RANGE for f in axis.functions):
        return own, none
    # of cosines over a part of a range as many again do what those over the whole did
    waves = (Function("wide_cosine", (float(order),)) for order in range(1, 2 * len(axis.functions) + 1))
    own = replace(own, functions=(Function("one"), *waves))
    grid = np.linspace(low, high, LAW_REPORT.over_range)
    return own, np.asarray(axis.basis(grid) @ np.linalg.pinv(own.basis(grid), rcond=LAW_REPORT.ridge))

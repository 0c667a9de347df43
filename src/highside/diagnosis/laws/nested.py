"""One law in the place of two that act alike, of which one follows nothing but what the other does.

Taken one by one a curve is found first, and a product beside it takes what the curve leaves; of a large law a product
takes what a product of fewer functions leaves. To who reads the claims, and to a model, it is one law of two
quantities: the sum of both.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.groups import SETS_IN, LawGroup
from highside.physics.law import Axis, Law
from highside.physics.law_functions import Function

ONE = Function("one")


def nested(terms: Sequence[LawTerm], shares: Sequence[float], formulas: Collection[int]) -> dict[int, list[int]]:
    """Of each product that is none of the `formulas` the numbers of the laws that are a part of it; none is of two."""
    parts: dict[int, list[int]] = {}
    taken: set[int] = set()
    for k in sorted(range(len(terms)), key=lambda k: -shares[k]):
        whole = terms[k].group
        if k in taken or k in formulas or not _is_product(whole):
            continue
        own = [j for j, term in enumerate(terms) if j != k and j not in taken and _is_part(term.group, whole)]
        if own:
            parts[k] = own
            taken |= {k, *own}
    return parts


def _is_product(group: LawGroup) -> bool:
    """Whether it is a surface over two quantities."""
    return not group.effect and len(group.axes) == 2 and _acts_all_along(group)


def _acts_all_along(group: LawGroup) -> bool:
    """Whether nothing in it sets in at some time or value."""
    return not any(f.kind in SETS_IN for axis in group.axes for f in axis.functions)


def _is_part(part: LawGroup, whole: LawGroup) -> bool:
    """Whether it acts as the whole does, and follows nothing but what that follows over the same range."""
    ranges = {axis.covariate: (axis.low, axis.high) for axis in whole.axes}
    return (
        not part.effect
        and _acts_all_along(part)
        and part.kind[:2] == whole.kind[:2]
        and all(ranges.get(axis.covariate) == (axis.low, axis.high) for axis in part.axes)
        and len(set(part.depends_on)) == len(part.axes)
    )


def joined(laws: Sequence[Law], covariance: Array) -> Law:
    """The sum of laws in one place, the first of which follows all that the others do; `covariance` of all their
    coefficients, law by law."""
    whole = laws[0]
    axes = tuple(_with_functions_of(axis, laws[1:]) for axis in whole.axes)
    turns = [_turn(law, axes) for law in laws]
    rows = sum(np.asarray(law.coefficients) @ turn for law, turn in zip(laws, turns, strict=True))
    each = np.eye(len(whole.channels))
    turn = np.concatenate([np.kron(each, one) for one in turns])
    spread = turn.T @ covariance @ turn
    return replace(
        whole,
        axes=axes,
        coefficients=tuple(tuple(map(float, row)) for row in np.asarray(rows)),
        covariance=tuple(tuple(map(float, row)) for row in spread),
    )


def _with_functions_of(axis: Axis, others: Sequence[Law]) -> Axis:
    """The axis with the functions that others have of its quantity; the constant, where one does not follow it."""
    more: list[Function] = []
    for law in others:
        own = [a for a in law.axes if a.covariate == axis.covariate]
        more += own[0].functions if own else [ONE]
    return replace(axis, functions=tuple(dict.fromkeys((*axis.functions, *more))))


def _turn(law: Law, axes: Sequence[Axis]) -> Array:
    """(m, M) what turns the coefficients of a law's functions into those of all products of the functions of axes."""
    sizes = [len(axis.functions) for axis in axes]
    own = {axis.covariate: axis.functions for axis in law.axes}
    at = [[axis.functions.index(f) for f in own.get(axis.covariate, (ONE,))] for axis in axes]
    numbers = np.arange(int(np.prod(sizes))).reshape(sizes)[np.ix_(*at)]
    # the law may name its quantities in another order, and has a constant of what it does not follow
    order = [axis.covariate for axis in axes]
    first = [order.index(name) for name in law.depends_on]
    numbers = numbers.transpose([*first, *(k for k in range(len(axes)) if k not in first)]).reshape(-1)
    made = np.zeros((numbers.size, int(np.prod(sizes))))
    made[np.arange(numbers.size), numbers] = 1.0
    return made

"""The curve of a law as it is reported: its value, its band, and where nothing was read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.core.result import Curve
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of, prior_of
from highside.diagnosis.laws.formulas_policy import LAW_CURVES
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, axis_of, product_of, values_of
from highside.diagnosis.laws.noise import evidence
from highside.diagnosis.laws.policy import LAW_EVIDENCE, LAW_GROUPS, LAW_REPORT
from highside.diagnosis.laws.priors import Prior
from highside.diagnosis.laws.problem import LawProblem
from highside.diagnosis.laws.products import ProductGroup, coefficients_of
from highside.physics.law import Law
from highside.physics.law_functions import Function
from highside.physics.places import PLACES

ONE = Function("one")


def slice_of(found: Found, terms: Sequence[LawTerm], k: int) -> slice:
    """Where a term's coefficients stand among those of all that is free and of the terms."""
    start = len(found.problem.free) + sum(t.group.size for t in terms[:k])
    return slice(start, start + terms[k].group.size)


def law_of_group(group: LawGroup, mean: Array, covariance: Array) -> Law:
    """The law of a group with coefficients (m,) and their covariance (m, m), which may be empty: not known."""
    turn = coefficients_of(group)
    rows = (turn @ mean).reshape(len(group.units), -1)
    covariance = turn @ covariance @ turn.T if covariance.size else covariance
    axes = group.surface if isinstance(group, ProductGroup) else group.axes
    return Law(group.label, group.place, tuple(u.channel for u in group.units), axes, _rows(rows), _rows(covariance))


def with_band(found: Found, white: Whitened, terms: Sequence[LawTerm], k: int, law: Law) -> Law:
    """The law of a term of one quantity with the covariance of all curves that the recording has as well, in the square
    of the unit of its place; of several quantities itself.

    A curve under another prior, with more waves than few values tell apart, is as likely as the one that is told, and
    differs from it where nothing was read. A formula's own covariance holds its places, widths and periods as known,
    and that it is right. So a law also has the waves of these curves, with coefficients of 0 and the covariance of
    what it is from them, each with the share of its evidence.
    """
    own = terms[k]
    if len(law.axes) > 1 or len(own.group.axes) > 1 or not own.group.orders.any():
        return law
    group, units = _with_all_waves(found.problem, own.group), len(law.channels)
    told, (span,) = law.axes[0].functions, group.axes
    curve = tuple(dict.fromkeys((ONE, *span.functions)))
    # the functions of a formula first, those of the curves after them: that is the order in which a reader wants them
    functions = tuple(dict.fromkeys((*told, *curve) if law.formula else curve))
    table, drawn = np.zeros((units, len(functions))), np.zeros((units, len(curve)))
    table[:, [functions.index(f) for f in told]] = law.coefficients
    waves = replace(span, functions=curve)
    if law.formula:
        # as a curve: what no curve follows of it, as at a corner, is not what it is uncertain by
        grid = np.linspace(span.low, span.high, LAW_REPORT.over_range)
        drawn[:] = np.array(law.coefficients) @ law.basis([grid]) @ np.linalg.pinv(waves.basis(grid), LAW_REPORT.ridge)
    else:
        drawn[:] = table
    level = waves.basis(values_of(found.problem, span.covariate, group.units[0])).mean(axis=1)
    turn = np.kron(np.eye(units), np.eye(len(curve))[:, [curve.index(f) for f in span.functions]])
    covariance = np.zeros((drawn.size, drawn.size))
    for share, mean, spread in _likely(white, terms, k, group):
        apart = drawn - (turn @ mean).reshape(drawn.shape)
        # a constant is none of the law's where the base has one too
        apart[:, 0] -= apart @ level
        covariance += share * (turn @ spread @ turn.T + np.outer(apart, apart))
    turn = np.kron(np.eye(units), np.eye(len(functions))[:, [functions.index(f) for f in curve]])
    axes = (replace(law.axes[0], functions=functions),)
    return replace(law, axes=axes, coefficients=_rows(table), covariance=_rows(turn @ covariance @ turn.T))


def _likely(white: Whitened, terms: Sequence[LawTerm], k: int, group: LawGroup) -> Iterator[tuple[float, Array, Array]]:
    """The coefficients (m,) of a group in the place of a term under all priors, their covariance (m, m), and the
    evidence of each as a share of the whole."""
    problem, own = white.families.problem, terms[k].prior
    priors = [Prior(own.size * factor, length) for length in LAW_EVIDENCE.lengths for factor in LAW_CURVES.sizes]
    tried = [[*terms[:k], LawTerm(group, prior), *terms[k + 1 :]] for prior in priors]
    columns, _ = white.columns(tried[0])
    flat = flattened(np.concatenate([columns, white.residual[None]]))
    inner, determinant = flat @ flat.T, np.array([white.whitener.log_determinant])
    precisions = [prior_of(problem, one) for one in tried]
    worth = np.array([float(evidence(inner[None], one, determinant)[0]) for one in precisions])
    shares = np.exp(worth - worth.max())
    start = len(problem.free) + sum(t.group.size for t in terms[:k])
    part = slice(start, start + group.size)
    for share, precision in zip(shares / shares.sum(), precisions, strict=True):
        inverse = inverse_of(inner[:-1, :-1], precision)
        yield float(share), (inverse @ inner[:-1, -1])[part], inverse[part, part]


def _rows(table: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in table)


def _with_all_waves(problem: LawProblem, group: LawGroup) -> LawGroup:
    """The group with as many waves as one of many values has: of a few a search tries no more than they tell apart."""
    axis, waves = group.axes[0], [f for f in group.axes[0].functions if f.kind != "one"]
    if {f.kind for f in waves} != {"wide_cosine"} or len(waves) >= LAW_GROUPS.cosines:
        return group
    values, constant = values_of(problem, axis.covariate, group.units[0]), len(waves) < len(axis.functions)
    axis, order = axis_of(axis.covariate, values, LAW_GROUPS.cosines, constant=constant, turns=0)
    return replace(group, axes=(axis,), order=order, basis=product_of(problem, group.units, (axis,)))


def curve_of(found: Found, group: LawGroup, law: Law) -> Curve:
    """The law of its first channel over its first covariate, the second at its median, or where it has set in."""
    axis, unit = law.axes[0], group.units[0]
    grid = np.linspace(axis.low, axis.high, LAW_REPORT.grid)
    at = [grid]
    for other in law.axes[1:]:
        middle = float(np.median(values_of(found.problem, other.covariate, unit)))
        at.append(np.full(grid.size, other.high if other.sets_in else middle))
    read = values_of(found.problem, axis.covariate, unit)
    if law.sets_in_s is not None:
        read = read[found.problem.covariates["time"] >= law.sets_in_s]
    drawn, value, std = (tuple(map(float, numbers)) for numbers in (grid, law.value(at), law.std(at)))
    stretches = unread(read, axis.low, axis.high, comes_round=axis.periodic)
    return Curve(drawn, value, std, PLACES[law.place].unit, stretches)


def unread(read: Array, low: float, high: float, *, comes_round: bool = False) -> tuple[tuple[float, float], ...]:
    """The stretches from low to high, a fifth of that and more, in which none of the values read (n,) lies."""
    if comes_round:
        read = np.mod(read - low, high - low) + low
        read = np.concatenate([[read.max() - (high - low)], read, [read.min() + (high - low)]])
    values = np.unique(np.concatenate([[] if comes_round else [low, high], read]))
    wide = np.flatnonzero(np.diff(values) >= LAW_CURVES.unread * (high - low))
    found = ((float(max(values[i], low)), float(min(values[i + 1], high))) for i in wide)
    return tuple((begin, end) for begin, end in found if begin < end)

"""Formulas of several laws beside one another.

The formula of a law is fitted with everything else free to move. What is told of the names does not move, and of two
laws each formula would take what both explain. So a formula is told only where all else need not move for it, and the
curves beside it are those that go with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.laws.evidence import LawTerm, Whitened, inverse_of
from highside.diagnosis.laws.families import raw_columns_of
from highside.diagnosis.laws.formulas import Closed
from highside.diagnosis.laws.formulas_policy import LAW_FORMULAS


def told_together(
    white: Whitened, terms: Sequence[LawTerm], closed: Mapping[int, Closed]
) -> tuple[frozenset[int], dict[int, Array]]:
    """Numbers of the terms whose formula is told, and of each other law the coefficients (m,) of its curve beside these
    formulas and the names as they are."""
    mean, _ = white.posterior(list(terms))
    problem = white.families.problem
    ends = len(problem.free) + np.cumsum([0, *(term.group.size for term in terms)])
    told = np.zeros(problem.residual.shape)
    for k, term in enumerate(terms):
        if term.group.effect:
            told += np.tensordot(mean[ends[k] : ends[k + 1]], raw_columns_of(problem, term.group), 1)
    curves = [k for k, term in enumerate(terms) if not term.group.effect]
    names = [k for k, term in enumerate(terms) if term.group.effect]
    formulas = np.zeros(problem.residual.shape)
    chosen: list[int] = []
    for k in sorted(closed, key=lambda k: -float(np.sum((closed[k].effect / problem.floor) ** 2))):
        beside = [i for i in curves if i != k]
        held, _ = _fitted(white, [terms[i] for i in beside], told + formulas + closed[k].effect)
        moved, _ = _fitted(white, [terms[i] for i in (*names, *beside)], formulas + closed[k].effect)
        if 0.5 * (held - moved) <= LAW_FORMULAS.margin:
            chosen.append(k)
            curves, formulas = beside, formulas + closed[k].effect
    _, found = _fitted(white, [terms[i] for i in curves], told + formulas)
    starts = len(problem.free) + np.cumsum([0, *(terms[k].group.size for k in curves)])
    return frozenset(chosen), {k: found[i:j] for k, i, j in zip(curves, starts[:-1], starts[1:], strict=True)}


def _fitted(white: Whitened, terms: list[LawTerm], told: Array) -> tuple[float, Array]:
    """Misfit, that of the priors included, and coefficients (K,) of all that is free and of the terms beside what is
    told (C, n)."""
    columns, prior = white.columns(terms)
    flat = flattened(columns)
    target = (white.residual - white.whitener.white(told[None])[0]).reshape(-1)
    mean = inverse_of(flat @ flat.T, prior) @ (flat @ target)
    return float(np.sum((target - mean @ flat) ** 2) + np.sum(prior * mean**2)), mean

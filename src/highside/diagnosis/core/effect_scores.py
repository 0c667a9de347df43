"""Score and Fisher information of the testable effects and laws of a recording, beside the base: what many add up.

An effect far too small for one recording leaves its first-order estimate in it all the same. With unit noise, columns
`X` (K, N) per unit of each amplitude, outside of the space of the base, and the residual `r` (N,), the score is `X r`
and the information `X X'`; the estimate of some amplitudes alone is their block of the information, inverted, times
their score. Sums over recordings are the score and the information of all of them together (Cox and Hinkley,
Theoretical Statistics, 4.8).

An effect is taken with all of its amplitudes. Of shapes that are whole numbers (harmonic orders) each is an entry of
its own; of a time constant the middle one of those tried stands for all, as their columns are nearly the same. What
begins at a time of its own, or is a line of a spectrum, is nothing that recordings have in common, and is left out.
Laws are those of `pooled_laws`, which are functions of the same quantities in every recording.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import CandidateSet, Term
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.regression import outside
from highside.diagnosis.core.selection import Selector
from highside.physics.effect import Effect

__all__ = ["EffectScores", "WhiteLaw", "effect_scores", "entry_name"]


@dataclass(frozen=True)
class EffectScores:
    """Score and information of K amplitudes of E entries, an entry being an effect at one of its shapes."""

    entries: tuple[str, ...]
    """(E,) `effect`, or `effect[order=2]`"""
    entry_of: tuple[int, ...]
    """(K,) the entry of each amplitude"""
    parameters: tuple[str, ...]
    """(K,) names of the amplitudes"""
    units: tuple[str, ...]
    """(K,)"""
    score: Array
    """(K,) per unit of the amplitude"""
    information: Array
    """(K, K) per unit of the amplitudes"""
    freedom: float
    """degrees of freedom by which the noise is known that both are in units of"""


@dataclass(frozen=True)
class WhiteLaw:
    """A law that is the same in every recording (`pooled_laws`), its columns (k, N) in units of the noise."""

    name: str
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    columns: Array


def entry_name(effect: str, shape: Mapping[str, float]) -> str:
    """`effect`, or `effect[order=2]` where it stands at one of several shapes."""
    if not shape:
        return effect
    return f"{effect}[{', '.join(f'{name}={value:g}' for name, value in sorted(shape.items()))}]"


def effect_scores(selector: Selector, laws: Sequence[WhiteLaw] = ()) -> EffectScores:
    """Score and information of every testable effect and of `laws`, in the noise of the selector's columns."""
    candidate_set = selector.candidate_set
    residual = outside(selector.base, selector.residual)
    entries: list[str] = []
    entry_of: list[int] = []
    parameters: list[str] = []
    units: list[str] = []
    blocks = []
    for k, candidate in enumerate(candidate_set.candidates):
        effect = candidate.effect
        if effect is None or any(p.epoch or p.line_over for p in effect.shapes):
            continue
        for term, name in _at_shapes(candidate_set, k, candidate, effect):
            columns = candidate_set.columns(term)
            bare = outside(selector.base, columns)
            if len(columns) != len(candidate.amplitudes) or not _visible(columns, bare):
                continue
            amplitudes = [p for p in effect.parameters if not p.shape]
            entry_of += [len(entries)] * len(columns)
            entries.append(name)
            parameters += [p.name for p in amplitudes]
            units += [p.unit for p in amplitudes]
            blocks.append(bare)
    for law in laws:
        bare = outside(selector.base, law.columns)
        if _visible(law.columns, bare):
            entry_of += [len(entries)] * len(bare)
            entries.append(law.name)
            parameters += law.parameters
            units += law.units
            blocks.append(bare)
    stacked = np.concatenate(blocks) if blocks else np.empty((0, residual.size))
    return EffectScores(
        tuple(entries),
        tuple(entry_of),
        tuple(parameters),
        tuple(units),
        stacked @ residual,
        stacked @ stacked.T,
        float(selector.freedom),
    )


def _visible(columns: Array, bare: Array) -> bool:
    """Whether anything of the columns lies outside of the base."""
    return bool(np.sum(bare**2) > REGRESSION.visible**2 * np.sum(columns**2))


def _at_shapes(candidate_set: CandidateSet, k: int, candidate: Candidate, effect: Effect) -> list[tuple[Term, str]]:
    """The terms of a candidate that stand for it, with the names of their entries."""
    orders = [p.name for p in effect.shapes if p.integer]
    of_order: dict[tuple[float, ...], list[int]] = {}
    for j, variant in enumerate(candidate.variants):
        if variant.whole:
            of_order.setdefault(tuple(variant.shape[name] for name in orders), []).append(j)
    return [
        (Term(k, same[len(same) // 2]), entry_name(candidate.id, dict(zip(orders, order, strict=True))))
        for order, same in of_order.items()
    ]

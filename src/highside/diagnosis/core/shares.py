"""Which claim matters how much: the share of each in what all explain, and the order in which they are reported."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.regression import outside
from highside.diagnosis.core.selection import Selector


def gain_of(selector: Selector, terms: Sequence[Term]) -> float:
    """Chi-square that terms explain beside the base."""
    left = outside(selector.space_with(terms), selector.residual)
    return float(selector.residual @ selector.residual - left @ left)


def shares_of(selector: Selector, terms: Sequence[Term]) -> Array:
    """(terms,) what each explains beside all others, as shares that add up to one."""
    total = gain_of(selector, terms)
    alone = np.array([total - gain_of(selector, [o for o in terms if o != m]) for m in terms])
    alone = np.maximum(alone, 0.0)
    return np.asarray(alone / max(float(alone.sum()), 1e-300))


def by_share(selector: Selector, terms: Sequence[Term]) -> list[Term]:
    """Terms by what they explain, the most first."""
    shares = shares_of(selector, terms)
    return [terms[int(k)] for k in np.argsort(-shares, kind="stable")]

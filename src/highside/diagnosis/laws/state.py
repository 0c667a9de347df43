"""A state of the search: laws, and the noise that was learnt beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.evidence import LawTerm
from highside.diagnosis.laws.noise import LawNoise
from highside.diagnosis.laws.policy import LAW_SEARCH


@dataclass
class State:
    """Laws and noise with their log evidence, of a `residual` (C, n) whose far values are clipped."""

    terms: list[LawTerm]
    noise: LawNoise
    evidence: float
    residual: Array

    @property
    def worth(self) -> float:
        """Its evidence less what each law must be worth: of sets that explain as much the one of fewer laws stays."""
        return worth(self.evidence, self.terms)

    @property
    def less_tries(self) -> float:
        """What it is worth less the logarithm of how many like its laws are tried: onsets are many."""
        return self.worth - sum(float(np.log(t.group.tries)) for t in self.terms)


def worth(evidence: float, terms: Sequence[LawTerm]) -> float:
    """Evidence of terms less what each of them must be worth."""
    return evidence - LAW_SEARCH.each * len(terms)


def names_alone(terms: Sequence[LawTerm]) -> set[str]:
    """The effects of the library that terms are, at whatever shape; none where a law is among them."""
    return {t.group.effect for t in terms} if all(t.group.effect for t in terms) else set()


def which(terms: list[LawTerm]) -> set[int]:
    """The groups of terms."""
    return {id(t.group) for t in terms}

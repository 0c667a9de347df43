"""What a search found: the laws of a session and the noise beside them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.classes import Class
from highside.diagnosis.laws.evidence import LawTerm, Whitened
from highside.diagnosis.laws.families import Families
from highside.diagnosis.laws.groups import LawGroup
from highside.diagnosis.laws.learning import NoiseLearner
from highside.diagnosis.laws.noise import LawNoise, Whitener
from highside.diagnosis.laws.policy import LAW_SEARCH, LAW_VERDICT
from highside.diagnosis.laws.problem import LawProblem


@dataclass(frozen=True)
class Found:
    """The laws of a session and the noise beside them."""

    problem: LawProblem
    terms: tuple[LawTerm, ...]
    noise: LawNoise
    evidence: float
    """restricted, with the noise learnt"""
    gains: tuple[float, ...]
    """of each term: nats that its removal costs with the noise learnt again"""
    classes: tuple[Class, ...]
    """of each term what `class_of` tells"""
    residual: Array
    """(C, n) with values far from the fit clipped"""
    families: Families

    @cached_property
    def next_gain(self) -> float:
        """Nats that the best further group would gain, the noise as it is; -inf where that is less than a law may gain
        beside a name."""
        gains, _ = self.whitened().scores(list(self.terms), least=LAW_VERDICT.beside, within=LAW_SEARCH.simpler)
        return float(np.max(gains, initial=-np.inf))

    @cached_property
    def without_memory(self) -> float:
        """Evidence of the terms beside the best noise that is not correlated from value to value."""
        return self.learner.without_memory(self.terms, self.residual)

    @cached_property
    def to_the_floor(self) -> float:
        """The same beside the floor and errors of the set angles alone."""
        return self.learner.without_memory(self.terms, self.residual, to_the_floor=True)

    @cached_property
    def learner(self) -> NoiseLearner:
        """Of the noise beside some of the terms."""
        return NoiseLearner(self.problem)

    def gain_of(self, which: Collection[int]) -> float:
        """Nats that the removal of these terms together costs with the noise learnt again."""
        others = [t for k, t in enumerate(self.terms) if k not in which]
        tries = sum(float(np.log(self.terms[k].group.tries)) for k in which)
        return self.evidence - self.learner.learn(others, self.residual)[1] - tries

    def class_of(self, k: int) -> tuple[LawGroup, ...]:
        """The groups that this session cannot tell from a term, that first."""
        return self.classes[k]()

    def only(self, kept: Sequence[int]) -> Found:
        """These terms alone, with the noise learnt again."""
        terms = tuple(self.terms[k] for k in kept)
        noise, found = self.learner.learn(terms, self.residual)
        classes = tuple(self.classes[k] for k in kept)
        one = replace(self, terms=terms, noise=noise, evidence=found, classes=classes, gains=(0.0,) * len(kept))
        return replace(one, gains=tuple(one.gain_of([k]) for k in range(len(kept))))

    def whitened(self) -> Whitened:
        """Everything under the noise that was learnt."""
        return Whitened(self.families, Whitener(self.problem, self.noise), self.residual)

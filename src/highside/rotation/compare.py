"""How well a method did: what it leaves of the errors it was fitted to, and of turns it did not use.

What is left of the fitted rows hides the difference between methods, because noise is most of it: where the truth is
known score against the truth, else look at the held-out error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from highside.errors import Refused
from highside.rotation.curve import CurveMethod, ErrorCurve
from highside.rotation.fit import DEFAULTS, FitOptions, fit
from highside.rotation.samples import Samples

METHODS = (CurveMethod.SINE, CurveMethod.HARMONICS2, CurveMethod.POLYNOMIAL9, CurveMethod.NETWORK, CurveMethod.AUTO)


@dataclass(frozen=True, slots=True)
class CurveScore:
    """What a curve leaves of the rows it was fitted to, in the unit of the errors."""

    curve: ErrorCurve
    mean: float
    std: float
    mean_abs: float
    largest: float


@dataclass(frozen=True, slots=True)
class CurveComparison:
    """One channel: a score a method, and why methods were refused."""

    scores: dict[CurveMethod, CurveScore]
    refused: dict[CurveMethod, str]

    def better_than_sine(self, method: CurveMethod) -> float | None:
        """By which share the mean absolute error is less than that of method 1; None without method 1."""
        first = self.scores.get(CurveMethod.SINE)
        if first is None or first.mean_abs == 0.0 or method not in self.scores:
            return None
        return 1.0 - self.scores[method].mean_abs / first.mean_abs


def score(curve: ErrorCurve, samples: Samples) -> CurveScore:
    """What the curve leaves of the samples."""
    left = samples.error - curve(samples.theta_rad, samples.rate_radps)
    size = np.abs(left)
    return CurveScore(curve, float(left.mean()), float(left.std()), float(size.mean()), float(size.max()))


def compare(
    samples: Samples, methods: Sequence[CurveMethod] = METHODS, options: FitOptions = DEFAULTS, *, held_out: bool = True
) -> CurveComparison:
    """All methods on the same samples. Rate terms are given to the methods that have them."""
    scores: dict[CurveMethod, CurveScore] = {}
    refused: dict[CurveMethod, str] = {}
    for method in methods:
        terms = options.rate_terms if method in (CurveMethod.POLYNOMIAL9, CurveMethod.AUTO) else 0
        own = FitOptions(terms, options.network_input, options.seed)
        try:
            scores[method] = score(fit(samples, method, own, held_out=held_out), samples)
        except Refused as error:
            refused[method] = str(error)
    return CurveComparison(scores, refused)

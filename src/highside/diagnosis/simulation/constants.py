"""Which constant of the simulation a claim may be: a factor that is the same on all channels of a kind.

Scale factors of sensors differ from axis to axis. One that is common to all accelerations is the value of g, or the
unit, that the simulation converts by; one that is common to all rates its unit or the frequency of its rows. A clock
that runs fast is told by `clock_skew` itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.simulation.policy import CONSTANTS

WORDS = {
    "scale": "all accelerations {factor} the prediction: the simulation's value of g, or its unit, may be off",
    "gyro_scale": "all rates {factor} the prediction: the simulation's unit of rates, or its time step, may be off",
}
"""What one factor on all channels of a kind may be, by the effect that it is named as"""


def with_constants(diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis with a hint for each claim that may be a constant of the simulation."""
    hints = tuple(words for claim in diagnosis.claims if (words := constant_of(claim)))
    if not hints:
        return diagnosis
    remainder = replace(diagnosis.remainder, hints=(*hints, *diagnosis.remainder.hints))
    return replace(diagnosis, remainder=remainder)


def constant_of(claim: Claim) -> str:
    """What constant a claim of scale factors may be, in words; empty where the factors differ."""
    words = WORDS.get(claim.effect)
    sizes = np.array([p.value for p in claim.parameters.values()])
    errors = np.array([p.std for p in claim.parameters.values()])
    if words is None or sizes.size < CONSTANTS.least_channels or np.any(errors <= 0.0):
        return ""
    weights = errors**-2
    mean = float(weights @ sizes / weights.sum())
    # beyond its errors a factor may differ by what the motion makes of other small effects
    spread = np.sqrt(errors**2 + (CONSTANTS.alike * mean) ** 2)
    differs = float(chdtrc(sizes.size - 1, float(np.sum(((sizes - mean) / spread) ** 2))))
    sure = abs(mean) * float(np.sqrt(weights.sum())) > CONSTANTS.sure
    if not sure or differs < CONSTANTS.chance:
        return ""
    return words.format(factor=f"are {1 + mean:.5g} times")

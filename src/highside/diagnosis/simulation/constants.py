"""Which constant of the simulation a claim may be: a factor that is the same on all channels of a kind.

Scale factors of sensors differ from axis to axis. One that is common to all accelerations is the value of g, or the
unit, that the simulation converts by; one that is common to all rates its unit or the frequency of its rows. A clock
that runs fast is told by `clock_skew` itself. Where the rates are off in the same proportion it is the motion of the
simulation that runs fast or slow, and no clock: a time that is wrong leaves rates as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.simulation.policy import CONSTANTS
from highside.diagnosis.simulation.session import SKEW
from highside.physics.effects.gyro_scale import EFFECT as GYRO_SCALE
from highside.special import chdtrc

WORDS = {
    "scale": "all accelerations {factor} the prediction: the simulation's value of g, or its unit, may be off",
    "gyro_scale": "all rates {factor} the prediction: the simulation's unit of rates, or its time step, may be off",
}
"""What one factor on all channels of a kind may be, by the effect that it is named as"""
MOTION = (
    "the motion of the prediction and its rates are {ratio:.6g} times as fast as the recorded ones: its frequency is "
    "off and no clock; where a spring or gravity sets it, a stiffness is {stiffness:.6g} times the real one, or a "
    "length {length:.6g} times"
)


def with_constants(diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis with a hint for each claim that may be a constant of the simulation."""
    motion = motion_of(diagnosis.claims)
    others = [constant_of(claim) for claim in diagnosis.claims if not (motion and claim.effect == GYRO_SCALE.id)]
    hints = tuple(words for words in (motion, *others) if words)
    if not hints:
        return diagnosis
    remainder = replace(diagnosis.remainder, hints=(*hints, *diagnosis.remainder.hints))
    return replace(diagnosis, remainder=remainder)


def motion_of(claims: Sequence[Claim]) -> str:
    """What runs fast or slow, in words, where the rates are off by as much as the clock; empty where they are not."""
    by_name = {claim.effect: claim for claim in claims}
    if not {SKEW, GYRO_SCALE.id} <= by_name.keys():
        return ""
    rate, factor = by_name[SKEW].parameters["eps"], common_factor(by_name[GYRO_SCALE.id])
    if factor is None:
        return ""
    # what is recorded at a time is predicted earlier, in proportion, and by as much slower
    mean, error = factor
    if abs(mean + rate.value) > CONSTANTS.sure * float(np.hypot(error, rate.std)) + CONSTANTS.alike * abs(rate.value):
        return ""
    ratio = 1.0 / (1.0 - rate.value)
    return MOTION.format(ratio=ratio, stiffness=ratio**2, length=ratio**-2)


def constant_of(claim: Claim) -> str:
    """What constant a claim of scale factors may be, in words; empty where the factors differ."""
    words, factor = WORDS.get(claim.effect), common_factor(claim)
    return "" if words is None or factor is None else words.format(factor=f"are {1 + factor[0]:.5g} times")


def common_factor(claim: Claim) -> tuple[float, float] | None:
    """By how much all channels of a claim of scale factors differ from 1, and its standard error; None where they do
    not differ by the same."""
    sizes = np.array([p.value for p in claim.parameters.values()])
    errors = np.array([p.std for p in claim.parameters.values()])
    if sizes.size < CONSTANTS.least_channels or np.any(errors <= 0.0):
        return None
    weights = errors**-2
    mean = float(weights @ sizes / weights.sum())
    # beyond its errors a factor may differ by what the motion makes of other small effects
    spread = np.sqrt(errors**2 + (CONSTANTS.alike * mean) ** 2)
    differs = float(chdtrc(sizes.size - 1, float(np.sum(((sizes - mean) / spread) ** 2))))
    sure = abs(mean) * float(np.sqrt(weights.sum())) > CONSTANTS.sure
    return (mean, float(weights.sum() ** -0.5)) if sure and differs >= CONSTANTS.chance else None

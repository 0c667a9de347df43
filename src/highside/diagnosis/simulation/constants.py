"""Which constant of the simulation a claim may be: a factor that is the same on all channels of a kind.

Scale factors of sensors differ from axis to axis. One that is common to all accelerations is the value of g, or the
unit, that the simulation converts by; one that is common to all rates its unit or the frequency of its rows. A clock
that runs fast is told by `clock_skew` itself. Where the rates are off in the same proportion it is the motion of the
simulation that runs fast or slow, and no clock: a time that is wrong leaves rates as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.problem import ReportData
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter
from highside.diagnosis.simulation.policy import CONSTANTS
from highside.diagnosis.simulation.session import SKEW, SimulationSession
from highside.physics.effect import REFERENCE_TEMP_C, Effect
from highside.physics.effects.gyro_scale import EFFECT as GYRO_SCALE
from highside.physics.effects.misalignment import EFFECT as MISALIGNMENT
from highside.physics.effects.motion_rate import EFFECT as MOTION_RATE
from highside.physics.effects.scale import EFFECT as SCALE
from highside.physics.effects.temperature_misalignment import EFFECT as TEMPERATURE_MISALIGNMENT
from highside.physics.effects.temperature_scale import EFFECT as TEMPERATURE_SCALE
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


AT_25_C = ((TEMPERATURE_SCALE, SCALE), (TEMPERATURE_MISALIGNMENT, MISALIGNMENT))
"""Effects of temperature whose formulas vanish at 25 C, and the constant that each has elsewhere"""


def with_constants(diagnosis: DiagnosisResult) -> DiagnosisResult:
    """The diagnosis with a hint for each claim that may be a constant of the simulation."""
    motion = motion_of(diagnosis.claims)
    others = [constant_of(claim) for claim in diagnosis.claims if not (motion and claim.effect == GYRO_SCALE.id)]
    hints = tuple(words for words in (motion, *others) if words)
    if not hints:
        return diagnosis
    remainder = replace(diagnosis.remainder, hints=(*hints, *diagnosis.remainder.hints))
    return replace(diagnosis, remainder=remainder)


def with_one_for_two(
    diagnosis: DiagnosisResult, report: ReportData, session: SimulationSession
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with one claim where two are of one cause: a clock and rates that are off in the same proportion
    are the motion; and what follows the temperature about its mean beside a constant that makes it vanish at
    25 C needs none."""
    if motion_of(diagnosis.claims):
        diagnosis, report = _joined(diagnosis, report, SKEW, GYRO_SCALE.id, MOTION_RATE)
    from_reference_c = float(session.state.temp_c.mean()) - REFERENCE_TEMP_C
    for warm, constant in AT_25_C:
        if _vanishes(diagnosis.claims, warm.id, constant.id, from_reference_c):
            diagnosis, report = _joined(diagnosis, report, warm.id, constant.id, warm)
    return diagnosis, report


def _vanishes(claims: Sequence[Claim], warm: str, constant: str, from_reference_c: float) -> bool:
    """Whether each of the constants of a claim is what an effect of temperature has at its mean, if it is nothing at
    the reference."""
    by_name = {claim.effect: claim for claim in claims}
    if not {warm, constant} <= by_name.keys():
        return False
    slopes, sizes = (list(by_name[name].parameters.items()) for name in (warm, constant))
    if [name.partition("_")[2] for name, _ in slopes] != [name.partition("_")[2] for name, _ in sizes]:
        return False
    return all(
        abs(size.value - slope.value * from_reference_c)
        <= CONSTANTS.sure * float(np.hypot(size.std, slope.std * from_reference_c)) + CONSTANTS.alike * abs(size.value)
        for (_, slope), (_, size) in zip(slopes, sizes, strict=True)
    )


def _joined(
    diagnosis: DiagnosisResult, report: ReportData, first: str, second: str, effect: Effect
) -> tuple[DiagnosisResult, ReportData]:
    """The diagnosis with one claim, of an effect, in the place of two; its size is that of the first."""
    one, other = (next(claim for claim in diagnosis.claims if claim.effect == name) for name in (first, second))
    joined = replace(
        one,
        effect=effect.id,
        story=effect.channel_story or effect.story,
        formula=effect.formula,
        stage=effect.stage.value,
        p_familywise=min(one.p_familywise, other.p_familywise),
        equivalence_class=one.equivalence_class if effect.id == first else (effect.id,),
        rivals_ruled_out=tuple(rival for rival in one.rivals_ruled_out if rival.effect != second),
        next_manoeuvre=effect.splitter,
        share=_sum(one.share, other.share),
        heldout_gain=_sum(one.heldout_gain, other.heldout_gain),
        stable=None if one.stable is None or other.stable is None else one.stable and other.stable,
    )
    claims = tuple(joined if claim is one else claim for claim in diagnosis.claims if claim is not other)
    own = [report.parts[name] for name in (first, second) if name in report.parts]
    parts = {name: part for name, part in report.parts.items() if name not in (first, second)}
    if own:
        parts[effect.id] = np.sum(own, axis=0)
    resembles = tuple(name for name in diagnosis.remainder.resembles if name not in (first, second))
    remainder = replace(diagnosis.remainder, resembles=resembles)
    return replace(diagnosis, claims=claims, remainder=remainder), replace(report, parts=parts)


def _sum(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one + other


def motion_of(claims: Sequence[Claim]) -> str:
    """What runs fast or slow, in words, where the rates are off by as much as the clock; empty where they are not."""
    by_name = {claim.effect: claim for claim in claims}
    if not {SKEW, GYRO_SCALE.id} <= by_name.keys():
        return ""
    rate = by_name[SKEW].parameters["eps"]
    if not is_one_motion(rate, by_name[GYRO_SCALE.id].parameters):
        return ""
    ratio = 1.0 / (1.0 - rate.value)
    return MOTION.format(ratio=ratio, stiffness=ratio**2, length=ratio**-2)


def is_one_motion(rate: FittedParameter, factors: Mapping[str, FittedParameter]) -> bool:
    """Whether rates are off by as much as a clock."""
    factor = common_factor(factors)
    if factor is None:
        return False
    # what is recorded at a time is predicted earlier, in proportion, and by as much slower
    mean, error = factor
    apart = CONSTANTS.sure * float(np.hypot(error, rate.std)) + CONSTANTS.alike * abs(rate.value)
    return abs(mean + rate.value) <= apart


def constant_of(claim: Claim) -> str:
    """What constant a claim of scale factors may be, in words; empty where the factors differ."""
    words, factor = WORDS.get(claim.effect), common_factor(claim.parameters)
    return "" if words is None or factor is None else words.format(factor=f"are {1 + factor[0]:.5g} times")


def common_factor(factors: Mapping[str, FittedParameter]) -> tuple[float, float] | None:
    """By how much the scale factors of all channels differ from 1, and its standard error; None where they do not
    differ by the same."""
    sizes = np.array([p.value for p in factors.values()])
    errors = np.array([p.std for p in factors.values()])
    if sizes.size < CONSTANTS.least_channels or np.any(errors <= 0.0):
        return None
    weights = errors**-2
    mean = float(weights @ sizes / weights.sum())
    # beyond its errors a factor may differ by what the motion makes of other small effects
    spread = np.sqrt(errors**2 + (CONSTANTS.alike * mean) ** 2)
    differs = float(chdtrc(sizes.size - 1, float(np.sum(((sizes - mean) / spread) ** 2))))
    sure = abs(mean) * float(np.sqrt(weights.sum())) > CONSTANTS.sure
    return (mean, float(weights.sum() ** -0.5)) if sure and differs >= CONSTANTS.chance else None

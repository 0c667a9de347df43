"""Sampling jitter: an effect that moves no mean, found by the scatter.

Rows that are sampled at random early or late scatter across the gravity vector in proportion to the rate. The noise
model has tried that on each channel; where the evidence is beyond doubt it is a claim, with one size for all channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter, Location
from highside.diagnosis.rows.noise import RotationNoise
from highside.diagnosis.rows.policy import JITTER
from highside.physics.effects.sampling_jitter import EFFECT
from highside.special import chdtrc

CLAIMING = ("nothing_left_out", "named", "named_plus")


def with_jitter(diagnosis: DiagnosisResult, noise: RotationNoise, channels: Sequence[str]) -> DiagnosisResult:
    """The diagnosis with sampling jitter among its claims, or in what remains where no names are given."""
    gain, size, error = noise.jitter.T
    found = np.flatnonzero(gain > 0)
    evidence = float(gain.sum())
    if evidence < JITTER.certain:
        return diagnosis
    if diagnosis.verdict not in CLAIMING:
        remainder = replace(diagnosis.remainder, resembles=(*diagnosis.remainder.resembles, EFFECT.id))
        return replace(diagnosis, remainder=remainder)
    weight = 1 / np.maximum(error[found], 1e-12) ** 2
    value, std = float(np.sum(weight * size[found]) / weight.sum()), float(weight.sum() ** -0.5)
    p = max(float(chdtrc(found.size, evidence)), 1e-300)
    size_s = FittedParameter(value, std, value - INTERVALS.normal * std, value + INTERVALS.normal * std, "s")
    claim = Claim(
        effect=EFFECT.id,
        story=EFFECT.story,
        formula=EFFECT.formula,
        stage=EFFECT.stage.value,
        parameters={EFFECT.parameters[0].name: size_s},
        p_familywise=p,
        equivalence_class=(EFFECT.id,),
        rivals_ruled_out=(),
        next_manoeuvre="none needed: noise that follows vibration was tried and does not explain the scatter",
    )
    where = Location(tuple(channels[int(c)] for c in found), "rotor_rate_dps", (), None, 1.0, p)
    return replace(
        diagnosis,
        verdict="named_plus" if diagnosis.verdict == "named_plus" else "named",
        claims=(*diagnosis.claims, claim),
        location=(*diagnosis.location, where),
    )

"""Recordings of a bench of which nobody said where it stands: the Earth's rotation has no known direction in the gyros.

It is 15 degrees an hour all the same. At one inclination gyros that feel gravity look like it, so that they get no name
alone, unless they feel more than the Earth turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import AnyArray
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.rotation.policy import UNKNOWN_SITE
from highside.long_arrays import is_long
from highside.physics.effects.earth_rotation import EFFECT as EARTH
from highside.physics.effects.gyro_g_sensitivity import EFFECT as ALIKE
from highside.physics.gravity import EARTH_RATE_RADPS

__all__ = ["without_site"]

SPLITTER = "say where the bench stands ([site] latitude_deg, azimuth_deg in the model)"


def without_site(diagnosis: DiagnosisResult, inc_deg: AnyArray) -> DiagnosisResult:
    """The diagnosis with the Earth's rotation beside what looks like it; `inc_deg` (N,): the inclinations of it."""
    # of a recording that is never held in the memory nothing is ruled out
    most = 0.0 if is_long(inc_deg) else float(np.max(np.abs(np.sin(np.radians(inc_deg)))))
    claims = tuple(_beside_earth(claim) if _could_be_earth(claim, most) else claim for claim in diagnosis.claims)
    return replace(diagnosis, claims=claims)


def _could_be_earth(claim: Claim, across_g: float) -> bool:
    """Whether it is no larger than what the Earth's rotation can be; `across_g`: the largest load across the axis."""
    if claim.effect != ALIKE.id:
        return False
    seen = [one for one in claim.parameters.values() if one.std < UNKNOWN_SITE.seen]
    return all((abs(one.value) - UNKNOWN_SITE.sigmas * one.std) * across_g <= EARTH_RATE_RADPS for one in seen)


def _beside_earth(claim: Claim) -> Claim:
    return replace(claim, equivalence_class=(*claim.equivalence_class, EARTH.id), next_manoeuvre=SPLITTER)

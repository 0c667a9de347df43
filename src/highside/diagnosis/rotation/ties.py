"""At one inclination every function of the load is a function of the toolface: a tie that no evidence breaks.

A sensor's nonlinearity (k f_x f_y, k f_x^2, k f_x^3, k |f_x|) reads there as an error of order 1 to 3 of the turn on
the same axis: f_x and f_y are sin I times a cosine and a sine of the toolface, f_z is a constant. A pick-up or a
contact that turns along is such an error. So both are told, with the manoeuvre that distinguishes them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.diagnosis.core.policy import UNTESTABLE
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.physics.effect import Stage
from highside.physics.effects import all_effects
from highside.physics.law import PREFIX
from highside.physics.state import ChainState

ACCELEROMETERS = {"ax": "x", "ay": "y", "az": "z"}


def with_ties(diagnosis: DiagnosisResult, state: ChainState) -> DiagnosisResult:
    """The diagnosis with laws of the toolface in the class of each claim that follows the load alone."""
    if np.ptp(state.inc_rad) >= UNTESTABLE.one_inclination_rad:
        return diagnosis
    return replace(diagnosis, claims=tuple(_tied(claim, state) for claim in diagnosis.claims))


def _tied(claim: Claim, state: ChainState) -> Claim:
    effect = all_effects().get(claim.effect)
    axes = [ACCELEROMETERS[channel] for channel in claim.channels if channel in ACCELEROMETERS]
    if effect is None or effect.stage is not Stage.SENSOR or effect.needs or effect.random or not axes:
        return claim
    laws = tuple(f"{PREFIX}offset_{axis}_tf" for axis in axes)
    known = claim.next_manoeuvre
    here = f"at {np.degrees(float(np.mean(state.inc_rad))):.0f} deg of inclination alone"
    words = (
        f"{here} a function of the load is a function of the toolface: turn at another inclination too, where an error "
        "of the turn itself keeps its size and this effect does not"
    )
    return replace(
        claim,
        equivalence_class=(*claim.equivalence_class, *(law for law in laws if law not in claim.equivalence_class)),
        next_manoeuvre=words if known.startswith("none needed") else f"{known}; {words}",
    )

"""What to do so that a recording shows what this one cannot, in plain words: an effect, or which of two it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.diagnosis.core.policy import UNTESTABLE
from highside.diagnosis.core.result import DiagnosisResult, NotTestable
from highside.physics.effect import Effect, Stage
from highside.physics.effects import all_effects
from highside.physics.state import ChainState


def one_sided(effect: Effect, state: ChainState) -> bool:
    """Whether an effect of the side of approach is a constant here, because there is one side only."""
    return "direction" in effect.needs and float(np.ptp(state.direction)) == 0.0


def what_splits(effect: Effect, rivals: Sequence[Effect]) -> str:
    """What tells an effect from its rivals: as the library has it with the rival, else with the effect, of those pairs
    of which one knows the other."""
    known = [
        e if effect.id in e.confused_with else effect
        for e in rivals
        if e.id in effect.confused_with or effect.id in e.confused_with
    ]
    return "; ".join(dict.fromkeys(e.splitter for e in known)) or effect.splitter


def with_manoeuvres(diagnosis: DiagnosisResult, state: ChainState) -> DiagnosisResult:
    """The diagnosis with what each effect that cannot be shown needs, given for the design at hand."""
    entries = tuple(_needing(entry, state) for entry in diagnosis.not_testable)
    return replace(diagnosis, not_testable=entries)


def _needing(entry: NotTestable, state: ChainState) -> NotTestable:
    effect = all_effects()[entry.effect]
    lacks = []
    turns = bool(np.any(state.rotor_rate_radps))
    if effect.known_size and np.isnan(state.latitude_rad):
        lacks.append("say where the bench stands ([site] latitude_deg, azimuth_deg in the model)")
    if one_sided(effect, state):
        lacks.append("turn in both senses" if turns else "approach the same poses from both sides")
    if "rotor_rate_radps" in effect.needs and not turns:
        lacks.append("record while the tool rotates, at several rates")
    elif "rotor_rate_radps" in effect.needs and np.ptp(state.rotor_rate_radps) == 0.0:
        lacks.append("turn at three rates at least, in both senses")
    if "temp_c" in effect.needs and np.ptp(state.temp_c) == 0.0:
        lacks.append("record the temperature, and change it up and down")
    if "vibration_rms_g" in effect.needs and np.ptp(state.vibration_rms_g) == 0.0:
        lacks.append("record the vibration at rest and while the tool is shaken")
    if "vibration_x_rms_g" in effect.needs and np.ptp(state.vibration_x_rms_g) == 0.0:
        lacks.append("record the vibration of each axis (vibration_x_rms_g and so on), at rest and shaken along each")
    if "since_move_s" in effect.needs and np.ptp(state.since_move_s) == 0.0:
        lacks.append("hold some poses briefly and others long, and record every row of them")
    if not lacks and effect.stage in (Stage.POSE, Stage.GRAVITY, Stage.MOUNTING, Stage.SENSOR):
        first = float(np.degrees(state.inc_rad[0]))
        if np.ptp(state.inc_rad) < UNTESTABLE.one_inclination_rad:
            lacks.append(f"measure at other inclinations than {first:g} deg as well")
    if effect.stage is Stage.GYRO:
        lacks.append("record the gyros too, while the tool rotates")
    # the library may say it already
    lacks = [words for words in lacks if not entry.needs.startswith(words)]
    return replace(entry, needs="; ".join([*lacks, entry.needs]))

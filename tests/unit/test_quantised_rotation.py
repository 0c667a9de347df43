"""Readings of a coarse converter in rotation: rounding is a function of the reading, and no missing effect."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.engine import diagnose_rotation
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.diagnosis.rows.session import RotationSession
from highside.physics.forward import ForwardModel
from highside.physics.plan import Profile, RotationPlan, Session, Site
from studies.scenario import random_sensor

FREE = ("bias", "scale", "misalignment")
STEP_G = 1.0 / 2048
"""of twelve bits over -1 to 1 g"""


def diagnosed(
    step_g: float, seed: int, effects: dict[str, dict[str, float]] | None = None, hold_s: float = 15.0
) -> DiagnosisResult:
    rates = tuple(2 * np.pi * np.array([-1.0, -0.4, 0.3, 0.8]))
    state = Session(RotationPlan(50.0, rates, hold_s, 1.0, 50.0), Site(), Profile((25.0, 27.0))).rows().state
    rng = np.random.default_rng(seed)
    sensor = random_sensor(rng).with_effects(effects or {})
    readings = sensor.predict(state) + 3e-5 * rng.standard_normal((3, state.n))
    readings = np.round(readings / step_g) * step_g if step_g else readings
    method = ProcedureParts.without("laws")
    return diagnose_rotation(RotationSession(readings, state), ForwardModel.of({}), FREE, method=method)[0]


@pytest.mark.parametrize("seed", [1, 2])
def test_rounding_is_not_a_missing_effect(seed: int) -> None:
    found = diagnosed(STEP_G, seed)
    assert found.verdict == "nothing_left_out"
    assert found.claims == ()


def test_an_effect_of_many_steps_is_still_found() -> None:
    found = diagnosed(STEP_G, 1, {"lever_arm": {"r_x": 0.05, "r_y": -0.03}})
    assert found.verdict != "nothing_left_out"


def test_a_recording_longer_than_what_the_noise_is_learned_from_is_judged_by_all_of_its_rows() -> None:
    """The toolface was that of the windows, and the readings were all: a command that met both ended by an error."""
    hold_s = 1.1 * ROW_NOISE.max_rows / (4 * 50.0)
    found = diagnosed(STEP_G, 1, hold_s=hold_s)
    assert found.verdict == "nothing_left_out"
    assert found.claims == ()

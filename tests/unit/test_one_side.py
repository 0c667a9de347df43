"""Play of the gears where every pose is approached from one side: a constant that other effects do as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter
from highside.diagnosis.poses.problem import PoseProblem
from highside.diagnosis.poses.session import PoseSession
from highside.physics.effects import get
from highside.physics.forward import ForwardModel
from studies import diagnosis_deck as deck

STATE = deck.design()
ONE_SIDED = replace(STATE, direction=np.ones(STATE.n))


def members(
    effect: str, values: dict[str, float], state: deck.ChainState, *, sides_told: bool = True
) -> tuple[tuple[str, ...], str]:
    """The class of a claim of an effect of these sizes, and the advice beside it."""
    mean = ForwardModel.of({}).predict(state) + deck.white_noise(state, np.random.default_rng(3))
    problem = PoseProblem.of(
        PoseSession(mean, np.ones(state.n), state, sides_told=sides_told), ForwardModel.of({}), deck.FREE, 1
    )
    known = get(effect)
    parameters = {p.name: FittedParameter(values.get(p.name, 0.0), 0.0, 0.0, 0.0, p.unit) for p in known.parameters}
    claim = Claim(effect, known.story, known.formula, known.stage.value, parameters, 1e-9, (effect,), (), "none needed")
    found = problem.completed(DiagnosisResult("named", (), (claim,), None)).claims[0]
    return found.equivalence_class, found.next_manoeuvre


def test_a_lean_that_a_constant_play_does_as_well_is_told_as_a_class() -> None:
    alike, advice = members("base_tilt", {"tilt_x": 3e-3}, ONE_SIDED)
    assert alike == ("base_tilt", "backlash")
    assert advice.startswith("approach the same poses from both sides")


def test_a_lean_that_no_play_does_stays_alone() -> None:
    assert members("base_tilt", {"tilt_x": 3e-3, "tilt_y": 3e-3}, ONE_SIDED) == (("base_tilt",), "none needed")
    assert members("sag", {"s": 3e-3}, ONE_SIDED) == (("sag",), "none needed")


def test_from_both_sides_play_is_a_name_of_its_own() -> None:
    assert members("base_tilt", {"tilt_x": 3e-3}, STATE) == (("base_tilt",), "none needed")


def test_where_nobody_wrote_the_side_it_may_have_been_one() -> None:
    alike, advice = members("base_tilt", {"tilt_x": 3e-3}, STATE, sides_told=False)
    assert alike == ("base_tilt", "backlash")
    assert advice.startswith("approach the same poses from both sides")
    assert members("base_tilt", {"tilt_x": 3e-3, "tilt_y": 3e-3}, STATE, sides_told=False)[0] == ("base_tilt",)

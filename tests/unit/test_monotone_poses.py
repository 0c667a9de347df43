"""In poses a name holds at a thousand times the strength, or is refused as implausible."""

from __future__ import annotations

import numpy as np
import pytest

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck
from studies.pose_strengths import judged, monotone
from studies.scenario import random_sensor

STATE = deck.design()


@pytest.mark.parametrize(
    ("effect", "strength"),
    [("bias_step", 1e3), ("bias_step", 1e7), ("warmup", 1e3), ("warmup", 1e7), ("sag", 1e3), ("sag", 1e7)],
)
def test_a_name_does_not_vanish_with_the_size_of_the_effect(effect: str, strength: float) -> None:
    session, _ = deck.single(STATE, effect, strength, seed=11)
    method = ProcedureParts.without("laws")
    found, _ = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=method)
    if found.verdict == "implausible_fit":
        assert effect in found.remainder.resembles
    else:
        assert found.verdict in ("named", "named_plus")
        assert effect in {name for claim in found.claims for name in claim.equivalence_class}
        assert all(claim.stable for claim in found.claims)


def few_poses() -> ChainState:
    """52 poses, of which twelve are set from the other side, over a loop of the temperature."""
    forth = [(i, t, 1.0) for i in (5.0, 35.0, 65.0, 95.0, 130.0) for t in range(0, 360, 45)]
    back = [(i, t, -1.0) for i in (35.0, 95.0) for t in range(340, 0, -60)]
    inc, tf, direction = np.array(forth + back).T
    t_s = 60.0 * np.arange(inc.size)
    temp = 25 + 30 * np.interp(t_s / t_s[-1], [0, 0.25, 0.4, 0.5, 0.6, 1], [0, 0.6, 1, 0.8, 1, 0])
    return ChainState.build(
        np.radians(inc), np.radians(tf), t_s=t_s, direction=direction, temp_c=temp, row_seconds=60.0
    )


@pytest.mark.parametrize("effect", ["temperature_scale", "temperature_bias", "bias_drift", "backlash"])
def test_what_is_named_at_a_strength_is_named_at_ten_thousand_times_it(effect: str) -> None:
    """Or refused as implausible, with the name."""
    for strength, must in ((1e3, True), (1e5, True), (1e7, False)):
        session, _ = deck.single(few_poses(), effect, strength, seed=11)
        found, _ = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=ProcedureParts.without("laws"))
        if found.verdict == "implausible_fit":
            assert not must, strength
            assert effect in found.remainder.resembles
        else:
            assert found.verdict in ("named", "named_plus"), strength
            assert effect in {name for claim in found.claims for name in claim.equivalence_class}


def test_the_study_of_strengths_counts_a_name_that_becomes_a_random_walk_as_lost() -> None:
    assert monotone(["nothing", "named", "near", "placed"])
    assert not monotone(["nothing", "named", "near", "wander"])


def test_the_study_of_strengths_tells_a_random_walk_from_a_near_answer() -> None:
    rng = np.random.default_rng(11)
    steps = rng.standard_normal((3, STATE.n))
    readings = random_sensor(rng).predict(STATE) + 10 * deck.SIGMA_G * np.cumsum(steps, axis=1)
    session = PoseSession(readings, np.ones(STATE.n), STATE)
    found, _ = diagnose_poses(session, ForwardModel.of({}), deck.FREE, method=ProcedureParts.without("laws"))
    assert found.verdict == "wander"
    assert {judged(found, name) for name in ("warmup", "bias_drift", "temperature_bias")} == {"wander"}

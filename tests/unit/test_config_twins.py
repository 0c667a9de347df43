"""Tables of a file and the values made of them: what stands twice stands with the same names."""

from __future__ import annotations

from dataclasses import fields

import pytest

from highside.bench.session.plans import Criterion, Limits
from highside.config.bench import SessionTable, VerificationPlan
from highside.config.model_motion import LegsMotion
from highside.physics.motion import Leg
from highside.physics.plan import LegPlan


def test_the_session_table_has_every_limit_but_the_one_of_the_bench() -> None:
    assert set(SessionTable.model_fields) == {field.name for field in fields(Limits)} - {"pose_sigma_deg"}


def test_a_verification_in_the_file_states_what_the_criterion_keeps() -> None:
    kept = {field.name for field in fields(Criterion)} - {"limit_g_total_g"}
    assert kept <= set(VerificationPlan.model_fields)
    shared = {
        field.name: field.default for field in fields(Criterion) if field.name in ("tilt_sigma_deg", "same_bench")
    }
    assert {name: VerificationPlan.model_fields[name].default for name in shared} == shared


def test_legs_of_the_file_are_the_legs_of_the_plan() -> None:
    table = LegsMotion.model_validate({"kind": "legs", "legs": [{"duration_s": 4, "turn_deg": 90}]})
    plan = table.plan()
    assert isinstance(plan, LegPlan) and plan.legs == (Leg(4.0, turn_deg=90.0),)


@pytest.mark.parametrize("wrong", [{"duration_s": 0}, {"duration_s": 1, "trn_deg": 2}, {"turn_deg": 1}])
def test_a_leg_of_the_file_is_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"legs\.0"):
        LegsMotion.model_validate({"kind": "legs", "legs": [wrong]})

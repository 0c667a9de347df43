"""Simulated sessions: where the tool is led, and that rates are the derivatives of angles."""

from __future__ import annotations

import numpy as np
import pytest

from highside.errors import InputError
from highside.physics.motion import Leg
from highside.physics.plan import (
    LegPlan,
    Plan,
    Pose,
    PosePlan,
    Profile,
    RotationPlan,
    Session,
    Site,
    full_turns,
    station_poses,
)
from highside.physics.state import ChainState


def test_a_stepped_session_holds_each_pose_and_needs_time_to_reach_the_next() -> None:
    plan = PosePlan((Pose(5, 45), Pose(5, 135), Pose(90, 0, -1)), hold_s=3, row_s=1, move_s=20)
    state, held = plan.rows(Site())
    assert state.t_s.tolist() == [0, 1, 2, 23, 24, 25, 46, 47, 48]
    assert np.degrees(state.inc_rad).round(9).tolist() == [5] * 6 + [90] * 3
    assert state.pose.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert state.direction.tolist() == [1] * 6 + [-1] * 3
    assert held.all()


def test_rings_return_from_the_other_side_and_close_on_the_first_pose() -> None:
    poses = station_poses([10, -10], [0, 90], returns=True, closure_every=4)
    assert poses == (
        Pose(10, 0, 1),
        Pose(10, 90, 1),
        Pose(10, 90, -1),
        Pose(10, 0, -1),
        Pose(10, 0, 1),
        Pose(-10, 0, 1),
        Pose(-10, 90, 1),
        Pose(-10, 90, -1),
        Pose(-10, 0, -1),
        Pose(10, 0, 1),
    )


def test_a_full_turn_has_73_stations_of_five_degrees() -> None:
    poses = full_turns([45.0])
    assert len(poses) == 73
    assert [pose.toolface_deg for pose in poses[:3]] == [0, 5, 10]
    assert poses[-1].toolface_deg == 360


def test_plateaus_repeat_the_session_at_each_temperature_after_a_soak() -> None:
    plan = PosePlan((Pose(5, 0), Pose(45, 0)), hold_s=1, move_s=9, plateaus_c=(25.0, 150.0), soak_s=1000)
    state, _ = plan.rows(Site())
    assert state.temp_c.tolist() == [25, 25, 150, 150]
    assert state.t_s.tolist() == [0, 10, 1020, 1030]
    assert state.pose.tolist() == [0, 1, 2, 3]


ROTATION = RotationPlan(62, (-2.0, 1.0, 8.0), hold_s=5, ramp_s=2, sample_hz=200)
MOVES = PosePlan((Pose(5, 350), Pose(45, 20), Pose(45, 10, -1)), hold_s=4, row_s=0.01, move_s=6, record_moves=True)
LEGS = LegPlan((Leg(4.0), Leg(6.0, 30.0, 400.0, 0.02), Leg(3.0, turn_deg=-90.0)), sample_hz=200)


@pytest.mark.parametrize("plan", [ROTATION, MOVES, LEGS], ids=["rotation", "moves", "legs"])
def test_rates_are_the_derivatives_of_the_angles(plan: Plan) -> None:
    state, _ = plan.rows(Site())
    step = np.diff(state.t_s)
    assert np.ptp(step) < 1e-9
    for angle, rate, tolerance in (
        (state.tf_rad, state.rotor_rate_radps, 0.02),
        (state.inc_rad, state.inc_rate_radps, 0.02),
        (state.rotor_rate_radps, state.rotor_accel_radps2, 0.1),
    ):
        middle = (rate[1:] + rate[:-1]) / 2
        # a jump of the acceleration at the end of a ramp spoils single intervals
        assert np.median(np.abs(np.diff(angle) / step - middle)) < 1e-3
        close = np.abs(np.diff(angle) / step - middle) < tolerance * (1e-3 + np.max(np.abs(rate)))
        assert np.mean(close) > 0.99


def test_rotation_reaches_its_rates_and_the_angle_is_their_integral() -> None:
    state, held = ROTATION.rows(Site())
    assert not held.any()
    assert state.rotor_rate_radps[0] == -2
    assert state.rotor_rate_radps[np.searchsorted(state.t_s, 8.0)] == 1
    # 5 s at -2, 2 s from -2 to 1, 5 s at 1, 2 s from 1 to 8
    assert state.tf_rad[np.searchsorted(state.t_s, 14.0)] == pytest.approx(-10 - 1 + 5 + 9)
    assert state.direction[0] == -1
    assert state.direction[-1] == 1


def test_moves_go_round_in_the_sense_of_the_approach() -> None:
    state, held = MOVES.rows(Site())
    on_the_way = ~held
    assert np.all(state.rotor_rate_radps[held] == 0)
    assert np.all(state.rotor_rate_radps[on_the_way] * state.direction[on_the_way] >= 0)
    # from 350 up to 20 is 30 degrees, not 330 down
    assert np.ptp(np.degrees(state.tf_rad[on_the_way & (state.pose == 1)])) <= 30
    assert np.all(np.diff(state.t_s) > 0)


def test_vibration_and_temperature_follow_their_profiles() -> None:
    session = Session(ROTATION, Site(), Profile((25.0, 55.0, 25.0)), Profile((0.0, 1.0), (0.0, 10.0)))
    state, _ = session.rows()
    assert state.temp_c[[0, -1]] == pytest.approx([25, 25])
    assert state.temp_c.max() == pytest.approx(55, abs=0.01)
    assert state.vibration_rms_g[np.searchsorted(state.t_s, 5.0)] == pytest.approx(0.5)
    assert state.vibration_rms_g[-1] == 1.0


def test_each_rate_may_have_its_own_vibration() -> None:
    plan = RotationPlan(62, (1.0, 2.0), hold_s=10, ramp_s=2, sample_hz=10, vibration_rms_g=(0.1, 0.4))
    state, _ = plan.rows(Site())
    assert state.vibration_rms_g[0] == pytest.approx(0.1)
    assert state.vibration_rms_g[-1] == pytest.approx(0.4)


def test_rings_and_stations_are_distinguished_from_the_encoder_readings() -> None:
    state, _ = PosePlan(station_poses([0.612, -0.612], [0, 120, 240, 360]), hold_s=1).rows(Site())
    assert len(set(state.inclination_station.tolist())) == 2
    assert len(set(state.toolface_station.tolist())) == 3


@pytest.mark.parametrize("plan", [ROTATION, MOVES, LEGS], ids=["rotation", "moves", "legs"])
def test_the_number_of_rows_is_known_beforehand(plan: Plan) -> None:
    assert plan.rows(Site()).state.n == pytest.approx(plan.row_count, rel=0.3)
    assert plan.rows(Site()).state.row_seconds == plan.row_seconds


def recorded(state: ChainState, **more: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of a recording of these rows, as `simulate` writes them."""
    return {
        "t_s": state.t_s,
        "inc_ref_deg": np.degrees(state.inc_rad),
        "tf_ref_deg": np.degrees(state.tf_rad) % 360,
        **more,
    }


def test_the_state_of_a_rotation_is_read_back_from_its_columns() -> None:
    state, _ = ROTATION.rows(Site())
    for columns in (recorded(state), recorded(state, rotor_rate_dps=np.degrees(state.rotor_rate_radps))):
        back = ChainState.from_columns(columns)
        np.testing.assert_allclose(np.diff(back.tf_rad), np.diff(state.tf_rad), atol=1e-12)
        steady = np.abs(np.gradient(state.rotor_accel_radps2)) == 0
        np.testing.assert_allclose(back.rotor_rate_radps[1:-1], state.rotor_rate_radps[1:-1], atol=0.01)
        np.testing.assert_allclose(
            back.rotor_accel_radps2[steady][2:-2], state.rotor_accel_radps2[steady][2:-2], atol=1
        )
        assert np.median(np.abs(back.rotor_accel_radps2 - state.rotor_accel_radps2)) < 1e-6
        assert back.row_seconds == pytest.approx(0.005)


def test_the_state_of_a_stepped_session_has_no_rates_between_its_poses() -> None:
    state, _ = PosePlan(station_poses([5, 45], [0, 90, 180]), hold_s=2).rows(Site())
    back = ChainState.from_columns(recorded(state, pose=state.pose.astype(float), direction=-state.direction))
    assert not back.rotor_rate_radps.any()
    assert np.array_equal(back.pose, state.pose)
    assert np.array_equal(back.direction, -state.direction)
    assert np.array_equal(back.inclination_station, state.inclination_station)


def test_the_rotor_angle_stands_in_for_the_toolface() -> None:
    columns = {"t_s": np.arange(3.0), "inc_ref_deg": np.full(3, 5.0), "rotor_deg": np.array([350.0, 0.0, 10.0])}
    assert np.degrees(ChainState.from_columns(columns).rotor_rate_radps) == pytest.approx([10, 10, 10])


def test_a_recording_without_a_reference_is_refused_by_the_columns_it_lacks() -> None:
    with pytest.raises(InputError, match=r"lacks the columns inc_ref_deg, tf_ref_deg \(or rotor_deg\)"):
        ChainState.from_columns({"t_s": np.arange(3.0)})

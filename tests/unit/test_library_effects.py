"""Effects that were added to the library, each concealed in a session of its own kind: it is named, with its size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from highside.diagnosis.core.method import ProcedureParts
from highside.diagnosis.core.result import Claim, DiagnosisResult
from highside.diagnosis.engine import diagnose_poses
from highside.diagnosis.poses.session import PoseSession, pose_session
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.plan import PosePlan, Session, station_poses
from highside.physics.state import ChainState
from studies import diagnosis_deck as deck
from studies.scenario import random_sensor

FURTHER = pytest.mark.further
Array = NDArray[np.float64]
Sizes = dict[str, float]


def one_claim(found: DiagnosisResult, effect: str) -> Claim:
    assert [claim.effect for claim in found.claims] == [effect], deck.in_words(found)
    return found.claims[0]


def holds_the_truth(claim: Claim, truth: Sizes) -> None:
    """Every size within its 95 % interval widened by half (one seed of many is drawn), and told from zero."""
    shapes = {p.name for p in library.get(claim.effect).shapes}
    for name, value in truth.items():
        if name in shapes:
            continue
        fitted = claim.parameters[name]
        half = (fitted.high - fitted.low) / 2
        assert abs(fitted.value - value) <= 1.5 * half, (name, value, fitted)
        assert half < abs(value), (name, value, fitted)


# -- stepped sessions


def stepped(effect: str, sizes: Sizes, seed: int, state: ChainState | None = None) -> PoseSession:
    state = deck.design() if state is None else state
    rng = np.random.default_rng([seed, *effect.encode()])
    mean = random_sensor(rng).with_effects({effect: sizes}).predict(state) + deck.white_noise(state, rng)
    return deck.measured(PoseSession(mean, np.ones(state.n), state))


@pytest.mark.parametrize(
    ("effect", "sizes"),
    [
        pytest.param("temperature_misalignment", {"mt_xy": 2.0e-5, "mt_zx": -1.5e-5}, marks=FURTHER),
        ("inclination_first_harmonic", {"c1": 4e-4, "s1": -3e-4}),
        pytest.param("inclination_second_harmonic", {"c2": 3e-4, "s2": 2e-4}, marks=FURTHER),
        ("odd_quadratic", {"ko_x": 3e-3, "ko_z": -3e-3}),
        ("reference_voltage", {"vt": 1.5e-5, "vd": -6e-8}),
        ("load_hysteresis", {"h_x": 1.5e-4, "h_z": -1.2e-4, "width": 0.1}),
    ],
)
def test_named_in_a_stepped_session(effect: str, sizes: Sizes) -> None:
    holds_the_truth(one_claim(deck.diagnosed(stepped(effect, sizes, 1)), effect), sizes)


def test_a_bench_that_settles_is_named_where_poses_are_held_for_different_times() -> None:
    """The rows are the command's: means are made of them, and with them the time since the stop."""
    rng = np.random.default_rng(3)
    truth = {"e_inc": 2e-3, "e_tf": 1.5e-3, "tau": 25.0}
    poses = station_poses([5.0, 30.0, 60.0, 90.0, 120.0], [float(t) for t in range(0, 360, 40)], returns=True)
    hold = rng.choice([4, 12, 40, 90], len(poses))
    begins = np.concatenate([[0.0], np.cumsum(hold[:-1] + 15.0)])
    inc, tf, direction = np.array([tuple(p) for p in poses]).T
    number = np.repeat(np.arange(len(poses)), hold)
    since = np.concatenate([np.arange(h, dtype=float) for h in hold])
    columns = {
        "t_s": begins[number] + since, "inc_ref_deg": inc[number], "tf_ref_deg": np.mod(tf, 360.0)[number],
        "direction": direction[number], "pose": number.astype(float),
    }  # fmt: skip
    state = ChainState.from_columns(columns)
    accel = random_sensor(rng).with_effects({"bench_settling": truth}).predict(state)
    accel = accel + 1.2e-4 * rng.standard_normal(accel.shape)
    session = pose_session(columns, accel, gravity_mps2=9.80665)
    assert np.ptp(session.state.since_move_s) > 40
    claim = one_claim(diagnose_poses(session, ForwardModel.of({}), deck.FREE)[0], "bench_settling")
    holds_the_truth(claim, truth)
    # held alike, all that is left of it is a constant share of each move: that is no settling
    even = replace(session.state, since_move_s=np.full(session.n, 5.0))
    alike = PoseSession(session.mean, session.count, even)
    blind = diagnose_poses(alike, ForwardModel.of({}), deck.FREE, method=ProcedureParts.without("laws"))[0]
    not_testable_entry = next(entry for entry in blind.not_testable if entry.effect == "bench_settling")
    assert "hold some poses briefly and others long" in not_testable_entry.needs


def test_rectification_is_reported_axis_by_axis_where_the_vibration_is_recorded_so() -> None:
    rng = np.random.default_rng(4)
    state = deck.design()
    shaken = {
        f"vibration_{a}_rms_g": np.where(rng.random(state.n) < 0.4, rng.uniform(0.3, 1.5, state.n), 0.02) for a in "xyz"
    }
    total = np.sqrt(sum(v**2 for v in shaken.values()))
    state = replace(state, vibration_rms_g=total, **shaken)
    truth = {"kv_xx": 1.2e-4, "kv_xy": -9e-5}
    claim = one_claim(
        deck.diagnosed(stepped("axis_vibration_rectification", truth, 5, state)), "axis_vibration_rectification"
    )
    holds_the_truth(claim, truth)
    # known as one number it is what was always told
    whole = replace(state, **dict.fromkeys(shaken, np.zeros(state.n)))
    found = deck.diagnosed(stepped("vibration_rectification", {"kv_x": 1e-4, "kv_z": -1e-4}, 6, whole))
    assert one_claim(found, "vibration_rectification")
    assert "axis_vibration_rectification" in {entry.effect for entry in found.not_testable}


# -- what was told before still is


@pytest.mark.parametrize(
    ("effect", "sizes"),
    [
        # in `test_diagnosis_engine` too
        pytest.param("sag", {"s": 4e-4}, marks=FURTHER),
        ("base_tilt", {"tilt_x": 3e-4, "tilt_y": -2e-4}),
        ("cubic", {"k3_x": 3e-3, "k3_z": -3e-3}),
        ("temperature_scale", {"st_x": 2e-5, "st_y": -1e-5, "st_z": 1e-5}),
    ],
)
def test_what_stands_beside_them_keeps_its_name(effect: str, sizes: Sizes) -> None:
    holds_the_truth(one_claim(deck.diagnosed(stepped(effect, sizes, 7)), effect), sizes)


def test_the_poses_of_a_plan_say_how_long_ago_they_were_reached() -> None:
    plan = PosePlan(station_poses([10.0, 40.0], [0.0, 90.0]), hold_s=5.0, row_s=1.0, move_s=8.0, record_moves=True)
    state, held = Session(plan).rows()
    assert state.since_move_s[held].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0] * 4
    assert np.all(state.since_move_s[~held] == 0.0)

"""Whole sessions on the simulated bench, a simulated clock: every plan ends in a record that keeps its promise."""

from __future__ import annotations

import numpy as np
import pytest
from rehearsal import Rehearsal, random_sensor

from highside.bench.session import plans
from highside.bench.session.plans import Limits, SessionKind, SessionPlan
from highside.bench.session.snapshot import PoseState, SessionState
from highside.bench.setup import habits_of
from highside.bench.simulated_operator import OperatorMistake
from highside.config.bench import SimulatedTable
from highside.errors import InputError

QUICK = Limits(std_error_g=2e-5, min_hold_s=2.0, max_hold_s=8.0, soak_s=20.0)

SESSIONS: dict[str, SessionPlan] = {
    "balance at one inclination": plans.balance_plan([30.0], QUICK),
    "balance at three inclinations": plans.balance_plan([1.2, 10.0, 45.0], QUICK),
    **{f"conventional {n}": plans.conventional_plan(n, QUICK) for n in (3, 6, 8, 12, 24)},
    "joint by advice": plans.joint_plan(12, QUICK),
    "joint on a bench that turns one way": plans.joint_plan(
        10, QUICK, inclinations_deg=(5, 30, 60, 90), toolfaces_deg=(0, 90, 180, 270)
    ),
    "custom": plans.custom_plan(
        [(5, 0), (5, 120), (45, 60), (45, 180), (45, 300), (90, 0), (90, 90), (90, 200)], "joint", QUICK
    ),
}


@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_ends_in_a_record_within_its_uncertainty(name: str) -> None:
    rehearsal = Rehearsal(SESSIONS[name]).run()
    assert rehearsal.state is SessionState.ACCEPTED
    session = rehearsal.session
    assert session.record is not None and session.record.pose_count == len(rehearsal.plan.poses)
    assert all(line.state is PoseState.DONE for line in session.ledger.lines.values())
    assert session.ledger.retaken == 0 and not session.ledger.refused
    assert rehearsal.within(2.0), (rehearsal.errors_deg(), rehearsal.stated_deg())
    assert session.record.serial == "7" and session.record.content["environment"]["bench"] == "simulated"


@pytest.mark.parametrize(
    "plan",
    [
        plans.soak_plan([25.0, 70.0, 25.0], (5.0, 45.0, 90.0), (45.0, 135.0, 225.0, 315.0), QUICK),
        plans.heated_roll_plan([25.0, 45.0, 65.0], 90.0, (0.0, 90.0, 180.0, 270.0), QUICK),
    ],
    ids=["oven soak", "heated roll"],
)
def test_sessions_by_temperature_take_each_pose_at_its_temperature(plan: SessionPlan) -> None:
    drifting = {"offset_per_c": (2e-5, -1e-5, 3e-5), "oven_tau_s": 15.0}
    rehearsal = Rehearsal(plan, rate_hz=20.0, bench_options=drifting).run(limit_s=20_000.0)
    assert rehearsal.state is SessionState.ACCEPTED
    for line in rehearsal.session.ledger.done:
        assert line.readings is not None and line.readings.temp_c is not None
        wanted = plan.stages[line.stage].temp_c
        assert abs(line.readings.temp_c - wanted) <= 2.0 * plan.limits.temp_tolerance_c
    record = rehearsal.session.record
    assert record is not None
    assert record.result.main.temperature is not None
    assert rehearsal.within(2.0), (rehearsal.errors_deg(), rehearsal.stated_deg())
    if plan.kind is SessionKind.OVEN:
        drift = record.result.main.parameters
        assert drift.get("b_x@1") > 0 > drift.get("b_y@1")


def test_attitudes_by_hand_are_found_by_themselves_and_calibrated_by_their_magnitude() -> None:
    plan = plans.unguided_plan(Limits(min_hold_s=1.5, max_hold_s=20.0, prior_offset_g=0.05, prior_matrix=0.05))
    rehearsal = Rehearsal(plan, hand_poses=16).run()
    assert rehearsal.state is SessionState.ACCEPTED
    record = rehearsal.session.record
    assert record is not None and record.pose_count >= 16
    truth = np.linalg.norm(np.linalg.inv(record.result.A) @ np.array(rehearsal.bench.settings.matrix), axis=0)
    assert np.allclose(truth, 1.0, atol=1e-3)
    assert np.allclose(record.result.b, rehearsal.bench.settings.offset_g, atol=1e-4)


@pytest.mark.parametrize(
    "plan", [plans.verification_plan([(5, 20), (45, 140), (90, 260)], QUICK), plans.roll_test_plan(60.0, 8, QUICK)]
)
def test_a_verification_ends_with_its_poses_and_makes_no_calibration(plan: SessionPlan) -> None:
    rehearsal = Rehearsal(plan).run()
    assert rehearsal.state is SessionState.ACCEPTED
    assert rehearsal.session.record is None
    assert len(rehearsal.session.ledger.pose_set()) == len(plan.poses)


def test_poses_may_be_taken_in_any_order() -> None:
    """The operator turns to poses as he likes; each is recognised by itself."""
    plan = plans.conventional_plan(12, QUICK)
    rehearsal = Rehearsal(plan)
    order = np.random.default_rng(3).permutation(len(plan.poses)).tolist()

    def turn(_: float) -> None:
        state = rehearsal.session.state
        free = rehearsal.bench.time_s > turn.until  # type: ignore[attr-defined]
        if state in (SessionState.GUIDING, SessionState.SETTLING) and free and order:
            pose = plan.poses[order.pop()]
            turn.until = rehearsal.bench.turn_to(pose.inc_deg, pose.tf_deg) + 6.0  # type: ignore[attr-defined]

    turn.until = 0.0  # type: ignore[attr-defined]
    rehearsal.operator._set_pose = lambda _: None  # type: ignore[method-assign]
    wanted = [plan.poses[k].id for k in reversed(order)]
    rehearsal.run(on_step=turn)
    assert rehearsal.state is SessionState.ACCEPTED
    assert [line.id for line in rehearsal.session.ledger.done] == wanted
    assert rehearsal.within(2.0)


def test_the_noise_is_learnt_and_a_noisier_sensor_is_held_longer() -> None:
    plan = plans.balance_plan([30.0], Limits(std_error_g=1e-5, min_hold_s=2.0, max_hold_s=60.0))
    calm, noisy = (Rehearsal(plan, rate_hz=rate).run() for rate in (50.0, 50.0))
    assert calm.took_s == noisy.took_s  # nothing but the seed decides
    worse = Rehearsal(plan)
    object.__setattr__(worse.bench.settings, "noise_density_g", 60e-6)
    worse.run()
    held = [np.mean([line.readings.n for line in r.session.ledger.done if line.readings]) for r in (calm, worse)]
    assert held[1] > 4.0 * held[0]
    for line in worse.session.ledger.done:
        assert line.readings is not None and max(line.readings.std_error_g) <= 1e-5


@pytest.mark.parametrize("plan", SESSIONS.values(), ids=SESSIONS)
def test_a_plan_survives_its_journal(plan: SessionPlan) -> None:
    assert SessionPlan.from_dict(plan.to_dict()) == plan


@pytest.mark.parametrize(
    "make",
    [
        lambda: plans.balance_plan([90.0]),
        lambda: plans.conventional_plan(7),
        lambda: plans.roll_test_plan(60.0, 4),
        lambda: plans.joint_plan(3),
        lambda: plans.joint_plan(20, inclinations_deg=(5,), toolfaces_deg=(0, 90)),
        lambda: plans.custom_plan([(200.0, 0.0)]),
        lambda: plans.custom_plan([]),
        lambda: plans.custom_plan([(0.0, 0.0)], "magic"),
        lambda: plans.soak_plan([25.0], (5.0,), (45.0,)),
        lambda: Limits(min_hold_s=5.0, max_hold_s=1.0),
        lambda: Limits(std_error_g=-1.0),
    ],
)
def test_what_cannot_be_is_refused_by_name(make: object) -> None:
    with pytest.raises(InputError):
        make()  # type: ignore[operator]


@pytest.mark.slow
def test_at_least_95_of_100_sessions_are_within_twice_their_stated_uncertainty() -> None:
    plan = plans.joint_plan(
        8, Limits(std_error_g=4e-5, min_hold_s=1.0, max_hold_s=3.0), inclinations_deg=(-45, 5, 45, 90, 150)
    )
    good = accepted = 0
    for seed in range(100):
        tilt = tuple(np.random.default_rng([seed, 3]).normal(0.0, 0.02, 2).tolist())
        rehearsal = Rehearsal(
            plan,
            seed=seed,
            rate_hz=20.0,
            sensor=random_sensor(seed),
            gyros=False,
            bench_options={"tilt_deg": tilt, "settle_s": 0.5, "turn_rate_dps": 120.0},
        ).run()
        accepted += rehearsal.state is SessionState.ACCEPTED
        good += rehearsal.state is SessionState.ACCEPTED and rehearsal.within(2.0)
    print(f"{accepted} accepted, {good} of 100 within twice the stated uncertainty")
    assert good >= 95


@pytest.mark.parametrize("word", ["shock", "knock"])
def test_a_planned_mistake_is_read_by_its_name_and_by_the_one_of_older_files(word: str) -> None:
    table = SimulatedTable(mistakes={"3": word})
    assert habits_of(table).mistakes == ((3, OperatorMistake.SHOCK),)


def test_a_mistake_that_nobody_makes_is_refused_with_those_that_are_made() -> None:
    with pytest.raises(InputError, match=r"simulated.mistakes.*shock"):
        habits_of(SimulatedTable(mistakes={"3": "sneeze"}))

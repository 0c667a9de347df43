"""The time to go: what it says while a session runs, against what the session then took."""

from __future__ import annotations

import numpy as np
import pytest
from rehearsal import Rehearsal, command

from highside.bench.session.entries import Began, HoldReadings, Noted, Paused, Resumed, TakenPose
from highside.bench.session.plans import conventional_plan, joint_plan
from highside.bench.session.snapshot import CommandName, SessionState
from highside.bench.session.time_to_go import Pace

ONE = HoldReadings(((0.0,), (0.0,), (1.0,)), 0.0, 3.0, None, (1e-5, 1e-5, 1e-5))


def taken(pose: int) -> TakenPose:
    return TakenPose(str(pose), ONE, None)


def said_against_true(rehearsal: Rehearsal) -> np.ndarray:
    """(2, N): what was said each half a second from the third pose on, and what it then took, s."""
    said: list[tuple[float, float | None]] = []
    all_taken: list[float] = []

    def look(now_s: float) -> None:
        session = rehearsal.session
        if session.state is SessionState.SOLVING or (session.ledger.done and not session.ledger.has_open):
            all_taken.append(now_s)
        elif len(session.ledger.done) >= 3:
            said.append((now_s, session.to_go_s))

    rehearsal.run(on_step=look)
    assert rehearsal.session.state is SessionState.ACCEPTED
    assert all(value is not None for _, value in said)
    end_s = all_taken[0]
    return np.array([(value, end_s - now_s) for now_s, value in said if now_s < end_s]).T


@pytest.mark.parametrize("seed", [71, 72, 73])
def test_what_is_said_is_about_what_it_takes(seed: int) -> None:
    """At any moment from the third pose on, within a quarter of the truth or one pose's time, whichever is more."""
    said, true = said_against_true(Rehearsal(joint_plan(16), seed=seed))
    pose_s = true[0] / 13.0
    off = np.abs(said - true)
    assert np.mean(off <= np.maximum(0.25 * true, pose_s)) > 0.95, np.max(off / np.maximum(true, pose_s))


def test_it_counts_down_and_stands_while_a_pose_takes_long() -> None:
    pace = Pace()
    for k, at_s in enumerate((0.0, 30.0, 60.0, 90.0)):
        pace.note(Began("a") if k == 0 else taken(k), at_s)
    assert pace.to_go_s(13, 90.0) == pytest.approx(13 * 30.0)
    assert pace.to_go_s(13, 100.0) == pytest.approx(13 * 30.0 - 10.0)
    # it never promises that the pose at which somebody struggles is done, nor all of those after it sooner
    assert pace.to_go_s(13, 1000.0) == pytest.approx(12 * 30.0 + 3.0)
    # a hold under way knows better: half of it took 5 s
    assert pace.to_go_s(1, 115.0, hold=(5.0, 0.5)) == pytest.approx(5.0)


def test_nothing_is_said_before_it_is_known_and_pauses_do_not_count() -> None:
    pace = Pace()
    pace.note(Began("a"), 0.0)
    pace.note(taken(1), 300.0)
    assert pace.to_go_s(15, 300.0) is None
    pace.note(taken(2), 330.0)
    pace.note(Paused("a"), 340.0)
    # paused for an hour: the interval is no pose's
    assert pace.to_go_s(14, 3000.0) == pace.to_go_s(14, 341.0)
    pace.note(Resumed("a"), 3940.0)
    pace.note(taken(3), 3970.0)
    pace.note(taken(4), 4000.0)
    # the talk before the first pose is left out as soon as others show that it was one
    assert pace.usual_s() == pytest.approx(30.0)


def test_a_journal_that_is_gone_on_with_knows_its_pace() -> None:
    entries = [Began("a"), taken(1), taken(2), taken(3), Noted("interrupted", ""), Resumed(None)]
    pace = Pace.of(entries, [0.0, 30.0, 60.0, 90.0, 7000.0, 7000.0])
    assert pace.to_go_s(4, 5.0) == pytest.approx(120.0), "by another clock"


def test_a_pause_and_a_lost_cable_leave_it_standing() -> None:
    rehearsal = Rehearsal(conventional_plan(6), seed=5)
    rehearsal.run(limit_s=40.0)
    session = rehearsal.session
    assert 3 <= len(session.ledger.done) < 6
    session.command(command(CommandName.PAUSE), rehearsal.bench.time_s)
    paused = session.to_go_s
    session.tick(rehearsal.bench.time_s + 500.0)
    assert paused is not None and session.to_go_s == paused


def test_a_plan_of_no_fixed_length_says_nothing() -> None:
    from highside.bench.session.plans import unguided_plan

    rehearsal = Rehearsal(unguided_plan(min_poses=12), seed=5)
    rehearsal.run(limit_s=60.0)
    assert rehearsal.session.to_go_s is None

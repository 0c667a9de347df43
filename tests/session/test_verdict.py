"""Verification and roll test end with their verdict in the session: shown, in the journal, the same on replay."""

from __future__ import annotations

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from rehearsal import MATRIX, OFFSET_G, Rehearsal, command

from highside.bench.session import outcome, plans
from highside.bench.session.entries import Ended
from highside.bench.session.journal import Encoder, encode_all, read_journal
from highside.bench.session.plans import Criterion, Limits, SessionPlan
from highside.bench.session.snapshot import CommandName, SessionState
from highside.bench.session.view import View
from highside.calibration.record import CalibrationRecord
from highside.errors import InputError

QUICK = Limits(std_error_g=2e-5, min_hold_s=2.0, max_hold_s=8.0)
POSES = [(5.0, 20.0), (45.0, 140.0), (90.0, 260.0), (45.0, 260.0)]


@functools.cache
def calibration() -> CalibrationRecord:
    """A good calibration of the rehearsal's sensor."""
    record = Rehearsal(plans.joint_plan(12, QUICK)).run().session.record
    assert record is not None
    return record


def verification(limit_deg: float) -> SessionPlan:
    return plans.verification_plan(POSES, QUICK, Criterion(calibration().id, limit_deg, 20 * limit_deg))


def roll(limit_deg: float) -> SessionPlan:
    return plans.roll_test_plan(60.0, 8, QUICK, Criterion(calibration().id, limit_deg, limit_g_total_g=2.5e-3))


def judge(plan: SessionPlan, offset_g: float = 0.0) -> Rehearsal:
    """A session that judges the calibration with a sensor whose x offset has moved since."""
    sensor = (MATRIX, (OFFSET_G[0] + offset_g, *OFFSET_G[1:]))
    return Rehearsal(plan, sensor=sensor, judged=calibration(), seed=3).run()


@pytest.mark.parametrize("make", [verification, roll])
@pytest.mark.parametrize(
    ("limit_deg", "offset_g", "says"),
    [(0.3, 0.0, "pass"), (0.3, 10e-3, "fail"), (1e-4, 0.0, "undecided")],
    ids=["as calibrated", "offset moved by 10 mg", "limit below what can be told"],
)
def test_a_session_ends_with_its_verdict(make: object, limit_deg: float, offset_g: float, says: str) -> None:
    plan: SessionPlan = make(limit_deg)  # type: ignore[operator]
    if says == "undecided" and plan.kind is plans.SessionKind.ROLL_TEST:
        limit_deg = 0.015
        plan = roll(limit_deg)
    done = judge(plan, offset_g)
    assert done.state is SessionState.ACCEPTED and done.session.record is None
    snapshot = View(done.session).snapshot()
    assert snapshot.plan.judges == calibration().id
    assert snapshot.result is not None and snapshot.result.verdict is not None
    verdict = snapshot.result.verdict
    assert (verdict.verdict, verdict.record, verdict.limit_inc_deg) == (says, calibration().id, limit_deg)
    assert calibration().id[:12] in snapshot.prompt and verdict.text in snapshot.prompt
    assert len(verdict.rows) == (len(POSES) if plan.kind is plans.SessionKind.VERIFICATION else 2)
    assert any(row.verdict == says for row in verdict.rows)
    # the journal alone tells the same
    ended = done.session.ledger.ended
    assert ended is not None and (ended.record, ended.verdict) == (None, says)
    _, solved, record = done.replayed()
    assert record is None and solved.verdict is not None
    assert solved.verdict.to_dict() == done.session.solved.verdict.to_dict()  # type: ignore[union-attr]
    again = Rehearsal(plan, judged=calibration())
    resumed = again.make_session(read_journal(done.journal).ledger())
    assert View(resumed).snapshot().result == snapshot.result


def test_a_verdict_that_does_not_follow_from_the_journal_is_refused() -> None:
    done = judge(verification(0.3))
    altered = [replace(e, verdict="fail") if isinstance(e, Ended) else e for e in done.entries]
    journal = read_journal(encode_all(done.header, [(entry, 1.0) for entry in altered]))
    with pytest.raises(InputError, match="gives the verdict pass, not fail"):
        outcome.replay(journal)


def test_the_journal_holds_the_calibration_that_is_judged_and_no_other() -> None:
    header = Rehearsal(verification(0.3), judged=calibration()).header
    line = Encoder().header(header)
    read = read_journal(line)
    assert read.header == header and read.header.judged is not None
    assert read.header.judged.to_json() == calibration().to_json()
    content = json.loads(line)["d"]["judged"]
    content["result"]["reading_noise_g"] = 1.0
    tampered = replace(header, judged=replace(calibration(), content=content))
    for wrong in (replace(header, judged=None), tampered):
        with pytest.raises(InputError):
            read_journal(Encoder().header(wrong))


def test_what_gives_no_verdict_is_not_accepted_but_says_why() -> None:
    plan = roll(0.3)
    rehearsal = Rehearsal(plan, judged=calibration())
    session = rehearsal.session
    session.command(command(CommandName.START), 0.0)
    for pose in plan.poses[4:]:
        assert session.command(command(CommandName.SKIP, pose=pose.id), 0.0).accepted
    look = rehearsal.operator.look
    rehearsal.operator.look = lambda s: [] if s.state is SessionState.REVIEW else look(s)  # type: ignore[method-assign]
    rehearsal.run(limit_s=300.0)
    assert session.state is SessionState.REVIEW
    snapshot = View(session).snapshot()
    assert CommandName.ACCEPT not in snapshot.allowed and CommandName.REJECT in snapshot.allowed
    assert "4 different toolfaces" in snapshot.prompt and "No verdict follows" in snapshot.prompt
    assert not session.command(command(CommandName.ACCEPT), 0.0).accepted


def test_the_running_uncertainty_is_that_of_the_result() -> None:
    """The same quantity by the same code: equal at the end, and before that what the poses so far would give."""
    for plan in (plans.balance_plan([30.0], QUICK), plans.conventional_plan(6, QUICK), plans.joint_plan(8, QUICK)):
        seen: list[tuple[int, float, float]] = []
        rehearsal = Rehearsal(plan)

        def ahead(_: float, rehearsal: Rehearsal = rehearsal, seen: list[tuple[int, float, float]] = seen) -> None:
            job = rehearsal.session.look_ahead()
            if job is None:
                return
            rehearsal.session.finish_look_ahead(job())
            shown = View(rehearsal.session).snapshot()
            if shown.uncertainty is not None:
                u = shown.uncertainty
                seen.append((shown.plan.done, u.rms_inc_std_deg, u.rms_tf_std_deg))

        rehearsal.run(on_step=ahead)
        snapshot = View(rehearsal.session).snapshot()
        assert snapshot.uncertainty is not None and snapshot.result is not None
        stated = (snapshot.result.inc_std_deg, snapshot.result.tf_std_deg)
        assert (snapshot.uncertainty.rms_inc_std_deg, snapshot.uncertainty.rms_tf_std_deg) == stated
        assert snapshot.uncertainty.inc_deg, "a curve to draw"
        job = outcome.solve_so_far(
            rehearsal.session.ledger.pose_columns(), rehearsal.session.ledger.request(), rehearsal.plan
        )
        assert job == snapshot.uncertainty
        for done, inc_std, _ in seen:
            assert done < len(plan.poses) and inc_std >= 0.9 * (stated[0] or 0.0)
        if plan.kind is plans.SessionKind.JOINT:
            assert [done for done, _, _ in seen] == [5, 6, 7]
            assert np.all(np.diff([tf for _, _, tf in seen]) < 0.0), "it falls with each pose"

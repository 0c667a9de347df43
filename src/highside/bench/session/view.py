"""The public picture of a session: its `Snapshot`, and the sentence that says what to do next."""

from __future__ import annotations

import math

import numpy as np

from highside.bench.session import checks
from highside.bench.session.guidance import CandidatePose, attitude_of, deviation_of, instruction, setting
from highside.bench.session.labels import label
from highside.bench.session.ledger import PoseLine
from highside.bench.session.outcome import Solved
from highside.bench.session.reasons import Fault
from highside.bench.session.session import BenchSession
from highside.bench.session.snapshot import (
    AttitudeState,
    Capture,
    ClosureState,
    CommandName,
    Deviation,
    FaultState,
    ForceState,
    PlanState,
    PoseRow,
    PoseState,
    ResultState,
    SessionState,
    Snapshot,
    StillnessState,
    Target,
)
from highside.bench.session.verdict import as_state


class View:
    """Makes snapshots of one session; keeps what changes only with the poses."""

    def __init__(self, session: BenchSession) -> None:
        self._session = session
        self._revision = -1
        self._closures: list[ClosureState] = []
        self._away: dict[str, float] = {}

    def snapshot(self) -> Snapshot:
        session = self._session
        ledger, header, plan = session.ledger, session.header, session.plan
        self._refresh()
        target = session.target
        attitude, deviation = self._where(target)
        stage = plan.stages[ledger.stage]
        refused = session.last_rejection
        return Snapshot(
            seq=session.seq,
            session=header.session,
            tool=header.tool_id,
            serial=header.serial,
            state=session.state,
            back_to=session.back_to,
            plan=PlanState(
                kind=plan.kind.value,
                title=plan.title,
                method=plan.method,
                poses=None if plan.open_ended else len(plan.poses),
                done=len(ledger.done),
                skipped=ledger.skipped,
                stage=ledger.stage,
                stages=len(plan.stages),
                stage_temp_c=stage.temp_c,
                judges=None if plan.criterion is None else plan.criterion.record,
            ),
            prompt=prompt(session, target, deviation),
            target=None
            if target is None
            else Target(pose=target.id, inc_deg=target.inc_deg, tf_deg=target.tf_deg, temp_c=stage.temp_c),
            attitude=attitude,
            deviation=deviation,
            stillness=self._stillness(),
            capture=self._capture(),
            temp_c=None if self._silent else session.tracker.temp_c,
            poses=[
                _row(line, plan.stages[line.stage].temp_c, self._away.get(line.id)) for line in ledger.lines.values()
            ],
            uncertainty=session.uncertainty,
            closures=self._closures,
            faults=[
                FaultState(code=fault.value, text=fault.text, since_s=max(0.0, since), detail=detail)
                for fault, since, detail in session.faults
            ],
            last_rejection=None if refused is None else refused[1],
            operator=ledger.operator,
            allowed=session.allowed(),
            result=None if session.solved is None else _result(session, session.solved),
            in_force=None
            if session.in_force is None
            else ForceState(present=session.in_force.present, before=session.in_force.before),
            to_go_s=session.to_go_s,
            elapsed_s=0.0 if session.started_s is None else max(0.0, session.now_s - session.started_s),
        )

    def _refresh(self) -> None:
        ledger = self._session.ledger
        if ledger.revision == self._revision:
            return
        self._revision = ledger.revision
        if any(line.sigmas is None and line.id not in self._away for line in ledger.done):
            self._away = checks.all_departures(ledger.pose_set(), ledger.plan.limits)
        limit = checks.closure_limit(ledger.plan)
        closures = checks.inclination_closures(ledger.pose_set(), ledger.plan.limits) if ledger.done else []
        self._closures = [
            ClosureState(
                inc_deg=math.degrees(c.inc_rad),
                size_g=float(np.linalg.norm(c.value)),
                p=c.p,
                good=c.p >= limit,
                poses=list(c.poses),
                worst=c.worst_pose,
            )
            for c in closures
        ]

    @property
    def _silent(self) -> bool:
        """Nothing comes from the tool: what it said last is no present value."""
        session = self._session
        return session.stale or any(fault in session.faults for fault in (Fault.NO_DATA, Fault.LINK_DOWN))

    def _where(self, target: CandidatePose | None) -> tuple[AttitudeState | None, Deviation | None]:
        session = self._session
        window = session.tracker.latest
        if window is None or self._silent:
            return None, None
        deviation = None
        if target is not None:
            deviation = deviation_of(window.mean, session.model, target, session.plan.limits)
        return attitude_of(window.mean, session.model), deviation

    def _stillness(self) -> StillnessState | None:
        tracker = self._session.tracker
        if not tracker.trace or self._silent:
            return None
        noise = tracker.floor.value
        return StillnessState(
            value=round(tracker.trace[-1], 4),
            still=tracker.stillness.still,
            noise_g=None if noise is None else (float(noise[0]), float(noise[1]), float(noise[2])),
            trace=[round(value, 3) for value in tracker.trace],
            trace_step_s=tracker.window_s,
        )

    def _capture(self) -> Capture | None:
        hold = self._session.hold
        if hold is None:
            return None
        target = self._session.plan.limits.std_error_g
        if not hold.windows:
            return Capture(progress=0.0, elapsed_s=0.0, readings=0, std_error_g=None, target_std_error_g=target)
        return Capture(
            progress=hold.progress(),
            elapsed_s=hold.elapsed_s,
            readings=hold.readings,
            std_error_g=float(np.max(hold.std_error())),
            target_std_error_g=target,
        )


def _row(line: PoseLine, temp_c: float | None, away: float | None) -> PoseRow:
    """`away`: the departure of a pose that was taken before there were others to compare it with."""
    readings = line.readings
    measured = readings.temp_c if readings is not None else None
    text = line.reason.text if line.reason is not None else None
    return PoseRow(
        pose=line.id,
        inc_deg=line.inc_deg,
        tf_deg=line.tf_deg,
        temp_c=temp_c if temp_c is not None else measured,
        stage=line.stage,
        state=line.state,
        attempts=line.attempts,
        std_error_g=None if readings is None else max(readings.std_error_g),
        readings=0 if readings is None else readings.n,
        sigmas=away if line.sigmas is None and line.state is PoseState.DONE else line.sigmas,
        reason=None if line.reason is None else line.reason.value,
        text=text if not line.detail or text is None else f"{text} ({line.detail})",
    )


def _result(session: BenchSession, solved: Solved) -> ResultState:
    ended = session.ledger.ended
    return ResultState(
        method=session.plan.method,
        record_id=ended.record if ended is not None else None,
        inc_std_deg=solved.inc_std_deg,
        tf_std_deg=solved.tf_std_deg,
        poses=len(session.ledger.done),
        retaken=session.ledger.retaken,
        refused=list(solved.refused),
        remarks=list(solved.remarks),
        verdict=None if solved.verdict is None else as_state(solved.verdict),
        turntable_id=None if solved.turntable is None else solved.turntable.id,
    )


_ENDED = {
    SessionState.REJECTED: "Ended: the result was rejected. The journal keeps what was measured.",
    SessionState.ABORTED: "Aborted. The journal keeps what was measured.",
}


def prompt(session: BenchSession, target: CandidatePose | None, deviation: Deviation | None) -> str:
    """What to do next, in one sentence."""
    state = session.state
    if state in _ENDED:
        return _ENDED[state]
    if state is SessionState.ACCEPTED:
        return _accepted(session)
    if state is SessionState.IDLE:
        judged = session.plan.criterion
        what = session.plan.title if judged is None else f"{session.plan.title} of calibration {judged.record[:12]}"
        return f"Clamp the tool, check that the table is level, then choose {label(CommandName.START)} ({what})."
    if state is SessionState.PAUSED:
        return f"Paused: choose {label(CommandName.RESUME)}; what has been measured is kept."
    for fault in (Fault.STORAGE, Fault.LINK_DOWN, Fault.NO_DATA, Fault.FROZEN, Fault.MIRRORED, Fault.NO_TEMPERATURE):
        if fault in session.faults:
            return fault.text
    match state:
        case SessionState.SOAKING:
            return _soak(session)
        case SessionState.CAPTURING:
            return f"Hands off: measuring{_name(target)}."
        case SessionState.SETTLING:
            return f"At the pose{_name(target)}: let it come to rest."
        case SessionState.GUIDING if session.plan.open_ended:
            done = len(session.ledger.done)
            more = max(0, session.plan.min_poses - done)
            rest = f"{more} more are needed" if more else "accept when you have enough"
            return f"Lay the tool down in an attitude that is new, and let go; {done} taken, {rest}."
        case SessionState.GUIDING if target is not None:
            return _guide(session, target, deviation)
        case SessionState.REVIEW:
            return _review(session)
        case _:
            return "One moment: the calibration is being computed."


def _name(target: CandidatePose | None) -> str:
    return "" if target is None else f" {target.id} ({setting(target.inc_deg, target.tf_deg)})"


def _guide(session: BenchSession, target: CandidatePose, deviation: Deviation | None) -> str:
    what = f"Set{_name(target)}"
    if session.must_leave == target.id:
        return f"{what} again: turn away from it first, then set it with care."
    if session.alike is not None:
        return f"{what}: it reads like pose {session.alike}, where the tool stands; turn the table away first."
    if deviation is None:
        return f"{what}."
    return f"{what}: {instruction(deviation, reversed_side=target.inc_deg < 0)}."


def _soak(session: BenchSession) -> str:
    stage = session.plan.stages[session.ledger.stage]
    now = session.tracker.temp_c
    here = "" if now is None else f", now {now:.1f}"
    if stage.temp_c is None:
        return "One moment."
    return f"Bring the tool to {stage.temp_c:g} deg C{here}; the session goes on by itself once that is steady."


def _accepted(session: BenchSession) -> str:
    """What became of the result, and what may still be done with it."""
    record, force = session.record, session.in_force
    if record is None:
        verdict = session.solved.verdict if session.solved is not None else None
        if verdict is not None:
            return f"Done: the verdict on calibration {verdict.record_id[:12]} is kept. {verdict.text}"
        return "Done: the result is accepted and kept."
    if force is not None and force.present == record.id:
        return f"Calibration {record.id[:12]} is in force: a running service takes it at its next reload."
    return f"Done: calibration {record.id[:12]} is kept. It is not in force until somebody puts it in force."


def _review(session: BenchSession) -> str:
    solved = session.solved
    if solved is None or not solved.may_be_accepted:
        why = solved.why if solved is not None else "not solved"
        what = "calibration" if session.plan.kind.calibrates else "verdict"
        return f"No {what} follows: {why}. Measure the poses named again, or reject."
    if solved.verdict is not None:
        return f"Calibration {solved.verdict.record_id[:12]}: {solved.verdict.text} Accept or reject."
    if Fault.CONTRADICTION in session.faults:
        return "The poses still contradict one another: look at the list, then accept, redo a pose, or reject."
    if not session.plan.kind.calibrates:
        return "All poses are taken; nothing was named to be judged by them. Accept or reject."
    return f"All poses are taken and agree: I within {solved.inc_std_deg or 0:.4f} deg (1 sigma); accept or reject."

"""A bench session: readings and commands in, journal entries and snapshots out. Pure; the clock comes with each call.

`machine` says what a state and an event lead to; this module finds the events (it looks at the readings) and does the
actions (it writes journal entries, by `write`, and applies them to the ledger). An entry that cannot be written is not
applied: what is not on the disk has not happened.

Who drives it calls `readings` with what the tool sends, `tick` from time to time, `command` for each command, and, when
`work()` gives a job, runs it (in a thread, if it likes) and hands the answer to `finish_work`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from highside.calibration.poses import Array
from highside.calibration.record import CalibrationRecord
from highside.codec.frame import Frame
from highside.session import ledger as entries
from highside.session import outcome
from highside.session.guidance import (
    Candidate,
    Provisional,
    Recognised,
    axes_that_fit,
    recognise,
)
from highside.session.hold import Hold
from highside.session.journal import Header
from highside.session.judge import Judged, contradictions, judge_hold
from highside.session.ledger import Entry, Ledger, PoseLine
from highside.session.machine import LIVE, MEASURING, Action, Event, Go, Onward, Outcome, Refuse, onward
from highside.session.machine import outcome as outcome_of
from highside.session.reasons import Fault, Refusal, Rejection
from highside.session.snapshot import Command, CommandName, PoseState, Reply, State
from highside.session.stillness import LOOK_BACK, Window
from highside.session.tracker import Gap, Tracker

DATA_LOST_S = 2.0
REPLIES_KEPT = 1000
SAME_ATTITUDE_DEG = 1.0
"""Poses found by themselves are different when they lie further apart than this."""
TRIM_WINDOWS = 3
"""Left out at the end of a hold that ended because the tool was moved."""
MAX_SAME_REFUSALS = 3
STILL_ELSEWHERE = 10
"""windows of rest at no open pose after which the operator is told"""


class StorageError(Exception):
    """`write` could not keep an entry."""


class BenchSession:
    """See the module's docstring. `write` keeps an entry for good or raises StorageError; `wall` is the UTC clock."""

    def __init__(
        self,
        header: Header,
        write: Callable[[Entry], None],
        wall: Callable[[], float],
        *,
        ledger: Ledger | None = None,
        known_noise_g: float | None = None,
    ) -> None:
        self.header = header
        self.plan = header.plan
        self.ledger = ledger or Ledger(header.plan)
        self.tracker = Tracker(header.plan.limits, known_noise_g)
        self.state = State.IDLE
        self.solved: outcome.Solved | None = None
        self.record: CalibrationRecord | None = None
        self.hold: Hold | None = None
        self.faults: dict[Fault, tuple[float, str]] = {}
        self.last_rejection: tuple[Rejection, str] | None = None
        self.recognised: Recognised | None = None
        self.seq = 0
        self.now_s = 0.0
        self.started_s: float | None = None
        self._write = write
        self._wall = wall
        self._replies: dict[str, Reply] = {}
        self._target: str | None = None
        self._model = Provisional.fit((), (), np.zeros((3, 0)), self.plan.limits)
        self._judged: Judged | None = None
        self._must_leave: str | None = None
        """a pose that was refused as it stands: it has to be set anew before it is measured again"""
        self._blame: tuple[Rejection, str] | None = None
        self._again: tuple[tuple[str, Rejection, str], ...] = ()
        self._working = False
        self._unsteady = False
        self._refused_last: tuple[str | None, Rejection] | None = None
        self._same_refusals = 0
        self._elsewhere = 0
        self._last_data_s: float | None = None
        self._since_s = 0.0
        if self.ledger.began:
            self._go_on()

    def _go_on(self) -> None:
        """A journal was read back: wait, paused, for an operator to go on (or stay ended)."""
        ended = self.ledger.ended
        self.state = State(ended.how) if ended is not None else State.PAUSED
        if ended is not None and ended.record is not None:
            self.solved = outcome.solve(self.ledger)
            self.record = outcome.make_record(self.header, self.ledger, self.solved, ended.t_wall_s)
        self._learn_again()

    # --- what comes in -----------------------------------------------------------------------------------------

    def readings(self, frames: Sequence[Frame], now_s: float) -> None:
        """Frames of the tool, in order of arrival; raw, their axes mapped."""
        self._at(now_s)
        if not frames:
            return
        self._last_data_s = now_s
        for fault in (Fault.NO_DATA, Fault.LINK_DOWN):
            self._clear(fault)
        if self.state is State.NO_DATA:
            self._event(Event.DATA_BACK)
        for item in self.tracker.windows(frames):
            if isinstance(item, Gap):
                self._raise(Fault.LOST_FRAMES, f"{item.missing_s:+.2f} s")
                self._spoil(Rejection.GAP, f"{item.missing_s:+.2f} s of the tool's time")
            else:
                self._window(item)
        self.seq += 1

    def tick(self, now_s: float) -> None:
        """Time passes, whether or not anything arrives."""
        self._at(now_s)
        if self._last_data_s is None:
            self._last_data_s = now_s
        if now_s - self._last_data_s > DATA_LOST_S:
            if Fault.NO_DATA not in self.faults:
                self._raise(Fault.NO_DATA)
                self.tracker.forget()
            self._blame = (Rejection.DATA_LOST, "")
            if self.state in MEASURING and self.state is not State.NO_DATA:
                self._event(Event.DATA_LOST)
        if self.state is not State.PAUSED and now_s - self._since_s > self.plan.limits.remind_s:
            self._event(Event.LONG_WAIT)

    def link_down(self, message: str, now_s: float) -> None:
        """The link has failed; it is tried again by whoever owns it."""
        self._at(now_s)
        self._raise(Fault.LINK_DOWN, message)
        self.tracker.forget()
        self._blame = (Rejection.DATA_LOST, message)
        if self.state in MEASURING and self.state is not State.NO_DATA:
            self._event(Event.DATA_LOST)

    def data_ended(self, now_s: float) -> None:
        """A recording that is played is over."""
        self._at(now_s)
        if self.state in MEASURING:
            self._finish_hold()
            if self.plan.open_ended:
                self._event(Event.DATA_ENDED)

    def clock_stepped(self, by_s: float, now_s: float) -> None:
        """The wall clock was set. Nothing here goes by it but the times in journal and record."""
        self._at(now_s)
        self._raise(Fault.CLOCK_STEP, f"{by_s:+.0f} s")
        try:
            self._keep(entries.Noted("clock_step", f"{by_s:+.3f} s"))
        except StorageError as error:
            self._raise(Fault.STORAGE, str(error))

    def command(self, command: Command, now_s: float) -> Reply:
        """Do what an operator asks, or say why not. Repeated request ids get the first answer."""
        self._at(now_s)
        known = self._replies.get(command.request_id)
        if known is not None:
            return known
        refusal = self._refuse(command.name, command.operator, command.pose)
        text = ""
        if refusal is None:
            try:
                self._event(self._event_of(command.name), command)
            except StorageError as error:
                refusal, text = Refusal.STORAGE, str(error)
        self.seq += 1
        reply = Reply(
            request_id=command.request_id,
            accepted=refusal is None,
            reason=None if refusal is None else refusal.value,
            text="done" if refusal is None else f"{refusal.text} {text}".strip(),
            state=self.state,
            seq=self.seq,
        )
        self._replies[command.request_id] = reply
        while len(self._replies) > REPLIES_KEPT:
            del self._replies[next(iter(self._replies))]
        return reply

    def note_interruption(self) -> None:
        """This journal is gone on with by a new process: an operator has to resume, and then holds the session."""
        if not self.state.ended:
            self._keep(entries.Noted("interrupted", "the process was started again"))
            self._keep(entries.Resumed(None))

    def work(self) -> Callable[[], outcome.Solved] | None:
        """The job to be run now, once; its answer goes to `finish_work`."""
        if self.state is not State.SOLVING or self._working:
            return None
        self._working = True
        return partial(outcome.solve, self.ledger)

    def finish_work(self, solved: outcome.Solved, now_s: float) -> None:
        """The solver has answered."""
        self._at(now_s)
        self._working = False
        if self.state is not State.SOLVING:
            return
        self.solved = solved
        may_ask = [
            (pose, reason, text)
            for pose, reason, text in solved.again
            if (line := self.ledger.lines.get(pose)) is not None
            and line.state is PoseState.DONE
            and line.asked_again < self.plan.limits.retakes
            and not self.plan.open_ended
        ]
        if may_ask:
            closure = [item for item in may_ask if item[1] is Rejection.CLOSURE]
            fewest = min(may_ask, key=lambda item: self.ledger.lines[item[0]].asked_again)
            self._again = (fewest,) if closure else tuple(may_ask)
            self._event(Event.AGAIN)
            return
        if solved.again:
            self._raise(Fault.CONTRADICTION, solved.again[0][2])
        else:
            self._clear(Fault.CONTRADICTION)
        self._event(Event.SOLVED)

    # --- what operators may do ---------------------------------------------------------------------------------

    def _event_of(self, name: CommandName) -> Event:
        if name is CommandName.ACCEPT and self.plan.open_ended and self.state in MEASURING:
            return Event.FINISH
        return Event(name.value)

    def _refuse(self, name: CommandName, operator: str, pose: str | None) -> Refusal | None:
        """Why a command would be refused now; None: it would be done."""
        ledger = self.ledger
        result = outcome_of(self.state, self._event_of(name))
        if isinstance(result, Refuse):
            return result.reason
        holder = ledger.operator
        free = name in (CommandName.START, CommandName.RESUME) or holder is None
        if not free and operator != holder:
            return Refusal.HELD_BY_OTHER
        if name in (CommandName.REDO, CommandName.SKIP):
            line = self._line_for(name, pose)
            if line is None:
                return Refusal.UNKNOWN_POSE if pose is not None else Refusal.NOT_NOW
            if line.open is (name is CommandName.REDO):
                return Refusal.NOT_NOW
        if name is CommandName.UNDO and not ledger.can_undo:
            return Refusal.NOTHING_TO_UNDO
        if name is CommandName.CAPTURE and (self.hold is None or not self.hold.long_enough):
            return Refusal.NOT_STILL
        if name is CommandName.ACCEPT and self.state is State.REVIEW:
            solved = self.solved
            if solved is None or not solved.may_be_accepted:
                return Refusal.NOT_SOLVED
        return None

    def allowed(self, operator: str | None = None) -> list[CommandName]:
        """What would not be refused now, to the operator who holds the session if none is named."""
        who = operator or self.ledger.operator or ""
        return [name for name in CommandName if self._refuse(name, who, None) is None]

    def _line_for(self, name: CommandName, pose: str | None) -> PoseLine | None:
        chosen = pose or (self.ledger.last_taken if name is CommandName.REDO else self.target_id)
        return self.ledger.lines.get(chosen) if chosen is not None else None

    # --- the machine -------------------------------------------------------------------------------------------

    def _event(self, event: Event, command: Command | None = None) -> None:
        """What `event` leads to. Where an entry cannot be written the state stays: an operator is told (StorageError),
        an observation will come again."""
        result: Outcome = outcome_of(self.state, event)
        if isinstance(result, Refuse):
            return
        try:
            self._do(result.action, event, command)
            self._clear(Fault.STORAGE)
        except StorageError as error:
            self._raise(Fault.STORAGE, str(error))
            if command is not None:
                raise
            if self.state is not State.CHECKING:
                return
            self.last_rejection = (Rejection.STORAGE, Rejection.STORAGE.text)
        self._enter(result)

    def _enter(self, step: Go) -> None:
        if step.to is None:
            return
        target = self._onward() if isinstance(step.to, Onward) else step.to
        if target is not State.CAPTURING and target is not State.CHECKING:
            self.hold = None
        if target is not self.state:
            self._since_s = self.now_s
            self._clear(Fault.WAITING_LONG)
        self.state = target
        if target is State.CHECKING:
            self._check()

    def _onward(self) -> State:
        ledger = self.ledger
        solved = self.solved is not None and self.solved.revision == ledger.revision
        return onward(
            waits_for_temperature=ledger.waits_for_temperature or self._unsteady,
            has_open=ledger.has_open,
            solved=solved,
        )

    def _keep(self, entry: Entry) -> None:
        """To the disk first, then into the ledger."""
        self._write(entry)
        self.ledger.apply(entry)
        self.seq += 1

    def _do(self, action: Action, event: Event, command: Command | None) -> None:
        operator = command.operator if command is not None else None
        match action:
            case Action.BEGIN:
                self._keep(entries.Began(operator or ""))
                self.started_s = self.now_s
            case Action.BEGIN_HOLD:
                pose = self.recognised.pose.id if self.recognised and self.recognised.pose else None
                rate = self.tracker.rate_hz or 1.0
                self.hold = Hold(pose, self.tracker.floor, self.tracker.allan, self.plan.limits, rate)
            case Action.REFUSE_HOLD:
                self._refuse_hold()
            case Action.TAKE:
                self._take()
            case Action.REFUSE_POSE:
                self._refuse_pose()
            case Action.REOPEN | Action.SKIP | Action.UNDO:
                self._edit(action, command)
            case Action.STAGE:
                self._unsteady = event is Event.UNSTEADY
                if not self._unsteady and self.ledger.waits_for_temperature:
                    self._keep(entries.StageReady(self.ledger.stage, self.tracker.temp_c))
            case Action.ASK_AGAIN:
                for pose, reason, text in self._again:
                    self._keep(entries.Reopened(pose, reason, text))
                    self.last_rejection = (reason, f"pose {pose}: {text}")
                self._again = ()
            case Action.CLOSE_PLAN:
                self._finish_hold()
                if self.plan.open_ended:
                    self._keep(entries.PlanClosed(operator))
            case Action.PAUSE:
                self._keep(entries.Paused(operator or ""))
            case Action.RESUME:
                self._keep(entries.Resumed(operator))
                self.tracker.stillness.forget()
            case Action.KEEP:
                self._accept(command)
            case Action.END:
                how = "aborted" if event is Event.ABORT else "rejected"
                note = (command.note or "") if command is not None else ""
                self._keep(entries.Ended(how, operator or "", self._wall(), None, note))
            case Action.REMIND:
                self._raise(Fault.WAITING_LONG)
            case Action.NONE | Action.ADD | Action.CLOSE_HOLD | Action.DROP_HOLD | Action.SOLVE | Action.SHOW:
                pass  # done where the readings are looked at, or by `_enter`

    def _edit(self, action: Action, command: Command | None) -> None:
        assert command is not None, "only operators edit"
        if action is Action.UNDO:
            self._keep(entries.Undone(command.operator))
        else:
            line = self._line_for(command.name, command.pose)
            assert line is not None, "refused before"
            if action is Action.SKIP:
                self._keep(entries.Skipped(line.id, command.operator))
            else:
                self._keep(entries.Reopened(line.id, Rejection.OPERATOR, command.note or "", command.operator))
        self._learn_again()

    def _accept(self, command: Command | None) -> None:
        assert command is not None and self.solved is not None, "refused before"
        now = self._wall()
        if self.solved.solution is not None:
            self.record = outcome.make_record(self.header, self.ledger, self.solved, now)
        name = self.record.id if self.record is not None else None
        self._keep(entries.Ended("accepted", command.operator, now, name, command.note or ""))

    # --- judging windows ---------------------------------------------------------------------------------------

    def _window(self, window: Window) -> None:
        hold = self.hold
        reference = hold.mean if hold is not None and len(hold.windows) >= LOOK_BACK else None
        self.tracker.judge(window, reference)
        if self.state is State.SOAKING:
            stage = self.plan.stages[self.ledger.stage]
            self._set(Fault.NO_TEMPERATURE, stage.temp_c is not None and self.tracker.temp_c is None)
            if self.tracker.at_temperature(stage):
                self._event(Event.STEADY)
        elif self.state in LIVE:
            if self.tracker.left_temperature(self.plan.stages[self.ledger.stage]):
                self._blame = (Rejection.TEMPERATURE, "")
                self._event(Event.UNSTEADY)
            elif self.plan.open_ended:
                self._window_by_hand(window)
            else:
                self._window_at_bench(window)

    def _window_at_bench(self, window: Window) -> None:
        still = self.tracker.stillness.still
        self.recognised = recognise(window.mean, self._model, self.candidates(), self.target, self.plan.limits)
        pose = self.recognised.pose
        hold = self.hold
        if hold is not None:
            if pose is None or pose.id != hold.pose:
                self._blame = (Rejection.WRONG_POSE, "") if still else (self.tracker.stillness.cause, "")
                self._event(Event.AWAY)
            elif not still:
                self._blame = (self.tracker.stillness.cause, "")
                self._event(Event.AT_POSE)
            else:
                self._lengthen(hold, window)
            return
        if not still or pose is None or pose.id != self._must_leave:
            self._must_leave = None
        if pose is not None and pose.open and pose.id != self._must_leave:
            self._elsewhere = 0
            self._clear(Fault.AXES_SUSPECT)
            self._event(Event.STILL if still else Event.AT_POSE)
            return
        self._event(Event.AWAY)
        self._elsewhere = self._elsewhere + 1 if still else 0
        if self._elsewhere == STILL_ELSEWHERE:
            self._still_elsewhere(window, pose)

    def _still_elsewhere(self, window: Window, pose: Candidate | None) -> None:
        """The tool rests, but at no open pose."""
        if pose is not None:
            if pose.id not in (self.ledger.last_taken, self._must_leave):
                self.last_rejection = (Rejection.REPEATED, f"pose {pose.id}: {Rejection.REPEATED.text}")
                self._note_refusal(entries.Refused(pose.id, Rejection.REPEATED))
            return
        target = self.target
        if target is not None and self.ledger.last_taken is None:
            fits = axes_that_fit(window.mean, self._model, target, self.plan.limits)
            self._set(Fault.AXES_SUSPECT, bool(fits), f"axes {fits[0]} would fit" if fits else "")

    def _window_by_hand(self, window: Window) -> None:
        still = self.tracker.stillness.still
        hold = self.hold
        if hold is not None:
            if still:
                self._lengthen(hold, window)
                return
            del hold.windows[-TRIM_WINDOWS:]
            self._blame = (Rejection.TOO_SHORT, "")
            self._event(Event.FULL if hold.long_enough else Event.AWAY)
            return
        self._event(Event.STILL if still and not self._is_last(window.mean, SAME_ATTITUDE_DEG) else Event.AWAY)

    def _is_last(self, mean: Array, within_deg: float) -> bool:
        """Whether an attitude is that of the pose taken last (its longest hold is kept already)."""
        last = self.ledger.last_taken
        readings = self.ledger.lines[last].readings if last is not None else None
        if readings is None or readings.n < self.plan.limits.max_hold_s * (self.tracker.rate_hz or 1.0) * 0.9:
            return False
        return bool(np.linalg.norm(mean - np.array(readings.mean())) < np.deg2rad(within_deg))

    def _lengthen(self, hold: Hold, window: Window) -> None:
        hold.add(window)
        self._event(Event.STILL)
        if (hold.elapsed_s >= self.plan.limits.max_hold_s) if self.plan.open_ended else hold.full():
            self._event(Event.FULL)

    def _spoil(self, reason: Rejection, detail: str) -> None:
        if self.hold is not None:
            self._blame = (reason, detail)
            if self.plan.open_ended:
                self._finish_hold()
            self._event(Event.BROKEN)

    def _finish_hold(self) -> None:
        """The stream is over: what was held long enough counts."""
        if self.hold is not None and self.hold.long_enough and self.state is State.CAPTURING:
            self._event(Event.FULL)

    # --- poses -------------------------------------------------------------------------------------------------

    def _check(self) -> None:
        """A hold is complete: take it or refuse it. Ends with the state onward."""
        assert self.hold is not None, "a hold leads here"
        mirrored = self.tracker.mirrored() is True
        self._judged = judge_hold(self.ledger, self.hold, mirrored=mirrored, same_deg=SAME_ATTITUDE_DEG)
        self._event(Event.GOOD if self._judged.good else Event.BAD)

    def _take(self) -> None:
        judged = self._judged
        assert judged is not None and isinstance(judged.entry, entries.Taken) and self.hold is not None
        asked_for, taken = self.target, judged.entry
        self._keep(taken)
        self.hold.learn()
        self.last_rejection = None
        other = asked_for is not None and asked_for.id != taken.pose
        detail = f"asked for {asked_for.id}, found {taken.pose}" if asked_for is not None else ""
        self._set(Fault.NOT_AS_ASKED, other, detail)
        for fault in (Fault.MIRRORED, Fault.NOT_ONE_G, Fault.FROZEN, Fault.NOT_STILL, Fault.AXES_SUSPECT):
            self._clear(fault)
        for again in contradictions(self.ledger, judged):
            self._keep(again)
            self.last_rejection = (again.reason, f"pose {again.pose}: {again.reason.text}")
            self._must_leave = again.pose
        self._learn_again()

    def _refuse_pose(self) -> None:
        judged = self._judged
        entry = judged.entry if judged is not None else None
        if not isinstance(entry, entries.Refused):
            return
        self.last_rejection = (
            entry.reason,
            f"{entry.reason.text} ({entry.detail})" if entry.detail else entry.reason.text,
        )
        fault = _FAULT_OF.get(entry.reason)
        if fault is not None:
            self._raise(fault, entry.detail)
        if entry.reason is Rejection.OUTLIER:
            self._must_leave = entry.pose
        self._note_refusal(entry)

    def _refuse_hold(self) -> None:
        """A hold was spoilt. Said, and written down if it had lasted a second."""
        blame, self._blame = self._blame, None
        hold = self.hold
        if hold is None or hold.elapsed_s < 1.0:
            return
        reason, detail = blame or (Rejection.MOVED, "")
        if self.plan.open_ended and reason in (Rejection.MOVED, Rejection.SHAKEN, Rejection.TOO_SHORT):
            return  # hands between two attitudes
        self.last_rejection = (reason, reason.text)
        self._note_refusal(entries.Refused(hold.pose, reason, detail))

    def _note_refusal(self, entry: entries.Refused) -> None:
        """Write a refusal down, but not the same one over and over."""
        key = (entry.pose, entry.reason)
        self._same_refusals = self._same_refusals + 1 if key == self._refused_last else 0
        self._refused_last = key
        if self._same_refusals < MAX_SAME_REFUSALS:
            self._keep(entry)

    def _learn_again(self) -> None:
        """The poses changed: the provisional fit follows."""
        lines = [(line, line.readings) for line in self.ledger.done]
        if self.plan.reference == "pose" and lines:
            a = np.array([r.mean() if r is not None else (0.0, 0.0, 0.0) for _, r in lines]).T
            inc = [float(line.inc_deg or 0.0) for line, _ in lines]
            tf = [float(line.tf_deg or 0.0) for line, _ in lines]
            self._model = Provisional.fit(inc, tf, a, self.plan.limits)
        else:
            self._model = Provisional.fit((), (), np.zeros((3, 0)), self.plan.limits)

    # --- what is asked for -------------------------------------------------------------------------------------

    @property
    def model(self) -> Provisional:
        """The sensor as far as it is known; for guidance alone."""
        return self._model

    @property
    def target_id(self) -> str | None:
        target = self.target
        return target.id if target is not None else None

    @property
    def target(self) -> Candidate | None:
        """The pose asked for: the one under way, else the first open one of the plan, those asked for again first."""
        lines = self.ledger.open_lines
        if not lines or self.plan.open_ended:
            return None
        under_way = self.hold.pose if self.hold is not None else None
        chosen = next((line for line in lines if line.id == under_way), None)
        chosen = chosen or next((line for line in lines if line.state is PoseState.AGAIN), lines[0])
        return _candidate(chosen)

    def candidates(self) -> list[Candidate]:
        """The poses of the present stage."""
        stage = self.ledger.stage
        return [_candidate(line) for line in self.ledger.lines.values() if line.stage == stage]

    @property
    def back_to(self) -> State | None:
        """Where a pause or a loss of data leads back to."""
        return self._onward() if self.state in (State.PAUSED, State.NO_DATA) else None

    @property
    def must_leave(self) -> str | None:
        return self._must_leave

    # --- faults ------------------------------------------------------------------------------------------------

    def _at(self, now_s: float) -> None:
        if not self._since_s:
            self._since_s = now_s
        self.now_s = now_s

    def _set(self, fault: Fault, wrong: bool, detail: str = "") -> None:
        if wrong:
            self._raise(fault, detail)
        else:
            self._clear(fault)

    def _raise(self, fault: Fault, detail: str = "") -> None:
        since = self.faults[fault][0] if fault in self.faults else self.now_s
        self.faults[fault] = (since, detail)

    def _clear(self, fault: Fault) -> None:
        self.faults.pop(fault, None)


_FAULT_OF = {
    Rejection.MIRRORED: Fault.MIRRORED,
    Rejection.NOT_ONE_G: Fault.NOT_ONE_G,
    Rejection.FROZEN: Fault.FROZEN,
    Rejection.SHAKEN: Fault.NOT_STILL,
}


def _candidate(line: PoseLine) -> Candidate:
    return Candidate(line.id, float(line.inc_deg or 0.0), float(line.tf_deg or 0.0), line.open)

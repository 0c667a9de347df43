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

from highside.calibration.record import CalibrationRecord
from highside.codec.frame import Frame
from highside.session import ledger as entries
from highside.session import outcome
from highside.session.commands import Replies, event_of, line_for, refusal
from highside.session.faults import Faults
from highside.session.guidance import Candidate, Provisional
from highside.session.hold import Hold
from highside.session.journal import Header
from highside.session.judge import Judged, contradictions, judge_hold
from highside.session.ledger import Entry, Ledger
from highside.session.machine import LIVE, MEASURING, Action, Event, Go, Onward, Outcome, Refuse, onward
from highside.session.machine import outcome as outcome_of
from highside.session.reasons import Fault, Refusal, Rejection
from highside.session.snapshot import Command, CommandName, Reply, State
from highside.session.stillness import Window
from highside.session.tracker import Gap, Tracker
from highside.session.watch import SAME_ATTITUDE_DEG, Watch

DATA_LOST_S = 2.0
MAX_SAME_REFUSALS = 3


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
        self.faults = Faults()
        self.watch = Watch(self.ledger, self.tracker, self.faults)
        self.last_rejection: tuple[Rejection, str] | None = None
        self.seq = 0
        self.now_s = 0.0
        self.started_s: float | None = None
        self._write = write
        self._wall = wall
        self._replies = Replies()
        self._judged: Judged | None = None
        self._again: tuple[tuple[str, Rejection, str], ...] = ()
        self._working = False
        self._unsteady = False
        self._refused_last: tuple[str | None, Rejection] | None = None
        self._same_refusals = 0
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
        self.watch.learn_again()

    # --- what comes in -----------------------------------------------------------------------------------------

    def readings(self, frames: Sequence[Frame], now_s: float) -> None:
        """Frames of the tool, in order of arrival; raw, their axes mapped."""
        self._at(now_s)
        if not frames:
            return
        self._last_data_s = now_s
        self.faults.clear(Fault.NO_DATA, Fault.LINK_DOWN)
        if self.state is State.NO_DATA:
            self._event(Event.DATA_BACK)
        for item in self.tracker.windows(frames):
            if isinstance(item, Gap):
                self.faults.put(Fault.LOST_FRAMES, f"{item.missing_s:+.2f} s")
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
                self.faults.put(Fault.NO_DATA)
                self.tracker.forget()
            self.watch.blame = (Rejection.DATA_LOST, "")
            if self.state in MEASURING and self.state is not State.NO_DATA:
                self._event(Event.DATA_LOST)
        if self.state is not State.PAUSED and now_s - self._since_s > self.plan.limits.remind_s:
            self._event(Event.LONG_WAIT)

    def link_down(self, message: str, now_s: float) -> None:
        """The link has failed; it is tried again by whoever owns it."""
        self._at(now_s)
        self.faults.put(Fault.LINK_DOWN, message)
        self.tracker.forget()
        self.watch.blame = (Rejection.DATA_LOST, message)
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
        self.faults.put(Fault.CLOCK_STEP, f"{by_s:+.0f} s")
        try:
            self._keep(entries.Noted("clock_step", f"{by_s:+.3f} s"))
        except StorageError as error:
            self.faults.put(Fault.STORAGE, str(error))

    def command(self, command: Command, now_s: float) -> Reply:
        """Do what an operator asks, or say why not. Repeated request ids get the first answer."""
        self._at(now_s)
        known = self._replies.before(command)
        if known is not None:
            return known
        refused, detail = self._refuse(command.name, command.operator, command.pose), ""
        if refused is None:
            try:
                self._event(event_of(command.name, self.state, self.ledger), command)
            except StorageError as error:
                refused, detail = Refusal.STORAGE, str(error)
        self.seq += 1
        return self._replies.give(command, refused, detail, self.state, self.seq)

    def allowed(self, operator: str | None = None) -> list[CommandName]:
        """What would not be refused now, to the operator who holds the session if none is named."""
        who = operator or self.ledger.operator or ""
        return [name for name in CommandName if self._refuse(name, who, None) is None]

    def _refuse(self, name: CommandName, operator: str, pose: str | None) -> Refusal | None:
        return refusal(
            name,
            operator,
            pose,
            state=self.state,
            ledger=self.ledger,
            target=self._target_id,
            hold=self.hold,
            solved=self.solved,
        )

    @property
    def _target_id(self) -> str | None:
        target = self.target
        return None if target is None else target.id

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
        self._again = () if self.plan.open_ended else outcome.to_ask_again(solved, self.ledger)
        if self._again:
            self._event(Event.AGAIN)
            return
        if solved.again:
            self.faults.put(Fault.CONTRADICTION, solved.again[0][2])
        else:
            self.faults.clear(Fault.CONTRADICTION)
        self._event(Event.SOLVED)

    # --- the machine -------------------------------------------------------------------------------------------

    def _event(self, event: Event, command: Command | None = None) -> None:
        """What `event` leads to. Where an entry cannot be written the state stays: an operator is told (StorageError),
        an observation will come again."""
        result: Outcome = outcome_of(self.state, event)
        if isinstance(result, Refuse):
            return
        try:
            self._do(result.action, event, command)
        except StorageError as error:
            self.faults.put(Fault.STORAGE, str(error))
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
            self.watch.hold = None
        if target is not self.state:
            self._since_s = self.now_s
            self.faults.clear(Fault.WAITING_LONG)
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
        self.faults.clear(Fault.STORAGE)
        self.ledger.apply(entry)
        self.seq += 1

    def _do(self, action: Action, event: Event, command: Command | None) -> None:
        operator = command.operator if command is not None else None
        match action:
            case Action.BEGIN:
                self._keep(entries.Began(operator or ""))
                self.started_s = self.now_s
            case Action.BEGIN_HOLD:
                self.watch.begin_hold()
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
                self.faults.put(Fault.WAITING_LONG)
            case Action.NONE | Action.ADD | Action.CLOSE_HOLD | Action.SHOW:
                pass  # done where the readings are looked at, or by `_enter`

    def _edit(self, action: Action, command: Command | None) -> None:
        assert command is not None, "only operators edit"
        if action is Action.UNDO:
            self._keep(entries.Undone(command.operator))
        else:
            line = line_for(command.name, command.pose, self.ledger, self._target_id)
            assert line is not None, "refused before"
            if action is Action.SKIP:
                self._keep(entries.Skipped(line.id, command.operator))
            else:
                self._keep(entries.Reopened(line.id, Rejection.OPERATOR, command.note or "", command.operator))
        self.watch.learn_again()

    def _accept(self, command: Command | None) -> None:
        assert command is not None and self.solved is not None, "refused before"
        now = self._wall()
        if self.solved.solution is not None:
            self.record = outcome.make_record(self.header, self.ledger, self.solved, now)
        name = self.record.id if self.record is not None else None
        self._keep(entries.Ended("accepted", command.operator, now, name, command.note or ""))

    # --- judging windows ---------------------------------------------------------------------------------------

    def _window(self, window: Window) -> None:
        self.tracker.judge(window, self.watch.reference())
        if self.state is State.SOAKING:
            stage = self.plan.stages[self.ledger.stage]
            self.faults.set(Fault.NO_TEMPERATURE, stage.temp_c is not None and self.tracker.temp_c is None)
            if self.tracker.at_temperature(stage):
                self._event(Event.STEADY)
        elif self.state in LIVE:
            for event in self.watch.look(window):
                self._event(event)
            if self.watch.repeated is not None:
                pose, self.watch.repeated = self.watch.repeated, None
                self.last_rejection = (Rejection.REPEATED, f"pose {pose}: {Rejection.REPEATED.text}")
                self._note_refusal(entries.Refused(pose, Rejection.REPEATED))

    def _spoil(self, reason: Rejection, detail: str) -> None:
        if self.hold is not None:
            self.watch.blame = (reason, detail)
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
        self.faults.set(Fault.NOT_AS_ASKED, other, detail)
        self.faults.clear(*_FAULT_OF.values(), Fault.AXES_SUSPECT)
        for again in contradictions(self.ledger, judged):
            self._keep(again)
            self.last_rejection = (again.reason, f"pose {again.pose}: {again.reason.text}")
            self.watch.must_leave = again.pose
        self.watch.learn_again()

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
            self.faults.put(fault, entry.detail)
        if entry.reason is Rejection.OUTLIER:
            self.watch.must_leave = entry.pose
        self._note_refusal(entry)

    def _refuse_hold(self) -> None:
        """A hold was spoilt. Said, and written down if it had lasted a second."""
        blame, self.watch.blame = self.watch.blame, None
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

    # --- what is asked for -------------------------------------------------------------------------------------

    @property
    def hold(self) -> Hold | None:
        """The hold under way."""
        return self.watch.hold

    @property
    def model(self) -> Provisional:
        """The sensor as far as it is known; for guidance alone."""
        return self.watch.model

    @property
    def target(self) -> Candidate | None:
        """The pose asked for."""
        return self.watch.target

    @property
    def must_leave(self) -> str | None:
        """A pose that has to be set anew before it is measured again."""
        return self.watch.must_leave

    @property
    def back_to(self) -> State | None:
        """Where a pause or a loss of data leads back to."""
        return self._onward() if self.state in (State.PAUSED, State.NO_DATA) else None

    def _at(self, now_s: float) -> None:
        if not self._since_s:
            self._since_s = now_s
        self.now_s = self.faults.now_s = now_s


_FAULT_OF = {
    Rejection.MIRRORED: Fault.MIRRORED,
    Rejection.NOT_ONE_G: Fault.NOT_ONE_G,
    Rejection.FROZEN: Fault.FROZEN,
    Rejection.SHAKEN: Fault.NOT_STILL,
}

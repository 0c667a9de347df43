"""A bench session: readings and commands in, journal entries and snapshots out. Pure; the clock comes with each call.

`machine` says what a state and an event lead to; this module finds the events (it looks at the readings, by `watch`)
and steps from state to state; `actions` does what belongs to a step.

Who drives it calls `readings` with what the tool sends, `tick` from time to time, `command` for each command, and, when
`work()` gives a job, runs it (in a thread, if it likes) and hands the answer to `finish_work`. In the same way
`look_ahead()` gives, after each pose, the job of saying how good the calibration would be by now.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from highside.bench.session import entries, force, outcome
from highside.bench.session.actions import Actions
from highside.bench.session.commands import Origin, Replies, event_of, holder_of, refusal
from highside.bench.session.entries import Entry
from highside.bench.session.faults import Faults
from highside.bench.session.force import InForce, Store, StoreError
from highside.bench.session.guidance import CandidatePose, Provisional
from highside.bench.session.hold import Hold
from highside.bench.session.journal import Header, StorageError
from highside.bench.session.ledger import Ledger
from highside.bench.session.machine import LIVE, MEASURING, Action, Go, Onward, Outcome, Refuse, SessionEvent, onward
from highside.bench.session.machine import outcome as outcome_of
from highside.bench.session.reasons import Fault, Refusal, Rejection
from highside.bench.session.snapshot import Command, CommandName, Reply, SessionState, UncertaintyState
from highside.bench.session.stillness import ReadingWindow
from highside.bench.session.time_to_go import Pace
from highside.bench.session.tracker import Gap, Tracker
from highside.bench.session.watch import Watch
from highside.calibration.record import CalibrationRecord
from highside.codec.frame import Frame

DATA_LOST_S = 2.0
STALE_S, STALE_WINDOWS = 1.0, 4.0
"""What the tool said so long ago, or so many windows, is shown as a present value no more; the session waits longer."""


class BenchSession:
    """See the module's docstring. `write` keeps an entry for good or raises StorageError; `wall` is the UTC clock;
    `store` is asked to put the calibration in force (None: it cannot be); `pace`: of a journal that is gone on with."""

    def __init__(
        self,
        header: Header,
        write: Callable[[Entry], None],
        wall: Callable[[], float],
        *,
        ledger: Ledger | None = None,
        known_noise_g: float | None = None,
        store: Store | None = None,
        pace: Pace | None = None,
    ) -> None:
        self.header = header
        self.plan = header.plan
        self.ledger = ledger or Ledger(header.plan)
        self.tracker = Tracker(header.plan.limits, known_noise_g)
        self.state = SessionState.IDLE
        self.faults = Faults()
        self.watch = Watch(self.ledger, self.tracker, self.faults)
        self.pace = pace or Pace()
        self.actions = Actions(
            header, self.ledger, self.tracker, self.watch, self.faults, write, wall, store, self.pace
        )
        self.now_s = 0.0
        self.started_s: float | None = None
        self._moments = 0
        self._replies = Replies()
        self._working = False
        self._so_far: tuple[int, UncertaintyState | None] | None = None
        self._looking_ahead = False
        self._last_data_s: float | None = None
        self.stale = False
        """nothing came for so long that what came last is no present value"""
        self._since_s = 0.0
        if self.ledger.began:
            self._go_on()

    def _go_on(self) -> None:
        """A journal was read back: wait, paused, for an operator to go on (or stay ended)."""
        ended = self.ledger.ended
        self.state = SessionState(ended.how) if ended is not None else SessionState.PAUSED
        if ended is not None:
            self.actions.end_again(ended)
        self.watch.go_on()

    @property
    def seq(self) -> int:
        """Grows with every change."""
        return self._moments + self.actions.kept

    @property
    def solved(self) -> outcome.Solved | None:
        """The solver's answer for the poses as they were then."""
        return self.actions.solved

    @property
    def record(self) -> CalibrationRecord | None:
        """The record of an accepted session."""
        return self.actions.record

    @property
    def in_force(self) -> InForce | None:
        """What the store has in force; None until a record was accepted."""
        return self.actions.in_force

    @property
    def last_rejection(self) -> tuple[Rejection, str] | None:
        return self.actions.last_rejection

    # --- what comes in -----------------------------------------------------------------------------------------

    def readings(self, frames: Sequence[Frame], now_s: float) -> None:
        """Frames of the tool, in order of arrival; raw, their axes mapped."""
        self._at(now_s)
        if not frames:
            return
        self._last_data_s = now_s
        self.stale = False
        self.faults.clear(Fault.NO_DATA, Fault.LINK_DOWN)
        if self.state is SessionState.NO_DATA:
            self._event(SessionEvent.DATA_BACK)
        for item in self.tracker.windows(frames):
            if isinstance(item, Gap):
                self.faults.put(Fault.LOST_FRAMES, f"{item.missing_s:+.2f} s")
                self._spoil(Rejection.GAP, f"{item.missing_s:+.2f} s of the tool's time")
            else:
                self._window(item)
        self._moments += 1

    def tick(self, now_s: float) -> None:
        """Time passes, whether or not anything arrives."""
        self._at(now_s)
        if self._last_data_s is None:
            self._last_data_s = now_s
        silent_s = now_s - self._last_data_s
        if not self.stale and silent_s > max(STALE_S, STALE_WINDOWS * self.tracker.window_s):
            self.stale = True
            self._moments += 1
        if silent_s > DATA_LOST_S:
            if Fault.NO_DATA not in self.faults:
                self.faults.put(Fault.NO_DATA)
                self.tracker.forget()
            self.watch.blame = (Rejection.DATA_LOST, "")
            if self.state in MEASURING and self.state is not SessionState.NO_DATA:
                self._event(SessionEvent.DATA_LOST)
        if self.state is not SessionState.PAUSED and now_s - self._since_s > self.plan.limits.remind_s:
            self._event(SessionEvent.LONG_WAIT)

    def link_down(self, message: str, now_s: float) -> None:
        """The link has failed; it is tried again by whoever owns it."""
        self._at(now_s)
        self.faults.put(Fault.LINK_DOWN, message)
        self.tracker.forget()
        self.watch.blame = (Rejection.DATA_LOST, message)
        if self.state in MEASURING and self.state is not SessionState.NO_DATA:
            self._event(SessionEvent.DATA_LOST)

    def data_ended(self, now_s: float) -> None:
        """A recording that is played is over."""
        self._at(now_s)
        if self.state in MEASURING:
            self._finish_hold()
            if self.plan.open_ended:
                self._event(SessionEvent.DATA_ENDED)

    def clock_stepped(self, by_s: float, now_s: float) -> None:
        """The wall clock was set. Nothing here goes by it but the times in journal and record."""
        self._at(now_s)
        self.faults.put(Fault.CLOCK_STEP, f"{by_s:+.0f} s")
        try:
            self.actions.keep(entries.Noted("clock_step", f"{by_s:+.3f} s"))
        except StorageError as error:
            self.faults.put(Fault.STORAGE, str(error))

    def command(self, command: Command, now_s: float, origin: Origin = Origin.HERE) -> Reply:
        """Do what an operator asks, or say why not. Repeated request ids get the first answer."""
        self._at(now_s)
        holder = holder_of(command, origin)
        known = self._replies.before(command, holder, self.state, self.seq)
        if known is not None:
            return known
        refused, detail = self._refuse(command.name, command.operator, holder, command.pose), ""
        if refused is None and command.name in force.COMMANDS:
            name = None if self.record is None else self.record.id
            wrong = force.not_confirmed(command, name, self.in_force or InForce())
            refused, detail = (None, "") if wrong is None else (Refusal.NOT_CONFIRMED, wrong)
        if refused is None:
            try:
                self.actions.holder = holder
                self._event(event_of(command.name, self.state, self.ledger), command)
            except StorageError as error:
                refused, detail = Refusal.STORAGE, str(error)
            except StoreError as error:
                refused, detail = Refusal.STORE, str(error)
        self._moments += 1
        return self._replies.give(command, holder, refused, detail, self.state, self.seq)

    def allowed(self, operator: str | None = None) -> list[CommandName]:
        """What would not be refused now, to the operator who holds the session if none is named."""
        who, target = operator or self.ledger.operator or "", self.target
        holder = self.ledger.holder or Origin.HERE
        return [name for name in CommandName if self._refuse(name, who, holder, None, target) is None]

    def _refuse(
        self, name: CommandName, operator: str, holder: str, pose: str | None, target: CandidatePose | None = None
    ) -> Refusal | None:
        target = target or (self.target if name in (CommandName.SKIP, CommandName.REDO) and pose is None else None)
        return refusal(
            name,
            operator,
            pose,
            holder=holder,
            state=self.state,
            ledger=self.ledger,
            target=None if target is None else target.id,
            hold=self.hold,
            solved=self.solved,
            record=None if self.record is None else self.record.id,
            in_force=self.in_force,
        )

    def remark(self, operator: str, text: str, now_s: float) -> None:
        """Keep what an operator wishes the reader to know; it decides nothing. Raises StorageError."""
        self._at(now_s)
        self.actions.keep(entries.Noted("remark", f"{operator}: {text}"))

    def photographed(self, entry: entries.Photographed, now_s: float) -> None:
        """Keep what a photograph is known by; its file is on the disk already. Raises StorageError."""
        self._at(now_s)
        self.actions.keep(entry)

    def note_interruption(self) -> None:
        """This journal is gone on with by a new process: an operator has to resume, and then holds the session."""
        if not self.state.ended:
            self.actions.keep(entries.Noted("interrupted", "the process was started again"))
            self.actions.keep(entries.Resumed(None))

    def work(self) -> Callable[[], outcome.Solved] | None:
        """The job to be run now, once; its answer goes to `finish_work`."""
        if self.state is not SessionState.SOLVING or self._working:
            return None
        self._working = True
        return partial(outcome.solve, self.ledger, self.header.judged)

    def finish_work(self, solved: outcome.Solved, now_s: float) -> None:
        """The solver has answered."""
        self._at(now_s)
        self._working = False
        if self.state is not SessionState.SOLVING:
            return
        self.actions.solved = solved
        self.actions.again = () if self.plan.open_ended else outcome.to_measure_again(solved, self.ledger)
        if self.actions.again:
            self._event(SessionEvent.AGAIN)
            return
        if solved.again:
            self.faults.put(Fault.CONTRADICTION, solved.again[0][2])
        else:
            self.faults.clear(Fault.CONTRADICTION)
        self._event(SessionEvent.SOLVED)

    def look_ahead(self) -> Callable[[], UncertaintyState | None] | None:
        """The job of saying what the result would state if the session ended with the poses taken so far, once for
        each change of them; its answer goes to `finish_look_ahead`. What it works on does not change meanwhile."""
        revision = self.ledger.revision
        known = self._so_far is not None and self._so_far[0] == revision
        if known or self._looking_ahead or not self.plan.kind.calibrates or self.state not in MEASURING:
            return None
        self._looking_ahead = True
        self._so_far = (revision, self.uncertainty)
        return partial(outcome.solve_so_far, self.ledger.solver_columns(), self.ledger.request(), self.plan)

    def finish_look_ahead(self, uncertainty: UncertaintyState | None) -> None:
        """The answer of `look_ahead`'s job."""
        self._looking_ahead = False
        if self._so_far is not None:
            self._so_far = (self._so_far[0], uncertainty)
        self._moments += 1

    @property
    def uncertainty(self) -> UncertaintyState | None:
        """What the calibration states of itself: the solution's, else that of the poses so far; None: none follows."""
        solved = self.solved
        if solved is not None and solved.revision == self.ledger.revision:
            return solved.uncertainty
        return None if self._so_far is None else self._so_far[1]

    @property
    def to_go_s(self) -> float | None:
        """What the poses still open will take, warming up not counted; None where that cannot be known."""
        waits = self.state in MEASURING or self.state is SessionState.PAUSED
        if self.plan.open_ended or not waits:
            return None
        poses = sum(line.open for line in self.ledger.lines.values())
        hold = None if self.hold is None else (self.hold.elapsed_s, self.hold.progress()) if self.hold.windows else None
        return self.pace.to_go_s(poses, self.now_s, hold=hold)

    # --- the machine -------------------------------------------------------------------------------------------

    def _event(self, event: SessionEvent, command: Command | None = None) -> None:
        """What `event` leads to. Where an entry cannot be written the state stays: an operator is notified
        (StorageError), an observation will come again."""
        result: Outcome = outcome_of(self.state, event)
        if isinstance(result, Refuse):
            return
        try:
            self._do(result.action, event, command)
        except StorageError as error:
            self.faults.put(Fault.STORAGE, str(error))
            if command is not None:
                raise
            if self.state is not SessionState.CHECKING:
                return
            self.actions.last_rejection = (Rejection.STORAGE, Rejection.STORAGE.text)
        self._enter(result)

    def _enter(self, step: Go) -> None:
        if step.to is None:
            return
        target = self._onward() if isinstance(step.to, Onward) else step.to
        if target is not SessionState.CAPTURING and target is not SessionState.CHECKING:
            self.watch.hold = None
        if target is SessionState.NO_DATA:
            self.pace.halt()
        if target is not self.state:
            self._since_s = self.now_s
            self.faults.clear(Fault.WAITING_LONG)
        self.state = target
        if target is SessionState.CHECKING:
            # takes no time: the state is onward again before anybody looks
            self._event(SessionEvent.GOOD if self.actions.check() else SessionEvent.BAD)

    def _onward(self) -> SessionState:
        ledger = self.ledger
        solved = self.solved is not None and self.solved.revision == ledger.revision
        return onward(
            waits_for_temperature=ledger.waits_for_temperature or self.actions.unsteady,
            has_open=ledger.has_open,
            solved=solved,
        )

    def _do(self, action: Action, event: SessionEvent, command: Command | None) -> None:
        if action is Action.CLOSE_PLAN:
            self._finish_hold()
        self.actions.do(action, event, command)
        if action is Action.BEGIN:
            self.started_s = self.now_s

    # --- judging windows ---------------------------------------------------------------------------------------

    def _window(self, window: ReadingWindow) -> None:
        self.tracker.judge(window, self.watch.reference())
        if self.state is SessionState.SOAKING:
            stage = self.plan.stages[self.ledger.stage]
            self.faults.set(Fault.NO_TEMPERATURE, stage.temp_c is not None and self.tracker.temp_c is None)
            if self.tracker.at_temperature(stage):
                self._event(SessionEvent.STEADY)
        elif self.state in LIVE:
            for event in self.watch.look(window):
                self._event(event)
            if self.watch.repeated is not None:
                pose, self.watch.repeated = self.watch.repeated, None
                self.actions.last_rejection = (Rejection.REPEATED, f"pose {pose}: {Rejection.REPEATED.text}")
                self.actions.note_refusal(entries.RefusedHold(pose, Rejection.REPEATED))

    def _spoil(self, reason: Rejection, detail: str) -> None:
        if self.hold is not None:
            self.watch.blame = (reason, detail)
            if self.plan.open_ended:
                self._finish_hold()
            self._event(SessionEvent.BROKEN)

    def _finish_hold(self) -> None:
        """The stream is over: what was held long enough counts."""
        if self.hold is not None and self.hold.long_enough and self.state is SessionState.CAPTURING:
            self._event(SessionEvent.FULL)

    # --- what is requested -------------------------------------------------------------------------------------

    @property
    def hold(self) -> Hold | None:
        """The hold under way."""
        return self.watch.hold

    @property
    def model(self) -> Provisional:
        """The sensor as far as it is known; for guidance alone."""
        return self.watch.model

    @property
    def target(self) -> CandidatePose | None:
        """The pose requested."""
        return self.watch.target

    @property
    def must_leave(self) -> str | None:
        """A pose that has to be set anew before it is measured again."""
        return self.watch.must_leave

    @property
    def alike(self) -> str | None:
        """A pose at which the tool stands and which reads like the target: it has to be left first."""
        return self.watch.alike

    @property
    def back_to(self) -> SessionState | None:
        """Where a pause or a loss of data leads back to."""
        return self._onward() if self.state in (SessionState.PAUSED, SessionState.NO_DATA) else None

    def _at(self, now_s: float) -> None:
        if not self._since_s:
            self._since_s = now_s
        self.now_s = self.faults.now_s = now_s

"""What is done with a step of the session: journal entries, poses judged, records and verdicts.

`machine` says which action belongs to a step; this module does it. An entry is written first (`write`) and then applied
to the ledger, so that what is not on the disk has not happened.
"""

from __future__ import annotations

from collections.abc import Callable

from highside.bench.session import entries, force, outcome
from highside.bench.session.commands import line_for
from highside.bench.session.entries import Entry
from highside.bench.session.faults import Faults
from highside.bench.session.force import InForce, Store, StoreError
from highside.bench.session.journal import Header, StorageError
from highside.bench.session.judge import JudgedHold, contradictions, judge_hold
from highside.bench.session.ledger import Ledger
from highside.bench.session.machine import Action, SessionEvent
from highside.bench.session.reasons import Fault, Rejection
from highside.bench.session.snapshot import Command, CommandName
from highside.bench.session.time_to_go import Pace
from highside.bench.session.tracker import Tracker
from highside.bench.session.watch import SAME_ATTITUDE_DEG, Watch
from highside.calibration.record import CalibrationRecord

MAX_SAME_REFUSALS = 3


class Actions:
    """`solved`, `record`, `last_rejection`, `unsteady` and `again` are the session's, changed here."""

    def __init__(
        self,
        header: Header,
        ledger: Ledger,
        tracker: Tracker,
        watch: Watch,
        faults: Faults,
        write: Callable[[Entry], None],
        wall: Callable[[], float],
        store: Store | None,
        pace: Pace,
    ) -> None:
        self.header = header
        self.plan = header.plan
        self.ledger = ledger
        self.tracker = tracker
        self.watch = watch
        self.faults = faults
        self.solved: outcome.Solved | None = None
        self.record: CalibrationRecord | None = None
        self.in_force: InForce | None = None
        self.last_rejection: tuple[Rejection, str] | None = None
        self.unsteady = False
        self.again: tuple[tuple[str, Rejection, str], ...] = ()
        self.kept = 0
        """entries written since the beginning of this process"""
        self.holder: str | None = None
        """what the command that is being done proves of who gave it"""
        self._write = write
        self._wall = wall
        self._store = store
        self._pace = pace
        self._judged: JudgedHold | None = None
        self._refused_last: tuple[str | None, Rejection] | None = None
        self._same_refusals = 0

    def keep(self, entry: Entry) -> None:
        """To the disk first, then into the ledger. Raises StorageError, and then nothing has happened."""
        self._write(entry)
        self.faults.clear(Fault.STORAGE)
        self.ledger.apply(entry)
        self._pace.note(entry, self.faults.now_s)
        self.kept += 1

    def do(self, action: Action, event: SessionEvent, command: Command | None) -> None:
        """One action of the table. Raises StorageError, and StoreError."""
        operator = command.operator if command is not None else None
        match action:
            case Action.BEGIN:
                self.keep(entries.Began(operator or "", self.holder))
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
                self.unsteady = event is SessionEvent.UNSTEADY
                if not self.unsteady and self.ledger.waits_for_temperature:
                    self.keep(entries.StageReady(self.ledger.stage, self.tracker.temp_c))
            case Action.REQUEST_AGAIN:
                for pose, reason, text in self.again:
                    self.keep(entries.Reopened(pose, reason, text))
                    self.last_rejection = (reason, f"pose {pose}: {text}")
                self.again = ()
            case Action.CLOSE_PLAN:
                if self.plan.open_ended:
                    self.keep(entries.PlanClosed(operator))
            case Action.PAUSE:
                self.keep(entries.Paused(operator or ""))
            case Action.RESUME:
                self.keep(entries.Resumed(operator, self.holder))
                self.tracker.stillness.forget()
            case Action.KEEP:
                self._accept(command)
            case Action.END:
                how = "aborted" if event is SessionEvent.ABORT else "rejected"
                note = (command.note or "") if command is not None else ""
                self.keep(entries.Ended(how, operator or "", self._wall(), None, note))
            case Action.REMIND:
                self.faults.put(Fault.WAITING_LONG)
            case Action.PUT_IN_FORCE:
                self._put_in_force(command)
            case Action.NONE | Action.ADD | Action.CLOSE_HOLD | Action.SHOW:
                pass  # done where the readings are looked at, or by the session's next state

    def _edit(self, action: Action, command: Command | None) -> None:
        assert command is not None, "only operators edit"
        if action is Action.UNDO:
            self.keep(entries.Undone(command.operator))
        else:
            target = self.watch.target
            line = line_for(command.name, command.pose, self.ledger, None if target is None else target.id)
            assert line is not None, "refused before"
            if action is Action.SKIP:
                self.keep(entries.Skipped(line.id, command.operator))
            else:
                self.keep(entries.Reopened(line.id, Rejection.OPERATOR, command.note or "", command.operator))
        self.watch.learn_again()

    # --- the end -----------------------------------------------------------------------------------------------

    def end_again(self, ended: entries.Ended) -> None:
        """A journal that has ended was read back: its result is made once more."""
        if ended.record is not None or ended.verdict is not None:
            self.solved = outcome.solve(self.ledger, self.header.judged)
        if ended.record is not None and self.solved is not None:
            self.record = outcome.make_record(self.header, self.ledger, self.solved, ended.t_wall_s)
            self._request_store()

    def _accept(self, command: Command | None) -> None:
        assert command is not None and self.solved is not None, "refused before"
        now = self._wall()
        if self.solved.solution is not None:
            self.record = outcome.make_record(self.header, self.ledger, self.solved, now)
        name = self.record.id if self.record is not None else None
        verdict = outcome.verdict_of(self.solved)
        turntable = None if self.solved.turntable is None else self.solved.turntable.id
        self.keep(entries.Ended("accepted", command.operator, now, name, command.note or "", verdict, turntable))
        self._request_store()

    def _request_store(self) -> None:
        if self._store is not None and self.record is not None:
            self.in_force = self._store.in_force(self.header.tool_id)

    def _put_in_force(self, command: Command | None) -> None:
        assert command is not None and self._store is not None and self.record is not None, "refused before"
        named = force.meant(command.name, self.record.id, self.in_force or InForce())
        try:
            if command.name is CommandName.ACTIVATE:
                self.in_force = self._store.activate(self.record)
            else:
                self.in_force = self._store.rollback(self.header.tool_id, named or "")
        except StoreError:
            self._request_store()  # it may have changed since
            raise
        # the store's own history is what counts; the journal tells that it was done from here
        try:
            self.keep(entries.PutInForce(command.name.value, named or "", command.operator))
        except StorageError as error:
            self.faults.put(Fault.STORAGE, str(error))

    # --- poses -------------------------------------------------------------------------------------------------

    def check(self) -> bool:
        """A hold is complete: whether it is taken."""
        hold = self.watch.hold
        assert hold is not None, "a hold leads here"
        mirrored = self.tracker.mirrored() is True
        self._judged = judge_hold(self.ledger, hold, mirrored=mirrored, same_deg=SAME_ATTITUDE_DEG)
        return self._judged.good

    def _take(self) -> None:
        judged, hold = self._judged, self.watch.hold
        assert judged is not None and isinstance(judged.entry, entries.TakenPose) and hold is not None
        requested, taken = self.watch.target, judged.entry
        self.keep(taken)
        hold.learn()
        self.last_rejection = None
        other = requested is not None and requested.id != taken.pose
        detail = f"requested {requested.id}, found {taken.pose}" if requested is not None else ""
        self.faults.set(Fault.OTHER_THAN_REQUESTED, other, detail)
        self.faults.clear(*_FAULT_OF.values(), Fault.AXES_SUSPECT)
        for again in contradictions(self.ledger, judged):
            self.keep(again)
            self.last_rejection = (again.reason, f"pose {again.pose}: {again.reason.text}")
            self.watch.must_leave = again.pose
        self.watch.learn_again()

    def _refuse_pose(self) -> None:
        judged = self._judged
        entry = judged.entry if judged is not None else None
        if not isinstance(entry, entries.RefusedHold):
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
        self.note_refusal(entry)

    def _refuse_hold(self) -> None:
        """A hold was spoilt. Said, and written down if it had lasted a second."""
        blame, self.watch.blame = self.watch.blame, None
        hold = self.watch.hold
        if hold is None or hold.elapsed_s < 1.0:
            return
        reason, detail = blame or (Rejection.MOVED, "")
        if self.plan.open_ended and reason in (Rejection.MOVED, Rejection.SHAKEN, Rejection.TOO_SHORT):
            return  # hands between two attitudes
        self.last_rejection = (reason, reason.text)
        self.note_refusal(entries.RefusedHold(hold.pose, reason, detail))

    def note_refusal(self, entry: entries.RefusedHold) -> None:
        """Write a refusal down, but not the same one over and over."""
        key = (entry.pose, entry.reason)
        self._same_refusals = self._same_refusals + 1 if key == self._refused_last else 0
        self._refused_last = key
        if self._same_refusals < MAX_SAME_REFUSALS:
            self.keep(entry)


_FAULT_OF = {
    Rejection.MIRRORED: Fault.MIRRORED,
    Rejection.NOT_ONE_G: Fault.NOT_ONE_G,
    Rejection.FROZEN: Fault.FROZEN,
    Rejection.SHAKEN: Fault.NOT_STILL,
}

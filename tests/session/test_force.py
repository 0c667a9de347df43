"""The session's calibration put in force and taken back: by whom, how confirmed, what the store refuses."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from rehearsal import Rehearsal

from highside.bench.session import plans
from highside.bench.session.commands import Origin
from highside.bench.session.entries import PutInForce
from highside.bench.session.journal import StorageError, read_journal
from highside.bench.session.plans import Limits
from highside.bench.session.snapshot import Command, CommandName, Reply, SessionState
from highside.bench.session.view import View
from highside.bench.store import BenchStore
from highside.calibration.record import CalibrationRecord
from highside.recording.calibration_store import CalibrationStore

PLAN = plans.balance_plan([30.0], Limits(std_error_g=4e-5, min_hold_s=1.0, max_hold_s=3.0))


class Bench:
    """An accepted session beside a real store."""

    def __init__(self, folder: Path, seed: int = 1) -> None:
        self.store = BenchStore(folder, "7")
        self.rehearsal = Rehearsal(PLAN, seed=seed, store=self.store, expires_days=365.0).run()
        self.session = self.rehearsal.session
        assert self.session.record is not None
        self.record: CalibrationRecord = self.session.record
        self.store.keep(self.record)

    def say(
        self,
        name: CommandName,
        confirm: str | None = None,
        operator: str = "simulated",
        origin: Origin = Origin.HERE,
    ) -> Reply:
        command = Command(name=name, request_id=os.urandom(8).hex(), operator=operator, confirm=confirm)
        return self.session.command(command, 0.0, origin)

    @property
    def allowed(self) -> list[CommandName]:
        return View(self.session).snapshot().allowed


def test_the_first_one_put_in_force_is_taken_back_to_nothing_by_who_put_it_there(tmp_path: Path) -> None:
    first, kept = Bench(tmp_path, seed=1), CalibrationStore(tmp_path)
    assert first.say(CommandName.ROLLBACK, "nothing").reason == "nothing_before", "none is in force"
    assert first.say(CommandName.ACTIVATE, first.record.id).accepted
    assert first.allowed == [CommandName.ROLLBACK]
    assert first.say(CommandName.ROLLBACK, first.record.id).reason == "not_confirmed", (
        "that is not what is in force then"
    )
    second = Bench(tmp_path, seed=2)
    assert second.allowed == [CommandName.ACTIVATE], "another session's is not taken out"
    assert second.say(CommandName.ROLLBACK, "nothing").reason == "nothing_before"
    assert first.say(CommandName.ROLLBACK, "nothing").accepted
    assert kept.active_id("tool") is None and first.allowed == [CommandName.ACTIVATE]
    assert "not in force" in View(first.session).snapshot().prompt
    told = [e for e in read_journal(first.rehearsal.journal).entries if isinstance(e, PutInForce)]
    assert [(e.how, e.record) for e in told] == [("activate", first.record.id), ("rollback", "nothing")]
    # and on from there, as if nothing had been
    assert first.say(CommandName.ACTIVATE, first.record.id).accepted
    assert (kept.active_id("tool"), kept.before_id("tool")) == (first.record.id, None)


def test_put_in_force_and_taken_back(tmp_path: Path) -> None:
    first = Bench(tmp_path, seed=1)
    assert first.allowed == [CommandName.ACTIVATE]
    assert first.say(CommandName.ACTIVATE, first.record.id[:6]).accepted
    kept = CalibrationStore(tmp_path)
    assert kept.active_id("tool") == first.record.id
    assert first.say(CommandName.ACTIVATE, first.record.id).reason == "in_force"

    second = Bench(tmp_path, seed=2)
    shown = View(second.session).snapshot()
    assert shown.in_force is not None and shown.in_force.present == first.record.id
    assert "not in force" in shown.prompt
    assert second.say(CommandName.ACTIVATE, second.record.id).accepted
    shown = View(second.session).snapshot()
    assert shown.in_force is not None
    assert (shown.in_force.present, shown.in_force.before) == (second.record.id, first.record.id)
    assert "is in force" in shown.prompt and shown.allowed == [CommandName.ROLLBACK]
    # back to the first, which has to be named
    assert second.say(CommandName.ROLLBACK, second.record.id).reason == "not_confirmed"
    assert second.say(CommandName.ROLLBACK, first.record.id[:8]).accepted
    assert kept.active_id("tool") == first.record.id
    assert [entry.action for entry in kept.history("tool")] == ["activate", "activate", "rollback"]
    # told by the journal, which is whole
    commands_kept = [e for e in read_journal(second.rehearsal.journal).entries if isinstance(e, PutInForce)]
    assert [(e.how, e.record) for e in commands_kept] == [("activate", second.record.id), ("rollback", first.record.id)]
    assert second.rehearsal.replayed()[2].id == second.record.id  # type: ignore[attr-defined]


def test_a_store_that_changed_meanwhile_is_not_rolled_back_to_something_else(tmp_path: Path) -> None:
    first, second, third = (Bench(tmp_path, seed=seed) for seed in (1, 2, 3))
    for bench in (first, second):
        assert bench.say(CommandName.ACTIVATE, bench.record.id).accepted
    # somebody at the command line
    CalibrationStore(tmp_path).activate(third.record, now_s=time.time())
    reply = second.say(CommandName.ROLLBACK, first.record.id)
    assert reply.reason == "store" and "the store has changed" in reply.text
    shown = View(second.session).snapshot().in_force
    assert shown is not None and (shown.present, shown.before) == (third.record.id, second.record.id)
    assert CalibrationStore(tmp_path).active_id("tool") == third.record.id


def test_at_the_broker_only_who_holds_it_and_only_by_name(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    record = bench.record.id
    for operator in ("stranger", "simulated"):
        assert bench.say(CommandName.ACTIVATE, record, operator, Origin.BROKER).reason == "held_by_other"
    for confirm in (None, record[:5], "0" * 64 if record[0] != "0" else "1" * 64):
        reply = bench.say(CommandName.ACTIVATE, confirm)
        assert reply.reason == "not_confirmed" and record[:12] in reply.text
    assert CalibrationStore(tmp_path).active_id("tool") is None
    # the same request twice is done once
    command = Command(name=CommandName.ACTIVATE, request_id="one", operator="simulated", confirm=record)
    first = bench.session.command(command, 0.0)
    assert first.accepted and bench.session.command(command, 0.0) == first
    assert len(CalibrationStore(tmp_path).history()) == 1


def test_another_than_who_measured_may_decide_at_the_bench(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    assert bench.say(CommandName.UNDO, operator="manager").reason in ("held_by_other", "not_now")
    assert bench.say(CommandName.ACTIVATE, bench.record.id, "manager").accepted
    assert CalibrationStore(tmp_path).active_id("tool") == bench.record.id
    last = [e for e in read_journal(bench.rehearsal.journal).entries if isinstance(e, PutInForce)][-1]
    assert last.operator == "manager"


def test_not_before_it_is_accepted(tmp_path: Path) -> None:
    rehearsal = Rehearsal(PLAN, store=BenchStore(tmp_path, "7"))
    for state in (SessionState.IDLE, SessionState.GUIDING, SessionState.REVIEW):
        look = rehearsal.operator.look
        rehearsal.operator.look = lambda s, look=look: [] if s.state is SessionState.REVIEW else look(s)  # type: ignore
        while rehearsal.session.state is not state:
            rehearsal.run(limit_s=0.5)
        for name in (CommandName.ACTIVATE, CommandName.ROLLBACK):
            command = Command(name=name, request_id=f"{state}{name}", operator="simulated", confirm="abcdef")
            assert rehearsal.session.command(command, 0.0).reason == "not_now"


@pytest.mark.parametrize("wrong", ["expired", "serial", "read-only"])
def test_what_the_store_refuses_is_said_in_a_line(wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(tmp_path)
    if wrong == "expired":
        monkeypatch.setattr(time, "time", lambda: bench.record.created_s + 400 * 86_400.0)
    elif wrong == "serial":
        bench.store._serial = "8"
    else:
        (tmp_path / "activations").write_text("in the way")
    reply = bench.say(CommandName.ACTIVATE, bench.record.id)
    assert (reply.accepted, reply.reason) == (False, "store")
    assert len(reply.text.splitlines()) == 1 and len(reply.text) < 400, reply.text
    assert bench.session.state is SessionState.ACCEPTED
    assert not [e for e in bench.rehearsal.entries if isinstance(e, PutInForce)]


def test_a_full_disk_of_the_journal_does_not_undo_it(tmp_path: Path) -> None:
    bench = Bench(tmp_path)

    def full(_: object) -> None:
        raise StorageError("disk full")

    bench.rehearsal.refuse_writing = full
    assert bench.say(CommandName.ACTIVATE, bench.record.id).accepted
    assert CalibrationStore(tmp_path).active_id("tool") == bench.record.id
    assert "storage" in {fault.code for fault in View(bench.session).snapshot().faults}

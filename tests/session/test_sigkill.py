"""SIGKILL at 100 random moments: accepted poses are on the disk, the session goes on, the result keeps its promise."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import pytest
from rehearsal import Rehearsal

from highside.bench.journal_file import JournalFile
from highside.bench.session import outcome, plans
from highside.bench.session.entries import Entry, TakenPose
from highside.bench.session.journal import read_journal
from highside.bench.session.plans import Limits
from highside.bench.session.snapshot import PoseState, SessionState
from highside.bench.simulated_operator import SimulatedOperator

KILLS = 100
PLAN = plans.custom_plan(
    [(20.0, 0.0), (20.0, 120.0), (20.0, 240.0), (70.0, 60.0), (70.0, 180.0), (110.0, 300.0), (110.0, 60.0)],
    "joint",
    Limits(std_error_g=5e-5, min_hold_s=1.0, max_hold_s=3.0),
)
WALL_S = 1_795_000_000.0


def rehearsal_for(seed: int) -> Rehearsal:
    options = {"settle_s": 0.4, "turn_rate_dps": 180.0, "shake_g": 0.0}
    return Rehearsal(PLAN, seed=seed, rate_hz=20.0, gyros=False, bench_options=options)


def measure(directory: str, seed: int, acknowledged: int) -> None:
    """The process to be killed: a whole session with its journal on the disk. Each pose that was accepted is told to
    the parent through a pipe, after it was written."""
    rehearsal = rehearsal_for(seed)
    file = JournalFile.create(Path(directory), rehearsal.header)

    def write(entry: Entry) -> None:
        file.write(entry, WALL_S)
        if isinstance(entry, TakenPose):
            os.write(acknowledged, entry.pose.encode() + b" ")

    rehearsal.write = write  # type: ignore[method-assign]
    rehearsal.session = rehearsal.make_session()
    os.write(acknowledged, b"! ")
    while True:  # at the end of a session the process waits to be killed like any other
        rehearsal.run(look_s=0.2)
        time.sleep(0.01)


@pytest.mark.slow
def test_a_kill_loses_at_most_the_pose_in_progress_and_the_session_goes_on(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    rng = random.Random(20)
    torn = finished = kept = within = 0
    for kill in range(KILLS):
        directory = tmp_path / str(kill)
        directory.mkdir()
        read_end, write_end = os.pipe()
        child = context.Process(target=measure, args=(str(directory), kill, write_end))
        child.start()
        os.close(write_end)
        assert os.read(read_end, 2) == b"! "
        # after some poses and a little, so that a slow machine is killed as early as a quick one
        acknowledged_bytes = b""
        wanted = rng.randint(0, len(PLAN.poses))
        while acknowledged_bytes.count(b" ") < wanted:
            acknowledged_bytes += os.read(read_end, 1)
        time.sleep(rng.uniform(0.0, 0.08))
        assert child.pid is not None
        os.kill(child.pid, signal.SIGKILL)
        child.join()
        while part := os.read(read_end, 1024):
            acknowledged_bytes += part
        os.close(read_end)
        path = directory / "rehearsal.journal"
        raw = path.read_bytes()
        file, journal = JournalFile.reopen(path)
        torn += journal.good_bytes < len(raw)
        ledger = journal.ledger()
        on_disk = {line.id for line in ledger.done}
        acknowledged = set(acknowledged_bytes.decode().split())
        # what was told is there; at most one more was written and not told any more
        assert acknowledged <= on_disk and len(on_disk - acknowledged) <= 1
        readings = {line.id: line.readings for line in ledger.done}
        kept += len(on_disk)
        finished += ledger.ended is not None
        again = rehearsal_for(kill)
        again.bench.settings = again.bench.settings.model_copy(update={"seed": 10_000 + kill})
        again.write = lambda entry, file=file: file.write(entry, WALL_S)  # type: ignore[method-assign,misc]
        again.session = again.make_session(ledger)
        if ledger.began:
            again.session.note_interruption()
        again.operator = SimulatedOperator(again.bench, ids="later")
        again.run(look_s=0.2)
        file.close()
        assert again.state is SessionState.ACCEPTED
        lines = again.session.ledger.lines
        assert all(lines[name].state is PoseState.DONE and lines[name].readings == r for name, r in readings.items())
        replayed, solved, record = outcome.replay(read_journal(path.read_bytes()))
        assert replayed.to_plain() == again.session.ledger.to_plain()
        assert record is not None and again.session.record is not None and solved.solution is not None
        assert record.to_json() == again.session.record.to_json()
        within += again.within(2.0)
    print(f"{KILLS} kills: {kept} poses kept, {torn} torn lines, {finished} had ended, {within} within 2 sigma")
    assert within >= 95
    assert 100 < kept < 7 * KILLS, "the kills must fall into the sessions"

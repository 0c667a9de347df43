"""The journal: replayed bit for bit, torn at its end without harm, damaged elsewhere refused; the disk's troubles."""

from __future__ import annotations

import errno
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rehearsal import Rehearsal, command

from highside.bench.journal_file import JournalFile, session_name, unfinished
from highside.bench.session import plans
from highside.bench.session.entries import Entry, TakenPose
from highside.bench.session.journal import encode_all, read_journal
from highside.bench.session.plans import Limits
from highside.bench.session.reasons import Rejection
from highside.bench.session.session import StorageError
from highside.bench.session.snapshot import CommandName, SessionState
from highside.bench.simulated_operator import OperatorMistake
from highside.errors import InputError

QUICK = Limits(std_error_g=3e-5, min_hold_s=1.5, max_hold_s=4.0)
PLAN = plans.balance_plan([12.0, 40.0], QUICK)


@pytest.fixture(scope="module")
def done() -> Rehearsal:
    mistakes = [(1, OperatorMistake.SHOCK), (2, OperatorMistake.UNDO), (4, OperatorMistake.UNPLUG)]
    rehearsal = Rehearsal(PLAN, mistakes=mistakes).run()
    assert rehearsal.state is SessionState.ACCEPTED
    return rehearsal


def test_a_replay_is_the_same_session_bit_for_bit(done: Rehearsal) -> None:
    ledger, solved, record = done.replayed()
    assert ledger.to_plain() == done.session.ledger.to_plain()
    assert json.dumps(ledger.pose_columns()) == json.dumps(done.session.ledger.pose_columns())
    assert done.session.record is not None and done.session.solved is not None
    assert record.to_json() == done.session.record.to_json()  # type: ignore[attr-defined]
    assert solved.solution is not None and done.session.solved.solution is not None
    mine, theirs = (s.solution.result.main.parameters for s in (solved, done.session.solved))
    assert mine.values.tobytes() == theirs.values.tobytes()
    assert mine.covariance.tobytes() == theirs.covariance.tobytes()


def test_what_is_written_reads_back_and_writes_the_same(done: Rehearsal) -> None:
    journal = read_journal(done.journal)
    assert list(journal.entries) == done.entries
    assert journal.good_bytes == len(done.journal)


def test_readings_are_raw(done: Rehearsal) -> None:
    """What the journal holds is what the sensor gave: matrix and offset of the sensor are in it."""
    taken = [entry for entry in done.entries if isinstance(entry, TakenPose)]
    matrix, offset = np.array(done.bench.settings.matrix), np.array(done.bench.settings.offset_g)
    for entry in taken:
        middle = 0.5 * (entry.readings.t_start_s + entry.readings.t_stop_s)
        truth = matrix @ done.bench.truth_block([middle]).gravity[:, 0] + offset
        assert np.allclose(entry.readings.mean(), truth, atol=5 * max(entry.readings.std_error_g))


@settings(max_examples=60, deadline=None)
@given(cut=st.floats(0.0, 1.0))
def test_torn_anywhere_it_keeps_every_line_before(done: Rehearsal, cut: float) -> None:
    whole = done.journal
    end = round(cut * len(whole))
    torn = whole[:end]
    first = len(done.lines[0])
    if end < first:
        with pytest.raises(InputError, match="no session"):
            read_journal(torn)
        return
    journal = read_journal(torn)
    complete = torn.count(b"\n") - 1
    assert len(journal.entries) == complete
    assert list(journal.entries) == done.entries[:complete]
    assert journal.good_bytes == sum(map(len, done.lines[: complete + 1]))


@settings(max_examples=60, deadline=None)
@given(where=st.floats(0.0, 1.0), bit=st.integers(0, 7))
def test_a_flipped_bit_is_found(done: Rehearsal, where: float, bit: int) -> None:
    data = bytearray(done.journal)
    at = min(len(data) - 1, int(where * len(data)))
    data[at] ^= 1 << bit
    last = len(done.journal) - len(done.lines[-1])
    try:
        journal = read_journal(bytes(data))
    except InputError:
        pass
    else:
        assert at >= last, "damage before the last line must be refused"
        assert list(journal.entries) == done.entries[: len(journal.entries)]
        assert len(journal.entries) < len(done.entries)


@settings(max_examples=200, deadline=None)
@given(data=st.binary(max_size=400))
def test_no_junk_is_taken_for_a_journal(data: bytes) -> None:
    with pytest.raises(InputError):
        read_journal(data)


@pytest.mark.parametrize("t", [1e18, 1e300, -1e12])
def test_a_time_that_no_calendar_has_is_found(done: Rehearsal, t: float) -> None:
    """The chain holds: whoever wrote it computed it."""
    data = encode_all(done.session.header, [])
    assert read_journal(data).header.t_wall_s == done.session.header.t_wall_s
    with pytest.raises(InputError, match="is no time in seconds"):
        read_journal(encode_all(replace(done.session.header, t_wall_s=t), []))


def test_what_earlier_journals_call_a_pose_that_the_solution_omits_is_read() -> None:
    assert Rejection("left_out") is Rejection.OMITTED
    with pytest.raises(ValueError, match="left_in"):
        Rejection("left_in")


def test_lines_exchanged_or_omitted_are_found(done: Rehearsal) -> None:
    lines = list(done.lines)
    for broken in (lines[:3] + lines[4:], [*lines[:2], lines[3], lines[2], *lines[4:]]):
        with pytest.raises(InputError, match="does not follow"):
            read_journal(b"".join(broken))


def test_the_file_is_locked_torn_ends_are_cut_and_it_goes_on(tmp_path: Path, done: Rehearsal) -> None:
    file = JournalFile.create(tmp_path, done.header)
    for entry in done.entries[:5]:
        file.write(entry, 1.0)
    with pytest.raises(InputError, match="another process"):
        JournalFile.reopen(file.path)
    file.close()
    with file.path.open("ab") as tail:
        tail.write(b'{"n":6,"e":"taken","d":{"pose":"3","readings":{"a":[[0.1')
    again, journal = JournalFile.reopen(file.path)
    assert list(journal.entries) == done.entries[:5]
    for entry in done.entries[5:]:
        again.write(entry, 1.0)
    again.close()
    assert list(read_journal(file.path.read_bytes()).entries) == done.entries


def test_a_full_disk_loses_nothing_and_leaves_no_torn_line(
    tmp_path: Path, done: Rehearsal, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = JournalFile.create(tmp_path, done.header)
    file.write(done.entries[0], 1.0)
    good = file.path.read_bytes()
    write = os.write

    def full(descriptor: int, data: bytes) -> int:
        write(descriptor, bytes(data)[:40])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(StorageError, match="No space left"):
        file.write(done.entries[1], 1.0)
    monkeypatch.undo()
    assert file.path.read_bytes() == good
    file.write(done.entries[1], 1.0)
    file.close()
    assert list(read_journal(file.path.read_bytes()).entries) == done.entries[:2]


def test_while_the_disk_refuses_no_pose_is_taken_and_afterwards_all_are() -> None:
    rehearsal = Rehearsal(PLAN)
    full = False

    def disk(_: Entry) -> None:
        if full:
            raise StorageError("disk full")

    rehearsal.refuse_writing = disk
    rehearsal.run(limit_s=20.0)
    taken = len(rehearsal.session.ledger.done)
    assert taken >= 1
    full = True
    rehearsal.run(limit_s=60.0)
    assert len(rehearsal.session.ledger.done) == taken
    assert "storage" in {fault.value for fault, _, _ in rehearsal.session.faults}
    refused = rehearsal.session.command(command(CommandName.PAUSE), rehearsal.bench.time_s)
    assert not refused.accepted and refused.reason == "storage"
    full = False
    rehearsal.run()
    assert rehearsal.state is SessionState.ACCEPTED and rehearsal.within(2.0)


def test_the_newest_unfinished_session_of_a_tool_is_found(tmp_path: Path, done: Rehearsal) -> None:
    assert unfinished(tmp_path, "tool", lambda _: True) is None
    for number in range(3):
        name = session_name(tmp_path, "tool", 1_795_000_000.0)
        header = type(done.header)(**{**{f: getattr(done.header, f) for f in done.header.__slots__}, "session": name})
        file = JournalFile.create(tmp_path, header)
        # the last has come to its end, the first was begun and nothing was measured in it
        for entry in done.entries[: {0: 1, 1: 3, 2: None}[number]]:
            file.write(entry, 1.0)
        file.close()
        os.utime(file.path, ns=(number, number))
    found = unfinished(tmp_path, "tool", lambda _: True)
    assert found is not None and found.path.name.endswith("-2.journal")
    # accepted, but the process ended before its record was in the store
    found = unfinished(tmp_path, "tool", lambda _: False)
    assert found is not None and found.path.name.endswith("-3.journal")
    assert unfinished(tmp_path, "other", lambda _: True) is None


@pytest.mark.parametrize("how", ["deleted", "its folder deleted", "moved away", "another in its place"])
def test_a_journal_that_is_taken_away_in_the_middle_is_written_anew_with_all_it_held(
    done: Rehearsal, tmp_path: Path, how: str
) -> None:
    folder = tmp_path / "sessions"
    file = JournalFile.create(folder, done.header)
    half = len(done.entries) // 2
    for entry in done.entries[:half]:
        file.write(entry, 1e9)
    if how == "deleted":
        file.path.unlink()
    elif how == "its folder deleted":
        shutil.rmtree(folder)
    elif how == "moved away":
        folder.rename(tmp_path / "elsewhere")
    else:
        file.path.unlink()
        file.path.write_bytes(b"another's")
        with pytest.raises(StorageError, match="exists"):
            file.write(done.entries[half], 1e9)
        assert file.path.read_bytes() == b"another's", "left alone"
        file.path.unlink()
    for entry in done.entries[half:]:
        file.write(entry, 1e9)
    with pytest.raises(InputError, match="another process drives"):
        JournalFile.reopen(file.path)
    file.close()
    assert list(read_journal(file.path.read_bytes()).entries) == done.entries

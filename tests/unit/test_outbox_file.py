"""The files of the outbox: an older version's is taken over, damage costs no more than what is damaged."""

from __future__ import annotations

import contextlib
import sqlite3
import time
from pathlib import Path

import pytest

from highside.errors import InputError
from highside.service.outbox import Outbox, inspect
from highside.service.outbox_file import MessageFile
from highside.service.sequence import BLOCK, SequenceFile

TOPIC = "highside/t/attitude"


def make(path: Path) -> Outbox:
    return Outbox(path, max_rows=10_000, max_age_s=1e9, max_bytes=1 << 30, commit_interval_s=0.005)


def drain(outbox: Outbox, n: int) -> list[int]:
    outbox.begin_delivery(lambda: None)
    found: list[int] = []
    deadline = time.monotonic() + 30.0
    while len(found) < n and time.monotonic() < deadline:
        taken = outbox.take()
        if taken is None:
            time.sleep(0.002)
            continue
        found.append(taken[0].seq)
        outbox.ack(taken[0].id)
    return found


def old_file(path: Path, n: int) -> None:
    """As the first version of this program left it."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute(
            "CREATE TABLE outbox (id INTEGER PRIMARY KEY AUTOINCREMENT, topic TEXT NOT NULL,"
            " seq INTEGER NOT NULL, created_s REAL NOT NULL, qos INTEGER NOT NULL, payload BLOB NOT NULL)"
        )
        db.execute("CREATE TABLE sequence (topic TEXT PRIMARY KEY, last INTEGER NOT NULL)")
        for seq in range(n):
            row = (TOPIC, 40 + seq, 1.7e9, 1, b"%d" % (40 + seq))
            db.execute("INSERT INTO outbox (topic, seq, created_s, qos, payload) VALUES (?, ?, ?, ?, ?)", row)
        db.execute("INSERT INTO sequence VALUES (?, ?)", (TOPIC, 40 + n + 6))
        db.execute("PRAGMA user_version = 1")
        db.commit()


def test_what_an_older_version_left_is_taken_over_once(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    old_file(path, 500)
    assert inspect(path).queued == 500
    outbox = make(path)
    outbox.start()
    assert outbox.stats.carried == 500
    assert outbox.next_seq(TOPIC) == 547, "numbers that were acknowledged are not used again"
    outbox.put(TOPIC, b"547")
    assert sorted(drain(outbox, 501)) == [*range(40, 540), 547]
    outbox.stop(10.0)
    again = make(path)
    again.start()
    assert again.stats.carried == 0
    assert again.next_seq(TOPIC) == 548
    again.stop(10.0)


def test_a_commit_is_on_the_disk_before_it_counts(tmp_path: Path) -> None:
    """SIGKILL keeps what only the kernel has: that SQLite waits for the disk shows in its setting, and in the guest."""
    file = MessageFile(tmp_path / "outbox.sqlite")
    file.open()
    try:
        assert file._database().execute("PRAGMA synchronous").fetchone() == (2,), "FULL"
    finally:
        file.close()


def test_a_reservation_cut_short_by_power_leaves_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "numbers"
    file = SequenceFile(path)
    assert file.open().first_free == {}
    file.write({TOPIC: 200})
    file.write({TOPIC: 400})
    file.close()
    content = bytearray(path.read_bytes())
    slot = len(content) // 2
    # generation 2 lies in the first slot; half of its content never reached the disk
    content[20:60] = bytes(40)
    path.write_bytes(content)
    said = SequenceFile(path).open()
    assert said.first_free == {TOPIC: 200}
    assert not said.sound
    assert not said.orderly
    content[slot : slot + 8] = b"\xff" * 8
    path.write_bytes(content)
    assert SequenceFile(path).open().first_free == {}


def test_many_topics_make_the_file_of_numbers_grow(tmp_path: Path) -> None:
    file = SequenceFile(tmp_path / "numbers")
    file.open()
    topics = {f"highside/{'t' * 50}/{i}": i for i in range(1_000)}
    file.write(topics)
    file.write(topics | {"more": 7}, orderly=True)
    file.close()
    said = SequenceFile(tmp_path / "numbers").open()
    assert said.first_free == topics | {"more": 7}
    assert said.orderly


def test_after_a_kill_the_numbering_goes_on_behind_the_reservation_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    file = SequenceFile(path.with_name(path.name + ".numbers"))
    file.open()
    file.write({TOPIC: 2_000})  # no orderly end
    file.close()
    outbox = make(path)
    outbox.start()
    assert outbox.next_seq(TOPIC) == 2_000
    assert outbox.stats.resumed_at == {TOPIC: 2_000}
    outbox.stop(10.0)
    again = make(path)
    again.start()
    assert again.next_seq(TOPIC) == 2_001
    assert again.stats.resumed_at == {}
    again.stop(10.0)


def test_nothing_is_handed_out_whose_number_is_not_reserved(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    outbox = make(path)
    outbox.start()
    outbox.begin_delivery(lambda: None)
    highest = -1
    for _ in range(5 * BLOCK):
        outbox.next_seq(TOPIC)
        outbox.put(TOPIC, b"x")
        time.sleep(0.001)
        while (taken := outbox.take()) is not None:
            highest = taken[0].seq
            said = SequenceFile(path.with_name(path.name + ".numbers")).open()
            assert highest < said.first_free[TOPIC]
            outbox.ack(taken[0].id)
    assert highest > BLOCK
    outbox.stop(10.0)


def test_a_row_that_was_damaged_on_the_disk_is_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    outbox = make(path)
    outbox.start()
    for _ in range(50):
        seq = outbox.next_seq(TOPIC)
        outbox.put(TOPIC, b"%d" % seq)
    outbox.stop(10.0)
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("UPDATE outbox SET payload = X'00' WHERE seq IN (7, 30)")
        db.commit()
    outbox = make(path)
    outbox.start()
    assert drain(outbox, 48) == [seq for seq in range(50) if seq not in (7, 30)]
    deadline = time.monotonic() + 10.0
    while outbox.stats.queued and time.monotonic() < deadline:
        time.sleep(0.01)
    outbox.stop(10.0)
    assert outbox.stats.dropped == {"corrupt": 2}
    assert outbox.stats.balanced()


def test_a_look_into_the_outbox_is_not_in_the_way_of_the_service(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with pytest.raises(InputError, match="no service has run here yet"):
        inspect(path)
    outbox = make(path)
    outbox.start()
    try:
        for n in range(1, 60):
            outbox.next_seq(TOPIC)
            outbox.put(TOPIC, b"x")
            state = inspect(path)
            assert state.in_use
            assert state.queued <= n
        deadline = time.monotonic() + 10.0
        while inspect(path).queued < 59 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert inspect(path).queued == 59
        assert outbox.stats.storage_errors == 0
    finally:
        outbox.stop(10.0)
    assert not inspect(path).in_use
    path.write_bytes(b"\x5a" * 5_000)
    with pytest.raises(InputError, match=r"outbox\.sqlite: cannot be read"):
        inspect(path)

"""The outbox on a real file: what is put is handed out in order until acknowledged, across restarts and bad disks."""

from __future__ import annotations

import contextlib
import resource
import sqlite3
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from highside.errors import InputError
from highside.service.clock import Moment
from highside.service.outbox import Outbox, StoredMessage

TOPIC = "highside/t/attitude"
NOW = 1_800_000_000.0


class Clocks:
    """A machine that has been up for 10,000 s; its clocks stand still unless they are moved."""

    def __init__(self, wall_s: float = NOW, boot_s: float = 10_000.0, boot_id: str = "first", synced: bool = True):
        self.wall_s, self.boot_s, self.boot_id, self.synced = wall_s, boot_s, boot_id, synced

    def __call__(self, *, synced: bool | None = None) -> Moment:
        return Moment(self.wall_s, self.synced if synced is None else synced, self.boot_id, self.boot_s)

    def pass_(self, seconds: float) -> None:
        self.wall_s += seconds
        self.boot_s += seconds


def make(path: Path, **changes: object) -> Outbox:
    options: dict[str, object] = {
        "max_rows": 100_000,
        "max_age_s": 1e6,
        "max_bytes": 1 << 30,
        "commit_interval_s": 0.005,
        "clocks": Clocks(),
    }
    return Outbox(path, **(options | changes))  # type: ignore[arg-type]


@contextlib.contextmanager
def started(path: Path, **changes: object) -> Iterator[Outbox]:
    outbox = make(path, **changes)
    outbox.start()
    try:
        yield outbox
    finally:
        outbox.stop(10.0)
        assert outbox.stats.balanced(), outbox.stats


def put(outbox: Outbox, n: int = 1, *, created_s: float = NOW, topic: str = TOPIC, size: int = 0) -> None:
    for _ in range(n):
        seq = outbox.next_seq(topic)
        outbox.put(topic, b"%d" % seq + b" " * size, created_s=created_s)


def until(condition: Callable[[], bool], what: str, timeout_s: float = 15.0) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"did not happen: {what}"
        time.sleep(0.002)


def take_all(outbox: Outbox, n: int, *, timeout_s: float = 15.0) -> list[tuple[StoredMessage, bool]]:
    """The next `n` messages, however long the thread needs to find them; not one more is waiting."""
    found: list[tuple[StoredMessage, bool]] = []
    deadline = time.monotonic() + timeout_s
    while len(found) < n:
        taken = outbox.take()
        if taken is not None:
            found.append(taken)
        else:
            assert time.monotonic() < deadline, f"{len(found)} of {n} messages came"
            time.sleep(0.001)
    return found


def stored(path: Path) -> list[int]:
    with contextlib.closing(sqlite3.connect(path)) as db:
        assert db.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
        return [row[0] for row in db.execute("SELECT seq FROM outbox ORDER BY id")]


def test_messages_come_out_in_order_and_are_gone_once_acknowledged(tmp_path: Path) -> None:
    with started(tmp_path / "outbox.sqlite") as outbox:
        outbox.begin_delivery(lambda: None)
        put(outbox, 500)
        rows = take_all(outbox, 500)
        assert [row.seq for row, _ in rows] == list(range(500))
        assert not any(historical for _, historical in rows)
        assert outbox.take() is None
        for row, _ in rows[:300]:
            outbox.ack(row.id)
            outbox.ack(row.id)  # a second PUBACK counts once
        assert outbox.stats.acknowledged == 300
        assert outbox.stats.queued == 200
    assert stored(tmp_path / "outbox.sqlite") == list(range(300, 500))


def test_what_was_not_acknowledged_is_handed_out_again_after_a_lost_connection(tmp_path: Path) -> None:
    with started(tmp_path / "outbox.sqlite") as outbox:
        outbox.begin_delivery(lambda: None)
        put(outbox, 20)
        rows = take_all(outbox, 20)
        for row, _ in rows[::2]:
            outbox.ack(row.id)
        outbox.end_delivery()
        outbox.ack(rows[1][0].id)  # too late: it belongs to the lost connection
        outbox.begin_delivery(lambda: None)
        assert [row.seq for row, _ in take_all(outbox, 10)] == list(range(1, 20, 2))


def test_numbers_and_messages_go_on_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 7)
        put(outbox, 3, topic="highside/t/survey")
    with started(path) as outbox:
        assert outbox.stats.carried == outbox.stats.queued == outbox.stats.produced == 10
        assert outbox.next_seq(TOPIC) == 7
        assert outbox.next_seq("highside/t/survey") == 3
        assert outbox.next_seq("highside/t/other") == 0
        outbox.begin_delivery(lambda: None)
        for row, _ in take_all(outbox, 10):
            outbox.ack(row.id)
    with started(path) as outbox:
        # the outbox is empty, the numbering is not forgotten: 7 was given out above
        assert outbox.stats.queued == 0
        assert outbox.next_seq(TOPIC) == 8


def test_old_messages_are_historical_and_yield_to_live_ones(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 6_000, created_s=NOW - 3600.0)
        put(outbox, 5, created_s=NOW - 1.0)
    with started(path) as outbox:
        outbox.begin_delivery(lambda: None)
        first = take_all(outbox, 105)
        assert [(row.seq, old) for row, old in first[:5]] == [(seq, False) for seq in range(6_000, 6_005)]
        assert [(row.seq, old) for row, old in first[5:]] == [(seq, True) for seq in range(100)]
        assert outbox.take(backlog=False) is None
        put(outbox, 1)
        until(lambda: outbox.stats.committed == 1, "commit")
        row, historical = take_all(outbox, 1)[0]
        # it may have come a moment before the live one was ready, never the other way round
        while historical:
            row, historical = take_all(outbox, 1)[0]
        assert row.seq == 6_005
        rest = [row.seq for row, _ in take_all(outbox, outbox.stats.queued - len(outbox._in_flight))]
        assert rest == list(range(6_000 - len(rest), 6_000))


def test_a_live_message_that_waited_too_long_becomes_historical(tmp_path: Path) -> None:
    clocks = Clocks()
    with started(tmp_path / "outbox.sqlite", clocks=clocks) as outbox:
        outbox.begin_delivery(lambda: None)
        put(outbox, 10)
        until(lambda: outbox.stats.committed == 10, "commit")
        clocks.pass_(60.0)
        put(outbox, 2, created_s=clocks.wall_s)
        rows = take_all(outbox, 12)
        assert sorted(row.seq for row, old in rows if old) == list(range(10))
        assert [row.seq for row, old in rows if old] == list(range(10))
        assert [row.seq for row, old in rows if not old] == [10, 11]


@pytest.mark.parametrize(
    ("caps", "created_s", "kept", "reason"),
    [
        ({"max_rows": 300}, NOW, range(700, 1000), "max_rows"),
        ({"max_bytes": 1000 * (100 + len(TOPIC)) // 2}, NOW, None, "max_bytes"),
        ({"max_age_s": 50.0}, NOW - 100.0, range(0), "max_age"),
    ],
)
def test_beyond_a_cap_the_oldest_are_dropped_and_counted(
    tmp_path: Path, caps: dict[str, float], created_s: float, kept: range | None, reason: str
) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path, **caps) as outbox:
        put(outbox, 1000, created_s=created_s, size=97)
        expected = 1000 if kept is None else 1000 - len(kept)
        until(lambda: outbox.stats.dropped.get(reason, 0) >= (expected if kept is not None else 480), "drop", 20.0)
        assert set(outbox.stats.dropped) == {reason}
        dropped = outbox.stats.dropped[reason]
    left = stored(path)
    assert left == list(range(dropped, 1000)), "the oldest went first"
    if kept is not None:
        assert left == list(kept)
    else:
        assert 480 <= dropped <= 520


def test_a_message_beyond_the_cap_alone_is_refused_and_costs_no_other(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It was stored, and everything older went for it; then it stayed alone, above the cap."""
    path = tmp_path / "outbox.sqlite"
    with started(path, max_bytes=100_000) as outbox:
        put(outbox, 100, size=97)
        put(outbox, 1, size=200_000)
        put(outbox, 100, size=97)
        until(lambda: outbox.stats.committed == 200, "commit")
        assert outbox.stats.dropped == {"too_large": 1}
        assert outbox.stats.produced == 201
        assert f"{200_003 + len(TOPIC)} bytes on {TOPIC}" in caplog.text
        assert "mqtt.outbox.max_bytes (100000)" in caplog.text
        outbox.begin_delivery(lambda: None)
        assert [row.seq for row, _ in take_all(outbox, 200)] == [*range(100), *range(101, 201)]


def test_a_message_that_an_earlier_and_larger_cap_had_let_in_costs_no_other(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 100, size=97)
        put(outbox, 1, size=200_000)
        put(outbox, 100, size=97)
    with started(path, max_bytes=100_000) as outbox:
        until(lambda: outbox.stats.dropped == {"too_large": 1}, "drop")
        outbox.begin_delivery(lambda: None)
        assert [row.seq for row, _ in take_all(outbox, 200)] == [*range(100), *range(101, 201)]
        assert outbox.stats.dropped == {"too_large": 1}
    assert len(stored(path)) == 200


HOUR, DAY = 3600.0, 86_400.0


@pytest.mark.parametrize("step_s", [HOUR, -HOUR, DAY, -DAY, 30 * DAY, -30 * DAY, 900 * DAY, NOW])
def test_a_step_of_the_wall_clock_ages_nothing_and_renews_nothing(tmp_path: Path, step_s: float) -> None:
    clocks = Clocks(wall_s=NOW - max(step_s, 0.0), synced=False)
    with started(tmp_path / "outbox.sqlite", clocks=clocks, max_age_s=14 * DAY) as outbox:
        put(outbox, 101, created_s=clocks.wall_s)
        until(lambda: outbox.stats.committed == 101, "commit")
        clocks.pass_(9.0)
        put(outbox, 3, created_s=clocks.wall_s)
        until(lambda: outbox.stats.committed == 104, "commit")
        clocks.wall_s += step_s
        clocks.synced = True
        time.sleep(1.2)  # the caps are looked at each second
        assert outbox.stats.dropped == {}
        outbox.begin_delivery(lambda: None)
        rows = take_all(outbox, 104)
        assert sorted(row.seq for row, historical in rows if historical) == list(range(101))
        assert [row.seq for row, historical in rows if not historical] == [101, 102, 103]


def test_what_is_older_than_the_cap_by_the_boot_clock_is_dropped_whatever_the_wall_clock_says(tmp_path: Path) -> None:
    clocks = Clocks(wall_s=120.0, synced=False)  # two minutes into 1970
    with started(tmp_path / "outbox.sqlite", clocks=clocks, max_age_s=HOUR) as outbox:
        put(outbox, 5, created_s=clocks.wall_s)
        until(lambda: outbox.stats.committed == 5, "commit")
        clocks.boot_s += 2 * HOUR
        until(lambda: outbox.stats.dropped == {"max_age": 5}, "drop")


@pytest.mark.parametrize(("then", "now", "kept"), [(True, True, 0), (True, False, 5), (False, True, 5)])
def test_across_boots_only_synchronised_stamps_tell_an_age(tmp_path: Path, then: bool, now: bool, kept: int) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path, max_age_s=HOUR, clocks=Clocks(synced=then)) as outbox:
        for _ in range(5):
            outbox.next_seq(TOPIC)
            outbox.put(TOPIC, b"{}", synced=then)
    later = Clocks(wall_s=NOW + 2 * HOUR, boot_s=30.0, boot_id="second", synced=now)
    with started(path, max_age_s=HOUR, clocks=later) as outbox:
        time.sleep(1.2)
        assert outbox.stats.queued == kept
        outbox.begin_delivery(lambda: None)
        assert all(historical for _, historical in take_all(outbox, kept))


def test_messages_in_flight_are_not_dropped_and_count_once(tmp_path: Path) -> None:
    with started(tmp_path / "outbox.sqlite", max_rows=100) as outbox:
        outbox.begin_delivery(lambda: None)
        put(outbox, 50)
        flying = [row for row, _ in take_all(outbox, 50)]
        put(outbox, 500)
        until(lambda: outbox.stats.queued <= 100 + 50, "drop")
        for row in flying:
            outbox.ack(row.id)
        until(lambda: outbox.stats.queued <= 100, "drop")
        stats = outbox.stats
        assert stats.acknowledged == 50
        assert stats.balanced()


def test_a_second_process_with_the_same_file_is_refused(tmp_path: Path) -> None:
    with started(tmp_path / "outbox.sqlite"):
        second = make(tmp_path / "outbox.sqlite")
        with pytest.raises(InputError, match=r"outbox\.sqlite: is in use by another process"):
            second.start()


@pytest.mark.parametrize("damage", ["garbage", "truncated", "overwritten middle", "other layout"])
def test_a_damaged_file_is_set_aside_and_a_new_one_begun(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 3_000, size=100)
    content = path.read_bytes()
    assert len(content) > 100_000
    if damage == "garbage":
        path.write_bytes(b"\x5a" * 50_000)
    elif damage == "truncated":
        path.write_bytes(content[: len(content) // 2 + 100])
    elif damage == "overwritten middle":
        path.write_bytes(content[:40_000] + b"\xff" * 30_000 + content[70_000:])
    else:
        path.unlink()
        with contextlib.closing(sqlite3.connect(path)) as db:
            db.execute("CREATE TABLE outbox (something TEXT)")
            db.execute("PRAGMA user_version = 77")
            db.commit()
    with started(path) as outbox:
        assert outbox.stats.corrupt_files == 1
        saved = outbox.stats.carried
        # what lies before and behind 30 of 400 kB is read; where the file ends in the middle, nothing can be
        assert saved > 2_500 if damage == "overwritten middle" else saved < 1_600, saved
        assert outbox.next_seq(TOPIC) == 3_000, "the numbers are kept beside it"
        outbox.put(TOPIC, b"3000", created_s=NOW)
        outbox.begin_delivery(lambda: None)
        put(outbox, 4)
        rows = [row for row, _ in take_all(outbox, saved + 5)]
        assert [row.seq for row in rows] == sorted(row.seq for row in rows)
        assert all(row.payload.split() == [b"%d" % row.seq] for row in rows)
    aside = [found for found in tmp_path.iterdir() if ".corrupt-" in found.name and not found.name.endswith("-wal")]
    assert len(aside) == 1
    assert len(stored(path)) == saved + 5


@contextlib.contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """No file of this process may grow beyond `limit` bytes: writes fail as on a full disk (EFBIG)."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_an_error_that_nobody_thought_of_does_not_end_the_storing(tmp_path: Path) -> None:
    """A name that no file can hold: told as a fault of storage, sent from memory, and what follows is stored again."""
    with started(tmp_path / "outbox.sqlite") as outbox:
        put(outbox, 1, topic="a\ud800b")
        put(outbox, 1)
        until(lambda: not outbox.stats.storage_ok, "failure noticed")
        assert "UnicodeEncodeError" in outbox.stats.storage_error
        outbox.begin_delivery(lambda: None)
        for row, _ in take_all(outbox, 2):
            outbox.ack(row.id)
        until(lambda: outbox.stats.storage_ok, "recovery")
        outbox.end_delivery()
        put(outbox, 3)
        until(lambda: outbox.stats.committed == 3, "commit of what followed")


def test_a_full_disk_does_not_stop_acquisition_or_sending_and_is_survived(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path, max_memory_rows=400) as outbox:
        put(outbox, 100, size=200)
        until(lambda: outbox.stats.committed == 100, "commit")
        with full_disk(4096):
            slowest = 0.0
            for _ in range(1000):
                began = time.perf_counter()
                put(outbox, 1, size=200)
                slowest = max(slowest, time.perf_counter() - began)
            until(lambda: not outbox.stats.storage_ok, "failure noticed")
            stats = outbox.stats
            assert stats.balanced()
            assert stats.dropped == {"memory": 600}
            assert outbox.uncommitted == 400
            assert stats.storage_error
            # late is better than never: with a broker there, messages leave from memory
            outbox.begin_delivery(lambda: None)
            rows = [row for row, _ in take_all(outbox, 50)]
            assert [row.seq for row in rows] == list(range(700, 750))
            for row in rows[:30]:
                outbox.ack(row.id)
            assert outbox.stats.balanced()
        until(lambda: outbox.stats.storage_ok, "recovery")
        until(lambda: outbox.stats.committed == 470, "commit of what waited")
        # 30 were acknowledged without ever being committed, and nothing waits for them
        assert outbox.uncommitted == 0
        # neither what is acknowledged nor what is in flight is handed out a second time
        again = [row.seq for row, _ in take_all(outbox, 450)]
        assert sorted(again) == [*range(100), *range(750, 1100)]
        assert outbox.take() is None
        assert slowest < 0.25
    assert stored(path) == [*range(100), *range(730, 1100)]


def test_a_file_damaged_while_in_use_costs_its_rows_and_no_more(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        # more than SQLite keeps in its cache: it has to read the file again
        put(outbox, 2_000, size=4_000)
        until(lambda: outbox.stats.committed == 2_000, "commit")
        path.write_bytes(b"\x5a" * 9_000_000)
        path.with_name(path.name + "-wal").write_bytes(b"")
        deadline = time.monotonic() + 20.0
        while not outbox.stats.corrupt_files:
            put(outbox, 1, created_s=NOW - 60.0)
            outbox.end_delivery()
            outbox.begin_delivery(lambda: None)
            assert time.monotonic() < deadline, outbox.stats
            time.sleep(0.02)
        until(lambda: outbox.stats.storage_ok, "recovery")
        put(outbox, 3)
        until(lambda: outbox.stats.committed >= 2_004, "commit")
        assert outbox.stats.dropped["corrupt"] >= 2_000
        assert outbox.stats.balanced()
        last = outbox.next_seq(TOPIC) - 1
    assert stored(path)[-3:] == [last - 2, last - 1, last]


def test_put_never_waits_for_the_disk(tmp_path: Path) -> None:
    costs: list[float] = []
    with started(tmp_path / "outbox.sqlite", commit_interval_s=0.05) as outbox:
        for _ in range(5_000):
            seq = outbox.next_seq(TOPIC)
            payload = b"x" * 300 + b"%d" % seq
            began = time.perf_counter()
            outbox.put(TOPIC, payload, created_s=NOW)
            costs.append(time.perf_counter() - began)
        until(lambda: outbox.stats.committed == 5_000, "commit")
    print(f"put: median {statistics.median(costs) * 1e6:.1f} us, slowest {max(costs) * 1e3:.2f} ms")
    assert statistics.median(costs) < 100e-6


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("put"), st.integers(1, 40)),
        st.tuples(st.just("old"), st.integers(1, 40)),
        st.tuples(st.just("take"), st.integers(1, 30)),
        st.tuples(st.just("ack"), st.integers(1, 30)),
        st.tuples(st.just("reconnect"), st.just(0)),
        st.tuples(st.just("restart"), st.just(0)),
        st.tuples(st.just("settle"), st.just(0)),
    ),
    min_size=5,
    max_size=30,
)


@settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=STEPS, small=st.booleans())
def test_any_history_of_puts_acknowledgements_and_restarts_balances(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[str, int]], small: bool
) -> None:
    path = tmp_path_factory.mktemp("history") / "outbox.sqlite"
    caps = {"max_rows": 60} if small else {}
    outbox = make(path, commit_interval_s=0.001, **caps)
    outbox.start()
    outbox.begin_delivery(lambda: None)
    flying: list[StoredMessage] = []
    delivered: set[int] = set()
    produced = 0
    dropped_before = 0

    def check() -> None:
        stats = outbox.stats
        assert stats.balanced(), stats
        assert stats.queued >= 0
        assert stats.queued_bytes >= 0

    for step, n in steps:
        if step in ("put", "old"):
            put(outbox, n, created_s=NOW if step == "put" else NOW - 1000.0)
            produced += n
        elif step == "take":
            for _ in range(n):
                taken = outbox.take()
                if taken is not None:
                    row = taken[0]
                    assert row.seq not in delivered, "what is acknowledged never comes again"
                    assert row.id not in {other.id for other in flying}, "handed out twice on one connection"
                    assert row.payload == b"%d" % row.seq
                    flying.append(row)
        elif step == "ack":
            for row in flying[:n]:
                outbox.ack(row.id)
                delivered.add(row.seq)
            del flying[:n]
        elif step == "reconnect":
            outbox.end_delivery()
            outbox.begin_delivery(lambda: None)
            flying.clear()
        elif step == "restart":
            outbox.stop(10.0)
            check()
            assert outbox.stats.queued == len(stored(path)), "the count is that of the file"
            dropped_before += sum(outbox.stats.dropped.values())
            outbox = make(path, commit_interval_s=0.001, **caps)
            outbox.start()
            outbox.begin_delivery(lambda: None)
            flying.clear()
        else:
            time.sleep(0.005)
        check()
    outbox.end_delivery()
    outbox.stop(10.0)
    check()
    left = stored(path)
    dropped = dropped_before + sum(outbox.stats.dropped.values())
    assert len(delivered) + len(left) + dropped == produced
    assert delivered.isdisjoint(left)
    assert left == sorted(left)
    if not small:
        assert dropped == 0
        assert sorted([*delivered, *left]) == list(range(produced))


def test_stop_commits_what_was_just_put(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path, commit_interval_s=1.0) as outbox:
        put(outbox, 1)
        until(lambda: outbox.stats.committed == 1, "first commit")
        put(outbox, 12_000)
        assert outbox.stats.committed == 1
    assert stored(path) == list(range(12_001))
    assert threading.active_count() < 20


def test_what_a_disk_that_refused_held_back_does_not_come_as_live_behind_younger_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The broker is back while the disk refuses: young messages go out of memory, stored ones are history then."""
    refusing = threading.Event()

    def guarded(work: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            if refusing.is_set():
                raise sqlite3.OperationalError("disk I/O error")
            return work(*arguments)

        return call

    with started(tmp_path / "outbox.sqlite", historical_after_s=60.0) as outbox:
        put(outbox, 10)
        until(lambda: outbox.stats.committed == 10, "commit")
        for name in ("change", "youngest", "between", "open"):
            monkeypatch.setattr(outbox._file, name, guarded(getattr(outbox._file, name)))
        refusing.set()
        put(outbox, 1)
        until(lambda: not outbox.stats.storage_ok, "refusal")
        outbox.begin_delivery(lambda: None)
        put(outbox, 4)
        young = take_all(outbox, 5)
        refusing.clear()
        until(lambda: outbox.stats.storage_ok, "the disk takes again")
        old = take_all(outbox, 10)
    assert [(row.seq, historical) for row, historical in young] == [(seq, False) for seq in range(10, 15)]
    assert [(row.seq, historical) for row, historical in old] == [(seq, True) for seq in range(10)]

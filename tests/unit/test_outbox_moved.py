"""The outbox's files deleted, moved away or replaced while it is in use: it notices, loses nothing and goes on."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest
from test_outbox import TOPIC, make, put, started, stored, take_all, until

from highside.errors import InputError
from highside.service.outbox import Outbox, inspect


@pytest.fixture(autouse=True)
def _looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("highside.service.outbox.LOOK_S", 0.02)


def everywhere(outbox: Outbox) -> None:
    """Messages in SQLite, in the log, in flight and in the sender's queues, some acknowledged and not yet deleted."""
    put(outbox, 300, size=400)  # beyond 64 KiB: straight into SQLite
    until(lambda: outbox.stats.committed == 300, "commit")
    for count in range(301, 321):
        put(outbox, 1)
        until(lambda: outbox.stats.committed == count, "commit into the log")  # noqa: B023 - awaited at once
    outbox.begin_delivery(lambda: None)
    for row, _ in take_all(outbox, 320)[:10]:
        outbox.ack(row.id)


def waiting(path: Path) -> int:
    """Messages in the files; 0 while they are being made."""
    try:
        return inspect(path).queued
    except InputError:
        return 0


def delivered(outbox: Outbox) -> list[int]:
    outbox.end_delivery()
    outbox.begin_delivery(lambda: None)
    return sorted(row.seq for row, _ in take_all(outbox, outbox.stats.queued))


def test_a_directory_that_is_deleted_costs_nothing_and_is_made_anew(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    with started(folder / "outbox.sqlite") as outbox:
        everywhere(outbox)
        shutil.rmtree(folder)
        until(lambda: outbox.stats.replaced == 1, "noticed")
        put(outbox, 5)
        until(lambda: waiting(folder / "outbox.sqlite") == 315, "what was there and what followed")
        assert delivered(outbox) == list(range(10, 325))
        assert outbox.stats.balanced()
        assert not outbox.stats.dropped
        assert outbox.stats.storage_ok
    assert stored(folder / "outbox.sqlite") == list(range(10, 325))
    with started(folder / "outbox.sqlite") as outbox:
        assert outbox.next_seq(TOPIC) == 325, "the numbers were kept, too"


def test_what_is_nowhere_but_in_a_deleted_file_is_taken_over_from_it(tmp_path: Path) -> None:
    """No broker was ever there: of what was moved into SQLite nothing is in memory."""
    folder = tmp_path / "state"
    with started(folder / "outbox.sqlite") as outbox:
        put(outbox, 3_000, size=400)
        until(lambda: outbox.stats.committed == 3_000, "commit")
        shutil.rmtree(folder)
        until(lambda: waiting(folder / "outbox.sqlite") == 3_000, "all of it in a new file")
        assert delivered(outbox) == list(range(3_000))
        assert not outbox.stats.dropped


def test_numbers_that_somebody_replaced_count_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 10)
        until(lambda: outbox.stats.committed == 10, "commit")
        other = tmp_path / "other"
        other.write_bytes(b"\x5a" * 40_000)
        other.replace(f"{path}.numbers")
        until(lambda: outbox.stats.replaced == 1, "noticed")
        time.sleep(0.2)
        put(outbox, 10)
        assert outbox.next_seq(TOPIC) == 20, "no jump, and none twice"
    with started(path) as outbox:
        assert outbox.next_seq(TOPIC) == 21


def test_a_directory_that_cannot_be_made_is_waited_for_and_what_is_put_meanwhile_kept(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    with started(folder / "outbox.sqlite") as outbox:
        everywhere(outbox)
        folder.rename(tmp_path / "away")
        folder.write_text("in the way")
        until(lambda: not outbox.stats.storage_ok, "noticed, with nothing to store")
        assert "state" in outbox.stats.storage_error
        put(outbox, 5)
        outbox.end_delivery()
        outbox.begin_delivery(lambda: None)
        assert [row.seq for row, _ in take_all(outbox, 5)] == list(range(320, 325)), "sent from memory meanwhile"
        folder.unlink()
        until(lambda: outbox.stats.storage_ok, "goes on")
        assert outbox.stats.replaced == 1
        assert delivered(outbox) == list(range(10, 325))
    assert stored(folder / "outbox.sqlite") == list(range(10, 325))


def test_another_outbox_in_its_place_is_set_aside_and_not_mixed_with_ours(tmp_path: Path) -> None:
    folder, other = tmp_path / "state", tmp_path / "other"
    with started(other / "outbox.sqlite") as outbox:
        put(outbox, 50, size=400)
    with started(folder / "outbox.sqlite") as outbox:
        everywhere(outbox)
        folder.rename(tmp_path / "away")
        other.rename(folder)
        until(lambda: outbox.stats.replaced == 1, "noticed")
        put(outbox, 5)
        until(lambda: waiting(folder / "outbox.sqlite") == 315, "what was there and what followed")
        assert delivered(outbox) == list(range(10, 325))
    assert stored(folder / "outbox.sqlite") == list(range(10, 325))
    (aside,) = (path for path in folder.glob("*.other-*") if path.name.rpartition("-")[2].isdecimal())
    assert stored(aside) == list(range(50))


def test_a_directory_whose_outbox_another_service_uses_is_left_to_it(tmp_path: Path) -> None:
    folder, other = tmp_path / "state", tmp_path / "other"
    with started(folder / "outbox.sqlite") as outbox:
        everywhere(outbox)
        with started(other / "outbox.sqlite") as second:
            put(second, 50, size=400)
            until(lambda: second.stats.committed == 50, "commit")
            folder.rename(tmp_path / "away")
            folder.symlink_to(other)
            until(lambda: "in use by another process" in outbox.stats.storage_error, "refused")
            put(outbox, 5)
        assert stored(other / "outbox.sqlite") == list(range(50)), "the other's is as it was"
        folder.unlink()
        until(lambda: outbox.stats.storage_ok, "goes on")
        assert delivered(outbox) == list(range(10, 325))


@pytest.mark.parametrize("name", ["", "-wal", ".log", ".numbers", ".lock"])
def test_each_single_file_that_is_deleted_is_begun_anew(tmp_path: Path, name: str) -> None:
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        everywhere(outbox)
        Path(f"{path}{name}").unlink()
        until(lambda: outbox.stats.replaced == 1, "noticed")
        put(outbox, 5)
        until(lambda: waiting(path) == 315, "what was there and what followed")
        until(lambda: Path(f"{path}{name}").exists(), "the file")
        with pytest.raises(InputError, match="in use by another process"):
            make(path).start()
        assert delivered(outbox) == list(range(10, 325))
        assert outbox.stats.replaced == 1, "told once"
    assert stored(path) == list(range(10, 325))
    with started(path) as outbox:
        assert outbox.next_seq(TOPIC) == 325


def test_a_file_of_which_nothing_can_be_read_any_more_costs_what_the_sender_does_not_have(tmp_path: Path) -> None:
    """Overwritten before it was deleted: rows that were handed out are stored again, the others are counted as lost."""
    path = tmp_path / "outbox.sqlite"
    with started(path) as outbox:
        put(outbox, 3_000, size=4_000)
        until(lambda: outbox.stats.committed == 3_000, "commit")
        outbox.begin_delivery(lambda: None)
        held = {row.seq for row, _ in take_all(outbox, 1)}
        size = path.stat().st_size
        path.write_bytes(b"\x5a" * size)
        Path(f"{path}-wal").write_bytes(b"")
        path.unlink()
        until(lambda: outbox.stats.replaced >= 1 and outbox.stats.storage_ok and path.exists(), "goes on")
        put(outbox, 3)
        until(lambda: outbox.stats.balanced() and outbox.uncommitted == 0, "commit of what followed")
        stats = outbox.stats
        assert stats.queued + stats.dropped.get("corrupt", 0) == 3_003
        assert stats.queued == inspect(path).queued
    assert held <= set(stored(path))

"""What is asked of the kernel before something counts as kept: the calls, in order.

A disk that forgets what was not synced (`tests/guest_suite/test_power_loss.py`) shows most of what a missing call
costs, but journalling file systems write some directories without being asked. Here the calls themselves are watched.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from highside.bench.journal_file import JournalFile
from highside.bench.session.entries import Noted
from highside.bench.setup import header_of
from highside.config.bench import load_bench
from highside.config.recorder import RecorderSettings
from highside.errors import InputError
from highside.link.base import Chunk
from highside.recording.calibration_store import CalibrationStore
from highside.recording.files import make_directory, write_folder, write_whole
from highside.service.outbox_file import MessageFile
from highside.service.places import take_state_dir
from highside.service.recorder import Recorder
from highside.service.rig.surveys import SurveyLog
from highside.service.rig.toolface import ToolfaceLog
from tests.segments import SegmentWriter

ROOT = Path(__file__).resolve().parents[2]
NOW = 1_795_000_000.0

Calls = list[tuple[str, str, int]]
"""(call, path relative to the test's folder, size of the file at that moment)"""


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Calls:
    """What was synced and renamed, in order."""
    seen: Calls = []

    def relative(path: str | os.PathLike[str]) -> str:
        return os.path.relpath(path, tmp_path)

    def watched(name: str, call: Callable[[int], None]) -> Callable[[int], None]:
        def sync(descriptor: int) -> None:
            call(descriptor)
            seen.append((name, relative(Path(f"/proc/self/fd/{descriptor}").readlink()), os.fstat(descriptor).st_size))

        return sync

    replace = os.replace

    def replaced(old: Any, new: Any) -> None:
        size = Path(old).stat().st_size
        replace(old, new)
        seen.append(("replace", relative(new), size))

    monkeypatch.setattr(os, "fsync", watched("sync", os.fsync))
    monkeypatch.setattr(os, "fdatasync", watched("sync", os.fdatasync))
    monkeypatch.setattr(os, "replace", replaced)
    return seen


def names(calls: Calls) -> list[tuple[str, str]]:
    return [(call, path) for call, path, _ in calls]


def until(what: Callable[[], bool]) -> None:
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_whole_file_is_synced_then_renamed_then_its_directory(tmp_path: Path, calls: Calls) -> None:
    write_whole(tmp_path / "file", b"x" * 3000)
    (first, beside, size), second, third = calls
    assert first == "sync" and beside.startswith(".file.") and size == 3000
    assert second == ("replace", "file", 3000)
    assert third[:2] == ("sync", ".")


def test_what_did_not_arrive_whole_never_replaces_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "file"
    write_whole(place, b"old")
    sync = os.fsync

    def emptied(descriptor: int) -> None:
        os.ftruncate(descriptor, 0)
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", emptied)
    with pytest.raises(InputError, match="0 bytes of 3 arrived"):
        write_whole(place, b"new")
    assert place.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_every_new_directory_is_synced_into_its_parent(tmp_path: Path, calls: Calls) -> None:
    make_directory(tmp_path / "a" / "b" / "c")
    assert {path for call, path, _ in calls if call == "sync"} == {".", "a", "a/b"}
    calls.clear()
    make_directory(tmp_path / "a" / "b" / "c")
    assert not calls


def test_the_places_of_a_new_installation_are_synced_into_their_parents(tmp_path: Path, calls: Calls) -> None:
    """Messages, a turntable's fit: what is synced into a folder goes with it where the folder itself was not."""
    lock = take_state_dir(tmp_path / "var" / "tool")
    assert {path for call, path, _ in calls if call == "sync"} == {".", "var"}
    lock.close()
    calls.clear()
    messages = MessageFile(tmp_path / "other" / "outbox.sqlite")
    messages.lock()
    assert ("sync", ".") in names(calls)
    messages.release()
    calls.clear()
    write_folder(tmp_path / "made" / "report", {"a.html": "text"})
    assert [path for call, path in names(calls) if call == "sync"][:2] == ["made", "."]


def test_a_wire_segment_is_synced_to_its_last_record(tmp_path: Path, calls: Calls) -> None:
    writer = SegmentWriter(tmp_path / "a.hsw", {})
    size = writer.append(b"x" * 100, t_wall=NOW, t_mono=1.0)
    writer.sync()
    assert size > 100
    assert calls == [("sync", "a.hsw", (tmp_path / "a.hsw").stat().st_size)]


def test_a_recording_is_known_to_its_directory_before_data_count_and_synced_at_its_interval(
    tmp_path: Path, calls: Calls
) -> None:
    recorder = Recorder(RecorderSettings(fsync_interval_s=0.05), tmp_path / "recordings", "tool")
    recorder.start()
    recorder.on_batch(Chunk(1.0, NOW, b"x" * 500))
    until(lambda: any(path.endswith(".hsw") for _, path, _ in calls))
    assert names(calls)[:2] == [("sync", "."), ("sync", "recordings")]
    _, path, size = calls[2]
    assert size == (tmp_path / path).stat().st_size > 500
    recorder.on_batch(Chunk(2.0, NOW, b"y" * 500))
    assert recorder.stop()
    assert calls[-1] == ("sync", path, (tmp_path / path).stat().st_size)


def test_a_toolface_setting_is_synced_before_it_is_confirmed(tmp_path: Path, calls: Calls) -> None:
    log = ToolfaceLog(tmp_path / "state")
    log.set(10.0, "driller", NOW)
    assert names(calls) == [("sync", "."), ("sync", "state/toolface.jsonl"), ("sync", "state")]
    calls.clear()
    log.set(20.0, "driller", NOW)
    assert calls == [("sync", "state/toolface.jsonl", log.path.stat().st_size)]


def test_a_survey_is_synced_before_it_counts_as_kept(tmp_path: Path, calls: Calls) -> None:
    log = SurveyLog(tmp_path / "surveys.jsonl")
    log.start()
    log.keep({"number": 1})
    until(lambda: log.kept == 1)
    assert calls[0] == ("sync", "surveys.jsonl", log.path.stat().st_size)
    assert calls[1][:2] == ("sync", ".")
    log.keep({"number": 2})
    until(lambda: log.kept == 2)
    assert calls[2:] == [("sync", "surveys.jsonl", log.path.stat().st_size)]
    log.stop(5.0)


def test_a_pose_is_synced_before_it_is_taken(tmp_path: Path, calls: Calls) -> None:
    settings = load_bench(ROOT / "config" / "bench-simulated.toml")
    journal = JournalFile.create(tmp_path / "sessions", header_of(settings, "s", NOW, "operator"))
    assert names(calls) == [("sync", "."), ("sync", "sessions/s.journal"), ("sync", "sessions")]
    calls.clear()
    journal.write(Noted("pose", "1"), NOW)
    assert calls == [("sync", "sessions/s.journal", journal.path.stat().st_size)]
    journal.close()


def test_a_store_is_known_to_its_directory(tmp_path: Path, calls: Calls) -> None:
    store = CalibrationStore(tmp_path / "deep" / "store")
    store._make(store._records)
    assert {path for _, path, _ in calls} == {".", "deep", "deep/store"}


@pytest.mark.timeout(60)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes among its files")
def test_a_named_pipe_is_written_to_where_somebody_reads_and_refused_where_nobody_does(tmp_path: Path) -> None:
    """To open one that nobody reads waits for ever: a service whose state file is one would stand still."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="pipe: is a named pipe, not a file"):
        write_whole(pipe, b"x")
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    long = bytes(range(256)) * 4096  # more than a pipe holds: it is written as it is read
    received = bytearray()

    def read() -> None:
        os.set_blocking(reader, True)
        while len(received) < len(long):
            # nothing, as long as nobody has opened the other end
            received.extend(os.read(reader, 1 << 16) or time.sleep(0.01) or b"")

    listening = threading.Thread(target=read)
    listening.start()
    write_whole(pipe, long)
    listening.join(30.0)
    os.close(reader)
    assert bytes(received) == long
    assert pipe.is_fifo()

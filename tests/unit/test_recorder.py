"""The wire recorder on a real disk: whole, in order, capped, and patient with a disk that refuses."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime, tzinfo
from pathlib import Path

import pytest

from highside.codec.frame import CanFrame
from highside.config.recorder import RecorderSettings
from highside.link.base import Chunk
from highside.recording.candump import read_candump
from highside.recording.wire import MAX_RECORD_BYTES, read_segments
from highside.service import recorder as recorder_module
from highside.service.recorder import Recorder
from highside.service.recorder_stats import DropReason, RecorderState


def chunk(number: int, size: int = 64) -> Chunk:
    """A numbered chunk: the number repeated to the size."""
    return Chunk(10.0 + number / 1024, 1.7e9 + number / 1024, number.to_bytes(4, "little") * (size // 4))


def files(directory: Path) -> list[Path]:
    """Recordings in the order of their names."""
    return sorted(directory.iterdir())


def chunks_in(directory: Path) -> list[Chunk]:
    """All records of all files, in order."""
    return [Chunk(*record) for path in files(directory) for record in read_segments(path)]


def until(what: Callable[[], bool], timeout_s: float = 20.0) -> None:
    """Wait for something that is expected at once."""
    end = time.monotonic() + timeout_s
    while not what():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_chunks_are_read_back_as_they_came(tmp_path: Path) -> None:
    recorder = Recorder(RecorderSettings(), tmp_path / "state" / "recordings", "bench-1", meta={"codec": "tool"})
    recorder.start()
    sent = [chunk(i, 4 * (i % 50)) for i in range(500)]
    for one in sent:
        recorder.on_batch(one)
    assert recorder.stop()
    (path,) = files(tmp_path / "state" / "recordings")
    reader = read_segments(path)
    assert [Chunk(*record) for record in reader] == sent
    assert reader.torn_bytes == 0
    assert reader.meta == {"tool": "bench-1", "codec": "tool"}
    assert path.name.startswith("bench-1_000001_20")
    stats = recorder.stats
    assert stats.state is RecorderState.OFF
    assert (stats.batches_in, stats.batches_written) == (500, 500)
    assert stats.bytes_written == sum(len(one.data) for one in sent)
    assert stats.file_bytes == path.stat().st_size
    assert stats.balanced()
    assert stats.as_dict()["balanced"] is True


def test_can_frames_become_candump_text(tmp_path: Path) -> None:
    frames = [
        CanFrame(1.0, 1436509052.249713, 0x44, bytes.fromhex("2A366C2B")),
        CanFrame(1.1, 1436509052.25, 0x18FF50E5, b"\x01\x02", extended=True),
        CanFrame(1.2, 1436509052.26, 0x7FF, b""),
        CanFrame(1.3, 1436509052.27, 0x88, bytes(8), error=True),
    ]
    recorder = Recorder(RecorderSettings(), tmp_path, "bench", channel="can7")
    recorder.start()
    recorder.on_batch(frames[:3])
    recorder.on_batch(frames[3:])
    assert recorder.stop()
    (path,) = files(tmp_path)
    assert path.read_text().splitlines()[0] == "(1436509052.249713) can7 044#2A366C2B"
    read = [frame._replace(t_mono=0.0) for frame in read_candump(path)]
    assert read == [frame._replace(t_mono=0.0) for frame in frames]
    assert recorder.stats.bytes_written == 14
    assert recorder.stats.balanced()


def test_a_link_that_changes_its_kind_begins_a_new_file(tmp_path: Path) -> None:
    recorder = Recorder(RecorderSettings(), tmp_path, "bench")
    recorder.start()
    for i in range(3):
        recorder.on_batch(chunk(i))
        recorder.on_batch([CanFrame(0.0, 1.7e9, i, b"\x01")])
    assert recorder.stop()
    assert [path.suffix for path in files(tmp_path)] == [".hsw", ".log"] * 3
    assert recorder.stats.segments == 6


def test_files_are_rotated_by_size_and_the_oldest_deleted_under_the_cap(tmp_path: Path) -> None:
    settings = RecorderSettings(segment_max_bytes=4096, total_max_bytes=5 * 4096, fsync_interval_s=60)
    recorder = Recorder(settings, tmp_path, "bench")
    recorder.start()
    for i in range(1000):
        recorder.on_batch(chunk(i))
    assert recorder.stop()
    sizes = [path.stat().st_size for path in files(tmp_path)]
    assert max(sizes) <= 4096
    assert sum(sizes) <= settings.total_max_bytes
    assert recorder.stats.segments_deleted == recorder.stats.segments - len(sizes) > 0
    kept = chunks_in(tmp_path)
    assert kept == [chunk(i) for i in range(1000 - len(kept), 1000)]
    assert len(kept) > 150


def test_files_are_rotated_by_time(tmp_path: Path) -> None:
    recorder = Recorder(RecorderSettings(segment_max_s=0.05), tmp_path, "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    until(lambda: recorder.stats.segments == 1 and recorder.stats.state is RecorderState.IDLE)
    assert recorder.stats.file is None
    recorder.on_batch(chunk(1))
    until(lambda: recorder.stats.segments == 2)
    assert recorder.stop()
    assert chunks_in(tmp_path) == [chunk(0), chunk(1)]


def test_a_second_run_and_a_clock_that_steps_back_overwrite_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Clock:
            return cls(1970, 1, 1, 0, 0, 9, tzinfo=tz)

    for run in range(3):
        if run == 1:
            monkeypatch.setattr(recorder_module, "datetime", Clock)
        recorder = Recorder(RecorderSettings(), tmp_path, "bench")
        recorder.start()
        recorder.on_batch(chunk(run))
        assert recorder.stop()
    assert chunks_in(tmp_path) == [chunk(0), chunk(1), chunk(2)]
    assert [path.name for path in files(tmp_path)][1:] == [
        "bench_000002_19700101T000009Z.hsw",
        "bench_000003_19700101T000009Z.hsw",
    ]


def test_a_name_that_is_taken_is_never_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # another process took the name between the look and the creation
    monkeypatch.setattr(Recorder, "_recordings", lambda self: [])
    for run in range(2):
        recorder = Recorder(RecorderSettings(), tmp_path, "bench")
        recorder.start()
        recorder.on_batch(chunk(run))
        assert recorder.stop()
    assert chunks_in(tmp_path) == [chunk(0), chunk(1)]


class Disk:
    """os.write with a fault that can be switched on; half of the data is written before it strikes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.fault: int | None = None
        self.blocked = False
        self._write = os.write
        monkeypatch.setattr(recorder_module.os, "write", self)

    def __call__(self, descriptor: int, data: memoryview | bytes) -> int:
        while self.blocked:
            time.sleep(0.005)
        if self.fault is not None:
            if len(data) > 40:
                return self._write(descriptor, bytes(data)[: len(data) // 2])
            raise OSError(self.fault, os.strerror(self.fault))
        return self._write(descriptor, data)


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.ENOSPC, DropReason.NO_SPACE),
        (errno.EROFS, DropReason.READ_ONLY),
        (errno.EIO, DropReason.IO_ERROR),
    ],
)
def test_a_disk_that_refuses_is_reported_and_taken_again_when_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, reason: DropReason
) -> None:
    disk = Disk(monkeypatch)
    recorder = Recorder(RecorderSettings(retry_s=0.02, queue_max_bytes=4096), tmp_path, "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    until(lambda: recorder.stats.batches_written == 1)
    disk.fault = number
    # 64 chunks of 64 bytes fill the queue, 36 more have no place
    for i in range(1, 101):
        recorder.on_batch(chunk(i))
        if i == 1:
            until(lambda: recorder.stats.state is RecorderState.FAILING)
    assert recorder.stats.reason is reason
    assert os.strerror(number) in recorder.stats.message
    assert recorder.stats.batches_dropped == {reason: 36}
    assert recorder.stats.balanced()
    until(lambda: recorder.stats.failures > 3)
    disk.fault = None
    until(lambda: recorder.stats.batches_queued == 0)
    assert recorder.stats.state is RecorderState.RECORDING
    assert recorder.stats.reason is None
    recorder.on_batch(chunk(101))
    assert recorder.stop()
    assert chunks_in(tmp_path) == [chunk(i) for i in (*range(65), 101)]
    assert all(path.stat().st_size > 0 for path in files(tmp_path))
    assert recorder.stats.balanced()


@pytest.mark.parametrize("how", ["deleted", "moved away"])
def test_a_file_that_is_deleted_while_it_is_written_is_reported_and_followed_by_another(
    tmp_path: Path, how: str
) -> None:
    """The kernel takes what is written to it as before, and nobody will ever find it."""
    directory = tmp_path / "recordings"
    recorder = Recorder(RecorderSettings(fsync_interval_s=0.05, retry_s=0.05), directory, "t")
    recorder.start()
    recorder.on_batch(chunk(1))
    until(lambda: recorder.stats.batches_written == 1)
    if how == "deleted":
        shutil.rmtree(directory)
    else:
        directory.rename(tmp_path / "elsewhere")
    number = 1
    while recorder.stats.failures == 0:
        number += 1
        recorder.on_batch(chunk(number))
        time.sleep(0.02)
        assert number < 500
    assert recorder.stats.message.startswith(f"recording to {directory} failed: t_000001_")
    assert recorder.stats.message.endswith(".hsw was deleted or moved while it was written")
    recorder.on_batch(chunk(number + 1))
    until(lambda: recorder.stats.state is RecorderState.RECORDING)
    recorder.on_batch(chunk(number + 2))
    assert recorder.stop()
    assert chunks_in(directory)[-1] == chunk(number + 2)
    assert recorder.stats.balanced()


def test_a_disk_that_hangs_never_holds_up_the_acquisition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(monkeypatch)
    disk.blocked = True
    recorder = Recorder(RecorderSettings(queue_max_bytes=6400), tmp_path, "bench")
    recorder.start()
    begin = time.monotonic()
    for i in range(1000):
        recorder.on_batch(chunk(i))
    assert time.monotonic() - begin < 1.0
    assert recorder.stats.batches_dropped == {DropReason.QUEUE_FULL: 900}
    assert not recorder.stop(0.2)
    assert recorder.stats.batches_dropped[DropReason.STOPPED] == 100
    disk.blocked = False
    assert recorder.stop(10.0)
    assert recorder.stats.balanced()


def test_a_directory_that_cannot_be_made_is_a_state_not_an_end(tmp_path: Path) -> None:
    in_the_way = tmp_path / "recordings"
    in_the_way.write_text("a file, not a directory")
    recorder = Recorder(RecorderSettings(retry_s=0.02), in_the_way, "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    until(lambda: recorder.stats.state is RecorderState.FAILING)
    in_the_way.unlink()
    until(lambda: recorder.stats.state is RecorderState.RECORDING)
    assert recorder.stop()
    assert chunks_in(in_the_way) == [chunk(0)]


def test_recording_can_be_switched_off_and_on(tmp_path: Path) -> None:
    off, on = RecorderSettings(enabled=False), RecorderSettings()
    recorder = Recorder(off, tmp_path, "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    assert recorder.stats.state is RecorderState.OFF
    recorder.apply(on)
    recorder.on_batch(chunk(1))
    until(lambda: recorder.stats.state is RecorderState.RECORDING)
    recorder.apply(off)
    until(lambda: recorder.stats.state is RecorderState.OFF)
    recorder.on_batch(chunk(2))
    assert recorder.stop()
    assert chunks_in(tmp_path) == [chunk(1)]
    assert recorder.stats.batches_in == 1


def test_it_is_fsynced_at_the_interval_and_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    fdatasync = os.fdatasync

    def counted(descriptor: int) -> None:
        synced.append(descriptor)
        fdatasync(descriptor)

    monkeypatch.setattr(recorder_module.os, "fdatasync", counted)
    recorder = Recorder(RecorderSettings(fsync_interval_s=0.05), tmp_path, "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    until(lambda: len(synced) == 1)
    # nothing new: nothing to sync
    time.sleep(0.3)
    assert len(synced) == 1
    recorder.on_batch(chunk(1))
    until(lambda: len(synced) == 2)
    recorder.on_batch(chunk(2))
    assert recorder.stop()
    assert len(synced) == 3


CHILD = """
import sys, time
from pathlib import Path
from highside.config.recorder import RecorderSettings
from highside.link.base import Chunk
from highside.service.recorder import Recorder

recorder = Recorder(RecorderSettings(segment_max_bytes=20_000, total_max_bytes=1 << 26), Path(sys.argv[1]), "bench")
recorder.start()
number = 0
while True:
    for _ in range(20):
        data = number.to_bytes(4, "little") * (8 + number % 23)
        recorder.on_batch(Chunk(number / 1024, 1.7e9 + number / 1024, data))
        number += 1
    print(recorder.stats.batches_written, flush=True)
    time.sleep(0.002)
"""


@pytest.mark.parametrize("after", [1, 700, 1_501, 4_000, 9_017])
def test_after_sigkill_all_that_was_written_is_read_back(tmp_path: Path, after: int) -> None:
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    written = 0
    while written < after:
        written = int(child.stdout.readline())
    child.kill()
    # what it had said before the signal took effect counts as well
    said = [line for line in child.stdout.read().splitlines(keepends=True) if line.endswith("\n")]
    written = max([written, *map(int, said)])
    child.wait()
    segments = files(tmp_path)
    if not segments[-1].stat().st_size:
        # it was just made, and its header not written yet
        segments.pop()
    records = [record for path in segments for record in read_segments(path)]
    numbers = [int.from_bytes(record.data[:4], "little") for record in records]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= written
    assert all(record.data == n.to_bytes(4, "little") * (8 + n % 23) for n, record in enumerate(records))


def test_a_file_torn_at_any_byte_reads_to_its_last_complete_record(tmp_path: Path) -> None:
    recorder = Recorder(RecorderSettings(), tmp_path / "whole", "bench")
    recorder.start()
    for i in range(5):
        recorder.on_batch(chunk(i, 16))
    assert recorder.stop()
    (path,) = files(tmp_path / "whole")
    content = path.read_bytes()
    record = 20 + 16 + 4
    begin = len(content) - 5 * record
    torn = tmp_path / "torn.hsw"
    for end in range(begin, len(content) + 1):
        torn.write_bytes(content[:end])
        reader = read_segments(torn)
        assert [Chunk(*one) for one in reader] == [chunk(i, 16) for i in range((end - begin) // record)]
        assert reader.torn_bytes == (end - begin) % record


def test_settings_without_room_for_two_segments_are_refused() -> None:
    with pytest.raises(ValueError, match="two segments"):
        RecorderSettings(segment_max_bytes=1 << 20, total_max_bytes=1 << 20)
    assert RecorderSettings().segment_max_bytes < MAX_RECORD_BYTES + 1

"""The recorder on file systems that are really full and really read-only."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from highside.config.recorder import RecorderSettings
from highside.link.base import Chunk
from highside.recording.wire import read_segments
from highside.service.recorder import Recorder
from highside.service.recorder_stats import DropReason, RecorderState


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, of 256 KiB."""
    place = tmp_path / "disk"
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", place], check=True)
    yield place
    subprocess.run(["umount", "--lazy", place], check=True)


def until(what: Callable[[], bool]) -> None:
    """Wait for something that is expected at once."""
    end = time.monotonic() + 20.0
    while not what():
        assert time.monotonic() < end
        time.sleep(0.01)


def chunk(number: int) -> Chunk:
    return Chunk(float(number), 1.7e9 + number, number.to_bytes(4, "little") * 256)


def numbers(directory: Path) -> list[int]:
    """The chunks in all files; each must be whole."""
    found = []
    for path in sorted(directory.iterdir()):
        reader = read_segments(path)
        found += [int.from_bytes(record.data[:4], "little") for record in reader]
        assert reader.torn_bytes == 0
    return found


def test_a_full_disk_is_reported_and_recording_resumes_when_there_is_room(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(100 * 1024))
    recorder = Recorder(RecorderSettings(retry_s=0.05, queue_max_bytes=32 * 1024), small_disk / "recordings", "bench")
    recorder.start()
    for number in range(400):
        recorder.on_batch(chunk(number))
        time.sleep(0.002)
    until(lambda: recorder.stats.state is RecorderState.FAILING)
    stats = recorder.stats
    assert stats.reason is DropReason.NO_SPACE
    # what is in no file is what the queue could not bridge, and it is counted
    assert stats.batches_dropped[DropReason.NO_SPACE] > 0
    assert stats.batches_queued == 32
    assert stats.balanced()
    ballast.unlink()
    until(lambda: recorder.stats.batches_queued == 0)
    assert stats.state is RecorderState.RECORDING
    recorder.on_batch(chunk(400))
    assert recorder.stop()
    found = numbers(small_disk / "recordings")
    assert len(found) == stats.batches_written == 401 - sum(stats.batches_dropped.values())
    assert found == sorted(set(found))
    assert found[-1] == 400


def test_a_read_only_file_system_is_reported_and_recording_resumes_when_it_is_writable(small_disk: Path) -> None:
    settings = RecorderSettings(retry_s=0.05, segment_max_bytes=4096, total_max_bytes=1 << 17)
    recorder = Recorder(settings, small_disk / "recordings", "bench")
    recorder.start()
    recorder.on_batch(chunk(0))
    until(lambda: recorder.stats.batches_written == 1)
    # the open file keeps a file system from becoming read-only: end it, as a restart of the service would
    assert recorder.stop()
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    recorder = Recorder(settings, small_disk / "recordings", "bench")
    recorder.start()
    recorder.on_batch(chunk(1))
    until(lambda: recorder.stats.state is RecorderState.FAILING)
    assert recorder.stats.reason is DropReason.READ_ONLY
    subprocess.run(["mount", "-o", "remount,rw", small_disk], check=True)
    until(lambda: recorder.stats.batches_written == 1)
    assert recorder.stop()
    assert numbers(small_disk / "recordings") == [0, 1]

"""Keeps what came over the wire, as it came, in files that survive whatever ends the process.

Serial bytes go to the project's own segments (`highside.recording.wire`: a header, then records with length, times and
checksum), CAN frames to `candump -L` text. Both are readable up to the last complete record however the process ended:
a record is handed to the kernel in one piece by plain `write`, with no buffer of our own that SIGKILL could take, and
is fsynced at an interval against a loss of power.

The acquisition never waits for the disk: `on_batch` puts the batch in a bounded queue, a thread of the recorder's own
writes. While the disk refuses (full, read-only, broken) the thread tries again at an interval; the queue bridges what
it can hold, the rest is dropped and counted by reason. At any time

    batches_in = batches_written + batches_queued + sum(batches_dropped.values())

and the same holds for the payload bytes.

A file's name is `<tool>_<sequence>_<UTC time>.<kind>`. Order follows the sequence number, which only grows: a clock
that steps back can neither overwrite nor reorder anything.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextvars import copy_context
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from highside.config.recorder import RecorderSettings
from highside.link.base import Batch, Chunk
from highside.recording.candump import format_candump
from highside.recording.files import flush_directory, make_directory
from highside.recording.in_place import is_at
from highside.recording.wire import SUFFIX, encode_header, encode_record
from highside.service.quiet_log import QuietLog
from highside.service.recorder_stats import REASONS, DropReason, RecorderState, RecorderStats
from highside.service.wake import Wake

log = logging.getLogger(__name__)

GATHER_S = 0.05
"""How long the writer lets batches gather before it writes them: the most that SIGKILL can take, as of messages."""
CANDUMP_SUFFIX = ".log"
_NAME = re.compile(r"^(?P<tool>.+)_(?P<sequence>\d{6,15})_\d{8}T\d{6}Z(?:\.hsw|\.log)$")


@dataclass(slots=True)
class _Segment:
    """The open file."""

    path: Path
    descriptor: int
    opened_mono: float
    is_can: bool
    size: int = 0
    """up to the end of the last complete record"""
    synced_mono: float = 0.0
    dirty: bool = False


class Recorder:
    """Records the batches of one link.

    `directory` is made when it is first needed. `meta` (tool id and what else the caller knows) is written into the
    header of serial segments; `channel` is the interface name in candump lines.
    """

    def __init__(
        self,
        settings: RecorderSettings,
        directory: Path,
        tool_id: str,
        *,
        meta: Mapping[str, str] | None = None,
        channel: str = "can0",
    ) -> None:
        self.stats = RecorderStats()
        self._settings = settings
        self._quiet = QuietLog(log)
        self._directory = directory
        self._tool_id = tool_id
        self._meta = {"tool": tool_id, **(meta or {})}
        self._channel = channel
        self._queue: deque[tuple[Batch, int]] = deque()
        self._lock = threading.Lock()
        self._wake = Wake()
        self._stopping = False
        self._idle = False
        """the writer waits to be notified of a batch; else it looks by itself"""
        self._thread: threading.Thread | None = None
        # the writer thread's own
        self._segment: _Segment | None = None
        self._next_sequence: int | None = None

    # --- the caller's side ---------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin; may be called once."""
        if self._thread is not None:
            raise RuntimeError("the recorder has been started already")
        self.stats.state = RecorderState.IDLE if self._settings.enabled else RecorderState.OFF
        self._thread = threading.Thread(target=copy_context().run, args=(self._run,), name="recorder", daemon=True)
        self._thread.start()

    def on_batch(self, batch: Batch) -> None:
        """Take a batch; never waits for the disk, never raises."""
        if not self._settings.enabled or not batch:
            return
        size = len(batch.data) if isinstance(batch, Chunk) else sum(len(frame.data) for frame in batch)
        stats = self.stats
        with self._lock:
            stats.batches_in += 1
            stats.bytes_in += size
            if self._stopping:
                self._drop(DropReason.STOPPED, size)
            elif stats.bytes_queued + size > self._settings.queue_max_bytes:
                self._drop(stats.reason or DropReason.QUEUE_FULL, size)
            else:
                stats.batches_queued += 1
                stats.bytes_queued += size
                self._queue.append((batch, size))
                if self._idle:
                    self._wake.set()

    def apply(self, settings: RecorderSettings) -> None:
        """Take new settings; an open file is closed first if recording is switched off."""
        with self._lock:
            self._settings = settings
        self._wake.set()

    def stop(self, timeout_s: float = 5.0) -> bool:
        """Write what is queued, fsync and close. Returns False if the disk did not allow it within `timeout_s`."""
        with self._lock:
            self._stopping = True
        self._wake.set()
        thread = self._thread
        if thread is not None:
            thread.join(timeout_s)
        with self._lock:
            for _, size in self._queue:
                self.stats.batches_queued -= 1
                self.stats.bytes_queued -= size
                self._drop(self.stats.reason or DropReason.STOPPED, size)
            lost = len(self._queue)
            self._queue.clear()
            self.stats.state = RecorderState.OFF
        return lost == 0 and (thread is None or not thread.is_alive())

    def _drop(self, reason: DropReason, size: int) -> None:
        dropped = self.stats.batches_dropped
        dropped[reason] = dropped.get(reason, 0) + 1
        self.stats.bytes_dropped += size

    # --- the writer's side ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        flowing = False
        while True:
            self._idle = not (self._queue or self._stopping)
            # looked at again: what was put before it could be seen that this thread sleeps wakes nobody
            if self._idle and not (self._queue or self._stopping):
                flowing = False
                self._wake.wait(self._idle_s())
            self._idle = False
            if self._queue and not (flowing or self._stopping):
                self._wake.wait(GATHER_S)
            stopping, flowing = self._stopping, bool(self._queue)
            try:
                self._write_queued()
                self._keep_time(close=stopping or not self._settings.enabled)
            except Exception as error:
                # whatever it is, this thread ends with the service and not before
                self._refused(error)
                if stopping:
                    return
                if not self._stopping:
                    self._wake.wait(self._settings.retry_s)
            else:
                if stopping:
                    return
                if flowing and not self._stopping:
                    # one wake-up for all that comes meanwhile
                    self._wake.wait(GATHER_S)

    def _idle_s(self) -> float | None:
        """How long nothing needs to be done to the open file, if nothing arrives."""
        segment = self._segment
        if segment is None:
            return None
        due = segment.opened_mono + self._settings.segment_max_s
        if segment.dirty:
            due = min(due, segment.synced_mono + self._settings.fsync_interval_s)
        return max(due - time.monotonic(), 0.0)

    def _write_queued(self) -> None:
        """Write everything queued, as few calls as possible, each to the end of a record."""
        while True:
            with self._lock:
                batches = list(self._queue)
            if not batches:
                return
            while batches:
                batches = batches[self._write_batches(batches) :]

    def _write_batches(self, batches: list[tuple[Batch, int]]) -> int:
        """Write the batches that go into the current file with one call; returns how many. Raises OSError."""
        settings = self._settings
        is_can = not isinstance(batches[0][0], Chunk)
        segment = self._segment
        first = self._encode(batches[0][0])
        if segment is not None and (
            segment.is_can != is_can
            or segment.size + len(first) > settings.segment_max_bytes
            or time.monotonic() - segment.opened_mono >= settings.segment_max_s
        ):
            self._close_segment()
            segment = None
        if segment is None:
            segment = self._open_segment(is_can)
        pieces, room = [first], settings.segment_max_bytes - segment.size - len(first)
        for batch, _ in batches[1:]:
            if isinstance(batch, Chunk) == is_can:
                break
            piece = self._encode(batch)
            room -= len(piece)
            if room < 0:
                break
            pieces.append(piece)
        self._write(segment, b"".join(pieces))
        self._written(segment, len(pieces))
        return len(pieces)

    def _encode(self, batch: Batch) -> bytes:
        if isinstance(batch, Chunk):
            return encode_record(batch)
        return "".join(format_candump(frame, self._channel) for frame in batch).encode("ascii")

    def _write(self, segment: _Segment, data: bytes) -> None:
        """Append in full, or leave the file as it was. Raises OSError."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(segment.descriptor, view) :]
        except OSError:
            # a torn record in the middle would end every later reading of this file
            with contextlib.suppress(OSError):
                os.ftruncate(segment.descriptor, segment.size)
            raise
        if not segment.dirty:
            segment.dirty, segment.synced_mono = True, time.monotonic()
        segment.size += len(data)
        self.stats.file_bytes += len(data)

    def _written(self, segment: _Segment, count: int) -> None:
        """Account for the first `count` batches of the queue."""
        stats = self.stats
        with self._lock:
            if not self._queue:
                return  # `stop` could not wait any longer and has counted them as dropped
            for _ in range(count):
                _, size = self._queue.popleft()
                stats.batches_queued -= 1
                stats.bytes_queued -= size
                stats.batches_written += 1
                stats.bytes_written += size
            if stats.state is RecorderState.FAILING:
                self._quiet.say(logging.INFO, "again", "recording again, to %s", segment.path.name)
            stats.state, stats.reason, stats.message = RecorderState.RECORDING, None, ""

    def _keep_time(self, *, close: bool) -> None:
        """Fsync and rotate what is due. Raises OSError."""
        segment, now = self._segment, time.monotonic()
        if segment is None:
            if close:
                self._settle(RecorderState.OFF)
            return
        if close or now - segment.opened_mono >= self._settings.segment_max_s:
            self._close_segment()
            self._settle(RecorderState.OFF if close else RecorderState.IDLE)
        elif segment.dirty and now - segment.synced_mono >= self._settings.fsync_interval_s:
            os.fdatasync(segment.descriptor)
            segment.dirty = False
            if not is_at(segment.path, segment.descriptor):
                # what is written goes on being taken by a file that nobody will find: a new one, with a word about it
                raise FileNotFoundError(errno.ENOENT, f"{segment.path.name} was deleted or moved while it was written")

    def _settle(self, state: RecorderState) -> None:
        with self._lock:
            self.stats.state, self.stats.reason, self.stats.message = state, None, ""

    def _refused(self, error: Exception) -> None:
        """The disk does not take it: give the file up, say so; the next attempt begins a new one."""
        if self._segment is not None:
            with contextlib.suppress(OSError):
                os.close(self._segment.descriptor)
            self._segment = None
        number, cause = (error.errno, error.strerror) if isinstance(error, OSError) else (None, type(error).__name__)
        reason = REASONS.get(number or 0, DropReason.IO_ERROR)
        message = f"recording to {self._directory} failed: {cause or error}"
        stats = self.stats
        with self._lock:
            news = stats.state is not RecorderState.FAILING or stats.reason is not reason
            stats.state, stats.reason, stats.message, stats.file = RecorderState.FAILING, reason, message, None
            stats.failures += 1
        if news:
            text = "%s; acquisition goes on, trying again every %g s"
            self._quiet.say(logging.ERROR, reason.value, text, message, self._settings.retry_s)

    # --- files ---------------------------------------------------------------------------------------------------

    def _open_segment(self, is_can: bool) -> _Segment:
        """Make room within the cap and create the next file. Raises OSError."""
        make_directory(self._directory)
        existing = self._recordings()
        if self._next_sequence is None:
            self._next_sequence = 1 + (existing[-1][0] if existing else 0)
        self._delete_oldest(existing)
        suffix = CANDUMP_SUFFIX if is_can else SUFFIX
        while True:
            stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
            path = self._directory / f"{self._tool_id}_{self._next_sequence:06d}_{stamp}{suffix}"
            self._next_sequence += 1
            with contextlib.suppress(FileExistsError):
                flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
                descriptor = os.open(path, flags, 0o640)
                break
        now = time.monotonic()
        segment = _Segment(path, descriptor, now, is_can, synced_mono=now)
        try:
            if not is_can:
                self._write(segment, encode_header(self._meta))
            flush_directory(self._directory)
        except OSError:
            # an empty file is no recording; without this a full disk would be littered with them
            os.close(descriptor)
            with contextlib.suppress(OSError):
                path.unlink()
            raise
        self._segment = segment
        self.stats.segments += 1
        self.stats.file = path.name
        return segment

    def _close_segment(self) -> None:
        """Fsync and close the open file. Raises OSError, with the file closed all the same."""
        segment, self._segment = self._segment, None
        self.stats.file = None
        if segment is None:
            return
        try:
            if segment.dirty:
                os.fdatasync(segment.descriptor)
        finally:
            os.close(segment.descriptor)

    def _recordings(self) -> list[tuple[int, Path]]:
        """Our files in order of their sequence numbers, whichever tool they are of."""
        return sorted(
            (int(match["sequence"]), path)
            for path in self._directory.iterdir()
            if (match := _NAME.match(path.name)) is not None and path.is_file()
        )

    def _delete_oldest(self, existing: list[tuple[int, Path]]) -> None:
        """Delete until another full segment fits under the cap."""
        sizes = [path.stat().st_size for _, path in existing]
        total = sum(sizes) + self._settings.segment_max_bytes
        for (_, path), size in zip(existing, sizes, strict=True):
            if total <= self._settings.total_max_bytes:
                return
            path.unlink()
            total -= size
            self.stats.segments_deleted += 1

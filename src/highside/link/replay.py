"""Wire recordings played again: into the service as a link, or into a pty or a CAN interface for anybody to read.

A recording is a candump log, the project's own serial segments, or raw bytes (which have no times and are given a byte
rate). It is played at `speed` times the recorded pace; 0 means as fast as possible, the event loop still getting its
turn after every batch. What is due is delivered in batches.

Times of what is delivered: `t_wall` is the recording's own; `t_mono` is the moment at which it was due, so that gaps
and rates are those of the recording (with speed 0 it runs on as the recording does, ahead of the clock).
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from pydantic import Field

from highside.codec.frame import CanFrame
from highside.errors import InputError
from highside.link.base import Chunk, Clock, Deliver, LinkError, LinkReason, SystemClock
from highside.link.wire import Wire
from highside.reading import open_binary
from highside.reading.config_table import ConfigTable
from highside.recording.candump import read_candump
from highside.recording.wire import WireKind, detect_kind, read_segments

FRAMES_PER_BATCH = 256
BYTES_PER_BATCH = 16384
RAW_TICK_S = 0.02
"""raw bytes are cut into pieces of this length in time"""
WAIT_S = 0.02
EMPTY_LOOKS = 50
"""Looks, 2 ms apart, that find nothing unread before all is taken for read. Source: with three the end of a replay was
lost on a machine with five runnable processes on two processors, as the kernel moved it on later than that."""
PENDING_LIMIT = 16384


class RecordedEvent(NamedTuple):
    """Something that was recorded: `t_s` after the beginning of the recording, never less than the event before."""

    t_s: float
    t_wall: float
    content: bytes | CanFrame


class ReplaySettings(ConfigTable):
    """A recording and its pace."""

    path: Path = Field(description="A candump log, a recording of serial segments, or raw bytes; may be gzipped.")
    speed: float = Field(default=1.0, ge=0, description="1: in real time, 2: twice as fast; 0: as fast as possible.")
    byte_rate: float = Field(default=11520.0, gt=0, description="Bytes per second of a raw file, which has no times.")


def events(path: Path, byte_rate: float = 11520.0) -> Iterator[RecordedEvent]:
    """The events of a recording of any kind, in order. Raises InputError for what cannot be read."""
    kind = detect_kind(path)
    if kind is WireKind.RAW:
        return _raw_events(path, byte_rate)
    if kind is WireKind.CANDUMP:
        return _in_order((frame.t_wall, frame.t_wall, frame) for frame in read_candump(path))
    return _in_order((record.t_mono, record.t_wall, record.data) for record in read_segments(path))


def _in_order(recorded: Iterator[tuple[float, float, bytes | CanFrame]]) -> Iterator[RecordedEvent]:
    first: float | None = None
    t_s = 0.0
    for t, t_wall, content in recorded:
        if first is None:
            first = t
        # a clock that was set back while recording must not stop the replay
        t_s = max(t_s, t - first)
        yield RecordedEvent(t_s, t_wall, content)


def _raw_events(path: Path, byte_rate: float) -> Iterator[RecordedEvent]:
    piece = max(1, min(BYTES_PER_BATCH, round(byte_rate * RAW_TICK_S)))
    position = 0
    with open_binary(path) as file:
        while data := file.read(piece):
            # a piece is there when its last byte is
            position += len(data)
            yield RecordedEvent(position / byte_rate, position / byte_rate, data)


async def paced(
    timeline: Iterator[RecordedEvent], speed: float, clock: Clock
) -> AsyncGenerator[list[RecordedEvent], None]:
    """Lists of events, each when it is due; their `t_s` is replaced by the monotonic time at which they were due."""
    start = clock.monotonic()
    pace = speed or 1.0
    batch: list[RecordedEvent] = []
    size = 0
    for event in timeline:
        due = start + event.t_s / pace
        full = len(batch) >= FRAMES_PER_BATCH or size >= BYTES_PER_BATCH
        if batch and (full or (speed > 0.0 and due > clock.monotonic())):
            yield batch
            batch, size = [], 0
            if full:
                await clock.sleep(0.0)  # others want the loop too
        if speed > 0.0 and (wait_s := due - clock.monotonic()) > 0.0:
            await clock.sleep(wait_s)
        batch.append(event._replace(t_s=due))
        size += len(event.content) if isinstance(event.content, bytes) else 0
    if batch:
        yield batch


def _deliver_batch(batch: list[RecordedEvent], deliver: Deliver) -> None:
    frames: list[CanFrame] = []
    parts: list[bytes] = []
    for event in batch:
        if isinstance(event.content, CanFrame):
            frames.append(event.content._replace(t_mono=event.t_s))
        else:
            parts.append(event.content)
    if frames:
        deliver(frames)
    if parts:
        deliver(Chunk(batch[-1].t_s, batch[-1].t_wall, b"".join(parts)))


class ReplayTransport:
    """A recording as a link; ends with FINISHED. A recording that cannot be read is a wrong configuration."""

    kernel_drops = 0

    def __init__(self, settings: ReplaySettings, clock: Clock | None = None) -> None:
        self._settings = settings
        self._clock = clock or SystemClock()
        self._playing: asyncio.Task[LinkError] | None = None

    async def open(self, deliver: Deliver) -> None:
        settings = self._settings
        try:
            # a candump log is read as a whole
            timeline = await asyncio.to_thread(events, settings.path, settings.byte_rate)
        except InputError as error:
            raise LinkError(LinkReason.CONFIG, str(error)) from error
        self._playing = asyncio.create_task(self._play(timeline, deliver))

    async def _play(self, timeline: Iterator[RecordedEvent], deliver: Deliver) -> LinkError:
        count = 0
        try:
            async with contextlib.aclosing(paced(timeline, self._settings.speed, self._clock)) as due:
                async for batch in due:
                    count += len(batch)
                    _deliver_batch(batch, deliver)
        except (InputError, OSError) as error:
            return LinkError(LinkReason.IO_ERROR, f"{self._settings.path}: {error}")
        return LinkError(LinkReason.FINISHED, f"{self._settings.path}: played to its end ({count} records)")

    async def wait_closed(self) -> LinkError:
        assert self._playing is not None, "open first"
        return await asyncio.shield(self._playing)

    async def wait_ready(self) -> None:
        await asyncio.get_running_loop().create_future()

    async def close(self) -> None:
        if self._playing is not None:
            self._playing.cancel()
            await asyncio.wait({self._playing})


@dataclass(slots=True)
class Played:
    """What `play` did."""

    records: int = 0
    bytes: int = 0
    frames: int = 0
    unheard: int = 0
    duration_s: float = 0.0
    began: bool = False
    """somebody was there to read"""


async def play(
    timeline: Iterator[RecordedEvent],
    wire: Wire,
    speed: float = 1.0,
    clock: Clock | None = None,
    played: Played | None = None,
) -> Played:
    """Write a recording to a wire that is plugged in: waits for a reader, then plays; waits until all has been taken.

    Counts go to `played` as it goes on. If the reader leaves, the rest is counted as unheard, as on a real line.
    """
    clock = clock or SystemClock()
    played = played if played is not None else Played()
    while not wire.listened_to:
        await clock.sleep(WAIT_S)
    played.began = True
    start = clock.monotonic()
    async with contextlib.aclosing(paced(timeline, speed, clock)) as due:
        async for batch in due:
            played.records += len(batch)
            for is_frame, group in groupby(batch, key=lambda event: isinstance(event.content, CanFrame)):
                if is_frame:
                    frames = [event.content for event in group if isinstance(event.content, CanFrame)]
                    played.frames += len(frames)
                    wire.write_frames(frames)
                else:
                    data = b"".join(event.content for event in group if isinstance(event.content, bytes))
                    played.bytes += len(data)
                    wire.write(data)
            await _sent(wire, PENDING_LIMIT if played.bytes else 0, clock)
    await _sent(wire, 0, clock)
    played.duration_s = clock.monotonic() - start
    played.unheard = wire.unheard
    return played


async def _sent(wire: Wire, limit: int, clock: Clock) -> None:
    """Wait until at most `limit` of what was written is pending; for nothing at all pending, also until it was read."""
    while wire.pending > limit:
        await clock.sleep(0.001)
        wire.flush()
    if limit == 0:
        # what does not fit the kernel's buffer follows a moment after the reader has made room: look more than once
        empty = 0
        while empty < EMPTY_LOOKS:
            empty = 0 if wire.unread else empty + 1
            await clock.sleep(0.002)

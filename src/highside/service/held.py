"""What has arrived and need not be processed yet, because no output can be due with it.

At 100 frames a second and 10 outputs nine reads in ten only add to what the tenth makes of them. Ten frames in one go
cost about as much as two that come alone, each to code that has left the processor's caches. So chunks wait undecoded,
and what was decoded too early waits as frames. The recorder has its copy of every chunk before that; what waits is
processed before anybody reads a counter, and nothing waits longer than `HELD_S`, while others arrive.

Two measures tell when the frame that is due may have come: as many bytes as the frames until then have had, and the
time until then. The first holds at any speed of the device's clock, the second where frames are lost on the way.
"""

from __future__ import annotations

import math

from highside.codec.frame import ByteCodec, CanCodec, Frame
from highside.link.base import Batch, Chunk

HELD_FRAMES = 32
"""Frames that wait at most: on a fast link they come in large reads, which cost little each."""
HELD_S = 0.1
"""How long a frame waits at most while others arrive; a link that falls silent, and whoever reads the counters, asks
for what is held."""
SLACK = 0.02
"""Share of a step between two frames by which a device's times scatter about its grid: no frame more is waited for."""


class Held:
    """The decoder's side of the pipeline: takes batches, gives frames when they are to be processed."""

    def __init__(self, codec: ByteCodec | CanCodec, output_rate_hz: float) -> None:
        self._codec = codec
        self._recent_s = 2.0 / output_rate_hz
        """a device time further than this before the next output has been set back"""
        self._chunks: list[Chunk] = []
        self._bytes = 0
        self._frames: list[Frame] = []
        self._enough = 0
        """bytes with which the next output may be due; 0: whatever comes is decoded at once"""
        self._until_mono = 0.0
        """from then on it may be due whatever has come"""
        self._frame_bytes = 0.0
        """of a frame on the wire, on average over the last that were decoded"""
        self._last: Frame | None = None

    def add(self, batch: Batch, due: float | None) -> list[Frame] | None:
        """The frames that are to be processed now; None while a batch only waits. `due`: device time of the next
        output, s."""
        if not isinstance(batch, Chunk):
            frames = self._codec.receive_can(batch)  # type: ignore[union-attr]
            self._frames += frames
        else:
            self._chunks.append(batch)
            self._bytes += len(batch.data)
            if self._bytes < self._enough and batch.t_mono < self._until_mono:
                return None
            frames = self._decode()
        if not frames:
            return []
        held, last = self._frames, frames[-1]
        t = last.t_mono if last.t_s is None else last.t_s
        # an output is due, or time went back (a reset), or it is simply time
        if (
            due is None
            or not due - self._recent_s <= t < due
            or len(held) >= HELD_FRAMES
            or last.t_mono - held[0].t_mono >= HELD_S
        ):
            self._frames = []
            return held
        return []

    def take(self) -> list[Frame]:
        """Everything that waits."""
        self._decode()
        held, self._frames = self._frames, []
        return held

    def expect(self, due: float | None, step_s: float) -> None:
        """What was given has been processed: the next output is due at device time `due`, frames are `step_s` apart."""
        self._enough, last = 0, self._last
        if due is None or last is None or step_s <= 0.0 or self._frame_bytes <= 0.0:
            return
        ahead_s = due - (last.t_mono if last.t_s is None else last.t_s)
        held = self._frames
        # bounded first: at a rate of one output in a thousand years the quotient is infinite
        frames = min(math.ceil(min(ahead_s / step_s - SLACK, HELD_FRAMES)), HELD_FRAMES - len(held))
        self._enough = math.floor(frames * self._frame_bytes) - self._codec.counts.bytes_pending
        self._until_mono = min(last.t_mono + ahead_s, (held[0] if held else last).t_mono + HELD_S)

    def _decode(self) -> list[Frame]:
        """The frames of all chunks that wait, which are held from now on."""
        chunks, size = self._chunks, self._bytes
        if not chunks:
            return []
        self._chunks, self._bytes = [], 0
        size += self._codec.counts.bytes_pending
        frames: list[Frame] = []
        for chunk in chunks:
            frames += self._codec.receive(chunk.data, chunk.t_mono)  # type: ignore[union-attr]
        if frames:
            self._frames += frames
            self._last = frames[-1]
            self._frame_bytes = (size - self._codec.counts.bytes_pending) / len(frames)
        else:
            self._frame_bytes = 0.0
        return frames

"""A decoder that raises costs what it was given, and never the service.

A codec promises not to raise on what comes over the wire; one of another package may not keep that. What it was given
when it raised is counted as junk, it begins anew as after an interruption, and the link goes on: one line in the log a
minute, the count `codec.faults` and the alarm `decoder_failed` in the health message.
"""

from __future__ import annotations

import contextlib
import logging
from typing import Any

from highside.codec.frame import ByteCodec, CanCodec, CanFrame, Counts, Frame
from highside.printable import one_line
from highside.service.quiet_log import QuietLog

log = logging.getLogger("highside")


class GuardedCodec:
    """Stands for a `ByteCodec` or a `CanCodec` and does not raise."""

    def __init__(self, codec: ByteCodec | CanCodec, configured: str) -> None:
        self._codec: Any = codec
        self._configured = configured
        self._quiet = QuietLog(log)
        self._bytes_in = self._handed_out = 0
        self.name, self.extra_columns, self.seq_modulus = codec.name, codec.extra_columns, codec.seq_modulus
        self.counts: Counts = codec.counts
        self.faults = 0

    def receive(self, data: bytes, t_mono: float = 0.0) -> list[Frame]:
        self._bytes_in += len(data)
        try:
            frames: list[Frame] = self._codec.receive(data, t_mono)
        except Exception as error:
            return self._failed(error)
        self._handed_out += len(frames)
        return frames

    def receive_can(self, frames: list[CanFrame]) -> list[Frame]:
        try:
            readings: list[Frame] = self._codec.receive_can(frames)
        except Exception as error:
            return self._failed(error)
        self._handed_out += len(readings)
        return readings

    def flush(self) -> list[Frame]:
        try:
            frames: list[Frame] = self._codec.flush()
        except Exception as error:
            return self._failed(error)
        self._handed_out += len(frames)
        return frames

    def reset(self) -> None:
        try:
            self._codec.reset()
        except Exception as error:
            self._failed(error)

    def _failed(self, error: Exception) -> list[Frame]:
        self.faults += 1
        text = "codec %s: its decoder failed (%s); what it was given is lost, the link goes on"
        cause = one_line(f"{type(error).__name__}: {error}")[:300]
        self._quiet.say(logging.ERROR, type(error).__name__, text, self._configured, cause)
        log.debug("codec %s: its decoder failed", self._configured, exc_info=error)
        self._begin_anew()
        return []

    def _begin_anew(self) -> None:
        """The books are closed by what is known for sure: what was given, and what was handed out."""
        with contextlib.suppress(Exception):
            self._codec.reset()
        counts = self.counts
        counts.bytes_in = max(counts.bytes_in, self._bytes_in)
        accounted = counts.bytes_framed + counts.bytes_bad + counts.bytes_text + counts.bytes_ignored
        counts.bytes_pending = 0
        counts.bytes_junk = max(counts.bytes_in - accounted, 0)
        counts.frames_bad += max(counts.frames_good - self._handed_out, 0)
        counts.frames_good, counts.frames_held = self._handed_out, 0

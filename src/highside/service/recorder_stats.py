"""What the recorder says of itself: its state, why a batch is in no file, and the accounts of batches and bytes."""

from __future__ import annotations

import errno
from dataclasses import dataclass, field
from enum import Enum


class RecorderState(Enum):
    """How the recorder is."""

    OFF = "off"
    """Not started, stopped, or switched off by configuration."""
    IDLE = "idle"
    """Ready; no file is open because nothing has arrived since the last one was closed."""
    RECORDING = "recording"
    """A file is open and takes what arrives."""
    FAILING = "failing"
    """The disk refuses; `reason` says why. Tried again by itself."""


class DropReason(Enum):
    """Why a batch is in no file."""

    QUEUE_FULL = "queue_full"
    """The disk is slower than the wire."""
    NO_SPACE = "no_space"
    """The disk, or this user's share of it, is full."""
    READ_ONLY = "read_only"
    """The file system is read-only, or the directory may not be written."""
    IO_ERROR = "io_error"
    """The disk reported an error."""
    STOPPED = "stopped"
    """The recorder was stopped before the disk had taken it."""


REASONS = {
    errno.ENOSPC: DropReason.NO_SPACE,
    errno.EDQUOT: DropReason.NO_SPACE,
    errno.EFBIG: DropReason.NO_SPACE,
    errno.EROFS: DropReason.READ_ONLY,
    errno.EACCES: DropReason.READ_ONLY,
    errno.EPERM: DropReason.READ_ONLY,
}
"""Why the disk refused, by the number of its error; any other is an I/O error."""


@dataclass(slots=True)
class RecorderStats:
    """What the recorder has done since it was made. Bytes are payload as on the wire, but for `file_bytes`."""

    state: RecorderState = RecorderState.OFF
    reason: DropReason | None = None
    """why the disk refuses, while it does"""
    message: str = ""
    file: str | None = None
    """name of the open file"""
    batches_in: int = 0
    batches_written: int = 0
    batches_queued: int = 0
    batches_dropped: dict[DropReason, int] = field(default_factory=dict)
    bytes_in: int = 0
    bytes_written: int = 0
    bytes_queued: int = 0
    bytes_dropped: int = 0
    file_bytes: int = 0
    """bytes written to files, with headers and time stamps"""
    segments: int = 0
    segments_deleted: int = 0
    """deleted to stay within the cap"""
    failures: int = 0
    """times that the disk refused"""

    def balanced(self) -> bool:
        """Whether every batch and byte is accounted for."""
        return (
            self.batches_in == self.batches_written + self.batches_queued + sum(self.batches_dropped.values())
            and self.bytes_in == self.bytes_written + self.bytes_queued + self.bytes_dropped
        )

    def as_dict(self) -> dict[str, object]:
        """For the health message."""
        return {
            "state": self.state.value,
            "reason": self.reason.value if self.reason else None,
            "message": self.message,
            "file": self.file,
            "batches_in": self.batches_in,
            "batches_written": self.batches_written,
            "batches_queued": self.batches_queued,
            "batches_dropped": {reason.value: count for reason, count in self.batches_dropped.items()},
            "bytes_in": self.bytes_in,
            "bytes_written": self.bytes_written,
            "bytes_queued": self.bytes_queued,
            "bytes_dropped": self.bytes_dropped,
            "file_bytes": self.file_bytes,
            "segments": self.segments,
            "segments_deleted": self.segments_deleted,
            "failures": self.failures,
            "balanced": self.balanced(),
        }

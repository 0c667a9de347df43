"""The `[recorder]` table: how what comes over the wire is kept."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from highside.reading.config_table import ConfigTable

MEBIBYTE = 1 << 20


class RecorderSettings(ConfigTable):
    """Wire-level recording below the state directory. The defaults keep 1 GiB: 3 h of a full serial line."""

    enabled: bool = Field(default=True, description="Whether the wire is recorded.")
    segment_max_bytes: int = Field(
        default=16 * MEBIBYTE, ge=4096, le=1 << 32, description="A new file is begun before one grows beyond this."
    )
    segment_max_s: float = Field(default=3600.0, gt=0, description="A new file is begun when one is this old.")
    total_max_bytes: int = Field(
        default=1024 * MEBIBYTE, ge=8192, description="All recordings together; the oldest are deleted first."
    )
    fsync_interval_s: float = Field(
        default=1.0, ge=0, le=60, description="At most this much is lost with the power; 0 is after every write."
    )
    queue_max_bytes: int = Field(
        default=8 * MEBIBYTE, ge=4096, le=1 << 30, description="Held in memory while the disk is slow or full."
    )
    retry_s: float = Field(default=1.0, gt=0, le=60, description="Pause between attempts while the disk refuses.")

    @model_validator(mode="after")
    def _room_for_two_segments(self) -> Self:
        if self.total_max_bytes < 2 * self.segment_max_bytes:
            raise ValueError("total_max_bytes must hold two segments: at least 2 * segment_max_bytes")
        return self

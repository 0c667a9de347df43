"""What a recording can be exported as; apart, so that the command line knows it before numpy is there."""

from __future__ import annotations

from enum import StrEnum


class ExportFormat(StrEnum):
    """What can be written."""

    MCAP = "mcap"
    PARQUET = "parquet"
    CSV = "csv"

"""What a survey list is written as; apart from the writers, so that a command offers it without loading them."""

from __future__ import annotations

from enum import StrEnum


class SurveyFormat(StrEnum):
    """What a survey list is written as."""

    CSV = "csv"
    LAS = "las"
    WITSML = "witsml"

"""The bench calibration state machine and its journal: events in, state and prompts out; the clock is injected."""

from __future__ import annotations

__all__ = [
    "commands",
    "driver",
    "entries",
    "journal",
    "judge",
    "ledger",
    "machine",
    "outcome",
    "plans",
    "session",
    "snapshot",
    "view",
]
"""the ways in: modules, loaded on request"""

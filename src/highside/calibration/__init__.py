"""Calibration methods, records, and the correction that the live service applies.

`pose_table` makes poses out of recordings, `conventional`, `balance` and `joint` solve them to a `result`, `record` is
what a laboratory gives away, `correction` and `schedule` what the service asks of it, `applied` what a recording does.
Sensor model: m = A g + b (+ nonlinear terms), readings in g; angles in rad inside. Theory: docs/theory/balance.md.
"""

from __future__ import annotations

__all__ = [
    "applied",
    "balance",
    "comparison",
    "conventional",
    "correction",
    "joint",
    "magnitude",
    "pose_table",
    "poses",
    "record",
    "result",
    "roll_test",
    "rolling_bias",
    "schedule",
    "signature",
    "summary",
    "temperature",
    "verification",
]
"""the ways in: modules, loaded when they are requested"""

"""The three papers reproduced: their tables beside ours, and the motions and instruments that this takes.

A leaf on top: the commands use it, and nothing else does.
"""

from __future__ import annotations

__all__ = [
    "drift_scenarios",
    "published_instrument",
    "reproduce_balance",
    "reproduce_drift",
    "reproduce_rotation",
    "rotation_scenarios",
]
"""the ways in: modules, loaded when they are requested"""

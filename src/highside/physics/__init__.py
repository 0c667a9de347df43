"""The forward model: gravity in the tool frame, the bench, the sensors, motion, noise; one library of effects.

Simulation, calibration and diagnosis use the same objects from here.
"""

from __future__ import annotations

__all__ = [
    "effect",
    "effects",
    "effects_page",
    "forward",
    "gravity",
    "motion",
    "noise",
    "plan",
    "rotation_chain",
    "simulation",
    "state",
]
"""the ways in: modules, loaded when they are requested"""

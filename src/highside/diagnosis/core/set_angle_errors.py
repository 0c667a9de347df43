"""Errors of the angles that a bench was set to, as noise: what they do to a reading, and how they are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.unexplained import hinted
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

WAYS = ("of inclination", "of toolface", "across the plane of the tilt")
"""ways in which a set angle is off, in the order of `turned_by_set_angles`"""
TAKEN_FOR = "what is left is taken for errors of the set angles: "


def turned_by_set_angles(model: ForwardModel, state: ChainState) -> Array:
    """(3, 3, n) g/rad: what a reading changes by with the inclination, with the toolface, and across the plane of the
    tilt.

    A bench that is shaken, or on which the tool sits a little differently each time, moves the level to all sides
    alike, and so across the plane of the tilt at any inclination; an error of the toolface moves it only as far as
    the tool is inclined.
    """
    angles = np.asarray(model.pose_sensitivity(state), dtype=float)[:, [0, 2]].transpose(1, 0, 2)
    force = np.asarray(model.chain(state).force, dtype=float)
    across = np.cross(force, angles[0], axis=0) / np.linalg.norm(force, axis=0)
    return np.concatenate([angles, across[None]])


def in_words(sizes: Array) -> str:
    """The sizes (3,) in rad of those that there are."""
    return ", ".join(f"{np.degrees(size):.2g} deg {name}" for size, name in zip(sizes, WAYS, strict=False) if size > 0)


def taken_for_set_angles(diagnosis: DiagnosisResult, sizes: Array) -> DiagnosisResult:
    """The diagnosis that says of what is left that it is errors of these sizes."""
    return instead(diagnosis, f"what is left is taken for errors of the set angles: {in_words(sizes)}")


def instead(diagnosis: DiagnosisResult, words: str) -> DiagnosisResult:
    """The diagnosis with a hint in place of what was said of the set angles before."""
    hints = tuple(hint for hint in diagnosis.remainder.hints if not hint.startswith(TAKEN_FOR))
    return hinted(replace(diagnosis, remainder=replace(diagnosis.remainder, hints=hints)), words)

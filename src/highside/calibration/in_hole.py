"""A calibration record made in the hole: its parent's, with a deviation that was observed down there.

Such a record rests on the poses of its parent and on what the hole showed since. It says so (`valid`: "in-hole",
`parent`, `evidence`), and can be recomputed: the parent's poses are solved again and the deviation is applied. The
sensor of the parent is `m = A f + b`; what was observed is the error of corrected readings, `c = (1 + S) f + d`, hence
`A (1 + S)` and `b + A d`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.calibration.method import Solution
from highside.calibration.result import CalibrationResult
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES
from highside.calibration.zone import Zone
from highside.errors import InputError

__all__ = ["IN_HOLE", "is_in_hole", "moved", "moved_again", "solved_again"]

IN_HOLE = "in-hole"
"""the member `valid` of such a record"""


def is_in_hole(content: Mapping[str, Any]) -> bool:
    """Whether the content is that of a record made in the hole."""
    return content.get("valid") == IN_HOLE


def moved(result: CalibrationResult, offset: Array, matrix: Array, covariance: Array | None) -> CalibrationResult:
    """A result of one zone with its sensor moved by `offset` (3,) g and `matrix` (3, 3), of corrected readings.

    `covariance` (12, 12): of both (offset, matrix row by row), in place of that of the zone; None: it stays. Raises
    InputError for a result that is not of one zone with a whole matrix and all offsets."""
    zones = result.zones
    names = (*OFFSET_NAMES, *MATRIX_NAMES)
    if len(zones) != 1 or zones[0].is_local or any(name not in zones[0].parameters for name in names):
        raise InputError("the record does not correct all attitudes by one matrix and offset")
    return replace(result, zones=(_moved_zone(zones[0], offset, matrix, covariance),))


def _moved_zone(zone: Zone, offset: Array, matrix: Array, covariance: Array | None) -> Zone:
    p = zone.parameters
    A = p.block(MATRIX_NAMES).reshape(3, 3)
    at = [p.names.index(name) for name in (*OFFSET_NAMES, *MATRIX_NAMES)]
    values = p.values.copy()
    values[at[:3]] += A @ offset
    values[at[3:]] += (A @ matrix).ravel()
    if covariance is None:
        return replace(zone, parameters=replace(p, values=values))
    back = np.zeros((12, 12))
    back[:3, :3] = A
    back[3:, 3:] = np.kron(A, np.eye(3))
    new = p.covariance.copy()
    # what the poses said of these together with the bench is superseded
    new[at, :] = new[:, at] = 0.0
    new[np.ix_(at, at)] = back @ covariance @ back.T
    student = None if p.student is None else p.student.copy()
    if student is not None:
        student[at, :] = student[:, at] = 0.0
    return replace(zone, parameters=replace(p, values=values, covariance=new, student=student))


def moved_again(content: Mapping[str, Any], result: CalibrationResult) -> CalibrationResult:
    """What the poses of a record gave, moved as the record says; unchanged for one that was not made in the hole."""
    if not is_in_hole(content):
        return result
    deviation = content["evidence"]["deviation"]
    return moved(result, np.array(deviation["offset_g"]), np.array(deviation["matrix"]), None)


def solved_again(content: Mapping[str, Any], solution: Solution) -> Solution:
    """The same of a whole solution."""
    return replace(solution, result=moved_again(content, solution.result)) if is_in_hole(content) else solution

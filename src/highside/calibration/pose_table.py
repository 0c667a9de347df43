"""From the columns of a recording to those of a pose table, and from a pose table to what a solver takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.calibration.poses import PoseSet
from highside.calibration.record import RecordError, RecordReason
from highside.calibration.still_intervals import find_still_intervals, labelled_intervals, poses_from_intervals
from highside.errors import InputError, Refused
from highside.physics.state import KNOWN_COLUMNS

__all__ = ["StillPoses", "require_g", "solver_columns", "still_poses", "tool_of_session"]


REFERENCE_MOVES_DEG = 0.01
"""A reference attitude that changes by more while the tool lies still belongs to two poses: about half a step of the
encoders of the bench in `config/model-bench.toml` (0.018 deg)."""
ROWS_LOOKED_AT = 1000
"""as many rows, spread over a recording, say whether its unit can be g"""
SOLVER_COLUMNS = (
    "inc_ref_deg",
    "tf_ref_deg",
    "ax",
    "ay",
    "az",
    "n",
    "std_ax",
    "std_ay",
    "std_az",
    "temp_c",
    "direction",
)
"""what a solver may use of a pose table, beside the name of the pose"""


class StillPoses(NamedTuple):
    """The still intervals of a recording as the columns of a pose table, each (K,), and what was omitted and why."""

    columns: dict[str, Array]
    omitted: list[str]


def still_poses(a: Array, columns: Mapping[str, Array], *, min_s: float, window_s: float, where: str) -> StillPoses:
    """Find the still intervals of readings `a` (3, N) in g, or take those that a column `pose` names.

    `columns` are those of the recording, each (N,): `t_s` in s, and of `inc_ref_deg`, `tf_ref_deg`, `temp_c`, `pose`,
    `direction` what there is; of further ones the means are kept, for laws that depend on them. Raises InputError
    (units that are not g, time that does not advance) and Refused (no usable pose).
    """
    require_g(a, where)
    t = columns["t_s"]
    steps = np.diff(t)
    if not steps.size or not np.median(steps) > 0.0:
        raise InputError("time does not advance", where=where, field="t_s")
    rate = 1.0 / float(np.median(steps))
    labels = columns.get("pose")
    codes = None if labels is None else np.where(np.isnan(labels), -1.0, labels)
    if codes is not None and bool((codes >= 0).any()):
        found = labelled_intervals(a, codes)
    else:
        found = find_still_intervals(a, rate, min_s=min_s, window_s=window_s)
    omitted: list[str] = []
    kept = []
    has_reference = {"inc_ref_deg", "tf_ref_deg"} <= set(columns)
    for interval in found:
        rows = slice(interval.start, interval.stop)
        why = _reference_fault(columns["inc_ref_deg"][rows], columns["tf_ref_deg"][rows]) if has_reference else None
        if why is None:
            kept.append(interval)
        else:
            omitted.append(f"{t[interval.start]:.3f} to {t[interval.stop - 1]:.3f} s: {why}")
    if not kept:
        raise Refused(f"{where}: no usable pose: {'; '.join(omitted[:3])}")
    poses = poses_from_intervals(a, kept, temp_c=columns.get("temp_c"))
    starts = np.array([interval.start for interval in kept])
    made = {name: columns[name][starts] for name in ("inc_ref_deg", "tf_ref_deg") if has_reference}
    made |= {"ax": poses.a[0], "ay": poses.a[1], "az": poses.a[2], "n": poses.n}
    made |= {f"std_a{axis}": poses.std[i] for i, axis in enumerate("xyz")}
    if poses.temp_c is not None and not np.isnan(poses.temp_c).any():
        made["temp_c"] = poses.temp_c
    rows_of = [interval.rows() for interval in kept]
    for name in (name for name in columns if _is_further(name)):
        means = np.array([columns[name][rows].mean() for rows in rows_of])
        if np.isfinite(means).all():
            made[name] = means
    for name in ("pose", "direction"):
        if name in columns and not np.isnan(columns[name][starts]).any():
            made[name] = columns[name][starts]
    return StillPoses(made, omitted)


def _is_further(name: str) -> bool:
    """Whether laws may depend on a column beside the temperature: vibration, the maker's own quantities."""
    return name == "vibration_rms_g" or (name not in KNOWN_COLUMNS and name != "azi_ref_deg")


def _reference_fault(inc_deg: Array, tf_deg: Array) -> str | None:
    """What is wrong with the reference of a still interval, if anything."""
    if np.isnan(inc_deg).any() or np.isnan(tf_deg).any():
        return "still, but no reference attitude"
    if max(np.ptp(inc_deg), np.ptp(np.unwrap(tf_deg, period=360.0))) > REFERENCE_MOVES_DEG:
        return "the reference attitude changes while the tool lies still"
    return None


def require_g(a: Array, where: str | None) -> None:
    """Raises InputError for readings (3, N) in units that cannot be g, judged by at most a thousand rows."""
    PoseSet.build(a[:, :: max(1, a.shape[1] // ROWS_LOOKED_AT)], where=where)


def solver_columns(
    columns: Mapping[str, Array], texts: Mapping[str, Sequence[str]]
) -> dict[str, list[float] | list[str]]:
    """The columns of a pose table that a solver may use, as plain values for the record."""
    made: dict[str, list[float] | list[str]] = {}
    for name in SOLVER_COLUMNS:
        if name in columns and not (name not in ("ax", "ay", "az") and np.isnan(columns[name]).all()):
            made[name] = columns[name].tolist()
    if "pose" in columns:
        made["pose"] = [f"{value:g}" for value in columns["pose"].tolist()]
    elif "pose" in texts:
        made["pose"] = list(texts["pose"])
    return made


def tool_of_session(
    columns: Mapping[str, Array], texts: Mapping[str, Sequence[str]], tool: str | None, serial: str | None, where: str
) -> tuple[str, str | None]:
    """Tool and serial number of a session: as given, checked against the table's own columns `tool` and `serial`.

    Raises InputError for poses of several tools, RecordError for those of another one than was given.
    """
    named = {}
    for column, given in (("tool", tool), ("serial", serial)):
        values = set(texts.get(column, ()))
        if column in columns:
            values = {f"{value:g}" for value in columns[column].tolist()}
        if len(values) > 1:
            raise InputError(f"poses of {len(values)} tools in one session", where=where, field=column)
        of_table = next(iter(values), None)
        if of_table is not None and given is not None and of_table != given:
            raise RecordError(
                RecordReason.WRONG_TOOL, f"{where}: the poses are of {column} {of_table!r}, not of {given!r}"
            )
        named[column] = given if given is not None else of_table
    return named["tool"] or "tool", named["serial"]

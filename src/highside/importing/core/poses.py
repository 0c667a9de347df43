"""A table of poses of another program: one row a pose, angles of the bench and mean readings, no time."""

from __future__ import annotations

import numpy as np

from highside.codec.axes import AxisMap
from highside.errors import InputError
from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.proposal import ACCELERATIONS, Proposal
from highside.importing.core.recording import converted, safe_name, turn, without_value
from highside.importing.core.source import Numbers
from highside.recording.table import POSE_COLUMNS, PoseTable

MEANS = ("ax", "ay", "az")
SPREADS = ("std_ax", "std_ay", "std_az")


def poses_of(proposal: Proposal, policy: ImportPolicy = POLICY) -> tuple[PoseTable, tuple[str, ...]]:
    """Carry out a proposal for a table of poses: the pose table, N rows, accelerations and their standard deviations
    in g, angles in deg, in the order of the file; and what was found in its rows.

    Raises InputError for a table without rows or without accelerations.
    """
    table = proposal.table
    if table.n == 0:
        raise InputError("holds no pose", where=table.where)
    found: dict[str, Numbers] = {}
    findings: list[str] = []
    for guess in proposal.guesses:
        column = table.column(guess.column)
        if column is None or column.numbers is None:
            continue
        found[guess.target] = converted(column.numbers, guess.unit)
        findings += without_value(found[guess.target], guess.target, table.place, policy)
    if not all(name in found for name in ACCELERATIONS):
        remedy = "--map ax_g=COLUMN:UNIT (and ay_g, az_g)"
        raise InputError("a table of poses needs three accelerations", where=table.where, remedy=remedy)
    spreads = _spreads(proposal)
    axes = AxisMap.parse(proposal.axes.axes, allow_mirror=True)
    turn(found, axes)
    columns: dict[str, Numbers] = {}
    for name in ("inc_ref_deg", "tf_ref_deg"):
        if name in found:
            columns[name] = found.pop(name)
    columns |= {ours: found.pop(name) for ours, name in zip(MEANS, ACCELERATIONS, strict=True)}
    if spreads:
        # a standard deviation goes with its axis, whichever way that points
        columns |= {name: spreads[axes.order[place]] for place, name in enumerate(SPREADS)}
    columns |= found
    texts: dict[str, tuple[str, ...]] = {}
    for name in proposal.kept:
        column = table.column(name)
        if column is None or (spreads and name in SPREADS):
            continue
        if column.numbers is not None:
            known = (*columns, *texts) if name == "n" else (*POSE_COLUMNS, *columns, *texts)
            columns[safe_name(name, set(known))] = converted(column.numbers, None)
        elif column.texts is not None:
            texts[safe_name(name, {*POSE_COLUMNS, *columns, *texts})] = column.texts
    return PoseTable(columns, texts, source=table.where), tuple(findings)


def _spreads(proposal: Proposal) -> list[Numbers]:
    """The standard deviations of x, y, z of the file in g, where it has all three under our names; they have the unit
    of the readings."""
    table = proposal.table
    found: list[Numbers] = []
    for name, target in zip(SPREADS, ACCELERATIONS, strict=True):
        column, guess = table.column(name), proposal.guess(target)
        if column is None or column.numbers is None or guess is None or guess.unit is None:
            return []
        found.append(np.abs(converted(column.numbers, None) * guess.unit.factor))
    return found

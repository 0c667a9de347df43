"""A recording that is clipped in places: those poses are left out of every fit, and the clipping itself is a claim.

A fit of clipped readings finds a cubic or a quadratic term that is not there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.result import Claim, DiagnosisResult, FittedParameter, Location, Verdict
from highside.diagnosis.intake.checks import CHANNELS, Intake
from highside.errors import InputError
from highside.long_arrays import runs_of
from highside.physics.effects.clipping import EFFECT as CLIPPING


def without_clipped_poses(columns: Mapping[str, Array], raw: Array, found: Intake) -> dict[str, Array]:
    """The columns with `pose` emptied where any reading (3, N) of it is at a limit, and in rows of impulses.

    Raises InputError without poses.
    """
    if found.impulses.size and "pose" in columns:
        pose = columns["pose"].copy()
        pose[found.impulses] = np.nan
        columns = {**columns, "pose": pose}
    if not found.clipped:
        return dict(columns)
    if "pose" not in columns:
        raise InputError(
            "some readings are clipped, and without poses they cannot be left out",
            field="pose",
            remedy="add a column pose",
        )
    pose = columns["pose"]
    return {**columns, "pose": np.where(np.isin(pose, pose[at_limit(raw, found)]), np.nan, pose)}


def without_meaning(raw: Array, found: Intake) -> NDArray[np.bool_] | None:
    """(N,) rows of a rotation that say nothing of physics: at a limit, or an impulse; None where there are none."""
    if not found.clipped and not found.impulses.size:
        return None
    rows = at_limit(raw, found)
    rows[found.impulses] = True
    return rows


def at_limit(raw: Array, found: Intake) -> NDArray[np.bool_]:
    """(N,) rows with any reading (3, N) at a limit."""
    rows = np.zeros(raw.shape[1], dtype=bool)
    for channel, (_, limit) in found.clipped.items():
        values = raw[channel]
        for part in runs_of(rows.size):
            rows[part] |= np.abs(values[part]) >= limit * (1 - 1e-12)
    return rows


def with_clipping(diagnosis: DiagnosisResult, found: Intake, axes: Sequence[tuple[int, float]]) -> DiagnosisResult:
    """The diagnosis of the other poses, with the clipping as a claim where names are given at all.

    `axes` says which channel, with which sign, is the tool's x, y and z.
    """
    if not found.clipped:
        return diagnosis
    parameters = {}
    for tool, (channel, _) in enumerate(axes):
        if channel in found.clipped:
            limit = found.clipped[channel][1]
            parameters[CLIPPING.parameters[tool].name] = FittedParameter(limit, 0.0, limit, limit, "g")
    faults = [f for f in found.findings if f.check == CLIPPING.id]
    p = max(f.p for f in faults)
    claim = Claim(
        effect=CLIPPING.id,
        story=CLIPPING.story,
        formula=CLIPPING.formula,
        stage=CLIPPING.stage.value,
        parameters=parameters,
        p_familywise=p,
        equivalence_class=(CLIPPING.id,),
        rivals_ruled_out=(),
        next_manoeuvre="; ".join(f.remedy for f in faults),
    )
    share = max(share for share, _ in found.clipped.values())
    where = Location(
        tuple(CHANNELS[c] for c in found.clipped),
        "reading_g",
        tuple((limit, limit) for _, limit in found.clipped.values()),
        None,
        share,
        p,
    )
    if diagnosis.verdict not in ("nothing_left_out", "named", "named_plus"):
        remainder = replace(diagnosis.remainder, hints=(*diagnosis.remainder.hints, "some readings are clipped"))
        return replace(diagnosis, remainder=remainder)
    verdict: Verdict = "named_plus" if diagnosis.verdict == "named_plus" else "named"
    return replace(
        diagnosis,
        verdict=verdict,
        claims=(claim, *diagnosis.claims),
        location=(where, *diagnosis.location),
    )

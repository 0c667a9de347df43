"""Tables joined to the one that is imported: files of references, other topics of the same container."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from highside.codec.axes import AxisMap
from highside.errors import InputError
from highside.importing.core.axes import axes_by_reference
from highside.importing.core.joining import joined
from highside.importing.core.poses import poses_of
from highside.importing.core.proposal import ACCELERATIONS, Doubt, Proposal, propose
from highside.importing.core.recording import ImportedRecording, recording_of, turn
from highside.importing.core.wishes import NOTHING, Taken, Wishes
from highside.importing.files import open_foreign
from highside.recording.table import PoseTable, Recording

_REFERENCE = ("inc_ref_deg", "tf_ref_deg")


@dataclass(frozen=True, slots=True)
class Second:
    """One table to be joined: a `file` of its own, or (None) the table of that `name` of the same file; what is said of
    its columns, and by which rule of a profile it was found."""

    name: str
    file: Path | None = None
    wishes: Wishes = field(default_factory=Wishes)
    by: str = ""


@dataclass(frozen=True, slots=True)
class Joins:
    """What is joined, how a value between two rows is taken (None: interpolated), and by how many seconds its clock is
    late: NaN for what is measured, None for what the clocks say."""

    seconds: tuple[Second, ...] = ()
    taken: Taken | None = None
    lag_s: float | None = None

    @classmethod
    def of(
        cls,
        tables: Sequence[str] = (),
        references: Sequence[Path] = (),
        wishes: Wishes | None = None,
        taken: Taken | None = None,
        lag_s: float | None = None,
    ) -> Joins:
        """`tables` of the same file and files of `references`, all with the same `wishes`."""
        theirs = wishes or Wishes()
        seconds = [Second(name, None, theirs) for name in tables]
        return cls((*seconds, *(Second(file.name, file, theirs) for file in references)), taken, lag_s)


@dataclass(frozen=True, slots=True)
class Carried:
    """A Recording with what was joined (or a pose table, to which nothing is), what was found in its rows, its axes in
    those of the file, and what must be confirmed."""

    recording: Recording | PoseTable
    findings: tuple[str, ...]
    axes: str
    doubts: tuple[Doubt, ...] = ()


def open_joined(path: Path, joins: Joins) -> list[tuple[str, Proposal, bool]]:
    """(name, proposal, whether of the same clock) of each table to be joined. Raises InputError."""
    found = []
    for second in joins.seconds:
        wishes = replace(second.wishes, reference=True)
        if second.file is None:
            found.append((second.name, _table_of(path, second.name, wishes), True))
        else:
            found.append((second.name, open_foreign(second.file, wishes), False))
    return found


def _table_of(path: Path, name: str, wishes: Wishes) -> Proposal:
    """Another table of the same file, with what was said of the columns that it has."""
    found = open_foreign(path, Wishes(reference=True, table=name))
    columns = found.table.columns
    own = {
        target: text
        for target, text in wishes.mapping.items()
        if any(text in (column.name, NOTHING) or text.startswith(f"{column.name}:") for column in columns)
    }
    return propose(found.table, replace(wishes, mapping=own)) if own or wishes.units else found


def carry_out(
    proposal: Proposal, others: Sequence[tuple[str, Proposal, bool]], joins: Joins, *, turned: bool = True
) -> Carried:
    """The recording of a proposal with the tables joined; `turned`: with axes as the joined reference shows them.

    Raises InputError for rows without times, clocks that nothing compares, and axes that agree with no reference.
    """
    if proposal.poses:
        if others:
            what = "a table of poses takes no second file: its rows have no times to join them by"
            raise InputError(what, where=proposal.table.where, remedy="leave out --reference and --join")
        poses, found = poses_of(proposal)
        return Carried(poses, (*proposal.table.remarks, *found), proposal.axes.axes)
    first = recording_of(proposal)
    recording, doubts, axes = first.recording, [], proposal.axes.axes
    findings = [second.by for second in joins.seconds if second.by]
    findings += [*proposal.table.remarks, *first.findings]
    for name, other, one_clock in others:
        second = recording_of(other)
        findings += [f"{name}: {line}" for line in (*other.table.remarks, *second.findings)]
        made = joined(
            ImportedRecording(recording, (), first.start_ns),
            second,
            name,
            taken=joins.taken or Taken.INTERPOLATED,
            lag_s=joins.lag_s,
            one_clock=one_clock,
        )
        recording = made.recording
        findings += made.findings
        if made.doubt is not None:
            doubts.append(Doubt(made.doubt, "--lag measured, --lag 0 or --lag SECONDS", made.open))
    if not others or not recording.has(*ACCELERATIONS, *_REFERENCE):
        return Carried(recording, tuple(findings), axes, tuple(doubts))
    gravity = np.vstack([recording[name] for name in ACCELERATIONS])
    guess = axes_by_reference(gravity, recording["inc_ref_deg"], recording["tf_ref_deg"])
    if proposal.axes_given:
        if guess.open is not None or guess.likely:
            findings.append(f"axes {axes} as given, though {guess.open or '; '.join(guess.evidence)}")
        return Carried(recording, tuple(findings), axes, tuple(doubts))
    if guess.open is not None and doubts:
        # at a wrong lag no axes agree: it is the lag that must be said
        return Carried(recording, tuple(findings), axes, (replace(doubts[0], open=True),))
    if guess.open is not None:
        raise InputError(guess.open, where=recording.source, remedy=f"--axes {guess.axes} (or another arrangement)")
    findings.append(f"axes {guess.axes}: {'; '.join(guess.evidence)}")
    if guess.likely:
        what = f"axes {guess.axes} agree with the reference, those of the file do not"
        doubts.append(Doubt(what, f"--axes={guess.axes}", False))
        if turned:
            turn(recording.columns, AxisMap.parse(guess.axes))
            axes = _after(axes, guess.axes)
    return Carried(recording, tuple(findings), axes, tuple(doubts))


def _after(first: str, second: str) -> str:
    """The arrangement that does as two do one after the other."""
    one, two = AxisMap.parse(first, allow_mirror=True), AxisMap.parse(second)
    signs = [two.signs[k] * one.signs[two.order[k]] for k in range(3)]
    return "".join(("-" if sign < 0 else "") + "xyz"[one.order[two.order[k]]] for k, sign in enumerate(signs))

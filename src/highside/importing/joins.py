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
from highside.importing.core.proposal import ACCELERATIONS, Doubt, Proposal, propose
from highside.importing.core.recording import ImportedRecording, recording_of, turn
from highside.importing.core.wishes import NOTHING, Taken, Wishes
from highside.importing.files import open_foreign
from highside.recording.table import Recording

_REFERENCE = ("inc_ref_deg", "tf_ref_deg")


@dataclass(frozen=True, slots=True)
class Joins:
    """What is joined: `tables` of the same file, `references` of their own with `mapping` and `units` of theirs.

    `lag_s`: by how much their clock is late, NaN for what is measured, None for what the clocks say.
    """

    tables: tuple[str, ...] = ()
    references: tuple[Path, ...] = ()
    wishes: Wishes = field(default_factory=Wishes)
    taken: Taken = Taken.INTERPOLATED
    lag_s: float | None = None

    @property
    def any(self) -> bool:
        """Whether there is anything to join."""
        return bool(self.tables or self.references)


@dataclass(frozen=True, slots=True)
class Carried:
    """A Recording with what was joined, what was found in its rows, and what must be confirmed."""

    recording: Recording
    findings: tuple[str, ...]
    doubts: tuple[Doubt, ...] = ()


def open_joined(path: Path, joins: Joins) -> list[tuple[str, Proposal, bool]]:
    """(name, proposal, whether of the same clock) of each table to be joined. Raises InputError."""
    wishes = replace(joins.wishes, reference=True)
    found = [(name, _table_of(path, name, wishes), True) for name in joins.tables]
    return found + [(file.name, open_foreign(file, wishes), False) for file in joins.references]


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
    first = recording_of(proposal)
    recording, findings, doubts = first.recording, [*proposal.table.remarks, *first.findings], []
    for name, other, one_clock in others:
        second = recording_of(other)
        findings += [f"{name}: {line}" for line in (*other.table.remarks, *second.findings)]
        made = joined(
            ImportedRecording(recording, (), first.start_ns),
            second,
            name,
            taken=joins.taken,
            lag_s=joins.lag_s,
            one_clock=one_clock,
        )
        recording = made.recording
        findings += made.findings
        if made.doubt is not None:
            doubts.append(Doubt(made.doubt, "--lag measured, --lag 0 or --lag SECONDS", made.open))
    if others and not proposal.axes_given and recording.has(*ACCELERATIONS, *_REFERENCE):
        gravity = np.vstack([recording[name] for name in ACCELERATIONS])
        guess = axes_by_reference(gravity, recording["inc_ref_deg"], recording["tf_ref_deg"])
        if guess.open is not None and doubts:
            # at a wrong lag no axes agree: it is the lag that must be said
            return Carried(recording, tuple(findings), (replace(doubts[0], open=True),))
        if guess.open is not None:
            raise InputError(guess.open, where=recording.source, remedy=f"--axes {guess.axes} (or another arrangement)")
        findings.append(f"axes {guess.axes}: {'; '.join(guess.evidence)}")
        if guess.likely:
            doubts.append(
                Doubt(
                    f"axes {guess.axes} agree with the reference, those of the file do not",
                    f"--axes={guess.axes}",
                    False,
                )
            )
            if turned:
                turn(recording.columns, AxisMap.parse(guess.axes))
    return Carried(recording, tuple(findings), tuple(doubts))

"""Recordings of other programs."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from highside.api.recording import Recording
from highside.errors import InputError
from highside.recording import table as tables
from highside.shown.card import card

if TYPE_CHECKING:
    from highside.importing.core.proposal import Proposal
    from highside.importing.core.wishes import Wishes
    from highside.importing.joins import Carried, Joins

__all__ = ["ImportProposal", "import_poses", "import_recording", "inspect_import", "propose_import", "write_imported"]

OPTION = re.compile(
    r"--(map|units|axes|rate|table|part|poses|profile|lag|reference|yes)\b(?: (?!takes|says)([^\s;]*[^\s;,]))?"
)
"""an option of `highside import` as its words name it, and its value"""
ARGUMENTS = {"map": "mapping", "rate": "rate_hz", "lag": "lag_s", "yes": "accept"}
"""those that have another name as an argument"""
EVIDENCE_SHOWN = 3


@dataclass(frozen=True, slots=True)
class ImportProposal:
    """What the columns of a file of another program are taken for, each with its evidence; nothing is read into a
    number yet.

    A notebook shows it as a table; `str` gives the same as lines. `read` carries it out.
    """

    _proposal: Proposal
    _others: tuple[Proposal, ...]
    remarks: tuple[str, ...]
    """what was found in the rows: gaps, repeats, rows without a value; what was joined"""
    _carried: Carried | InputError

    @property
    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Column of ours, column of the file, its unit there, how certain that is, and the evidence."""
        return rows_of(self._proposal)

    @property
    def doubts(self) -> tuple[str, ...]:
        """What must be decided (`open`) or confirmed before use, and the argument that does it."""
        standing = [doubt for proposal in (self._proposal, *self._others) for doubt in proposal.doubts]
        standing += [] if isinstance(self._carried, InputError) else self._carried.doubts
        return tuple(
            f"{'open' if doubt.open else 'look at'}: {doubt.what}; {_in_arguments(doubt.remedy)}" for doubt in standing
        )

    def read(self, *, accept: bool = False) -> Recording:
        """The Recording of N rows. What rests on values alone is used only with `accept`; what is open never.

        Raises InputError that says which argument decides it, and for a table of poses.
        """
        table, notes = self._accepted(accept)
        if isinstance(table, tables.PoseTable):
            raise InputError("is a table of poses", where=table.source, remedy="import_poses reads it, or give rate_hz")
        return Recording.of(table, notes)

    def read_poses(self, *, accept: bool = False) -> tables.PoseTable:
        """The pose table of N rows, one a pose; as `read`. Raises InputError for a recording, too."""
        table, _ = self._accepted(accept)
        if not isinstance(table, tables.PoseTable):
            raise InputError("is a recording", where=table.source, remedy="import_recording reads it, or give poses")
        return table

    def _accepted(self, accept: bool) -> tuple[tables.Recording | tables.PoseTable, tuple[str, ...]]:
        """What was read, and what each column was taken for. Raises InputError that says which argument decides it."""
        from highside.importing.files import refuse_doubts, refuse_open

        with _as_arguments():
            for proposal in (self._proposal, *self._others):
                refuse_open(proposal, accepted=accept)
            if isinstance(self._carried, InputError):
                raise self._carried
            refuse_doubts(self._carried.doubts, self._proposal.table.where, accepted=accept)
        taken = [f"{ours} is {column} ({unit}, {sure}): {why}" for ours, column, unit, sure, why in self.rows]
        return self._carried.recording, (*taken, *self.remarks)

    def __str__(self) -> str:
        table = [("column", "from", "unit", "", "evidence"), *self.rows]
        widths = [max(len(row[place]) for row in table) for place in range(4)]
        lines = [
            "  ".join([*(cell.ljust(width) for cell, width in zip(row[:4], widths, strict=True)), row[4]]).rstrip()
            for row in table
        ]
        return "\n".join([*lines, *self.doubts, *self.remarks])

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        source = self._proposal.table
        return card(
            ["column", "from", "unit", "", "evidence"],
            self.rows,
            *self.doubts,
            *self.remarks,
            title=f"{source.where}: {source.form}, {source.n} rows",
        )


def inspect_import(
    file: str | os.PathLike[str],
    *,
    mapping: Mapping[str, str] | None = None,
    units: Sequence[str] = (),
    axes: str | None = None,
    rate_hz: float | None = None,
    table: str | None = None,
    part: int | None = None,
    profile: str | None = None,
    poses: bool = False,
) -> ImportProposal:
    """What a file of another program seems to hold: its columns as `t_s`, `ax_g`, ..., units, times and axes, with the
    evidence, before any of it is used.

    `file`, `mapping`, `units`, `axes`, `rate_hz`, `table`, `part` and `profile` as for `import_recording`; `poses`:
    each row is a pose. Raises InputError for a file that cannot be read.
    """
    from highside.importing.core.wishes import Wishes

    wishes = Wishes(dict(mapping or {}), tuple(units), axes, rate_hz, table, part, poses=poses)
    return _inspected(Path(file), wishes, None, profile)


def _inspected(file: Path, wishes: Wishes, joins: Joins | None, profile: str | None) -> ImportProposal:
    from highside.importing.joins import carry_out, open_joined

    with _as_arguments():
        proposal, _, together, _ = propose_import(file, wishes, joins, profile)
        others = open_joined(file, together)
        carried: Carried | InputError
        try:
            carried = carry_out(proposal, others, together)
        except InputError as fault:
            carried = fault
    findings = () if isinstance(carried, InputError) else carried.findings
    return ImportProposal(proposal, tuple(other for _, other, _ in others), findings, carried)


def import_recording(
    file: str | os.PathLike[str],
    *,
    mapping: Mapping[str, str] | None = None,
    units: Sequence[str] = (),
    axes: str | None = None,
    rate_hz: float | None = None,
    table: str | None = None,
    part: int | None = None,
    profile: str | None = None,
    accept: bool = False,
    reference: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    reference_mapping: Mapping[str, str] | None = None,
    join: Sequence[str] = (),
    take: str | None = None,
    lag_s: float | None = None,
) -> Recording:
    """A Recording of N rows out of a file of another program: `t_s`, `ax_g`, ... whatever they are called there.

    `file`: CSV in any dialect, Excel, Parquet, Arrow, NumPy, MATLAB, HDF5, MCAP, ROS, PX4. `mapping`: column of ours
    to `COLUMN` or `COLUMN:unit` of the file, or `none`; `units`: units of the file, one a quantity, as
    `("m/s2", "rad/s")`; `axes`: the tool's axes in the file's (`"-yxz"`); `rate_hz`: rows/s where it has no time;
    `table`: which sheet, topic or length of arrays; `part`: which part, from 1, where its clock began again;
    `profile`: a mapping kept by `highside import`, with the second files that it joins.
    `reference`: files whose columns are joined on the times of this one (`reference_mapping`: as `mapping`, for them),
    `join`: names of other tables of the same file; `take`: interpolated (if not given), nearest or last; `lag_s`: by
    how much their clock is late, NaN for what is measured.
    What rests on values alone is used only with `accept`; what is open never. Raises InputError that says which
    argument decides it.
    """
    from highside.importing.core.wishes import Taken, Wishes
    from highside.importing.joins import Joins

    files = (reference,) if isinstance(reference, str | os.PathLike) else tuple(reference)
    theirs = Wishes(dict(reference_mapping or {}), tuple(units))
    taken = None if take is None else Taken(take)
    joins = Joins.of(tuple(join), tuple(map(Path, files)), theirs, taken, lag_s)
    wishes = Wishes(dict(mapping or {}), tuple(units), axes, rate_hz, table, part)
    return _inspected(Path(file), wishes, joins, profile).read(accept=accept)


def import_poses(
    file: str | os.PathLike[str],
    *,
    mapping: Mapping[str, str] | None = None,
    units: Sequence[str] = (),
    axes: str | None = None,
    table: str | None = None,
    profile: str | None = None,
    accept: bool = False,
) -> tables.PoseTable:
    """A pose table of N rows, one a pose, out of a table of another program: the bench's `inc_ref_deg` and
    `tf_ref_deg`, the mean readings `ax`, `ay`, `az` in g, and what else it holds.

    `file`, `mapping`, `units`, `axes`, `table`, `profile` and `accept` as for `import_recording`. Standard deviations
    named `std_ax`, `std_ay`, `std_az` have the unit of the readings. Raises InputError that says which argument decides
    what is open.
    """
    return inspect_import(
        file, mapping=mapping, units=units, axes=axes, table=table, profile=profile, poses=True
    ).read_poses(accept=accept)


def propose_import(
    file: Path, wishes: Wishes, joins: Joins | None, profile: str | None
) -> tuple[Proposal, Wishes, Joins, bool]:
    """The proposal, the wishes and what is joined with those of the profile, and whether there is such a profile."""
    from highside.importing.files import open_foreign
    from highside.importing.joins import Joins
    from highside.importing.profiles import load, merged

    kept = None if profile is None else load(profile)
    joins = joins or Joins()
    if kept is not None:
        wishes, joins = merged(kept.wishes, wishes), kept.joins(file, joins)
    return open_foreign(file, wishes), wishes, joins, kept is not None


def rows_of(proposal: Proposal) -> list[tuple[str, str, str, str, str]]:
    """A proposal as rows of words: column of ours, of the file, unit there, how certain, and why."""
    rows = [
        (
            guess.target,
            guess.column,
            guess.unit.name if guess.unit else "",
            guess.sure.value,
            "; ".join(guess.evidence[:EVIDENCE_SHOWN]),
        )
        for guess in proposal.guesses
    ]
    if proposal.rate_hz is not None:
        rows.append(("t_s", "(row)", f"1/{proposal.rate_hz:g} s", "given", "rows at this rate"))
    why = "; ".join(proposal.axes.evidence)
    return [*rows, ("axes", "", proposal.axes.axes, "given" if proposal.axes_given else "", why)]


def write_imported(recording: tables.Recording | tables.PoseTable, target: Path) -> None:
    """Write as the name of the file says: Parquet, or CSV. Raises InputError."""
    from highside.recording.export import export
    from highside.recording.export_format import ExportFormat

    kinds = {".parquet": ExportFormat.PARQUET, ".mcap": ExportFormat.MCAP}
    export(recording, target, kinds.get(target.suffix, ExportFormat.CSV))


@contextmanager
def _as_arguments() -> Iterator[None]:
    """Within it an InputError that names options of `highside import` names the arguments of the same meaning."""
    try:
        yield
    except InputError as error:
        field, remedy = (None if text is None else _in_arguments(text) for text in (error.field, error.remedy))
        raise InputError(error.what, where=error.where, field=field, remedy=remedy) from None


def _in_arguments(text: str) -> str:
    """`--map t_s=time:ms` as `mapping={"t_s": "time:ms"}`, `--units rad/s` as `units=["rad/s"]`, `--yes` as
    `accept=True`; an option without a value by the name of the argument."""

    def argument(found: re.Match[str]) -> str:
        option, value = found[1], found[2]
        name = ARGUMENTS.get(option, option)
        if option == "yes":
            return "accept=True" + (f" {value}" if value else "")
        if value is None:
            return name
        if option == "map":
            ours, _, theirs = value.partition("=")
            return f'{name}={{"{ours}": "{theirs}"}}'
        if option == "units":
            return f"{name}={json.dumps(value.split(','))}"
        if option == "lag":
            return f'{name}=float("nan")' if value == "measured" else f"{name}={value}"
        return f"{name}={value}" if option in ("rate", "part") else f'{name}="{value}"'

    return OPTION.sub(argument, text)

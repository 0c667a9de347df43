"""`highside import`: a recording of another program becomes a Recording; what is inferred is shown first."""

from __future__ import annotations

import json
import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json
from highside.errors import InputError
from highside.importing.core.wishes import Taken, Wishes, parse_mapping

if TYPE_CHECKING:
    from highside.importing.core.proposal import Proposal
    from highside.importing.joins import Joins

OutputOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", help="Recording or pose table to write: .csv, .csv.gz or .parquet."),
]

_EVIDENCE_SHOWN = 3


def import_file(
    file: Annotated[
        Path, typer.Argument(help="A recording of another program: CSV, Excel, Parquet, MATLAB, HDF5, MCAP, PX4, ROS.")
    ],
    output: OutputOption = None,
    mapping: Annotated[
        list[str] | None, typer.Option("--map", metavar="NAME=COLUMN[:UNIT]", help="Say what a column is; repeatable.")
    ] = None,
    units: Annotated[str | None, typer.Option("--units", help="Units of the file, e.g. m/s2,rad/s,C,ms.")] = None,
    axes: Annotated[
        str | None, typer.Option("--axes", help="The tool's x, y, z in the file's axes, e.g. \"-yxz\".")
    ] = None,
    rate_hz: Annotated[float | None, typer.Option("--rate", help="Rows a second, for a file without a time.")] = None,
    table: Annotated[
        str | None, typer.Option("--table", help="Which sheet, topic or array of a file with several.")
    ] = None,
    poses: Annotated[
        bool, typer.Option("--poses", help="Each row is a pose: bench angles and mean readings, no time.")
    ] = False,
    part: Annotated[
        int | None, typer.Option("--part", help="Which part of a file whose clock began again, from 1.")
    ] = None,
    profile: Annotated[
        str | None,
        typer.Option("--profile", help="Keep what is said under this name, or use what is kept."),
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(
            "--reference", help="File whose columns (angles, an encoder) are joined on these times; repeatable."
        ),
    ] = None,
    reference_map: Annotated[
        list[str] | None, typer.Option("--reference-map", metavar="NAME=COLUMN[:UNIT]", help="As --map, for it.")
    ] = None,
    join: Annotated[
        list[str] | None, typer.Option("--join", help="Another table (topic, sheet) of this file to join; repeatable.")
    ] = None,
    take: Annotated[
        Taken | None, typer.Option("--take", help="How a value between two joined rows is taken; interpolated if not.")
    ] = None,
    lag: Annotated[
        str | None, typer.Option("--lag", metavar="SECONDS|measured", help="How late the joined clock is.")
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Take what is shown without a question.")] = False,
    inspect: Annotated[bool, typer.Option("--inspect", help="Only show what the file seems to hold.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="With --inspect: as JSON, on the standard output.")] = False,
) -> None:
    """Turn a recording of another program into a Recording, a table of poses into a pose table: columns, units, time
    and axes with their evidence."""
    from highside.importing.joins import Joins

    texts = tuple(text.strip() for text in (units or "").split(",") if text.strip())
    wishes = Wishes(parse_mapping(mapping or []), texts, axes, rate_hz, table, part, poses=poses)
    theirs = Wishes(parse_mapping(reference_map or []), texts)
    joins = Joins.of(tuple(join or ()), tuple(reference or ()), theirs, take, _lag_s(lag))
    if inspect:
        _inspect(file, wishes, joins, profile, as_json=as_json)
        return
    _import(file, output, wishes, joins, profile, yes=yes)


def _inspect(file: Path, wishes: Wishes, joins: Joins, profile: str | None, *, as_json: bool) -> None:
    """Show what would be taken for what, and what must be decided; nothing is written."""
    from highside.api.any_file import is_own
    from highside.api.importing import propose_import, rows_of
    from highside.importing.joins import carry_out, open_joined

    proposal, _, joined, _ = propose_import(file, wishes, joins, profile)
    others = open_joined(file, joined)
    doubts = [doubt for each in (proposal, *(other for _, other, _ in others)) for doubt in each.doubts]
    findings: tuple[str, ...] = ()
    # what is open cannot be carried out, and is what is asked for here
    if not any(doubt.open for doubt in doubts):
        carried = carry_out(proposal, others, joined)
        findings, doubts = tuple(carried.findings), [*doubts, *carried.doubts]
    if not as_json:
        for shown in (proposal, *(other for _, other, _ in others)):
            _show(shown)
        for line in findings:
            echo(f"  {line}", err=True)
        return
    from highside.importing.core.words import possible_references

    said = {
        "own": is_own(file),
        "form": proposal.table.form,
        "rows": proposal.table.n,
        "columns": [list(row) for each in (proposal, *(other for _, other, _ in others)) for row in rows_of(each)],
        "kept": list(proposal.kept),
        "omitted": list(proposal.omitted),
        "possible_references": possible_references(proposal.kept, [guess.target for guess in proposal.guesses]),
        "doubts": [{"open": doubt.open, "what": doubt.what, "remedy": doubt.remedy} for doubt in doubts],
        "findings": list(findings),
    }
    echo_json(json.dumps(said))


def _import(file: Path, output: Path | None, wishes: Wishes, joins: Joins, profile: str | None, *, yes: bool) -> None:
    from highside.api.importing import propose_import, write_imported
    from highside.importing.files import refuse_doubts, refuse_open
    from highside.importing.joins import carry_out, open_joined
    from highside.importing.profiles import joined_by, store

    if output is None:
        raise InputError("is missing", field="--output", remedy="name the file to write, or only --inspect this one")
    proposal, together, joined, kept = propose_import(file, wishes, joins, profile)
    _show(proposal)
    ask = sys.stdin.isatty() and not yes
    refuse_open(proposal, accepted=yes or ask)
    others = open_joined(file, joined)
    for _, other, _ in others:
        _show(other)
        refuse_open(other, accepted=yes or ask)
    carried = carry_out(proposal, others, joined)
    for line in carried.findings:
        echo(f"  {line}", err=True)
    refuse_doubts(carried.doubts, str(file), accepted=yes or ask)
    if ask and not typer.confirm("Use it?", default=True, err=True):
        raise typer.Abort
    write_imported(carried.recording, output)
    if profile is not None and (not kept or wishes.mapping or joins.seconds):
        seconds = [other for _, other, _ in others]
        where = store(profile, file, proposal, together, joined, seconds, carried.axes)
        echo(f"  kept as profile {profile}: {where}", err=True)
        for rule in joined_by(joined, file):
            echo(f"  it joins {rule}", err=True)
    rows = "poses" if proposal.poses else "rows"
    done, columns = carried.recording.n, len(carried.recording.order)
    echo(f"{output}: {done} of {proposal.table.n} {rows}, {columns} columns", err=True)


def _lag_s(text: str | None) -> float | None:
    """Seconds; NaN for `measured`. Raises InputError."""
    if text is None or text == "measured":
        return None if text is None else math.nan
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise InputError(f"{text!r} is no number of seconds", field="--lag", remedy="write e.g. 0.12, or measured")
    return seconds


def _show(proposal: Proposal) -> None:
    """The proposal as a table on the error output."""
    from highside.importing.core.words import possible_references

    rows = [("column", "from", "unit", "", "evidence")]
    for guess in proposal.guesses:
        reasons = "; ".join(guess.evidence[:_EVIDENCE_SHOWN])
        rows.append((guess.target, guess.column, guess.unit.name if guess.unit else "", guess.sure.value, reasons))
    if proposal.rate_hz is not None:
        stated = proposal.rate_hz == proposal.table.rate_hz
        sure, why = ("likely", "the file says so") if stated else ("given", "--rate")
        rows.append(("t_s", "(row)", f"1/{proposal.rate_hz:g} s", sure, why))
    rows.append(
        ("axes", "", proposal.axes.axes, "given" if proposal.axes_given else "", "; ".join(proposal.axes.evidence))
    )
    widths = [max(len(row[place]) for row in rows) for place in range(4)]
    echo(f"{proposal.table.where}: {proposal.table.form}, {proposal.table.n} rows", err=True)
    for row in rows:
        cells = "  ".join(cell.ljust(width) for cell, width in zip(row[:4], widths, strict=True))
        echo(f"  {cells}  {row[4]}".rstrip(), err=True)
    for names, what in ((proposal.kept, "as they are"), (proposal.omitted, "omitted, row numbers")):
        if names:
            shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
            echo(f"  {what}: {shown}", err=True)
    unclaimed = possible_references(proposal.kept, [guess.target for guess in proposal.guesses])
    if unclaimed:
        options = " ".join(f"--map {ours}={shlex.quote(name)}" for ours, name in unclaimed.items())
        echo(f"  where the bench was set, and not what the tool computed? then {options}", err=True)
    for doubt in proposal.doubts:
        echo(f"  {'open' if doubt.open else 'look at'}: {doubt.what}; {doubt.remedy}", err=True)

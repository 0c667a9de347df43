"""The way in: a file of another program, and what the user says of it, to a proposal and a Recording."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from highside.errors import InputError
from highside.importing.core.markers import without_markers
from highside.importing.core.proposal import ACCELERATIONS, RATES, Doubt, Proposal, Sure, propose
from highside.importing.core.recording import ImportedRecording, recording_of
from highside.importing.core.source import SourceTable
from highside.importing.core.wishes import Wishes
from highside.importing.forms.registry import form_of
from highside.importing.forms.topics import bag_within
from highside.reading import read_bytes

__all__ = ["ImportedRecording", "open_foreign", "recording_of", "refuse_open"]


def open_foreign(path: Path, wishes: Wishes) -> Proposal:
    """What the columns of a file are. Raises InputError for a file that cannot be read, and for a wish it cannot meet.

    Of a file with several tables (sheets, topics, arrays of several lengths) the one with accelerations is meant.
    """
    path = bag_within(path)
    where = str(path)
    data = read_bytes(path)
    if not data.strip():
        raise InputError("is empty", where=where)
    stem = path.name.removesuffix(".gz").rsplit(".", 1)[0]
    with warnings.catch_warnings():
        # what a library thinks of a file is no line for the user: it is read, or refused
        warnings.simplefilter("ignore")
        tables = tuple(map(without_markers, form_of(data).read(data, where, stem)))
    # what is judged from here on are the columns: of a long text the bytes are as large again
    del data
    if wishes.table is not None:
        tables = tuple(table for table in tables if table.name == wishes.table) or _no_table(tables, wishes.table)
    if len(tables) == 1:
        return propose(tables[0], wishes)
    return _the_one(tables, wishes)


def _the_one(tables: tuple[SourceTable, ...], wishes: Wishes) -> Proposal:
    made: list[Proposal] = []
    refused: InputError | None = None
    for table in tables:
        try:
            made.append(propose(table, wishes))
        except InputError as error:
            refused = error
    if not made and refused is not None:
        raise refused
    with_accelerations = [p for p in made if p.guess(ACCELERATIONS[0]) is not None]
    settled = [p for p in with_accelerations if all(g.open is None for g in p.guesses if g.target in ACCELERATIONS)]
    chosen = settled or with_accelerations
    if len(chosen) > 1:
        # of several the one that has rates beside them, if there is but one
        chosen = [p for p in chosen if p.guess(RATES[0]) is not None] or chosen
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join((p.table.name or "?") for p in (chosen or made)[:8])
    what = f"{len(chosen)} of its tables hold accelerations" if chosen else "none of its tables holds accelerations"
    raise InputError(f"{what}: {names}", where=tables[0].where, remedy="--table NAME says which")


def _no_table(tables: tuple[SourceTable, ...], name: str) -> tuple[SourceTable, ...]:
    names = ", ".join(table.name for table in tables[:8])
    raise InputError(f"has no table {name!r}", where=tables[0].where, field="--table", remedy=f"it has {names}")


def refuse_open(proposal: Proposal, *, accepted: bool) -> None:
    """Raises InputError, in one line with the option to give, for what is open, and, unless it was `accepted`, for what
    rests on values alone."""
    refuse_doubts(proposal.doubts, proposal.table.where, accepted=accepted)


def refuse_doubts(doubts: Sequence[Doubt], where: str, *, accepted: bool) -> None:
    """The same for doubts of whatever kind."""
    standing = [doubt for doubt in doubts if doubt.open]
    if not standing and not accepted:
        standing = list(doubts)
    if not standing:
        return
    first = standing[0]
    more = f" ({len(standing) - 1} more)" if len(standing) > 1 else ""
    remedy = first.remedy if first.open else f"{first.remedy}; --yes takes what is shown"
    if first.open and len(standing) > 1 and all(doubt.option for doubt in standing):
        remedy = f"{remedy}; all of it in one line: {one_line(doubts)}"
    elif first.open and len(standing) == 1 and len(doubts) > 1 and not accepted:
        remedy = f"{remedy}; with --yes for what rests on values alone"
    raise InputError(f"{first.what}{more}", where=where, remedy=remedy)


def one_line(doubts: Sequence[Doubt]) -> str:
    """The options that decide what is open, and take what rests on values alone."""
    options = [doubt.option for doubt in doubts if doubt.open]
    units = [option.removeprefix("--units ") for option in options if option.startswith("--units ")]
    said = [option for option in options if not option.startswith("--units ")]
    said += [f"--units {','.join(units)}"] if units else []
    return " ".join([*said, *(["--yes"] if any(not doubt.open for doubt in doubts) else [])])


def uncertain(proposal: Proposal) -> tuple[str, ...]:
    """Columns of ours whose guess is not certain."""
    return tuple(guess.target for guess in proposal.guesses if guess.sure in (Sure.LIKELY, Sure.OPEN))

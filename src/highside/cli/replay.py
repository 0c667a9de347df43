"""`highside replay`: plays a recording of the wire into a pty or a CAN interface, for any program to read."""

from __future__ import annotations

import asyncio
import json
import math
import signal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json
from highside.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from highside.link.replay import Played, RecordedEvent
    from highside.link.wire import CanWire, PtyWire

TABLE_STARTS = (b"PAR1", b"ARROW1", b"\x89MCAP0")
"""First bytes of Parquet, Arrow and MCAP files."""


SAID_AFTER_S = 1.0
"""A reader that is started beside it has opened the pty by then."""


def replay(
    file: Annotated[Path, typer.Argument(help="Raw bytes, highside's segments or candump -L text; plain or .gz.")],
    to: Annotated[str, typer.Option("--to", help='Where to: "pty" or "can:INTERFACE".')],
    speed: Annotated[
        float, typer.Option("--speed", min=0.0, help="1: as recorded, 2: twice as fast, 0: at once.")
    ] = 1.0,
    link: Annotated[Path | None, typer.Option("--link", help="Symbolic link to make to the pty.")] = None,
    byte_rate: Annotated[float, typer.Option("--byte-rate", min=1.0, help="Bytes/s of a file of raw bytes.")] = 11520.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the counts as one JSON object at the end.")] = False,
) -> None:
    """Play a recording of the wire into a link.

    The address to open is printed first. A pty waits for its reader, then plays, and ends when all has been read.
    """
    from highside.errors import Refused
    from highside.link.replay import Played, events
    from highside.recording.wire import WireKind, detect_kind

    for option, value in (("--speed", speed), ("--byte-rate", byte_rate)):
        if not math.isfinite(value):
            raise InputError(f"{value} is no finite number", where=option, remedy="give a number such as 1.0")
    kind = detect_kind(file)
    doubt = _refuse_readings(file) if kind is WireKind.RAW else None
    wire = _wire(to, link)
    if (kind is WireKind.CANDUMP) != to.startswith("can:"):
        what = "CAN frames" if kind is WireKind.CANDUMP else "bytes"
        remedy = "use --to can:INTERFACE" if kind is WireKind.CANDUMP else "use --to pty"
        raise InputError(f"holds {what}, which do not fit --to {to}", where=str(file), remedy=remedy)
    if doubt is not None:
        echo(f"{file}: {doubt}", err=True)
    timeline = events(file, byte_rate)
    wire.plug()
    played = Played()
    try:
        asyncio.run(_play(timeline, wire, speed, played))
    except (KeyboardInterrupt, asyncio.CancelledError):
        raise typer.Exit(130) from None
    finally:
        wire.remove()
        summary = {
            "file": str(file),
            "kind": kind.value,
            "records": played.records,
            "bytes": played.bytes,
            "frames": played.frames,
            "unheard": played.unheard,
            "duration_s": round(played.duration_s, 3),
        }
        if as_json:
            echo_json(json.dumps(summary))
        echo(
            f"{file}: {played.records} records ({played.frames} CAN frames, {played.bytes} bytes) in"
            f" {played.duration_s:.1f} s, {played.unheard} unheard"
            + ("" if played.began else f"; no program has opened {wire.address}"),
            err=True,
        )
    if played.unheard:
        raise Refused(
            f"{wire.address}: the reader left, or was too slow: {played.unheard} bytes or frames were not read"
        )


def _refuse_readings(file: Path) -> str | None:
    """A table of readings would be played as bytes that no codec finds a frame in. Raises InputError for one of ours;
    returns a line on what may be one: a device may send text with a head, too."""
    import contextlib
    import zlib

    from highside.reading import open_binary
    from highside.recording.table import RECORDING_COLUMNS

    start = b""
    # what a torn file cannot give is not there, as everywhere in wire recordings
    with contextlib.suppress(EOFError, OSError, zlib.error), open_binary(file) as opened:
        start = opened.read(4096)
    columns = start.split(b"\n", 1)[0].decode("ascii", "replace").strip().split(",")
    if start.startswith(TABLE_STARTS) or len(set(columns) & set(RECORDING_COLUMNS)) > 1:
        raise InputError(
            "holds readings, not bytes of the wire",
            where=str(file),
            remedy="give what the service recorded (.hsw), candump text or raw bytes; a table is read by `diagnose` and"
            " `calibrate apply`",
        )
    if _looks_like_a_head(start.split(b"\n", 1)[0]):
        return "begins like a table and is played as the text that it is; `highside import` reads tables of readings"
    return None


def _looks_like_a_head(line: bytes) -> bool:
    """Whether a line names columns: three cells or more, each a word, none a number."""
    try:
        text = line.decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        return False
    cells = max((text.split(mark) for mark in ",;\t"), key=len)
    return len(cells) > 2 and text.isprintable() and all(cell.strip(' "')[:1].isalpha() for cell in cells)


def _wire(to: str, link: Path | None) -> PtyWire | CanWire:
    from highside.link.wire import CanWire, PtyWire

    if to == "pty":
        return PtyWire(link)
    scheme, _, interface = to.partition(":")
    if scheme != "can" or not interface:
        raise InputError(f"{to!r} is no target", where="--to", remedy='use "pty" or "can:INTERFACE"')
    if link is not None:
        raise InputError("a CAN interface needs no link", where="--link", remedy="leave it out")
    return CanWire(interface)


async def _play(timeline: Iterator[RecordedEvent], wire: PtyWire | CanWire, speed: float, played: Played) -> None:
    from highside.link.replay import play

    task = asyncio.current_task()
    if task is not None:
        # the link to the pty is taken away whoever ends us
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, task.cancel)
    # who reads it may stop us at once
    echo(wire.address)
    waiting = asyncio.get_running_loop().call_later(SAID_AFTER_S, _say_that_it_waits, wire)
    try:
        await play(timeline, wire, speed, played=played)
    finally:
        waiting.cancel()


def _say_that_it_waits(wire: PtyWire | CanWire) -> None:
    if not wire.listened_to:
        echo(f"{wire.address}: waits for a program that opens it; Ctrl-C ends", err=True)

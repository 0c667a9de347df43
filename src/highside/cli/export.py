"""`highside export`: a recording for Foxglove (MCAP), for pandas and others (Parquet), or as plain CSV."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.say import echo
from highside.recording.export_format import ExportFormat


def export(
    file: Annotated[Path, typer.Argument(help="A Recording (CSV, may be gzipped); with --codec one of the wire.")],
    to: Annotated[ExportFormat, typer.Option("--to", help="What to write.")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The file to write; beside REC if absent.")
    ] = None,
    codec: Annotated[
        str | None, typer.Option("--codec", help="FILE is of the wire: tool, vn100, delimited or dbc.")
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", help="TOML file with a [codec] table.")] = None,
) -> None:
    """Write a recording in a format that other programs read; values go over unchanged."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from highside.cli.decode import decode_recording
    from highside.cli.kinds import TABLE, refuse_another_kind
    from highside.errors import InputError
    from highside.recording.export import export as write
    from highside.recording.table import read_recording

    target = output or file.with_name(f"{_stem(file)}.{to.value}")
    if target.exists() and target.resolve() == file.resolve():
        raise InputError("is the recording itself", where=str(target), field="--output", remedy="name another file")
    refuse_another_kind(target, TABLE, "--output")
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    shown = sys.stderr.isatty()
    bar = Progress(*columns, console=console, disable=not shown, transient=True)
    # older versions end a bar that nobody sees with an empty line
    with bar if shown else contextlib.nullcontext():
        task = bar.add_task(f"reading {file.name}", total=None)
        recording = read_recording(file) if codec is None and config is None else decode_recording(file, codec, config)
        bar.update(task, description=f"writing {target.name}", total=recording.n)
        write(recording, target, to, lambda done, total: bar.update(task, completed=done, total=total))
    echo(f"{target}: {recording.n} frames, {len(recording.order)} columns", err=True)


def _stem(file: Path) -> str:
    return file.name.removesuffix(".gz").rsplit(".", 1)[0]

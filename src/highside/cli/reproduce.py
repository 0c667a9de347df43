"""`highside reproduce`: the papers' tables beside ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(name="reproduce", no_args_is_help=True, help="The papers' tables beside ours.")


@app.callback()
def _group() -> None:
    """The papers' tables beside ours."""


@app.command()
def balance(
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as one JSON object.")] = False,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder for balance.html and balance.json.")
    ] = None,
) -> None:
    """Tables 1 to 6 and figures 1 to 7 of the balance paper, from a simulated instrument.

    Without --json the page and the numbers are written to a folder (reproduce-balance, if -o names no other).
    """
    from highside.errors import InputError
    from highside.recording.files import write_whole
    from highside.report.reproduce_balance import as_dict, run_experiment

    experiment = run_experiment()
    result = as_dict(experiment)
    folder = output if output is not None or as_json else Path("reproduce-balance")
    if folder is not None:
        from highside.report.reproduce_balance_page import page_of

        page = page_of(experiment)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot be made a folder: {error.strerror}", where=str(folder), field="-o") from None
        write_whole(folder / "balance.html", page.encode())
        write_whole(folder / "balance.json", (json.dumps(result, indent=1) + "\n").encode())
    if as_json:
        typer.echo(json.dumps(result))
        return
    for statement in result["statements"]:
        typer.echo(f"{statement['topic']}\n  the paper says   {statement['paper_says']}")
        typer.echo(f"  its own tables   {statement['published']}\n  this simulation  {statement['ours']}")
        typer.echo(f"  why              {statement['reason']}\n")
    typer.echo(f"Tables and figures: {folder}/balance.html")

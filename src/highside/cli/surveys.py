"""`highside surveys ...`: what the surveys that a tool kept say, and what others read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo

app = typer.Typer(
    name="surveys", no_args_is_help=True, help="Kept surveys: what they say of the calibration, and lists for others."
)

Surveys = Annotated[Path, typer.Argument(metavar="SURVEYS", help="surveys.jsonl of the state directory of a tool.")]


@app.command("analyse")
def analyse(
    surveys: Surveys,
    out: Annotated[Path, typer.Option("--out", help="Folder for surveys.json and report.html.")],
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="Record they were made under; else the ISCWSA MWD model is assumed."),
    ] = None,
    gravity_mps2: Annotated[
        float | None,
        typer.Option("--gravity-mps2", help="Local gravity; else what the tool expected. Needs --calibration."),
    ] = None,
    gravity_std_mps2: Annotated[
        float, typer.Option("--gravity-std-mps2", min=0.0, help="Standard deviation of --gravity-mps2.")
    ] = 5e-4,
) -> None:
    """Say from surveys alone whether the calibration that they were made under still holds (multi-station analysis).

    Exit status 1 where it departs.
    """
    from highside.api.surveys import analyse_surveys
    from highside.report.plots import can_plot
    from highside.report.watch_page import NO_FIGURES, claim_words, headline

    with as_options("gravity_mps2"):
        made = analyse_surveys(surveys, calibration, gravity_mps2=gravity_mps2, gravity_std_mps2=gravity_std_mps2)
    made.save(out)
    found = made.found
    echo(headline(found))
    for claim in found.claims:
        echo(claim_words(claim))
    for line in found.advice:
        echo(f"advice: {line}")
    if found.noise_grown:
        echo(f"noise grown: {found.noise_ratio:.2f} times what is stated")
    for note in made.notes:
        echo(f"note: {note}", err=True)
    if not can_plot():
        echo(f"{out / 'report.html'}: {NO_FIGURES}", err=True)
    if found.verdict == "departs":
        raise typer.Exit(1)

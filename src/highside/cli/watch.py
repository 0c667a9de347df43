"""`highside watch`: whether a calibration still holds, from a recording of the hole alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.api.surveys import AnalysedSurveys
    from highside.api.watch import WatchedRecording


def watch(
    recording: Annotated[
        Path, typer.Argument(metavar="REC", help="Recording of the hole: accelerometers, and gyros where it turns.")
    ],
    calibration: Annotated[Path, typer.Option("--calibration", help="The record in force (JSON).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for watch.json and report.html.")],
    gravity_g: Annotated[
        float,
        typer.Option("--gravity-g", help="Gravity of the site in the units of the readings; 1 for units of local g."),
    ] = 1.0,
) -> None:
    """Say whether a calibration still holds in the hole, without a bench and without a reference.

    Exit status 1 where it departs.
    """
    from highside.api.watch import watch_recording

    with as_options("gravity_g"):
        made = watch_recording(recording, calibration, gravity_g=gravity_g)
    show_watched(made, out)


def show_watched(made: WatchedRecording | AnalysedSurveys, out: Path) -> None:
    """Write the report and print what was found. Exit status 1 where the calibration departs."""
    from highside.report.plots import can_plot
    from highside.report.watch_page import NO_FIGURES, claim_words, headline

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

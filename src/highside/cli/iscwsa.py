"""`highside calibrate iscwsa`: the accelerometer terms of the ISCWSA MWD model, of one tool."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from highside.cli.options import as_options
from highside.cli.say import echo


def iscwsa(
    record_file: Annotated[Path, typer.Argument(metavar="RECORD", help="Calibration record (JSON).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Tool model to write (JSON of ISCWSA).")],
    watch: Annotated[
        Path | None, typer.Option("--watch", help="watch.json or surveys.json of this calibration: what it left.")
    ] = None,
    hours: Annotated[float, typer.Option("--hours", help="In use since the calibration; without --watch.")] = 100.0,
    warmer_c: Annotated[
        float, typer.Option("--warmer-c", help="Degrees from the temperature of the calibration; without --watch.")
    ] = 0.0,
    axial: Annotated[
        bool, typer.Option("--axial", help="Forms for azimuths corrected for axial interference.")
    ] = False,
    into: Annotated[
        Path | None, typer.Option("--into", help="Tool model (JSON) whose accelerometer terms are replaced.")
    ] = None,
) -> None:
    """Write one-sigma weights of the accelerometer terms of the ISCWSA MWD error model, as welleng reads them."""
    from highside.api.iscwsa import error_model

    with as_options("hours", "warmer_c"):
        made = error_model(record_file, watch=watch, hours=hours, warmer_c=warmer_c, axial=axial)
    made.save(output, into=into)
    for term in made.found.terms:
        echo(f"{term.name:12} {term.value:.3g} {term.unit}{'' if term.standard else '   (not of the model: ours)'}")
    for inc, by_terms, whole in made.found.check:
        echo(f"inclination {inc:2.0f} deg: sigma {by_terms:.4f} deg by the terms, {whole:.4f} by the covariance")
    echo(f"they hold: {made.basis}", err=True)
    for line in made.found.not_held:
        echo(f"not held: {line}", err=True)

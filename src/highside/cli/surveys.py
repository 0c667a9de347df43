"""`highside surveys ...`: what the surveys that a tool kept say, and what others read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import Language, as_options, in_options, speaking
from highside.cli.say import echo
from highside.cli.watch import show_watched
from highside.recording.survey_formats import SurveyFormat

if TYPE_CHECKING:
    from highside.api.survey_list import ListedSurveys

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
    language: Language = None,
) -> None:
    """Say from surveys alone whether the calibration that they were made under still holds (multi-station analysis).

    Exit status 1 where it departs.
    """
    from highside.api.surveys import analyse_surveys

    with as_options("gravity_mps2"):
        made = analyse_surveys(surveys, calibration, gravity_mps2=gravity_mps2, gravity_std_mps2=gravity_std_mps2)
    with speaking(language):
        show_watched(made, out)


Depths = Annotated[
    Path | None,
    typer.Option("--depths", help="CSV with md_m and seq or t (UTC epoch s); else md_m of the surveys themselves."),
]
Azimuths = Annotated[
    Path | None,
    typer.Option("--azimuths", help="CSV with azi_deg and seq, t or md_m; else azi_deg of a tool with gyros."),
]
Offset = Annotated[
    float, typer.Option("--sensor-offset-m", min=-100.0, max=1000.0, help="Of the sensor behind the depth given.")
]


@app.command("list")
def list_command(
    surveys: Surveys, depths: Depths = None, azimuths: Azimuths = None, sensor_offset_m: Offset = 0.0
) -> None:
    """Print the accepted surveys by measured depth, with positions by minimum curvature where azimuth is known."""
    from highside.api.survey_list import list_surveys

    found = list_surveys(surveys, depths=depths, azimuths=azimuths, sensor_offset_m=sensor_offset_m)
    names = [name for name in _SHOWN if found.table.has(name)]
    echo("  ".join(f"{name:>11}" for name in names))
    for row in range(found.table.n):
        cells = (float(found.table.columns[name][row]) for name in names)
        echo("  ".join(f"{'' if cell != cell else f'{cell:.3f}':>11}" for cell in cells))
    _remarks(found)


_SHOWN = ("md_m", "inc_deg", "azi_deg", "tf_deg", "tvd_m", "north_m", "east_m", "dls_deg_30m")


@app.command("export")
def export(
    surveys: Surveys,
    to: Annotated[SurveyFormat, typer.Option("--to", help="What to write.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The file to write.")],
    depths: Depths = None,
    azimuths: Azimuths = None,
    sensor_offset_m: Offset = 0.0,
    wellbore: Annotated[str, typer.Option("--wellbore", help="Name of the wellbore.")] = "unknown",
    datum: Annotated[str, typer.Option("--datum", help="What measured depth counts from, e.g. KB.")] = "unknown",
    north: Annotated[str, typer.Option("--north", help="What azimuths refer to: true, magnetic or grid.")] = "true",
) -> None:
    """Write the survey list as CSV, LAS 2.0 or a WITSML 2.0 trajectory."""
    from highside.api.survey_list import list_surveys

    found = list_surveys(surveys, depths=depths, azimuths=azimuths, sensor_offset_m=sensor_offset_m)
    with as_options("north", "to"):
        found.save(output, to.value, wellbore=wellbore, datum=datum, north=north)
    echo(f"{output}: {found.table.n} stations", err=True)
    _remarks(found)


def _remarks(found: ListedSurveys) -> None:
    for reason, count in found.left_out.items():
        echo(f"left out: {count} ({reason})", err=True)
    for note in found.notes:
        echo(f"note: {in_options(note)}", err=True)

"""`highside watch`: whether a calibration still holds, from a recording of the hole alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from highside.cli.options import Language, PrintLanguage, as_options, speaking
from highside.cli.say import echo
from highside.errors import InputError

if TYPE_CHECKING:
    from highside.api.calibration import Calibration
    from highside.api.surveys import AnalysedSurveys
    from highside.api.watch import WatchedRecording


class _OfRecordings(TyperGroup):
    """`highside watch REC.csv` is `highside watch recording REC.csv`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the word in that was left out."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = ["recording", *args]
        return list(super().parse_args(ctx, args))


app = typer.Typer(
    name="watch",
    cls=_OfRecordings,
    no_args_is_help=True,
    help="Whether a calibration still holds in the hole; `highside watch REC.csv` is `watch recording REC.csv`.",
)


@app.command()
def recording(
    file: Annotated[
        Path, typer.Argument(metavar="REC", help="Recording of the hole: accelerometers, and gyros where it turns.")
    ],
    calibration: Annotated[Path, typer.Option("--calibration", help="The record in force (JSON).")],
    out: Annotated[Path, typer.Option("--out", help="Folder for watch.json and report.html.")],
    gravity_g: Annotated[
        float,
        typer.Option("--gravity-g", help="Gravity of the site in the units of the readings; 1 for units of local g."),
    ] = 1.0,
    repeat_g: Annotated[
        float | None,
        typer.Option("--repeat-g", help="Repeatability of an offset from the bench to the hole, g, 1 sigma."),
    ] = None,
    random_walk_g: Annotated[
        float | None, typer.Option("--random-walk-g", help="Random walk of an offset, g/sqrt(h).")
    ] = None,
    still_floor_g: Annotated[
        float | None, typer.Option("--still-floor-g", help="1/f noise of the mean at rest, g, 1 sigma.")
    ] = None,
    window_floor_g: Annotated[
        float | None, typer.Option("--window-floor-g", help="The same of a harmonic while the tool turns.")
    ] = None,
    whirl_m: Annotated[
        float | None, typer.Option("--whirl-m", help="Sideways motion of the turning collar, m rms.")
    ] = None,
    of_tool: Annotated[
        str | None,
        typer.Option("--tool", metavar="ID", help="Whose recording it is: a record of another tool is refused."),
    ] = None,
    serial: Annotated[str | None, typer.Option("--serial", help="The same by serial number.")] = None,
    language: Language = None,
) -> None:
    """Say whether a calibration still holds in the hole, without a bench and without a reference.

    The options from --repeat-g to --whirl-m are what the tool may do while its calibration holds; unless given, a good
    quartz tool's. Exit status 1 where it departs.
    """
    from highside.api.watch import watch_recording

    tool = {
        "repeat_g": repeat_g,
        "random_walk_g": random_walk_g,
        "still_floor_g": still_floor_g,
        "window_floor_g": window_floor_g,
        "whirl_m": whirl_m,
    }
    with as_options("gravity_g", *tool):
        given = {name: value for name, value in tool.items() if value is not None}
        made = watch_recording(file, calibration, gravity_g=gravity_g, tool=of_tool, serial=serial, **given)
    whose = f"under the record of tool {made.tool}; --tool says whose recording it is"
    with speaking(language):
        show_watched(made, out, *((whose,) if of_tool is None and serial is None else ()))


def show_watched(made: WatchedRecording | AnalysedSurveys, out: Path, *notes: str) -> None:
    """Write the report and print what was found, with further `notes`. Exit status 1 where the calibration departs."""
    from highside.report.plots import can_plot
    from highside.report.watch_page import NO_FIGURES, claim_words, headline
    from highside.watch.words import noise_words
    from highside.words import _, told

    made.save(out)
    found = made.found
    echo(headline(found))
    for claim in found.claims:
        echo(claim_words(claim))
    for line in found.advice:
        echo(_("advice: %(what)s", what=told(line, "watch")))
    for change in found.noise_changes:
        echo(told(noise_words(change), "watch"))
    if found.noise_grown:
        echo(_("noise grown: %(times)s times what is stated", times=f"{found.noise_ratio:.2f}"))
    for note in (*made.notes, *notes):
        echo(_("note: %(what)s", what=told(note, "watch")), err=True)
    if not can_plot():
        echo(f"{out / 'report.html'}: {_(NO_FIGURES)}", err=True)
    if found.verdict == "departs":
        raise typer.Exit(1)


@app.command()
def propose(
    said: Annotated[
        Path,
        typer.Argument(metavar="WATCH", help="watch.json: of `highside watch`, or of the service's state directory."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Record to write.")],
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="The record that was watched (JSON).")
    ] = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="Or the store that holds it; the new record is kept there, too.")
    ] = None,
    language: PrintLanguage = None,
) -> None:
    """Write a calibration record that corrects what departs, for a person to put in force.

    Nothing is in force by it: `highside calibrate activate` does that, `calibrate rollback` takes it back. Exit status
    2 where nothing is to be proposed: nothing departs, or the attitudes seen so far do not name what does.
    """
    from highside.api.calibration import Calibration
    from highside.api.watch import proposal_of
    from highside.reading import read_document
    from highside.recording.calibration_store import CalibrationStore
    from highside.watch.proposal import read_outcome

    data = read_document(said)
    if (calibration is None) == (store is None):
        raise InputError("which record was watched?", remedy="give --calibration or --store")
    kept = None if store is None else CalibrationStore(store)
    parent: Path | Calibration
    if kept is not None:
        watched = read_outcome(data, str(said))
        if watched.cal_id not in kept.ids():
            of = "" if watched.tool is None else f" of tool {watched.tool}"
            raise InputError(
                f"watched record {watched.cal_id[:12]}{of}, which is not in {store}",
                where=str(said),
                field="cal_id",
                remedy="give the store of that tool, or the record itself by --calibration",
            )
        parent = Calibration(kept.get(watched.cal_id))
    else:
        assert calibration is not None
        parent = calibration
    made = proposal_of(data, parent, where=str(said))
    made.save(output)
    if kept is not None:
        kept.add(made.record)
    with speaking(language):
        _show_proposed(made, output)


def _show_proposed(made: Calibration, output: Path) -> None:
    from highside.words import _

    content = made.record.content
    evidence = content["evidence"]
    size = evidence["size"][evidence["parameter"]]
    named = {"file": output, "id": made.id[:12], "tool": made.record.tool_id}
    echo(_("%(file)s: record %(id)s of tool %(tool)s, made in the hole, its parent", **named))
    echo(f"  {content['parent'][:12]}: {evidence['parameter']} {size['value']:+.3g} +- {size['std']:.2g}")
    command = f"highside calibrate activate {output} --store STORE"
    echo(_("not in force: %(command)s; calibrate rollback takes it back", command=command))

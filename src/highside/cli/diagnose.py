"""`highside diagnose`: where a recording departs from the simulation, and what physics was left out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.core.method import Method
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.engine import Picture
    from highside.diagnosis.table.engine import SummaryPicture
    from highside.recording.table import Recording


def diagnose(
    recording: Annotated[
        Path | None,
        typer.Argument(help="The Recording or pose table (CSV, optionally gzipped), or with --codec a wire recording."),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", help="Model file (TOML): what the simulation knows. --summary does without."),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Directory for diagnosis.json and report.html.")] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the calibration of thresholds.")] = 1,
    summary: Annotated[
        Path | None,
        typer.Option(
            "--summary", help="A published error table (CSV) in place of a recording; --model may be left out."
        ),
    ] = None,
    corrected_by: Annotated[
        str, typer.Option("--corrected-by", help="conventional3, balance-average or none: what the table comes after.")
    ] = "none",
    stations: Annotated[int, typer.Option("--stations", min=8, help="Toolfaces of a revolution, both ends.")] = 73,
    readings: Annotated[int, typer.Option("--readings", min=1, help="Readings at each station.")] = 4,
    simulation: Annotated[
        Path | None, typer.Option("--simulation", help="Another program's output (CSV) as the prediction.")
    ] = None,
    write_model: Annotated[
        Path | None, typer.Option("--write-model", help="Write the model with what was found (TOML).")
    ] = None,
    codec: Annotated[str | None, typer.Option("--codec", help="Decode a wire recording first.")] = None,
    config: Annotated[Path | None, typer.Option("--config", help="TOML file with a [codec] table.")] = None,
    first_s: Annotated[float | None, typer.Option("--from", help="Only rows from this time on, s.")] = None,
    last_s: Annotated[float | None, typer.Option("--to", help="Only rows up to this time, s.")] = None,
    without: Annotated[
        str | None, typer.Option("--without", hidden=True, help="colour, refit or refusal: what that part is worth.")
    ] = None,
) -> None:
    """Say where a recording departs from the simulation, what was left out, and how sure that is."""
    from highside.cli.diagnose_inputs import read_rows
    from highside.cli.diagnose_progress import progress_on_terminal
    from highside.config.model import Model, as_toml, load_model
    from highside.diagnosis.core.method import Method
    from highside.errors import InputError
    from highside.recording.files import write_whole
    from highside.report.diagnosis_page import NO_FIGURES, page_of
    from highside.report.diagnosis_words import VERDICTS, blame, sizes
    from highside.report.page import can_plot

    source = recording or summary
    if (recording is None) == (summary is None) or source is None:
        raise InputError("give one of them", field="RECORDING, --summary", remedy="a recording or an error table")
    if simulation is not None and (summary is not None or write_model is not None):
        raise InputError(
            "goes with a recording alone", field="--simulation", remedy="leave --summary and --write-model out: "
            "what the other program lacks is for that program to take up",
        )  # fmt: skip
    # what goes with an error table or another program's output needs no model: nothing is known then, beside the sensor
    bare = simulation is not None or summary is not None
    for name, value in (("--model", model), ("--out", out)):
        if value is None and not (name == "--model" and bare):
            raise InputError("is missing", field=name, remedy="see highside diagnose --help")
    assert out is not None
    knows = load_model(model) if model is not None else Model()
    diagnosis: Diagnosis
    picture: Picture | SummaryPicture | None
    with progress_on_terminal() as progress:
        if summary is not None:
            from highside.cli.diagnose_summary import diagnose_table

            diagnosis, picture = diagnose_table(
                summary, knows, corrected_by=corrected_by, stations=stations, readings=readings, seed=seed,
                progress=progress,
            )  # fmt: skip
        else:
            assert recording is not None
            rows = read_rows(recording, codec, config, first_s, last_s)
            progress(0.0, f"{rows.n} rows")
            if simulation is not None:
                from highside.cli.diagnose_simulation import diagnose_beside

                diagnosis, picture = diagnose_beside(rows, simulation, knows, seed)
            else:
                diagnosis, picture = _diagnose(rows, knows, seed, Method.without(without))
    page = page_of(diagnosis, picture, source.name)
    told = as_toml(_with_claims(knows, diagnosis)) if write_model is not None and _says_something(diagnosis) else None
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(out)) from None
    write_whole(out / "diagnosis.json", (json.dumps(diagnosis.to_dict(), indent=1) + "\n").encode())
    write_whole(out / "report.html", page.encode())
    named = ", ".join(claim.effect for claim in diagnosis.claims)
    echo(f"{diagnosis.verdict} - {VERDICTS[diagnosis.verdict]}{': ' + named if named else ''}")
    for claim in diagnosis.claims:
        echo(f"{claim.effect}: {sizes(claim)}")
    if blame(diagnosis):
        echo(f"to blame: {blame(diagnosis)}")
    for finding in diagnosis.intake:
        echo(f"{finding.check} ({', '.join(finding.channels)}): {finding.remedy}")
    if not can_plot():
        echo(f"{out / 'report.html'}: {NO_FIGURES}", err=True)
    if write_model is not None:
        if told is not None:
            write_whole(write_model, told.encode())
        else:
            echo(f"{write_model}: not written, since nothing was given a name", err=True)
    if diagnosis.verdict == "bad_data":
        raise typer.Exit(1)


def _says_something(diagnosis: Diagnosis) -> bool:
    """Whether a model can be made of it: names, or that none is missing."""
    return diagnosis.verdict in ("named", "named_plus", "nothing_left_out")


def _with_claims(knows: Model, diagnosis: Diagnosis) -> Model:
    """The model with the claimed effects at their fitted values. Raises InputError for values that are not plausible.

    Parameters of an effect that the claim says nothing of stay as the model has them.
    """
    known = knows.forward().parameters()
    claimed = {
        claim.effect: known.get(claim.effect, {}) | {name: p.value for name, p in claim.parameters.items()}
        for claim in diagnosis.claims
    }
    return knows.with_effects(claimed) if claimed else knows


def _diagnose(rows: Recording, knows: Model, seed: int, method: Method) -> tuple[Diagnosis, Picture | None]:
    """Intake, then the engine for the kind of recording it is."""
    from dataclasses import replace

    import numpy as np

    from highside import __version__
    from highside.cli.diagnose_rotation import diagnose_rows, rotates
    from highside.diagnosis.core.result import Diagnosis
    from highside.diagnosis.engine import diagnose_poses
    from highside.diagnosis.intake.checks import check
    from highside.diagnosis.intake.clipped import with_clipping, without_clipped_poses
    from highside.diagnosis.poses.session import pose_session
    from highside.errors import InputError

    if knows.reference.kind == "magnitude":
        from highside.cli.diagnose_magnitude import diagnose_magnitude

        return diagnose_magnitude(rows, knows, seed)
    if knows.reference.kind == "simulation":
        raise InputError(
            "the model says that another program predicts the recording", where=rows.source, field="reference.kind",
            remedy="give its output with --simulation SIM.csv",
        )  # fmt: skip
    references = {"inc_ref_deg", "tf_ref_deg", "rotor_deg"}
    if "kind" not in knows.reference.model_fields_set and not references & set(rows.columns):
        raise InputError(
            "nothing says where the tool was, and the model does not say what else is known", where=rows.source,
            field="inc_ref_deg, tf_ref_deg or rotor_deg", remedy="add these columns; or put [reference] kind = "
            '"magnitude" into the model if only |g| is known; or give another program\'s output with --simulation',
        )  # fmt: skip
    axes = knows.tool.map
    toolface = "rotor_deg" if "rotor_deg" in rows.columns and "tf_ref_deg" not in rows.columns else "tf_ref_deg"
    signed = list(zip(axes.order, axes.signs, strict=True))
    found = check(rows.columns, ("inc_ref_deg", toolface), signed)
    if found.spoiled:
        return Diagnosis("bad_data", intake=found.findings, seed=seed, version=__version__), None
    if rotates(rows):
        diagnosis, picture = diagnose_rows(rows, knows, signed, found, seed, method)
        return with_clipping(replace(diagnosis, intake=found.findings), found, signed), picture
    raw = rows.accel()
    accel = np.stack([sign * raw[channel] for channel, sign in signed])
    site = knows.site.site
    try:
        session = pose_session(
            without_clipped_poses(rows.columns, raw, found), accel, gravity_mps2=site.gravity_mps2,
            latitude_rad=site.latitude_rad, azimuth_rad=site.azimuth_rad,
        )  # fmt: skip
    except InputError as error:
        raise InputError(error.what, where=rows.source, field=error.field, remedy=error.remedy) from None
    diagnosis, picture = diagnose_poses(
        session, knows.forward(), knows.sensor.free, seed=seed, version=__version__, method=method
    )
    return with_clipping(replace(diagnosis, intake=found.findings), found, signed), picture

"""`highside diagnose`: where a recording departs from the simulation, and what physics was left out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from highside.config.model import Model
    from highside.diagnosis.engine import Picture
    from highside.diagnosis.result import Diagnosis
    from highside.recording.table import Recording


def diagnose(
    recording: Annotated[Path, typer.Argument(help="The Recording (CSV, optionally gzipped).")],
    model: Annotated[Path, typer.Option("--model", help="Model file (TOML): what the simulation knows.")],
    out: Annotated[Path, typer.Option("--out", help="Directory for diagnosis.json and report.html.")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the calibration of thresholds.")] = 1,
) -> None:
    """Say where a recording departs from the simulation, what was left out, and how sure that is."""
    from highside.config.model import load_model
    from highside.errors import InputError
    from highside.recording.files import write_whole
    from highside.recording.table import read_recording
    from highside.report.diagnosis_page import VERDICTS, page_of

    knows = load_model(model)
    rows = read_recording(recording)
    diagnosis, picture = _diagnose(rows, knows, seed)
    page = page_of(diagnosis, picture, recording.name)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made: {error.strerror}", where=str(out)) from None
    write_whole(out / "diagnosis.json", (json.dumps(diagnosis.to_dict(), indent=1) + "\n").encode())
    write_whole(out / "report.html", page.encode())
    named = ", ".join(claim.effect for claim in diagnosis.claims)
    typer.echo(f"{diagnosis.verdict} - {VERDICTS[diagnosis.verdict]}{': ' + named if named else ''}")
    for finding in diagnosis.intake:
        typer.echo(f"{finding.check} ({', '.join(finding.channels)}): {finding.remedy}")
    if diagnosis.verdict == "bad_data":
        raise typer.Exit(1)


def _diagnose(rows: Recording, knows: Model, seed: int) -> tuple[Diagnosis, Picture | None]:
    """Intake, then the engine for the kind of recording it is."""
    from dataclasses import replace

    import numpy as np

    from highside import __version__
    from highside.cli.diagnose_rotation import diagnose_rows, rotates
    from highside.diagnosis.clipped import with_clipping, without_clipped_poses
    from highside.diagnosis.engine import diagnose_poses
    from highside.diagnosis.intake import check
    from highside.diagnosis.result import Diagnosis
    from highside.diagnosis.session import pose_session
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
        diagnosis, picture = diagnose_rows(rows, knows, signed, found, seed)
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
    diagnosis, picture = diagnose_poses(session, knows.forward(), knows.sensor.free, seed=seed, version=__version__)
    return with_clipping(replace(diagnosis, intake=found.findings), found, signed), picture

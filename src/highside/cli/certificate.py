"""`highside calibrate certificate`: the certificate of a record, as PDF or as HTML that prints as numbered sheets."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.say import echo


def certificate(
    record_file: Annotated[Path, typer.Argument(metavar="RECORD", help="Calibration record (JSON).")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="File to write: .pdf, or .html to be printed from a browser.")
    ],
    fields_file: Annotated[
        Path | None, typer.Option("--fields", help="TOML file: laboratory, customer, traceability, limits, signatory.")
    ] = None,
    previous_file: Annotated[
        Path | None, typer.Option("--previous", help="Record in force before: gives the state as found.")
    ] = None,
    as_found: Annotated[
        Path | None,
        typer.Option("--as-found", help="Poses measured before (table or journal); else those of the record."),
    ] = None,
    as_left: Annotated[
        Path | None, typer.Option("--as-left", help="Poses measured afterwards; else those of the record.")
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", help="Sign the certificate with this key: OUTPUT.sig.")] = None,
) -> None:
    """Write a certificate: result, uncertainty budget (GUM, k = 2), as found / as left, method, poses, identity."""
    from highside.calibration.record import RecordError, RecordReason, to_utc
    from highside.cli.keys import signing_key_if_any
    from highside.cli.verification import read_poses
    from highside.config.certificate import CertificateFields, load_certificate_fields
    from highside.recording.calibration_store import read_record
    from highside.recording.files import write_whole
    from highside.report.certificate import certificate as make
    from highside.report.certificate_conformity import verdict_lines
    from highside.report.certificate_inputs import Inputs
    from highside.report.plots import need_plots

    need_plots()  # before the work: the sheets are drawn

    private = signing_key_if_any(key)
    record = read_record(record_file)
    fields = CertificateFields() if fields_file is None else load_certificate_fields(fields_file)
    previous = None if previous_file is None else read_record(previous_file)
    if previous is not None and previous.tool_id != record.tool_id:
        raise RecordError(
            RecordReason.WRONG_TOOL, f"{previous_file}: is of tool {previous.tool_id!r}, not of {record.tool_id!r}"
        )
    found, left = (None if path is None else read_poses(path) for path in (as_found, as_left))
    inputs = Inputs(record, fields, to_utc(time.time()), previous, found, left)
    sheets = make(inputs)
    if output.suffix.lower() == ".pdf":
        data, pages = sheets.pdf()
        extent = f", {pages} pages"
    else:
        data, extent = sheets.html().encode(), ""
    write_whole(output, data)
    echo(f"{output}: certificate of record {record.id[:12]}{extent}")
    if private is not None:
        from highside.recording.keys import sign_file

        beside = sign_file(output, private, now_s=time.time())
        echo(f"{beside}: signed by {private.name}")
    for line in verdict_lines(inputs):
        echo(line)

"""`highside calibrate certificate`: the certificate of a record, as PDF or as HTML that prints as numbered sheets."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import as_options, speaking
from highside.cli.say import echo

if TYPE_CHECKING:
    from highside.api.certificate import Certificate
    from highside.calibration.signature import SigningKey

Session = Annotated[
    Path | None, typer.Option("--session", help="Journal of the record's session: its photographs as an annex.")
]
Language = Annotated[
    str | None,
    typer.Option("--language", help="en, de, nb or es; else as the fields say (issue.language), else English."),
]


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
    session: Session = None,
    language: Language = None,
    key: Annotated[Path | None, typer.Option("--key", help="Sign the certificate with this key: OUTPUT.sig.")] = None,
    dcc: Annotated[
        Path | None,
        typer.Option("--dcc", help="The same as Digital Calibration Certificate (PTB's DCC XML 3.3.0), OUTPUT within."),
    ] = None,
) -> None:
    """Write a certificate: result, uncertainty budget (GUM, k = 2), as found / as left, method, poses, identity."""
    from highside.api.certificate import certify
    from highside.cli.keys import signing_key_if_any
    from highside.cli.verification import read_poses
    from highside.recording.calibration_store import read_record
    from highside.recording.files import write_whole
    from highside.report.document import need_pdf
    from highside.report.plots import need_plots

    need_plots()  # before the work: the sheets are drawn
    if output.suffix.lower() == ".pdf":
        need_pdf()

    private = signing_key_if_any(key)
    record = read_record(record_file)
    # a journal of a session has poses too, which a program reads otherwise
    found, left = (None if path is None else read_poses(path) for path in (as_found, as_left))
    with as_options(language="--language"):
        made = certify(
            record,
            fields_file,
            previous=previous_file,
            as_found=found,
            as_left=left,
            session=session,
            language=language,
        )
    # the sheets are in the language that their fields name, whatever is spoken at the terminal
    pages = made.save(output)
    if dcc is not None:
        write_whole(dcc, made.dcc(output))
    signatures = {} if private is None else _signed((output, dcc), private)
    with speaking(language):
        _tell(made, output, pages, dcc, signatures)


def _signed(files: tuple[Path | None, ...], private: SigningKey) -> dict[Path, str]:
    """The signatures that were written beside the files, and whose they are."""
    from highside.recording.keys import sign_file

    return {sign_file(file, private, now_s=time.time()): private.name for file in files if file is not None}


def _tell(made: Certificate, output: Path, pages: int | None, dcc: Path | None, signatures: dict[Path, str]) -> None:
    """What was written: the certificate, where wanted the digital one with it inside, signatures; and the verdicts."""
    from highside.words import _

    of = {"file": output, "id": made.inputs.record.id[:12]}
    if pages:
        echo(_("%(file)s: certificate of record %(id)s, %(pages)s pages", **of, pages=pages))
    else:
        echo(_("%(file)s: certificate of record %(id)s", **of))
    if dcc is not None:
        echo(_("%(file)s: digital calibration certificate (DCC %(version)s)", file=dcc, version="3.3.0"))
    for file, name in signatures.items():
        echo(_("%(file)s: signed by %(name)s", file=file, name=name))
    for line in made.verdicts:
        echo(line)

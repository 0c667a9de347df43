"""`highside rotation turntable`: the bench's own encoder and axis, fitted with a calibrated tool."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.options import PrintLanguage, speaking
from highside.cli.say import echo, echo_json

if TYPE_CHECKING:
    from highside.api.turntable import TurntableFit


def turntable(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="REC",
            help="Turns at two inclinations or more (CSV): inc_ref_deg, tf_ref_deg of the bench; inc_deg, tf_deg of a"
            " calibrated tool (`calibrate apply`) or of another reference; rotor_deg where it is not tf_ref_deg.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Compensation (JSON) to write.")],
    largest_order: Annotated[int, typer.Option(min=0, max=12, help="Highest harmonic looked for.")] = 8,
    language: PrintLanguage = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Fit a bench's encoder and axis errors, good at every inclination; `calibrate solve --turntable` uses them.

    It needs a reference: a calibrated tool, or another. Without one: `rotation fit-self`, turns at two inclinations.
    """
    from highside.api.turntable import fit_turntable
    from highside.recording.files import write_whole

    with speaking(language):
        found = fit_turntable(recording, largest_order=largest_order)
        made = found.compensation
        write_whole(output, made.to_json().encode())
        if as_json:
            order, left = found.curve.order, found.noise_arcmin
            echo_json(json.dumps({"output": str(output), "id": made.id, "order": order, "noise": left}))
        else:
            _tell(found, output)


def _tell(found: TurntableFit, output: Path) -> None:
    from highside.words import _, told

    order, rows, short = found.curve.order, found.rows, found.compensation.id[:12]
    echo(_("%(file)s: order %(order)s from %(rows)s rows, %(id)s", file=output, order=order, rows=rows, id=short))
    for name, harmonics in found.harmonics_arcmin().items():
        listed = ", ".join(f"{k}: {size:.3f}'" for k, size in enumerate(harmonics, start=1))
        echo(f"  {name:<8} {listed or _('no harmonic')}")
    left = {name: f"{size:.3f}" for name, size in found.noise_arcmin.items()}
    echo("  " + _("a row about the curves: T %(toolface_arcmin)s', I %(inclination_arcmin)s'", **left))
    if found.curve.coverage.warning:
        echo(told(found.curve.coverage.warning, "rotation"), err=True)

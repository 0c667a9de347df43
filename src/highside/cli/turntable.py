"""`highside rotation turntable`: the bench's own encoder and axis, fitted with a calibrated tool."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.say import echo, echo_json


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
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Fit a bench's encoder and axis errors, good at every inclination; `calibrate solve --turntable` uses them.

    It needs a reference: a calibrated tool, or another. Without one: `rotation fit-self`, turns at two inclinations.
    """
    from highside.api.turntable import fit_turntable
    from highside.recording.files import write_whole

    found = fit_turntable(recording, largest_order=largest_order)
    made = found.compensation
    write_whole(output, made.to_json().encode())
    left = found.noise_arcmin
    if as_json:
        echo_json(json.dumps({"output": str(output), "id": made.id, "order": found.curve.order, "noise": left}))
        return
    echo(f"{output}: order {found.curve.order} from {found.rows} rows, {made.id[:12]}")
    for name, harmonics in found.harmonics_arcmin().items():
        listed = ", ".join(f"{k}: {size:.3f}'" for k, size in enumerate(harmonics, start=1))
        echo(f"  {name:<8} {listed or 'no harmonic'}")
    echo(f"  a row about the curves: T {left['toolface_arcmin']:.3f}', I {left['inclination_arcmin']:.3f}'")
    if found.curve.coverage.warning:
        echo(found.curve.coverage.warning, err=True)

"""The bench's own encoder and axis: fitted with a calibrated tool, taken off the poses of later calibrations."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo, echo_json
from highside.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.rotation import Compensation

    Floats = NDArray[np.float64]

LARGEST_ERROR_DEG = 1.0


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
    import hashlib

    import numpy as np

    from highside.attitude.angles import wrap_signed
    from highside.reading import read_bytes
    from highside.recording.files import write_whole
    from highside.recording.table import Table
    from highside.rotation.turntable import fit_turntable

    table = Table.read(recording)
    inc_ref, tf_ref, inc, tf = table.require("inc_ref_deg", "tf_ref_deg", "inc_deg", "tf_deg")
    angle = table.columns.get("rotor_deg", tf_ref)
    rows = np.isfinite(np.vstack([inc_ref, tf_ref, inc, tf, angle])).all(axis=0)
    d_tf = np.radians(tf[rows] - tf_ref[rows])
    # about the toolface zero, which may be anything
    zero = float(np.angle(np.exp(1j * d_tf).mean())) if d_tf.size else 0.0
    d_tf = zero + np.asarray(wrap_signed(d_tf - zero))
    d_inc = np.radians(inc[rows] - inc_ref[rows])
    for name, off in (("tf_deg", d_tf - zero), ("inc_deg", d_inc)):
        worst = float(np.degrees(np.abs(off).max())) if off.size else 0.0
        if worst > LARGEST_ERROR_DEG:
            raise InputError(
                f"{worst:.2f} deg from the bench in a row: no error of a turntable", where=str(recording), field=name,
                remedy="leave out rows in motion and rows of another fixture",
            )  # fmt: skip
    try:
        found = fit_turntable(np.radians(angle[rows]), np.radians(inc_ref[rows]), d_tf, d_inc, largest_order)
    except InputError as problem:
        raise InputError(problem.what, where=str(recording), remedy=problem.remedy) from None
    made = found.compensation(recording.name, hashlib.sha256(read_bytes(recording)).hexdigest())
    write_whole(output, made.to_json().encode())
    left = {
        "toolface_arcmin": float(np.degrees(found.noise_rad) * 60.0),
        "inclination_arcmin": float(np.degrees(found.along_noise_rad) * 60.0),
    }
    if as_json:
        echo_json(json.dumps({"output": str(output), "id": made.id, "order": found.order, "noise": left}))
        return
    echo(f"{output}: order {found.order} from {int(rows.sum())} rows, {made.id[:12]}")
    for name, curve in made.curves.items():
        harmonics = np.hypot(curve.parameters[1::2], curve.parameters[2::2])
        listed = ", ".join(f"{k}: {size:.3f}'" for k, size in enumerate(harmonics, start=1))
        echo(f"  {name:<8} {listed or 'no harmonic'}")
    echo(f"  a row about the curves: T {left['toolface_arcmin']:.3f}', I {left['inclination_arcmin']:.3f}'")
    if found.coverage.warning:
        echo(found.coverage.warning, err=True)


def read_compensation(path: Path) -> Compensation:
    """A compensation from its file; see `Compensation.from_json`."""
    from highside.reading import read_bytes
    from highside.rotation import Compensation

    return Compensation.from_json(read_bytes(path), where=str(path))

"""`highside rotation fit-self`: a compensation from a recording without an outside reference."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.say import echo, echo_json
from highside.errors import InputError, Refused

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.rotation.self_reference import SelfErrors

    Floats = NDArray[np.float64]


class PartName(StrEnum):
    """Which error is fitted."""

    DECODED = "decoded"
    SENSOR = "sensor"
    ROTOR = "rotor"


def fit_self(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="REC...",
            help="Recording (CSV) of a turning rotor: t_s, rotor_deg, ax_g.., and gx_dps.. if it has gyros. Several, at"
            " different inclinations: encoder and axis of the turntable, good at all of them (`calibrate solve"
            " --turntable`).",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Compensation (JSON) to write.")],
    of: Annotated[
        PartName,
        typer.Option(
            help="decoded: I and T against the encoder's (the case stands). sensor: against the gyros' prediction."
            " rotor: the gyros' prediction against the encoder's."
        ),
    ] = PartName.DECODED,
    calibration: Annotated[Path | None, typer.Option(help="Calibration record: readings are corrected first.")] = None,
    gyro_bias_dph: Annotated[float, typer.Option(help="What is not known of the gyros' bias, deg/h.")] = 10.0,
    gyro_misalignment_arcmin: Annotated[
        float, typer.Option(help="What is not known of the gyros' alignment with the accelerometers, arcmin.")
    ] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Fit errors of I and T against the rotor angle with the recording's own gyros and accelerometers as reference."""
    import hashlib
    import math

    import numpy as np

    from highside.reading import read_bytes
    from highside.recording.files import write_whole
    from highside.rotation import Compensation, Validity
    from highside.rotation.self_reference import GyroDoubt
    from highside.rotation.self_turntable import self_turntable

    for name, value in (("--gyro-bias-dph", gyro_bias_dph), ("--gyro-misalignment-arcmin", gyro_misalignment_arcmin)):
        if not value >= 0.0:
            raise InputError("must not be negative", field=name)
    doubt = GyroDoubt(math.radians(gyro_bias_dph / 3600.0), math.radians(gyro_misalignment_arcmin / 60.0))
    found = [_errors(recording, of, calibration) for recording in recordings]
    inclinations = [math.degrees(one.mean_inclination_rad) for one in found]
    digest = hashlib.sha256(b"".join(read_bytes(recording) for recording in recordings)).hexdigest()
    source = " ".join(recording.name for recording in recordings)
    remarks: list[str] = []
    if len(found) == 1:
        curves = found[0].curves(doubt)
        validity = Validity(inclination_deg=inclinations[0])
    else:
        curves = self_turntable(found, doubt)
        validity = Validity()
        if of is PartName.DECODED and calibration is None:
            remarks.append("the accelerometers' own errors pass for the turntable's: give --calibration or --of rotor")
    made = Compensation(curves, validity, source, digest)
    write_whole(output, made.to_json().encode())
    theta = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    described = {
        name: {
            "order": curve.order,
            "half_range_arcmin": float(np.ptp(curve(theta)) / 2.0),
            "std_worst_arcmin": float(curve.std(theta).max()),
            "held_out_rms_arcmin": None if curve.held_out is None else curve.held_out.rms,
            "remarks": list(curve.remarks),
        }
        for name, curve in curves.items()
    }
    turns = sum(one.turns for one in found)
    if as_json:
        said: dict[str, Any] = {
            "output": str(output),
            "id": made.id,
            "of": of.value,
            "turns": turns,
            "curves": described,
        }
        said |= {"inclination_deg": inclinations[0] if len(found) == 1 else inclinations, "remarks": remarks}
        echo_json(json.dumps(said))
        return
    at = ", ".join(f"{one:.2f}" for one in inclinations)
    echo(f"{output}: {of.value} errors of {turns:.1f} turns at I = {at} deg, {made.id[:12]}")
    for name, one in described.items():
        echo(
            f"  {name:<11} order {one['order']:<2} amplitude {one['half_range_arcmin']:.3f}',"
            f" uncertain by {one['std_worst_arcmin']:.3f}'"
        )
    for remark in dict.fromkeys([*remarks, *(remark for curve in curves.values() for remark in curve.remarks)]):
        echo(remark, err=True)


def _errors(recording: Path, of: PartName, calibration: Path | None) -> SelfErrors:
    """What one recording tells of itself."""
    import numpy as np

    from highside.recording.table import read_recording
    from highside.rotation.self_reference import Part, self_errors

    table = read_recording(recording)
    angle, *accel = table.require("rotor_deg", "ax_g", "ay_g", "az_g")
    gyros = ("gx_dps", "gy_dps", "gz_dps")
    rates = np.radians(np.vstack(table.require(*gyros))) if table.has(*gyros) else None
    a = np.vstack(accel)
    if calibration is not None:
        a = _corrected(a, table.columns.get("temp_c"), calibration)
    t_s = table.t_s
    if np.any(np.diff(t_s) <= 0.0):
        raise InputError("time stands or goes back", where=str(recording), field="t_s", remedy="sort the rows by time")
    known = np.isfinite(np.vstack([a, angle, *([] if rates is None else [rates])])).all(axis=0)
    if int(known.sum()) < 8:
        raise Refused(f"{recording}: {int(known.sum())} rows in which rotor angle and readings are all known")
    try:
        return self_errors(
            t_s[known], a[:, known], None if rates is None else rates[:, known], np.radians(angle[known]),
            Part(of.value),
        )  # fmt: skip
    except Refused as problem:
        raise Refused(f"{recording}: {problem}") from None


def _corrected(a: Floats, temp_c: Floats | None, path: Path) -> Floats:
    from highside.calibration.correction import LinearCorrection
    from highside.calibration.record import correction_from_record
    from highside.calibration.schedule import ScheduledCorrection
    from highside.recording.calibration_store import read_record

    correction = correction_from_record(read_record(path))
    if not isinstance(correction, LinearCorrection | ScheduledCorrection):
        raise InputError("does not correct accelerations", where=str(path))
    return correction.correct_block(a, temp_c)

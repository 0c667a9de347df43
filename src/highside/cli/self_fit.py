"""`highside rotation fit-self`: a compensation from a recording without an outside reference."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from highside.cli.options import PrintLanguage, as_options, in_options, speaking
from highside.cli.say import echo, echo_json

if TYPE_CHECKING:
    from highside.api.turntable import SelfFit


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
    language: PrintLanguage = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Fit errors of I and T against the rotor angle with the recording's own gyros and accelerometers as reference."""
    from highside.api.turntable import fit_self as fit
    from highside.recording.files import write_whole

    with speaking(language):
        with as_options("gyro_bias_dph", "gyro_misalignment_arcmin"):
            found = fit(
                recordings,
                of=of.value,
                calibration=calibration,
                gyro_bias_dph=gyro_bias_dph,
                gyro_misalignment_arcmin=gyro_misalignment_arcmin,
            )
        write_whole(output, found.compensation.to_json().encode())
        if as_json:
            _print_json(found, of, output)
        else:
            _print_lines(found, of, output)


def _print_json(found: SelfFit, of: PartName, output: Path) -> None:
    inclinations = found.inclinations_deg
    printed: dict[str, Any] = {
        "output": str(output),
        "id": found.compensation.id,
        "of": of.value,
        "turns": found.turns,
        "curves": found.described(),
        "inclination_deg": inclinations[0] if len(inclinations) == 1 else inclinations,
        "remarks": [in_options(remark) for remark in found.remarks],
    }
    echo_json(json.dumps(printed))


def _print_lines(found: SelfFit, of: PartName, output: Path) -> None:
    from highside.words import _, told

    echo(
        _(
            "%(file)s: %(part)s errors of %(turns)s turns at I = %(at)s deg, %(id)s",
            file=output,
            part=of.value,
            turns=f"{found.turns:.1f}",
            at=", ".join(f"{one:.2f}" for one in found.inclinations_deg),
            id=found.compensation.id[:12],
        )
    )
    for name, one in found.described().items():
        line = _(
            "order %(order)s amplitude %(size)s', uncertain by %(std)s'",
            order=f"{one['order']:<2}",
            size=f"{one['half_range_arcmin']:.3f}",
            std=f"{one['std_worst_arcmin']:.3f}",
        )
        echo(f"  {name:<11} {line}")
    for remark in found.sentences:
        echo(in_options(told(remark, "rotation")), err=True)

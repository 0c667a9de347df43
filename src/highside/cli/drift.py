"""`highside drift`: attitude, azimuth and gyro biases of a Recording with gyros, and what the azimuth rests on."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from highside.cli.say import echo

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from highside.gyro.filter import Settings
    from highside.gyro.result import DriftResult

    Column = NDArray[np.float64]

_SHORTEST_S = 2.0


class Method(StrEnum):
    LITERAL = "literal"
    LITERAL_BLOCK = "literal_block"
    RECURSIVE = "recursive"
    KINEMATIC = "kinematic"
    NONE = "none"


class Policy(StrEnum):
    GYRO = "gyro"
    PREV = "prev"
    HOLD = "hold"


def drift(
    recording: Annotated[Path, typer.Argument(help="Recording with accelerometers and gyros (CSV, .gz).")],
    method: Annotated[
        Method,
        typer.Option(
            "--method",
            help="literal: the paper's equations 7-12, gravity believed where its gate sees no vibration. "
            "literal_block: their average over each stop. recursive: PI loop with derived gains. kinematic: error-"
            "state filter with zero-rate updates. none: the gyro alone.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Attitude and bias for each row (CSV, .gz).")],
    latitude_deg: Annotated[
        float | None, typer.Option("--latitude-deg", min=-90, max=90, help="For the Earth's rotation.")
    ] = None,
    azimuth_deg: Annotated[
        float | None, typer.Option("--azimuth-deg", help="Azimuth at the start, clockwise from true north.")
    ] = None,
    azimuth_std_deg: Annotated[
        float, typer.Option("--azimuth-std-deg", min=0, help="Its standard deviation (kinematic, recursive).")
    ] = 0.1,
    rest: Annotated[
        str | None,
        typer.Option("--rest", help="When the tool stood, s: 0-420,1800-1920. Without it stops are detected."),
    ] = None,
    azimuth_policy: Annotated[
        Policy | None,
        typer.Option(
            "--azimuth-policy",
            help="literal and literal_block (default hold). gyro: azimuth uncorrected. prev: nothing turns about the "
            "vertical. hold: the azimuth does not change (straight hole).",
        ),
    ] = None,
    straight_hole: Annotated[
        bool,
        typer.Option("--straight-hole", help="Assert that the azimuth stays that of the start (kinematic, recursive)."),
    ] = False,
    smooth: Annotated[
        bool,
        typer.Option("--smooth", help="Let every row know the whole recording (kinematic); else a row knows its past."),
    ] = False,
    by_hand: Annotated[
        bool,
        typer.Option(
            "--carried",
            help="The sensor is carried or waved by hand (kinematic): accelerations of any size, a velocity that stays "
            "bounded. Else accelerations are vibration, which averages out.",
        ),
    ] = False,
    arw: Annotated[
        float, typer.Option("--gyro-arw", min=1e-6, help="Angle random walk of the gyros, deg/sqrt(h).")
    ] = 0.1,
    rrw: Annotated[
        float, typer.Option("--gyro-rrw", min=0, help="Rate random walk of the gyros, deg/h/sqrt(h).")
    ] = 0.1,
    bias_std: Annotated[
        float, typer.Option("--gyro-bias-std", min=1e-3, help="Bias to be expected at power-up, deg/h, 1 sigma.")
    ] = 20.0,
) -> None:
    """Follow the attitude by gyros and gravity. What the azimuth rests on is printed in words."""
    import numpy as np

    from highside.errors import InputError
    from highside.gyro.checks import check_units, saturated_rows
    from highside.gyro.filter import carried
    from highside.recording.table import Recording, read_recording, write_recording

    if azimuth_policy is not None and method not in (Method.LITERAL, Method.LITERAL_BLOCK):
        raise InputError(
            f"has no meaning with --method {method.value}", field="--azimuth-policy", remedy="leave it out"
        )
    if straight_hole and method not in (Method.KINEMATIC, Method.RECURSIVE):
        raise InputError(f"has no meaning with --method {method.value}", field="--straight-hole", remedy="leave it out")
    if smooth and method is not Method.KINEMATIC:
        raise InputError(f"has no meaning with --method {method.value}", field="--smooth", remedy="leave it out")
    if by_hand and method is not Method.KINEMATIC:
        raise InputError(f"has no meaning with --method {method.value}", field="--carried", remedy="leave it out")
    intervals = _intervals(rest)
    table = read_recording(recording)
    where = str(recording)
    gyros = [name for name in ("gx_dps", "gy_dps", "gz_dps") if not table.has(name)]
    if gyros:
        raise InputError(
            f"lacks the gyro column{'s' if len(gyros) > 1 else ''} {', '.join(gyros)}",
            where=where,
            remedy="drift needs a tool with three gyros",
        )
    block = table.complete("t_s", "ax_g", "ay_g", "az_g", "gx_dps", "gy_dps", "gz_dps")
    t_s, accel, rate = block[0], block[1:4], np.radians(block[4:7])
    backwards = np.flatnonzero(np.diff(t_s) <= 0.0)
    if backwards.size:
        raise InputError(
            "time does not increase", where=f"{where}: line {backwards[0] + 3}", field="t_s", remedy="sort the rows"
        )
    if t_s.size < 2 or t_s[-1] - t_s[0] < _SHORTEST_S:
        raise InputError("is shorter than 2 s", where=where, remedy="drift shows over minutes")
    for begin, end in intervals:
        if end <= t_s[0] or begin >= t_s[-1]:
            raise InputError(
                f"{begin:g}-{end:g} lies outside of the recording ({t_s[0]:g} to {t_s[-1]:g} s)", field="--rest"
            )
    settings = _settings(latitude_deg, azimuth_deg, azimuth_std_deg, arw, rrw, bias_std)
    doubts = check_units(t_s, rate, accel, where, arw=settings.arw)
    if by_hand:
        settings = carried(settings)
    result = _run(method, t_s, rate, accel, intervals, azimuth_policy, straight_hole, settings, smooth=smooth)
    # the rotor's angle goes along: `rotation apply` takes its error off the azimuth
    rotor = {name: table.columns[name] for name in ("rotor_deg", "rotor_rate_dps") if table.has(name)}
    write_recording(output, Recording(_columns(result) | rotor))
    echo(f"{t_s.size} rows, {method.value}; azimuth from {result.basis_words}", err=True)
    for note in (*result.notes, *doubts):
        echo(f"note: {note}", err=True)
    clipped = saturated_rows(rate)
    if clipped:
        echo(
            f"note: a gyro stands at its limit in {clipped} rows: turns beyond its range are lost, "
            "and the azimuth with them",
            err=True,
        )


def _intervals(text: str | None) -> Column:
    """`0-420,1800-1920` as (K, 2) seconds."""
    import re

    import numpy as np

    from highside.errors import InputError

    if text is None:
        return np.zeros((0, 2))
    pairs = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*-\s*(\d+(?:\.\d*)?)\s*", part)
        if match is None or float(match[2]) <= float(match[1]):
            raise InputError(
                f"{part.strip()!r} is no interval", field="--rest", remedy="give begin-end in seconds: 0-420,1800-1920"
            )
        pairs.append((float(match[1]), float(match[2])))
    return np.array(pairs)


def _settings(
    latitude_deg: float | None, azimuth_deg: float | None, azimuth_std_deg: float, arw: float, rrw: float, bias: float
) -> Settings:
    import math

    from highside.gyro.filter import Settings
    from highside.gyro.frames import DEG_PER_HOUR, DEG_PER_SQRT_HOUR

    return Settings(
        latitude_rad=None if latitude_deg is None else math.radians(latitude_deg),
        azimuth_rad=None if azimuth_deg is None else math.radians(azimuth_deg),
        azimuth_std_rad=math.radians(azimuth_std_deg),
        arw=arw * DEG_PER_SQRT_HOUR,
        rrw=rrw * DEG_PER_HOUR / 60.0,
        bias_std_radps=bias * DEG_PER_HOUR,
    )


def _run(
    method: Method, t_s: Column, rate: Column, accel: Column, rest: Column, policy: Policy | None, straight: bool,
    settings: Settings, *, smooth: bool,
) -> DriftResult:  # fmt: skip
    import math
    from dataclasses import replace

    from highside.gyro.gates import quiet_rows
    from highside.gyro.kinematic import kinematic
    from highside.gyro.literal import AzimuthPolicy, literal
    from highside.gyro.recursive import recursive

    if method is Method.KINEMATIC:
        own = replace(settings, straight_hole_std_rad=math.radians(0.1) if straight else None)
        return kinematic(t_s, rate, accel, own, rest=rest if rest.size else None, smooth=smooth)
    if method is Method.RECURSIVE:
        return recursive(t_s, rate, accel, settings, hold=straight, rest=rest if rest.size else None)
    quiet = quiet_rows(t_s, rate, accel, rest)
    result = literal(
        t_s,
        rate,
        accel,
        policy=AzimuthPolicy(policy.value) if policy else AzimuthPolicy.HOLD,
        quiet=quiet,
        azimuth_rad=settings.azimuth_rad or 0.0,
        average=method is Method.LITERAL_BLOCK,
        correct=method is not Method.NONE,
    )
    if method is Method.NONE:
        return result
    by = "within --rest" if rest.size else "by the gate on vibration"
    said = f"gravity believed in {int(quiet.sum())} of {quiet.size} rows, {by}"
    if not quiet.any():
        said += ": nowhere is it quiet, so that the gyro alone carries the attitude and no drift is known"
    return replace(result, notes=(*result.notes, said))


def _columns(result: DriftResult) -> dict[str, Column]:
    """The columns of the output, degrees and deg/s."""
    import numpy as np

    columns = {
        "t_s": result.t_s,
        "inc_deg": np.degrees(result.inc_rad),
        "tf_deg": np.degrees(result.tf_rad),
        "azi_deg": np.degrees(result.azi_rad),
        "azi_std_deg": np.degrees(result.azi_std_rad),
    }
    for kind, values in (("bias", result.bias_radps), ("bias_std", result.bias_std_radps)):
        columns |= {f"{kind}_{axis}_dps": np.degrees(row) for axis, row in zip("xyz", values, strict=True)}
    return columns

"""`highside drift`: attitude, azimuth and gyro biases of a Recording with gyros, and what the azimuth rests on."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from highside.cli.options import as_options, in_options
from highside.cli.say import echo
from highside.errors import InputError


class DriftMethod(StrEnum):
    LITERAL = "literal"
    LITERAL_BLOCK = "literal_block"
    RECURSIVE = "recursive"
    KINEMATIC = "kinematic"
    NONE = "none"


class AzimuthOption(StrEnum):
    GYRO = "gyro"
    PREV = "prev"
    HOLD = "hold"


Method = Annotated[
    DriftMethod,
    typer.Option(
        "--method",
        help="literal: the paper's equations 7-12, gravity believed where its gate sees no vibration. "
        "literal_block: their average over each stop. recursive: Mahony (PI) complementary filter with "
        "derived gains. kinematic: error-state Kalman filter with zero-rate updates. none: the gyro alone.",
    ),
]
LatitudeDeg = Annotated[float | None, typer.Option("--latitude-deg", min=-90, max=90, help="For the Earth's rotation.")]
AzimuthDeg = Annotated[
    float | None, typer.Option("--azimuth-deg", help="Azimuth at the start, clockwise from true north.")
]
AzimuthStdDeg = Annotated[
    float, typer.Option("--azimuth-std-deg", min=0, max=90, help="Its standard deviation (kinematic, recursive).")
]
Rest = Annotated[
    str | None,
    typer.Option("--rest", help="When the tool was at rest, s: 0-420,1800-1920. Without it stops are detected."),
]
AzimuthPolicy = Annotated[
    AzimuthOption | None,
    typer.Option(
        "--azimuth-policy",
        help="literal and literal_block (default hold). gyro: azimuth uncorrected. prev: nothing turns about the "
        "vertical. hold: the azimuth does not change (straight hole).",
    ),
]
StraightHole = Annotated[
    bool,
    typer.Option("--straight-hole", help="Assert that the azimuth stays that of the start (kinematic, recursive)."),
]
Smooth = Annotated[
    bool,
    typer.Option("--smooth", help="Let every row know the whole recording (kinematic); else a row knows its past."),
]
ByHand = Annotated[
    bool,
    typer.Option(
        "--carried",
        help="The sensor is carried or waved by hand (kinematic): accelerations of any size, a velocity that stays "
        "bounded. Else accelerations are vibration, which averages out.",
    ),
]
Arw = Annotated[
    float, typer.Option("--gyro-arw", min=1e-6, max=100, help="Angle random walk of the gyros, deg/sqrt(h).")
]
Rrw = Annotated[
    float, typer.Option("--gyro-rrw", min=0, max=1000, help="Rate random walk of the gyros, deg/h/sqrt(h).")
]
BiasStd = Annotated[
    float, typer.Option("--gyro-bias-std", min=1e-3, max=1e5, help="Bias to be expected at power-up, deg/h, 1 sigma.")
]


def drift(
    recording: Annotated[Path, typer.Argument(help="Recording with accelerometers and gyros (CSV, .gz).")],
    method: Method,
    output: Annotated[Path, typer.Option("-o", "--output", help="Attitude and bias for each row (CSV, .gz).")],
    latitude_deg: LatitudeDeg = None,
    azimuth_deg: AzimuthDeg = None,
    azimuth_std_deg: AzimuthStdDeg = 0.1,
    rest: Rest = None,
    azimuth_policy: AzimuthPolicy = None,
    straight_hole: StraightHole = False,
    smooth: Smooth = False,
    by_hand: ByHand = False,
    arw: Arw = 0.1,
    rrw: Rrw = 0.1,
    bias_std: BiasStd = 20.0,
) -> None:
    """Follow the attitude by gyros and gravity. What the azimuth rests on is printed in words."""
    from highside.api.gyro import drift as follow

    names = ("azimuth_policy", "straight_hole", "smooth", "carried", "rest")
    with as_options(*names):
        done = follow(
            recording,
            method.value,
            latitude_deg=latitude_deg,
            azimuth_deg=azimuth_deg,
            azimuth_std_deg=azimuth_std_deg,
            rest=_intervals(rest),
            azimuth_policy=None if azimuth_policy is None else azimuth_policy.value,
            straight_hole=straight_hole,
            smooth=smooth,
            carried=by_hand,
            gyro_arw=arw,
            gyro_rrw=rrw,
            gyro_bias_std=bias_std,
        )
    done.data.write(output)
    echo(f"{done.data.n} rows, {method.value}; azimuth from {done.basis}", err=True)
    for note in done.notes:
        echo(f"note: {in_options(note)}", err=True)


def _intervals(text: str | None) -> list[tuple[float, float]]:
    """`0-420,1800-1920` as pairs of seconds."""
    import re

    if text is None:
        return []
    pairs = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*-\s*(\d+(?:\.\d*)?)\s*", part)
        if match is None or float(match[2]) <= float(match[1]):
            raise InputError(
                f"{part.strip()!r} is no interval", field="--rest", remedy="give begin-end in seconds: 0-420,1800-1920"
            )
        pairs.append((float(match[1]), float(match[2])))
    return pairs

"""What a certificate rests on, and how its numbers are written."""

from __future__ import annotations

import math
from dataclasses import dataclass

from highside.bench.photographs import Found
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord
from highside.config.certificate import CertificateFields
from highside.words import _, said_later

NOT_STATED = said_later("not stated")


@dataclass(frozen=True, slots=True)
class Inputs:
    """All that a certificate rests on. `previous`: the record in force before; `as_found_poses`, `as_left_poses`: poses
    measured for a verification; without them the poses of the calibration itself are used, and that is said.
    `photographs`: of the session, for the annex."""

    record: CalibrationRecord
    fields: CertificateFields
    issued_utc: str
    previous: CalibrationRecord | None = None
    as_found_poses: PoseSet | None = None
    as_left_poses: PoseSet | None = None
    photographs: tuple[Found, ...] = ()


def or_not_stated(text: str | None) -> str:
    """What was stated, or that nothing was."""
    return text or _(NOT_STATED)


def degrees(value: float) -> str:
    """An uncertainty in degrees with two significant digits."""
    if value <= 0 or not math.isfinite(value):
        return "0°" if value == 0 else "-"
    return f"{number(value)}°"


def number(value: float) -> str:
    if value == 0:
        return "0"
    digits = max(0, 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 7)}f}"


def signed(value: float) -> str:
    return "" if not math.isfinite(value) else f"{value:+.4f}"

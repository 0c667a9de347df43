"""What the pipeline gives: attitudes, and surveys of stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from highside.service.stillness import AxisScatter


class Azimuth(NamedTuple):
    """What an attitude says about the azimuth; None where it is not known, the basis then says why."""

    azi_deg: float | None
    azi_std_deg: float | None
    basis: tuple[str, ...]
    flags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AttitudeOutput:
    """One output of the pipeline; angles in degrees, accelerations in g, times in seconds.

    Not the message: `messages.AttitudeMessage` is the contract of the wire (null for what is not known, wall clock,
    sequence number), this the value that surveys, WITS and metrics take too, with NaN, the window's means and the
    `Azimuth` as one. What fields the message takes from it, its annotations say, and the writer is made from them.
    """

    t_device_s: float
    t_mono: float
    """arrival of the last byte of the last frame used, monotonic clock"""
    inc_deg: float
    inc_std_deg: float
    tf_deg: float
    tf_std_deg: float
    motor_toolface_deg: float
    """of the motor's bend: that of the sensor and the offset, in [0, 360)"""
    toolface_offset_deg: float
    g_total: float
    g_total_std: float
    """of the reading and of the correction, g"""
    cal_id: str
    zone: str
    flags: tuple[str, ...]
    n: int
    window_s: float
    temp_c: float | None
    azimuth: Azimuth | None = None
    """None for a tool without gyros"""
    comp_id: str | None = None
    """of the rotor-angle compensation in force; a flag says where it was not applied"""
    accel: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    """mean of the window, corrected, x, y and z of the tool in local g: for channels that follow from it"""


class SurveyReason(StrEnum):
    """Why a survey is refused."""

    MOVED = "moved"
    G_TOTAL_LOW = "g_total_low"
    G_TOTAL_HIGH = "g_total_high"
    TOO_COLD = "too_cold"
    TOO_HOT = "too_hot"
    TEMPERATURE_UNKNOWN = "temperature_unknown"
    SHOCK = "shock"
    UNCERTAIN = "uncertain"
    NO_CORRECTION = "no_correction"
    SENSOR_STUCK = "sensor_stuck"


@dataclass(frozen=True, slots=True)
class SurveyVerdict:
    """What was decided about a survey."""

    accepted: bool
    reasons: tuple[SurveyReason, ...]
    g_error_mg: float
    """Gtotal minus the expected one, mg; NaN where no correction holds"""
    g_std_mg: float
    """standard deviation of that difference, of survey, calibration and both gravities"""
    shock_g: float

    def as_dict(self) -> dict[str, Any]:
        """Members of the survey message and of the kept line."""
        return {
            "accepted": self.accepted,
            "reasons": [reason.value for reason in self.reasons],
            "g_error_mg": _finite(self.g_error_mg, 4),
            "g_error_std_mg": _finite(self.g_std_mg, 4),
            "shock_g": round(self.shock_g, 4),
        }


@dataclass(frozen=True, slots=True)
class Survey:
    """The average over a time without motion."""

    attitude: AttitudeOutput
    duration_s: float
    g_std: float
    """standard deviation of one reading, root mean square over the axes"""
    verdict: SurveyVerdict
    scatter: AxisScatter | None = None
    """what the axes scatter within it"""


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None

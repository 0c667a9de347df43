"""What the pipeline gives: attitudes, and surveys of stops."""

from __future__ import annotations

import math
from dataclasses import dataclass

from highside.service.drift_stage import Azimuth
from highside.service.rig.surveys import SurveyVerdict


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
    toolface_deg: float
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


@dataclass(frozen=True, slots=True)
class Survey:
    """The average over a time without motion."""

    attitude: AttitudeOutput
    duration_s: float
    g_std: float
    """standard deviation of one reading, root mean square over the axes"""
    verdict: SurveyVerdict

"""The azimuth of the hole: that of the sensors' package, freed of what the rotor angle adds to it."""

from __future__ import annotations

import math

from highside.rotation.live import LiveCompensation
from highside.service.drift_stage import DriftStage
from highside.service.outputs import Azimuth


def hole_azimuth(
    drift: DriftStage | None,
    rotation: LiveCompensation | None,
    rotor: tuple[float | None, float | None],
    t_s: float,
    inc_rad: float,
) -> Azimuth | None:
    """At the device time of an output; None for a tool without gyros. `rotor`: angle and rate (deg, deg/s) at the
    reading that the azimuth refers to; `inc_rad`: the inclination felt there."""
    azimuth = None if drift is None else drift.azimuth(t_s)
    if azimuth is None or azimuth.azi_deg is None or rotation is None or not rotation.corrects_heading:
        return azimuth
    error, own_std, doubts = rotation.heading(*rotor, inc_rad)
    std = azimuth.azi_std_deg
    return Azimuth(
        (azimuth.azi_deg - math.degrees(error)) % 360.0,
        None if std is None else math.hypot(std, math.degrees(own_std)),
        azimuth.basis,
        azimuth.flags + doubts,
    )

"""One way in for all methods: attitude, azimuth and gyro biases of a recording by the method that is named."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from highside.arrays import Array
from highside.gyro.complementary import complementary
from highside.gyro.filter import FilterSettings
from highside.gyro.gates import NO_REST_GATE, quiet_rows
from highside.gyro.literal import AzimuthPolicy, literal
from highside.gyro.recording_filter import error_state_filter
from highside.gyro.result import DriftResult

__all__ = ["METHODS", "STRAIGHT_HOLE_STD_DEG", "FollowOptions", "MethodName", "PolicyName", "columns_deg", "follow"]

MethodName = Literal["literal", "literal_block", "recursive", "kinematic", "none"]
PolicyName = Literal["gyro", "prev", "hold"]
METHODS: tuple[str, ...] = get_args(MethodName)
STRAIGHT_HOLE_STD_DEG = 0.1
"""How straight a hole is that is said to be so: standard deviation of its azimuth about that of the start, deg."""


@dataclass(frozen=True, slots=True)
class FollowOptions:
    """Options of a method beside its settings: when the tool was at rest, (K, 2) s; what is asserted of the azimuth."""

    rest: Array
    policy: PolicyName | None = None
    straight_hole: bool = False
    smooth: bool = False


def follow(
    method: MethodName, t_s: Array, rate: Array, accel: Array, settings: FilterSettings, options: FollowOptions
) -> DriftResult:
    """Follow the attitude of N rows: times (N,) s, rates (3, N) rad/s and accelerations (3, N) g in the tool frame."""
    rest = options.rest if options.rest.size else None
    if method == "kinematic":
        std = math.radians(STRAIGHT_HOLE_STD_DEG) if options.straight_hole else None
        own = replace(settings, straight_hole_std_rad=std)
        return error_state_filter(t_s, rate, accel, own, rest=rest, smooth=options.smooth)
    if method == "recursive":
        return complementary(t_s, rate, accel, settings, hold=options.straight_hole, rest=rest)
    quiet, still = quiet_rows(t_s, rate, accel, options.rest)
    result = literal(
        t_s,
        rate,
        accel,
        policy=AzimuthPolicy(options.policy) if options.policy else AzimuthPolicy.HOLD,
        quiet=quiet,
        azimuth_rad=settings.azimuth_rad or 0.0,
        average=method == "literal_block",
        correct=method != "none",
    )
    if method == "none":
        return result
    by = "by the gate on vibration" if rest is None else "within rest="
    note = f"gravity believed in {int(quiet.sum())} of {quiet.size} rows, {by}"
    if not quiet.any():
        note += ": nowhere is it quiet, so that the gyro alone carries the attitude and no drift is known"
    elif rest is None and still is None:
        note += NO_REST_GATE
    return replace(result, notes=(*result.notes, note))


def columns_deg(result: DriftResult) -> dict[str, Array]:
    """The columns of a result, (N,) each, in degrees and deg/s."""
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

"""Errors by the rotor angle out of the columns of a recording, and what a compensation leaves of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.rotation.compensation import Compensation
from highside.rotation.curve import ErrorCurve
from highside.rotation.direction import RotorMotion
from highside.rotation.recorded import UncompensatedRows, attitudes, azimuths
from highside.rotation.samples import Samples

__all__ = [
    "CHANNELS",
    "CompensatedColumns",
    "check_rotor",
    "compensated",
    "described",
    "motion_of",
    "samples_of",
    "shape_of",
    "warnings_of",
]

Columns = Mapping[str, Array]

CHANNELS = ("roll", "pitch", "heading", "inclination", "toolface")
LARGEST_ERROR_ARCMIN = 1800.0
"""An error of 30 degrees or more is none of an encoder or an axis: units or signs are wrong."""
LARGEST_STEP_DEG = 720.0
"""Two turns between two rows are none of a rotor that is sampled: counts of an encoder."""
FAR_STEP_DEG = 60.0
"""From row to row; a rotor that turns by more is sampled at fewer than six points a turn, too few for two harmonics."""
FAR_SHARE = 0.3
"""Share of such steps above which the rows are not in order or sampled too slowly; a few are gaps."""
LONG_RECORDING = 200
"""rows from which a table is of a turning rotor; a shorter one may step from pose to pose as it likes"""
FEW_ANGLES = 8
"""angles below which their range says nothing of their unit"""


def check_rotor(columns: Columns, where: str | None) -> None:
    """Raises InputError unless `rotor_deg` (N,) can be the degrees of one rotor in the order of `t_s` (N,) s."""
    angle = columns["rotor_deg"]
    known = angle[np.isfinite(angle)]
    if known.size >= FEW_ANGLES and float(np.abs(known).max()) <= 2.0 * np.pi * 1.001 and float(np.ptp(known)) > 1.0:
        raise InputError(
            f"no angle is beyond {np.abs(known).max():.2f}: these are radians",
            where=where,
            field="rotor_deg",
            remedy="give degrees",
        )
    steps = np.abs(np.diff(known))
    if steps.size and float(steps.max()) > LARGEST_STEP_DEG:
        raise InputError(
            f"jumps by {steps.max():.0f} between two rows: no degrees (counts of an encoder?)",
            where=where,
            field="rotor_deg",
            remedy="give degrees",
        )
    turned = np.abs(np.mod(np.diff(known) + 180.0, 360.0) - 180.0)
    if turned.size >= LONG_RECORDING and float(np.mean(turned > FAR_STEP_DEG)) > FAR_SHARE:
        raise InputError(
            f"many rows lie more than {FAR_STEP_DEG:g} deg from the row before: not in order, or sampled too slowly",
            where=where,
            field="rotor_deg",
            remedy="sort by time, or record faster",
        )


def samples_of(channel: str, columns: Columns, *, with_rate: bool, where: str | None) -> Samples:
    """The rows in which a channel's error (`d_CHANNEL_arcmin`) and the rotor angle are known. Raises InputError."""
    name = f"d_{channel}_arcmin"
    angle, error = columns["rotor_deg"], columns[name]
    rate = columns["rotor_rate_dps"] if with_rate else None
    rows = np.isfinite(angle) & np.isfinite(error)
    if rate is not None:
        rows &= np.isfinite(rate)
    worst = float(np.abs(error[rows]).max()) if rows.any() else 0.0
    if worst > LARGEST_ERROR_ARCMIN:
        raise InputError(
            f"{worst:g} is no small error", where=where, field=name, remedy="give decoded - true in arcmin"
        )
    try:
        return Samples.build(np.radians(angle[rows]), error[rows], None if rate is None else np.radians(rate[rows]))
    except InputError as problem:
        raise InputError(problem.what, where=where, field=name, remedy=problem.remedy) from None


def motion_of(columns: Columns) -> RotorMotion:
    """How the rotor moved, from the rows whose angle is known."""
    known = np.isfinite(columns["rotor_deg"])
    return RotorMotion.of(columns["t_s"][known], np.radians(columns["rotor_deg"][known]))


@dataclass(slots=True)
class CompensatedColumns:
    """Columns to add, each (N,), and what to say of them."""

    columns: dict[str, Array] = field(default_factory=dict)
    channels: dict[str, dict[str, float]] = field(default_factory=dict)
    """by channel the mean absolute error before and after, arcmin"""
    attitude: dict[str, dict[str, int]] = field(default_factory=dict)
    """by quantity (inc, tf, azi) the rows compensated, and why others were not"""

    def errors_off(self, compensation: Compensation, channel: str, samples: Samples, columns: Columns) -> None:
        """The error of one channel less the fitted one, in the rows where both are known."""
        curve = compensation.curves[channel]
        kept = np.isfinite(columns[f"d_{channel}_arcmin"]) & np.isfinite(columns["rotor_deg"])
        out = np.full(kept.size, np.nan)
        out[kept] = samples.error - curve(samples.theta_rad, samples.rate_radps)
        self.columns[f"d_{channel}_comp_arcmin"] = out
        self.channels[channel] = {
            "before_mean_abs_arcmin": float(np.mean(np.abs(samples.error))),
            "after_mean_abs_arcmin": float(np.mean(np.abs(out[kept]))),
        }

    def attitude_off(self, compensation: Compensation, columns: Columns) -> None:
        """Columns inc_comp_deg, tf_comp_deg, azi_comp_deg, and *_comp_std_deg where there is *_std_deg."""
        if "inc_deg" not in columns:
            return
        theta = np.radians(columns["rotor_deg"])
        rate = np.radians(columns["rotor_rate_dps"]) if "rotor_rate_dps" in columns else None
        inc = np.radians(columns["inc_deg"])
        if "tf_deg" in columns:
            both = attitudes(compensation, theta, rate, inc, np.radians(columns["tf_deg"]))
            if both is not None:
                self._add("inc", both.inc_rad, both.inc_std_rad, both.why, columns)
                self._add("tf", both.tf_rad, both.tf_std_rad, both.why, columns)
        if "azi_deg" in columns:
            one = azimuths(compensation, theta, rate, inc, np.radians(columns["azi_deg"]))
            if one is not None:
                self._add("azi", one.azi_rad, one.azi_std_rad, one.why, columns)

    def _add(self, name: str, values: Array, std: Array, why: UncompensatedRows, columns: Columns) -> None:
        self.columns[f"{name}_comp_deg"] = np.degrees(values)
        if f"{name}_std_deg" in columns:
            self.columns[f"{name}_comp_std_deg"] = np.hypot(columns[f"{name}_std_deg"], np.degrees(std))
        self.attitude[name] = {
            "compensated": int(np.isfinite(values).sum()),
            "rotor_unknown": int(why.unknown.sum()),
            "rotation_outside": int(why.outside.sum()),
            "rotation_gap": int(why.gap.sum()),
        }


def compensated(compensation: Compensation, samples: Mapping[str, Samples], columns: Columns) -> CompensatedColumns:
    """Take a compensation off the errors of these channels, and off the attitudes among the columns of N rows."""
    done = CompensatedColumns()
    for channel, known in samples.items():
        if channel in compensation.curves:
            done.errors_off(compensation, channel, known, columns)
    done.attitude_off(compensation, columns)
    return done


def warnings_of(compensation: Compensation, columns: Columns) -> list[str]:
    """A line if the recording was made far from the inclination of the fit, and one for each direction and range of
    rates in it that the fit never saw."""
    lines: list[str] = []
    validity = compensation.validity
    if validity.inclination_deg is not None and "inc_ref_deg" in columns:
        off = np.abs(columns["inc_ref_deg"] - validity.inclination_deg)
        beyond = int(np.sum(off > validity.within_deg))
        if beyond:
            lines.append(
                f"{beyond} of {off.size} rows lie up to {np.nanmax(off):.1f} deg from the inclination of"
                f" {validity.inclination_deg:g} deg at which the compensation was fitted: its coefficients change with"
                " attitude"
            )
    if compensation.motion is not None:
        lines += compensation.motion.unobserved(motion_of(columns))
    return lines


def shape_of(curve: ErrorCurve, theta_rad: Array) -> tuple[float, float]:
    """Half of a curve's range over rotor angles (N,), and its largest standard deviation there, arcmin."""
    rate = None if curve.rate is None else np.full(theta_rad.size, curve.rate.centre_radps)
    return float(np.ptp(curve(theta_rad, rate)) / 2.0), float(curve.std(theta_rad, rate).max())


def described(curve: ErrorCurve) -> dict[str, Any]:
    """What a reader wants to know of a curve, as plain values in arcmin."""
    half_range, std_worst = shape_of(curve, np.linspace(0.0, 2.0 * np.pi, 721))
    return {
        "method": curve.method.value,
        "order": curve.order,
        "noise_arcmin": curve.noise,
        "half_range_arcmin": half_range,
        "std_worst_arcmin": std_worst,
        "held_out_rms_arcmin": None if curve.held_out is None else curve.held_out.rms,
        "coverage": curve.coverage.to_dict(),
        "remarks": list(curve.remarks),
    }

"""A turntable's own errors: fitted beside a calibrated tool, or out of a recording's own gyros and accelerometers."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from highside.api.rotation import chart_of_curves
from highside.attitude.angles import wrap_signed
from highside.calibration.applied import corrected_accel
from highside.calibration.record import CalibrationRecord
from highside.errors import InputError, Refused
from highside.reading import read_bytes
from highside.recording.calibration_store import read_record
from highside.recording.frames import Columns, File, FrameT, source_of, take
from highside.recording.table import Recording, Table
from highside.rotation import Compensation, Validity
from highside.rotation.recording import shape_of
from highside.rotation.self_reference import ErrorPart, GyroDoubt, SelfErrors, self_errors
from highside.rotation.self_turntable import self_turntable
from highside.rotation.turntable import TurntableCurve
from highside.rotation.turntable import fit_turntable as fit_curves
from highside.shown.card import card
from highside.shown.plot import Plot

__all__ = ["SelfFit", "TurntableFit", "fit_self", "fit_turntable"]


LARGEST_ERROR_DEG = 1.0
"""A tool that reads so far from the bench is in motion or in another fixture: turntables are good to arcminutes."""
FEWEST_ROWS = 8
"""rows with angle and readings below which nothing is fitted"""
TURN_RAD = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)


@dataclass(frozen=True, slots=True)
class TurntableFit:
    """Errors of a bench's encoder and axis, good at every inclination."""

    compensation: Compensation
    curve: TurntableCurve
    rows: int
    """that were used"""

    @property
    def noise_arcmin(self) -> dict[str, float]:
        """Standard deviation of one row about the curves, by quantity."""
        return {
            "toolface_arcmin": float(np.degrees(self.curve.noise_rad) * 60.0),
            "inclination_arcmin": float(np.degrees(self.curve.along_noise_rad) * 60.0),
        }

    def harmonics_arcmin(self) -> dict[str, list[float]]:
        """By channel the amplitude of each harmonic, the first first."""
        return {
            name: np.hypot(curve.parameters[1::2], curve.parameters[2::2]).tolist()
            for name, curve in self.compensation.curves.items()
        }

    def _repr_html_(self) -> str:
        """What a notebook shows: the harmonics of each channel."""
        rows = [[name, ", ".join(f"{size:.3g}" for size in sizes)] for name, sizes in self.harmonics_arcmin().items()]
        noise = ", ".join(f"{name.removesuffix('_arcmin')} {size:.3g}" for name, size in self.noise_arcmin.items())
        title = f"Errors of a turntable, fitted to {self.rows} rows"
        return card(["channel", "harmonics, arcmin"], rows, f"noise of a row, arcmin: {noise}", title=title)

    def plot(self) -> Plot:
        """The curves with their standard deviation over a turn, arcmin."""
        return chart_of_curves(self.compensation.curves)


def fit_turntable(recording: File | Columns | FrameT, *, largest_order: int = 8) -> TurntableFit:
    """Fit a bench's encoder and axis errors beside a calibrated tool.

    `recording` (a file, DataFrame, dict of arrays or table of N rows) of turns at two inclinations or more needs
    `inc_ref_deg, tf_ref_deg` of the bench and `inc_deg, tf_deg` of the tool (see `Calibration.correct`), and
    `rotor_deg` where that is not `tf_ref_deg`. `largest_order`: the highest harmonic that is looked for. Raises
    InputError for rows that are not in order or too far from the bench, Refused where nothing can be fitted.
    """
    table = take(recording, Table).table
    where = table.source
    inc_ref, tf_ref, inc, tf = table.require("inc_ref_deg", "tf_ref_deg", "inc_deg", "tf_deg")
    angle = table.columns.get("rotor_deg", tf_ref)
    rows = np.isfinite(np.vstack([inc_ref, tf_ref, inc, tf, angle])).all(axis=0)
    d_tf = np.radians(tf[rows] - tf_ref[rows])
    # about the toolface zero, which may be anything
    zero = float(np.angle(np.exp(1j * d_tf).mean())) if d_tf.size else 0.0
    d_tf = zero + np.asarray(wrap_signed(d_tf - zero))
    d_inc = np.radians(inc[rows] - inc_ref[rows])
    for name, off in (("tf_deg", d_tf - zero), ("inc_deg", d_inc)):
        worst = float(np.degrees(np.abs(off).max())) if off.size else 0.0
        if worst > LARGEST_ERROR_DEG:
            raise InputError(
                f"{worst:.2f} deg from the bench in a row: no error of a turntable",
                where=where,
                field=name,
                remedy="omit rows in motion and rows of another fixture",
            )
    try:
        found = fit_curves(np.radians(angle[rows]), np.radians(inc_ref[rows]), d_tf, d_inc, largest_order)
    except InputError as problem:
        raise InputError(problem.what, where=where, remedy=problem.remedy) from None
    return TurntableFit(found.compensation(*source_of(recording, table)), found, int(rows.sum()))


@dataclass(frozen=True, slots=True)
class SelfFit:
    """A compensation out of recordings without an outside reference, and what is to be said of it."""

    compensation: Compensation
    inclinations_deg: list[float]
    """the mean of each recording"""
    turns: float
    """of all recordings"""
    remarks: tuple[str, ...]
    """of the fit as a whole"""
    sentences: tuple[str, ...]
    """these and what the curves say of themselves, each once"""

    def described(self) -> dict[str, dict[str, Any]]:
        """By channel order, amplitude and uncertainty of the curve as plain values, arcmin."""
        described = {}
        for name, curve in self.compensation.curves.items():
            half_range, std_worst = shape_of(curve, TURN_RAD)
            described[name] = {
                "order": curve.order,
                "half_range_arcmin": half_range,
                "std_worst_arcmin": std_worst,
                "held_out_rms_arcmin": None if curve.held_out is None else curve.held_out.rms,
                "remarks": list(curve.remarks),
            }
        return described

    def _repr_html_(self) -> str:
        """What a notebook shows: the curve of each channel, and what is to be said of it."""
        rows = [
            [name, str(one["order"]), f"{one['half_range_arcmin']:.3f}", f"{one['std_worst_arcmin']:.3f}"]
            for name, one in self.described().items()
        ]
        title = f"Errors by the rotor angle without a reference, {self.turns:.1f} turns"
        header = ["channel", "order", "half range, arcmin", "largest std, arcmin"]
        return card(header, rows, *self.sentences, title=title)

    def plot(self) -> Plot:
        """The curves with their standard deviation over a turn, arcmin."""
        return chart_of_curves(self.compensation.curves)


def fit_self(
    recordings: Sequence[File | Columns | FrameT],
    *,
    of: Literal["decoded", "sensor", "rotor"] = "decoded",
    calibration: CalibrationRecord | File | None = None,
    gyro_bias_dph: float = 10.0,
    gyro_misalignment_arcmin: float = 1.0,
) -> SelfFit:
    """Fit errors of I and T against the rotor angle with the recordings' own gyros and accelerometers as reference.

    Each of `recordings` (files, DataFrames, dicts of arrays or Recordings) is of a turning rotor and needs `t_s` in s,
    `rotor_deg`, `ax_g, ay_g, az_g` in g and, if the tool has gyros, `gx_dps, ...`. One gives a compensation good at its
    inclination, several at different inclinations one of encoder and axis, good at all. `of`: "decoded" (I and T
    against the encoder's), "sensor" (against the gyros' prediction), "rotor" (that prediction against the encoder's).
    `calibration` corrects the readings first. `gyro_bias_dph` and `gyro_misalignment_arcmin`: what is not known of the
    gyros' bias and of their alignment with the accelerometers. Raises InputError and Refused.
    """
    for name, value in (("gyro_bias_dph", gyro_bias_dph), ("gyro_misalignment_arcmin", gyro_misalignment_arcmin)):
        if not value >= 0.0:
            raise InputError("must not be negative", field=name)
    doubt = GyroDoubt(math.radians(gyro_bias_dph / 3600.0), math.radians(gyro_misalignment_arcmin / 60.0))
    tables = []
    found = []
    for recording in recordings:
        tables.append(take(recording, Recording).table)
        found.append(_errors(tables[-1], of, calibration))
    inclinations = [math.degrees(one.mean_inclination_rad) for one in found]
    names = [source_of(one, table)[0] for one, table in zip(recordings, tables, strict=True)]
    remarks: list[str] = []
    if len(found) == 1:
        curves = found[0].curves(doubt)
        validity = Validity(inclination_deg=inclinations[0])
    else:
        curves = self_turntable(found, doubt)
        validity = Validity()
        if of == "decoded" and calibration is None:
            remarks.append("the accelerometers' own errors pass for the turntable's: give calibration= or of='rotor'")
    made = Compensation(curves, validity, " ".join(names), _digest(recordings, tables))
    headline = dict.fromkeys([*remarks, *(remark for curve in curves.values() for remark in curve.remarks)])
    return SelfFit(made, inclinations, sum(one.turns for one in found), tuple(remarks), tuple(headline))


def _digest(recordings: Sequence[object], tables: Sequence[Table]) -> str:
    """SHA-256 of all files one after the other; of tables in memory of the CSV that they would be."""
    whole = hashlib.sha256()
    for given, table in zip(recordings, tables, strict=True):
        whole.update(read_bytes(Path(given)) if isinstance(given, str | os.PathLike) else table.as_csv().encode())
    return whole.hexdigest()


def _errors(table: Recording, of: str, calibration: CalibrationRecord | File | None) -> SelfErrors:
    """What one recording tells of itself."""
    where = table.source or "recording"
    angle, *accel = table.require("rotor_deg", "ax_g", "ay_g", "az_g")
    gyros = ("gx_dps", "gy_dps", "gz_dps")
    rates = np.radians(np.vstack(table.require(*gyros))) if table.has(*gyros) else None
    a = np.vstack(accel)
    if calibration is not None:
        known = calibration if isinstance(calibration, CalibrationRecord) else read_record(Path(calibration))
        file = None if isinstance(calibration, CalibrationRecord) else str(calibration)
        a = corrected_accel(known, a, table.columns.get("temp_c"), where=file, columns=table.columns)
    t_s = table.t_s
    if np.any(np.diff(t_s) <= 0.0):
        raise InputError("time stands or goes back", where=where, field="t_s", remedy="sort the rows by time")
    rows = np.isfinite(np.vstack([a, angle, *([] if rates is None else [rates])])).all(axis=0)
    if int(rows.sum()) < FEWEST_ROWS:
        raise Refused(f"{where}: {int(rows.sum())} rows in which rotor angle and readings are all known")
    try:
        return self_errors(
            t_s[rows], a[:, rows], None if rates is None else rates[:, rows], np.radians(angle[rows]), ErrorPart(of)
        )
    except Refused as problem:
        raise Refused(f"{where}: {problem}") from None

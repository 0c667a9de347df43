"""Rotation: errors that repeat with the rotor angle are fitted, taken off, and the methods compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypedDict, TypeVar, Unpack, overload

import numpy as np

from highside.api.bench import load_compensation
from highside.api.recording import Recording
from highside.arrays import Array
from highside.errors import InputError
from highside.recording.frames import Columns, File, FrameT, source_of, take
from highside.recording.table import Recording as Rows
from highside.rotation import Compensation, CurveMethod, ErrorCurve, FitOptions, NetworkInput, Samples, Validity, fit
from highside.rotation.compare import CurveComparison
from highside.rotation.compare import compare as compare_methods
from highside.rotation.direction import DirectionDifference, direction_difference
from highside.rotation.recording import (
    CHANNELS,
    CompensatedColumns,
    check_rotor,
    compensated,
    described,
    motion_of,
    samples_of,
    warnings_of,
)
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

__all__ = [
    "ComparedRotation",
    "CompensatedRecording",
    "FitOfRotation",
    "compare_rotation",
    "compensate",
    "fit_rotation",
]

DataT = TypeVar("DataT")
CURVE_POINTS = 1200
"""of a fitted curve, and of the rows drawn over it"""
MethodName = Literal["sine", "harmonics2", "polynomial9", "network", "auto"]


@dataclass(frozen=True, slots=True)
class FitOfRotation:
    """A compensation, and by channel what it was fitted to and whether the error differs by the direction of turn."""

    compensation: Compensation
    samples: dict[str, Samples]
    direction: dict[str, DirectionDifference | None]
    rows: int
    """of the recording"""

    def described(self) -> dict[str, dict[str, Any]]:
        """By channel order, noise, amplitude and coverage of the curve as plain values, arcmin."""
        return {
            name: described(curve) | {"direction": None if (found := self.direction[name]) is None else found.to_dict()}
            for name, curve in self.compensation.curves.items()
        }

    def _repr_html_(self) -> str:
        """What a notebook shows: the curve of each channel, and what must be reported."""
        names = {"order": "order", "half_range_arcmin": "half range, arcmin", "noise_arcmin": "noise of a row, arcmin"}
        found = self.described()
        rows = [[channel, *(_word(one.get(name)) for name in names)] for channel, one in found.items()]
        remarks = (f"{channel}: {sentence}" for channel, sentence in self.remarks())
        title = f"Errors by the rotor angle, fitted to {self.rows} rows"
        return card(["channel", *names.values()], rows, *remarks, title=title)

    def plot(self) -> Plot:
        """The rows and the fitted curves with their standard deviation over a turn, arcmin."""
        return chart_of_curves(self.compensation.curves, self.samples)

    def remarks(self) -> list[tuple[str, str]]:
        """(channel, sentence) of what must be reported."""
        lines: list[tuple[str, str]] = []
        for name, curve in self.compensation.curves.items():
            found = self.direction[name]
            lines += [(name, remark) for remark in curve.remarks]
            lines += [(name, found.sentence)] if found is not None and found.found else []
        return lines


class FitArguments(TypedDict, total=False):
    """How an error is fitted against the rotor angle."""

    method: MethodName
    rate_terms: int
    network_input: Literal["scaled", "periodic"]
    seed: int
    inclination_deg: float | None
    roll_deg: float | None
    pitch_deg: float | None


def fit_rotation(
    recording: File | Columns | FrameT,
    *,
    method: MethodName = "auto",
    rate_terms: int = 0,
    network_input: Literal["scaled", "periodic"] = "scaled",
    seed: int = 0,
    inclination_deg: float | None = None,
    roll_deg: float | None = None,
    pitch_deg: float | None = None,
) -> FitOfRotation:
    """Fit each error of a recording against the rotor angle.

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows) needs `t_s` in s, `rotor_deg`, and any of
    `d_roll_arcmin, d_pitch_arcmin, d_heading_arcmin, d_inclination_arcmin, d_toolface_arcmin` (decoded - true).
    `method`: "sine", "harmonics2", "polynomial9", "network" or "auto" (a Fourier series that chooses its own order).
    `rate_terms`: powers of `rotor_rate_dps`, 0 to 2 (polynomial9, auto); `network_input` and `seed` are the network's.
    `inclination_deg`, `roll_deg`, `pitch_deg`: the attitude at which it was recorded. Raises InputError for a recording
    that is not in order, Refused where nothing can be fitted.
    """
    table = read_rotation(recording)
    options = FitOptions(rate_terms, NetworkInput(network_input), seed)
    samples = _samples(table, with_rate=rate_terms > 0)
    curves = {channel: fit(one, CurveMethod(method), options) for channel, one in samples.items()}
    name, digest = source_of(recording, table)
    validity = Validity(inclination_deg, roll_deg, pitch_deg)
    made = Compensation(curves, validity, name, digest, motion_of(table.columns))
    by_direction = {channel: direction_difference(samples[channel], curve) for channel, curve in curves.items()}
    return FitOfRotation(made, samples, by_direction, table.n)


@dataclass(frozen=True, slots=True)
class CompensatedRecording(Generic[DataT]):
    """N rows with the fitted errors taken off."""

    data: DataT
    """In the kind that came in, with `d_roll_comp_arcmin, ...` = measured - fitted, and of attitudes
    `inc_comp_deg, tf_comp_deg, azi_comp_deg` (with `*_comp_std_deg`)"""
    compensation: Compensation
    done: CompensatedColumns
    """by channel the mean absolute error before and after; by quantity the rows compensated and why others were not"""
    warnings: tuple[str, ...]
    """where the recording lies beyond what the compensation was fitted to"""

    def _repr_html_(self) -> str:
        """What a notebook shows: each channel before and after."""
        rows = [
            [channel, f"{one['before_mean_abs_arcmin']:.4f}", f"{one['after_mean_abs_arcmin']:.4f}"]
            for channel, one in self.done.channels.items()
        ]
        rows += [[name, "", f"{counts['compensated']} rows"] for name, counts in self.done.attitude.items()]
        headline = f"Compensated by {self.compensation.id[:12]}"
        return card(["channel", "mean |error| before, arcmin", "after"], rows, *self.warnings, title=headline)

    def plot(self) -> Plot:
        """The fitted curves with their standard deviation over a turn, arcmin."""
        return chart_of_curves(self.compensation.curves)


@overload
def compensate(
    recording: File, by: Compensation | File | None = ..., **fitted: Unpack[FitArguments]
) -> CompensatedRecording[Recording]: ...
@overload
def compensate(
    recording: Columns, by: Compensation | File | None = ..., **fitted: Unpack[FitArguments]
) -> CompensatedRecording[dict[str, Array]]: ...
@overload
def compensate(
    recording: FrameT, by: Compensation | File | None = ..., **fitted: Unpack[FitArguments]
) -> CompensatedRecording[FrameT]: ...
def compensate(
    recording: Any, by: Compensation | File | None = None, **fitted: Unpack[FitArguments]
) -> CompensatedRecording[Any]:
    """Take errors that repeat with the rotor angle off, of errors and of attitudes as the live service does.

    `recording` (a file, DataFrame, dict of arrays or Recording of N rows) needs `t_s` in s, `rotor_deg`, and errors
    `d_roll_arcmin, ...` (see `fit_rotation`) or attitudes: `inc_deg` with `tf_deg` (of `Calibration.correct`) or
    `azi_deg` (of `drift`). `by`: the compensation (or its file) of another recording; without it the errors of this one
    are fitted first, as `fit_rotation` with the further arguments. Raises InputError for a recording that is not in
    order or has nothing that the compensation is for.
    """
    if by is not None and fitted:
        raise InputError("has no meaning with a compensation that is fitted", field=next(iter(fitted)))
    given = None if by is None else load_compensation(by)
    taken = take(recording, Rows)
    table = _checked(taken.table)
    known = given or fit_rotation(table, **fitted).compensation
    has_errors = any(table.has(f"d_{channel}_arcmin") for channel in CHANNELS)
    with_rate = any(curve.rate is not None for curve in known.curves.values())
    has_attitude = table.has("inc_deg") and bool(compensated(known, {}, table.columns).columns)
    samples = _samples(table, with_rate=with_rate) if has_errors or not has_attitude else {}
    done = compensated(known, samples, table.columns)
    if not done.columns:
        raise InputError(
            f"has none of the errors this compensation is for ({', '.join(known.curves)})",
            where=table.source,
            remedy=f"give {' or '.join(f'd_{name}_arcmin' for name in known.curves)}, or inc_deg with tf_deg or"
            " azi_deg",
        )
    warnings = tuple(warnings_of(known, table.columns))
    return CompensatedRecording(taken.with_columns(done.columns), known, done, warnings)


class ComparedRotation(dict[str, tuple[Samples, CurveComparison, DirectionDifference | None]]):
    """By channel the rows, a score a method (or why it was refused), and whether the error differs by direction."""

    def _repr_html_(self) -> str:
        """What a notebook shows: what each method leaves of each channel."""
        rows = [
            [
                channel,
                method.value,
                f"{score.mean_abs:.4f}",
                f"{score.std:.4f}",
                "" if held is None else f"{held.rms:.4f}",
            ]
            for channel, (_, comparison, _) in self.items()
            for method, score in comparison.scores.items()
            for held in (score.curve.held_out,)
        ]
        refused = (
            f"{channel}, {method.value}: {why}"
            for channel, (_, comparison, _) in self.items()
            for method, why in comparison.refused.items()
        )
        header = ["channel", "method", "mean |left|, arcmin", "std", "rms of turns not used"]
        return card(header, rows, *refused)

    def plot(self) -> Plot:
        """What each method leaves of each channel, mean absolute error in arcmin."""
        panels = []
        for channel, (_, comparison, _) in self.items():
            left = np.array([score.mean_abs for score in comparison.scores.values()])
            names = tuple(method.value for method in comparison.scores)
            line = PlotLine("mean |left|", left, look="points")
            panels.append(PlotPanel(np.arange(left.size, dtype=float), (line,), "", f"{channel}, arcmin", names=names))
        return Plot("What the methods leave", tuple(panels))


def compare_rotation(
    recording: File | Columns | FrameT,
    *,
    rate_terms: int = 0,
    network_input: Literal["scaled", "periodic"] = "scaled",
    seed: int = 0,
) -> ComparedRotation:
    """Fit all methods to the same rows of each error `d_roll_arcmin, ...` of a recording over its `rotor_deg`.

    Arguments as those of `fit_rotation`: `recording`, `rate_terms`, `network_input`, `seed`. By channel the rows, a
    score a method (what it leaves of these rows and of whole turns it did not use, arcmin; or why it was refused), and
    whether the error differs by the direction of turn (None: one direction only). Raises InputError for a recording
    that is not in order.
    """
    table = read_rotation(recording)
    options = FitOptions(rate_terms, NetworkInput(network_input), seed)
    found = ComparedRotation()
    for channel, samples in _samples(table, with_rate=rate_terms > 0).items():
        comparison = compare_methods(samples, options=options)
        best = comparison.scores.get(CurveMethod.AUTO) or next(iter(comparison.scores.values()), None)
        found[channel] = samples, comparison, None if best is None else direction_difference(samples, best.curve)
    return found


def read_rotation(recording: Any) -> Rows:
    """A recording of a rotor, its angles checked to be degrees of one rotor in time order. Raises InputError."""
    return _checked(take(recording, Rows).table)


def _checked(table: Rows) -> Rows:
    table.require("rotor_deg")
    back = np.flatnonzero(np.diff(table.t_s) < 0)
    if back.size:
        raise InputError(
            "time goes back", where=table.place(int(back[0]) + 1), field="t_s", remedy="sort the rows by time"
        )
    check_rotor(table.columns, table.source)
    return table


def _samples(table: Rows, *, with_rate: bool) -> dict[str, Samples]:
    """The errors that the recording has, each with the rows in which it and the angle are known."""
    present = [channel for channel in CHANNELS if table.has(f"d_{channel}_arcmin")]
    if not present:
        raise InputError(
            f"has none of {', '.join(f'd_{channel}_arcmin' for channel in CHANNELS)}",
            where=table.source,
            remedy=f"it has: {', '.join(table.order)}",
        )
    table.require("rotor_deg", *(f"d_{channel}_arcmin" for channel in present))
    if with_rate:
        table.require("rotor_rate_dps")
    return {c: samples_of(c, table.columns, with_rate=with_rate, where=table.source) for c in present}


def chart_of_curves(curves: Mapping[str, ErrorCurve], samples: Mapping[str, Samples] | None = None) -> Plot:
    """Fitted curves with their standard deviation over a turn, a panel a channel; over them the rows, thinned."""
    theta = np.linspace(0.0, 2.0 * np.pi, CURVE_POINTS)
    panels = []
    for name, curve in curves.items():
        along, error = theta, None
        if samples is not None:
            rows = samples[name]
            some = np.linspace(0, rows.error.size - 1, min(rows.error.size, CURVE_POINTS)).astype(int)
            # the curve is drawn at the angles of the rows: a panel has one axis for all its lines
            turned = np.mod(rows.theta_rad[some], 2.0 * np.pi)
            order = np.argsort(turned)
            along, error = turned[order], rows.error[some][order]
        rate = None if curve.rate is None else np.full(along.size, curve.rate.centre_radps)
        lines = [PlotLine("fitted", curve(along, rate), curve.std(along, rate))]
        if error is not None:
            lines.insert(0, PlotLine("measured", error, look="points", colour="#808890"))
        panels.append(PlotPanel(np.degrees(along), tuple(lines), "rotor angle, deg", f"{name}, arcmin"))
    return Plot("Error over the rotor angle", tuple(panels))


def _word(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value if value is not None else "")

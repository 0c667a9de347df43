"""Figures of a diagnosis: residuals before and after, where the mismatch sits, of recordings and of error tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.engine import Picture
from highside.diagnosis.result import Location
from highside.diagnosis.summary import SummaryPicture
from highside.diagnosis.summary_chain import CELLS
from highside.report.diagnosis_words import AXIS_NAMES
from highside.report.page import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BEFORE, AFTER, SHADE = "#d9822b", "#2f7fd1", "#808890"
MANY = 3000
"""More points than this are drawn as a sample, with the means of bins over them."""
BINS = 60
TOLD = {
    "d_inc_mean_deg": "inclination, mean",
    "d_inc_pp_deg": "inclination, peak-to-peak",
    "d_tf_mean_deg": "toolface, mean",
    "d_tf_pp_deg": "toolface, peak-to-peak",
}


def residuals(picture: Picture, location: Location) -> Figure:
    """One panel a channel: residuals over the covariate of a location, the location shaded."""
    along, label = _along(picture, location.covariate)
    names = [name for name in location.channels if name in picture.channels] or list(picture.channels)
    figure, axes = new_figure(1, len(names))
    for axis, name in zip(axes[0], names, strict=True):
        channel = picture.channels.index(name)
        size, unit = (1e6, "ug") if name in ("ax", "ay", "az", "g_total") else (1.0, "")
        if name in ("gx", "gy", "gz"):
            size, unit = float(np.degrees(1)), "deg/s"
        if picture.units:
            size, unit = 1.0, picture.units[channel]
        _shade(axis, along, location.intervals)
        drawn = [(picture.before, BEFORE, "before"), (picture.after, AFTER, "after")]
        if np.array_equal(picture.before, picture.after):
            drawn = [(picture.before, AFTER, "residual")]
        for values, colour, word in drawn:
            _points(axis, along, size * values[channel], colour, word)
        axis.axhline(0, color=SHADE, linewidth=0.8)
        axis.set(xlabel=label, ylabel=f"residual, {unit}".rstrip(", "), title=name)
        axis.legend()
    return figure


def _shade(axis: Axes, along: Array, intervals: Sequence[tuple[float, float]]) -> None:
    pad = 0.01 * float(np.ptp(along) or 1.0)
    whole = intervals and intervals[0][0] <= np.min(along) and intervals[-1][1] >= np.max(along) and len(intervals) == 1
    for low, high in () if whole else intervals:
        axis.axvspan(low - pad, high + pad, color=SHADE, alpha=0.18, linewidth=0)


def _points(axis: Axes, along: Array, values: Array, colour: str, word: str) -> None:
    if along.size <= MANY:
        axis.plot(along, values, ".", color=colour, label=word, markersize=4)
        return
    # a picture of every row would be megabytes: a sample, and what the rows of a bin have in common
    some = np.linspace(0, along.size - 1, MANY // 2).astype(int)
    axis.plot(along[some], values[some], ".", color=colour, alpha=0.15, markersize=2)
    edges = np.linspace(along.min(), along.max(), BINS + 1)
    which = np.clip(np.digitize(along, edges) - 1, 0, BINS - 1)
    count = np.bincount(which, minlength=BINS)
    mean = np.bincount(which, values, BINS) / np.maximum(count, 1)
    middle = (edges[:-1] + edges[1:]) / 2
    axis.plot(middle[count > 0], mean[count > 0], "-", color=colour, label=f"{word} (mean of a bin)")


def _along(picture: Picture, covariate: str) -> tuple[Array, str]:
    if covariate in picture.covariates:
        return picture.covariates[covariate], AXIS_NAMES.get(covariate, covariate)
    state = picture.session.state
    columns = {
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "inc_ref_deg": np.degrees(state.inc_rad),
        "temp_c": state.temp_c,
        "t_s": state.t_s,
        "direction": state.direction,
        "vibration_rms_g": state.vibration_rms_g,
        "rotor_rate_dps": np.degrees(state.rotor_rate_radps),
    }
    parts = covariate.split(" x ")
    varying = [name for name in (*parts[::-1], "inc_ref_deg", "tf_ref_deg", "t_s") if name in columns]
    if covariate.startswith("temp_c"):
        varying.insert(0, "temp_c")
    name = next((name for name in varying if np.ptp(columns[name]) > 0), "t_s")
    return np.asarray(columns[name], dtype=float), AXIS_NAMES[name]


def table_misfit(picture: SummaryPicture, places: Sequence[Location]) -> Figure:
    """Misfit of each column in sigma over the rows, before and after; shaded where a claim sits."""
    figure, axes = new_figure(2, 2, height=2.6)
    rows = np.argsort(picture.inc_deg)
    at = np.arange(rows.size)
    for column, axis in enumerate(np.ravel(np.array(axes, dtype=object))):
        shaded = np.zeros(rows.size, dtype=bool)
        for place in places:
            if CELLS[column] in place.channels:
                for low, high in place.intervals:
                    inc = picture.inc_deg[rows]
                    shaded |= (inc >= low - 1e-6) & (inc <= high + 1e-6)
        for k in np.flatnonzero(shaded):
            axis.axvspan(k - 0.5, k + 0.5, color=SHADE, alpha=0.14, linewidth=0)
        axis.axhspan(-1, 1, color=SHADE, alpha=0.12, linewidth=0)
        axis.plot(at, picture.before[rows, column], "o", color=BEFORE, label="before", markersize=4)
        axis.plot(at, picture.after[rows, column], "o", color=AFTER, label="after", markersize=4)
        axis.set_xticks(at, [f"{value:g}" for value in picture.inc_deg[rows]], rotation=60)
        axis.set(ylabel="misfit, sigma", title=TOLD[CELLS[column]])
        if column == 0:
            axis.legend()
    return figure


def table_values(picture: SummaryPicture) -> Figure:
    """What the table says beside what the simulated chain says, deg."""
    figure, axes = new_figure(2, 2, height=2.6)
    rows = np.argsort(picture.inc_deg)
    at = np.arange(rows.size)
    for column, axis in enumerate(np.ravel(np.array(axes, dtype=object))):
        axis.errorbar(
            at, picture.told[rows, column], picture.sigma[rows, column], fmt="o", color=SHADE, markersize=4,
            label="the table, with sigma",
        )  # fmt: skip
        axis.plot(at, picture.base[rows, column], "-", color=BEFORE, label="simulated before")
        axis.plot(at, picture.fitted[rows, column], "-", color=AFTER, label="simulated after")
        axis.set_xticks(at, [f"{value:g}" for value in picture.inc_deg[rows]], rotation=60)
        axis.set(ylabel="deg", title=TOLD[CELLS[column]])
        if column == 0:
            axis.legend()
    return figure

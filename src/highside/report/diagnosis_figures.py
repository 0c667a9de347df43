"""Figures of a diagnosis: residuals before and after, where the mismatch sits, of recordings and of error tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
Ints = NDArray[np.intp]

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


def residuals(picture: Picture, location: Location) -> list[Figure]:
    """One figure a channel: residuals over the covariate of a location, the location shaded.

    What turns with the load cancels in the mean over a covariate that only drives its size: then the rms is drawn.
    """
    along, label = _along(picture, location.covariate)
    names = [name for name in location.channels if name in picture.channels] or list(picture.channels)
    figures = []
    for name in names:
        figure, axes = new_figure(1, 1, width=max(10.5 / len(names), 3.5), height=3.0)
        figures.append(figure)
        axis = axes[0][0]
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
        how = _mean if _cancels_not(along, picture.before[channel], picture.after[channel]) else _rms
        for values, colour, word in drawn:
            _points(axis, along, size * values[channel], colour, word, how)
        axis.axhline(0, color=SHADE, linewidth=0.8)
        axis.set(xlabel=label, ylabel=f"residual, {unit}".rstrip(", "), title=name)
        axis.legend()
    return figures


def _mean(values: Array, which: Ints, count: Ints) -> Array:
    return np.asarray(np.bincount(which, values, count.size) / np.maximum(count, 1))


def _rms(values: Array, which: Ints, count: Ints) -> Array:
    return np.asarray(np.sqrt(np.bincount(which, values**2, count.size) / np.maximum(count, 1)))


def _binned(along: Array) -> tuple[Ints, Ints, Array]:
    """Bin of each row, rows of each bin, middle of each bin: settings where there are few."""
    settings = np.unique(np.round(along, 3))
    if settings.size <= BINS:
        which = np.searchsorted(settings, np.round(along, 3))
        return which, np.bincount(which, minlength=settings.size), settings
    edges = np.linspace(along.min(), along.max(), BINS + 1)
    which = np.clip(np.digitize(along, edges) - 1, 0, BINS - 1)
    return which, np.bincount(which, minlength=BINS), (edges[:-1] + edges[1:]) / 2


def _cancels_not(along: Array, before: Array, after: Array) -> bool:
    """Whether the means over bins show a third at least of what was explained."""
    which, count, _ = _binned(along)
    removed = float(np.mean(before**2) - np.mean(after**2))
    shown = float(np.sum(count * (_mean(before, which, count) ** 2 - _mean(after, which, count) ** 2)) / before.size)
    return removed <= 0.0 or shown > removed / 3


def _shade(axis: Axes, along: Array, intervals: Sequence[tuple[float, float]]) -> None:
    pad = 0.01 * float(np.ptp(along) or 1.0)
    whole = intervals and intervals[0][0] <= np.min(along) and intervals[-1][1] >= np.max(along) and len(intervals) == 1
    for low, high in () if whole else intervals:
        axis.axvspan(low - pad, high + pad, color=SHADE, alpha=0.18, linewidth=0)


def _points(
    axis: Axes, along: Array, values: Array, colour: str, word: str, how: Callable[[Array, Ints, Ints], Array]
) -> None:
    """The points, and over them what those of a bin have in common; of many points a sample."""
    some = np.linspace(0, along.size - 1, min(along.size, MANY // 2)).astype(int)
    few = along.size <= MANY
    alpha, size = (0.55, 4) if few else (0.15, 2)
    # thousands of points are a picture of their own: as elements of the page they take seconds to write and to show
    axis.plot(along[some], values[some], ".", color=colour, alpha=alpha, markersize=size, rasterized=not few)
    which, count, middle = _binned(along)
    told = "mean" if how is _mean else "rms"
    shows = count > (0 if few else 1)
    axis.plot(middle[shows], how(values, which, count)[shows], "-", color=colour, label=f"{word} ({told})")


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
    # the intervals of a product are told along its first covariate, but for a side of approach
    parts = [part.removesuffix("^2") for part in covariate.split(" x ")]
    if parts[0] == "direction" and len(parts) > 1:
        parts = parts[1:]
    varying = [name for name in (*parts[:1], "inc_ref_deg", "tf_ref_deg", "t_s") if name in columns]
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

"""Figures of a diagnosis: what each effect does with all others taken off, and what is left; of recordings and of error
tables. What is left has axes of its own in units of the noise: at the scale of an effect it would be a flat line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.result import Curve, Location
from highside.diagnosis.engine import ReportData
from highside.diagnosis.table.chain import CELLS
from highside.diagnosis.table.engine import SummaryReportData
from highside.physics.covariates import COVARIATES
from highside.physics.covariates import covariate as covariate_of
from highside.physics.gravity import gravity_direction
from highside.physics.law import Law
from highside.report.diagnosis_words import axis_title, scale_of
from highside.report.misfit_steps import sigma_of, unit_of
from highside.report.plots import logarithmic, new_figure
from highside.words import _, said_later, told

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Ints = NDArray[np.intp]

BEFORE, AFTER, SHADE = "#d9822b", "#2f7fd1", "#808890"
MANY = 3000
"""More points than this are drawn as a sample, with the means of bins over them."""
BINS = 60
CELL_TITLES = {
    "d_inc_mean_deg": said_later("inclination, mean"),
    "d_inc_pp_deg": said_later("inclination, peak-to-peak"),
    "d_tf_mean_deg": said_later("toolface, mean"),
    "d_tf_pp_deg": said_later("toolface, peak-to-peak"),
}


def residuals(report_data: ReportData, location: Location, effect: str | None = None) -> list[Figure]:
    """One figure a channel over the covariate of a location, the location shaded: above what is to be explained, below
    what is left of it in units of the noise of one row.

    Of an `effect` the partial residual: all other named effects taken off, so that only its own shape is seen, and over
    it what it does as fitted. What turns with the load cancels in the mean over a covariate that only drives its size:
    then the rms is drawn.
    """
    names = [name for name in location.channels if name in report_data.channels] or list(report_data.channels)
    part = report_data.parts.get(effect or "")
    above = report_data.before if part is None else report_data.after + part
    figures = []
    for name in names:
        channel = report_data.channels.index(name)
        along, label = _along(report_data, location.covariate, channel % 3)
        size, unit = unit_of(report_data, channel)
        plain = np.array_equal(above, report_data.after)
        figure, axes = new_figure(1 if plain else 2, 1, width=max(10.5 / len(names), 3.5), height=3.0 if plain else 2.2)
        figures.append(figure)
        axis = axes[0][0]
        how = _mean if _cancels_not(along, above[channel], report_data.after[channel]) else _rms
        if plain:
            _points(axis, along, size * report_data.after[channel], AFTER, _("residual"), how)
        else:
            word = _("before") if part is None else _("others taken off")
            _points(axis, along, size * above[channel], BEFORE, word, how)
            if part is not None:
                _line(axis, along, size * part[channel], how)
            _points(
                axes[1][0], along, report_data.after[channel] / sigma_of(report_data, channel), AFTER, _("left"), how
            )
            axes[1][0].set(ylabel=_("left, sigma"))
        for each in (row[0] for row in axes):
            _shade(each, along, location.intervals)
            each.axhline(0, color=SHADE, linewidth=0.8)
            each.set(xlabel=label)
            each.legend()
        left_over = _("residual")
        axis.set(ylabel=f"{left_over}, {unit}".rstrip(", "), title=name)
    return figures


def over_time(report_data: ReportData) -> Figure:
    """A column a channel: the readings and the simulation where that misses them most, and what is left there in units
    of the noise; below, the misfit over the whole recording before and after."""
    t = np.asarray(report_data.session.state.t_s, dtype=float)
    sigmas = np.array([[sigma_of(report_data, k)] for k in range(len(report_data.channels))])
    rows = _worst_stretch(np.sum((report_data.before / sigmas) ** 2, axis=0))
    names = report_data.channels[:COLUMNS]
    figure, axes = new_figure(3, len(names), height=1.9)
    for channel, name in enumerate(names):
        size, unit = unit_of(report_data, channel)
        if unit == "ug":
            size, unit = 1.0, "g"
        top, left, whole = (row[channel] for row in axes)
        _beside(top, t, size, report_data, channel, rows)
        what = _("misfit") if report_data.recorded is None else _("reading")
        top.set(ylabel=f"{what}, {unit}", title=name)
        sigma = float(sigmas[channel, 0])
        mark = "o" if rows.stop - rows.start <= FEW else "-"
        left.plot(t[rows], report_data.after[channel, rows] / sigma, mark, color=AFTER, markersize=3, linewidth=0.8)
        left.axhspan(-2, 2, color=SHADE, alpha=0.12, linewidth=0)
        left.set(ylabel=_("left, sigma"), xlabel=_("time, s"))
        which, count, middle = _binned(t)
        for values, colour in ((report_data.before, BEFORE), (report_data.after, AFTER)):
            whole.plot(
                middle[count > 0],
                _rms(values[channel] / sigma, which, count)[count > 0],
                ".-",
                color=colour,
                markersize=3,
            )
        logarithmic(whole)
        whole.set(ylabel=_("rms, sigma"), xlabel=_("time, s (whole recording)"))
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def law_curve(curve: Curve, label: str) -> Figure:
    """A smooth law over its covariate with twice its standard deviation."""
    figure, axes = new_figure(1, 1, height=2.6)
    axis = axes[0][0]
    size, unit = scale_of(max((abs(v) for v in curve.value), default=0.0), curve.unit)
    grid, value, std = (np.asarray(v, dtype=float) for v in (curve.grid, curve.value, curve.std))
    axis.fill_between(grid, size * (value - 2 * std), size * (value + 2 * std), color=AFTER, alpha=0.2, linewidth=0)
    axis.plot(grid, size * value, "-", color=AFTER)
    axis.axhline(0, color=SHADE, linewidth=0.8)
    law = _("law")
    axis.set(xlabel=label, ylabel=f"{law}, {unit}".rstrip(", "))
    return figure


def law_surface(law: Law) -> Figure:
    """A law of two covariates: its value over both, and beside it the standard deviation."""
    figure, axes = new_figure(1, 2, height=3.2)
    first, second = law.axes[0], law.axes[1]
    u, v = (np.linspace(axis.low, axis.high, SURFACE) for axis in (first, second))
    at = [np.repeat(u, v.size), np.tile(v, u.size)]
    value, std = (np.asarray(f(at), dtype=float).reshape(u.size, v.size).T for f in (law.value, law.std))
    top = float(np.abs(value).max())
    size, unit = scale_of(top, law.at.unit)
    for axis, values, word, colours, low in (
        (axes[0][0], value, _("law"), "RdBu_r", -size * top),
        (axes[0][1], std, _("its standard deviation"), "Greys", 0.0),
    ):
        drawn = axis.pcolormesh(
            u, v, size * values, shading="auto", rasterized=True, cmap=colours, vmin=low, vmax=size * top
        )
        figure.colorbar(drawn, ax=axis, label=f"{word}, {unit}".rstrip(", "))
        names = [f"{told(c.title)}, {c.unit}".rstrip(", ") for c in map(covariate_of, law.depends_on[:2])]
        axis.set(xlabel=names[0], ylabel=names[1])
        axis.grid(visible=False)
    return figure


SURFACE = 60
"""Points of each axis of a law of two covariates."""


COLUMNS = 3
"""Channels side by side; of a recording with gyros the accelerometers."""
FEW = 60
"""No more rows than this are drawn as points: poses, not a curve."""


def _beside(axis: Axes, t: Array, size: float, report_data: ReportData, channel: int, rows: slice) -> None:
    """The readings and the simulation of one channel, before and after; without readings only what is left."""
    recorded = np.zeros_like(report_data.before) if report_data.recorded is None else report_data.recorded
    drawn = [
        (recorded - report_data.before, BEFORE, "-", _("simulated before")),
        (recorded - report_data.after, AFTER, "--", _("simulated after")),
    ]
    if np.array_equal(report_data.before, report_data.after):
        # nothing was taken in: one line, not two on one another
        drawn = [(recorded - report_data.after, AFTER, "-", _("simulated"))]
        if report_data.recorded is None:
            drawn = [(report_data.after, AFTER, "-", _("left"))]
    elif report_data.recorded is None:
        drawn = [(report_data.before, BEFORE, "-", _("before")), (report_data.after, AFTER, "-", _("after"))]
    if report_data.recorded is not None:
        axis.plot(t[rows], size * recorded[channel, rows], "o", color=SHADE, label=_("recorded"), markersize=3)
    for values, colour, style, word in drawn:
        axis.plot(t[rows], size * values[channel, rows], style, color=colour, label=word)


STRETCH = 240
"""Rows that are shown one by one: more are a band of ink."""


def _worst_stretch(energy: Array) -> slice:
    """Where that many rows in a row hold the most misfit."""
    n = energy.size
    if n <= STRETCH:
        return slice(0, n)
    running = np.convolve(energy, np.ones(STRETCH), "valid")
    start = int(np.argmax(running))
    return slice(start, start + STRETCH)


def _line(axis: Axes, along: Array, values: Array, how: Callable[[Array, Ints, Ints], Array]) -> None:
    """What an effect does as fitted."""
    which, count, middle = _binned(along)
    shows = count > 0
    axis.plot(middle[shows], how(values, which, count)[shows], "--", color="black", label=_("as fitted"), linewidth=1.0)


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
    # thousands of points are an image of their own: as elements of the page they take seconds to write and to show
    axis.plot(along[some], values[some], ".", color=colour, alpha=alpha, markersize=size, rasterized=not few)
    which, count, middle = _binned(along)
    kind = _("mean") if how is _mean else _("rms")
    shows = count > (0 if few else 1)
    axis.plot(middle[shows], how(values, which, count)[shows], "-", color=colour, label=f"{word} ({kind})")


def _along(report_data: ReportData, covariate: str, channel: int = 0) -> tuple[Array, str]:
    """(n,) what a residual is drawn over, and its label: a covariate of laws (of that axis' own), or of locations."""
    if covariate in report_data.covariates:
        return report_data.covariates[covariate], axis_title(covariate) or covariate
    state = report_data.session.state
    first = covariate.split(" x ")[0]
    if first in COVARIATES or first in state.extra:
        own = covariate_of(first)
        load = np.asarray(gravity_direction(state.inc_rad, state.tf_rad), dtype=float)
        return np.asarray(own.of(state, load, channel), dtype=float), f"{told(own.title)}, {own.unit}".rstrip(", ")
    columns = {
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "inc_ref_deg": np.degrees(state.inc_rad),
        "temp_c": state.temp_c,
        "t_s": state.t_s,
        "direction": state.direction,
        "vibration_rms_g": state.vibration_rms_g,
        "rotor_rate_dps": np.degrees(state.rotor_rate_radps),
    }
    # the intervals of a product are given along its first covariate, but for a side of approach
    parts = [part.removesuffix("^2") for part in covariate.split(" x ")]
    if parts[0] == "direction" and len(parts) > 1:
        parts = parts[1:]
    varying = [name for name in (*parts[:1], "inc_ref_deg", "tf_ref_deg", "t_s") if name in columns]
    name = next((name for name in varying if np.ptp(columns[name]) > 0), "t_s")
    return np.asarray(columns[name], dtype=float), axis_title(name)


def table_misfit(report_data: SummaryReportData, places: Sequence[Location]) -> Figure:
    """Misfit of each column in sigma over the rows, before and after; shaded where a claim sits."""
    figure, axes = new_figure(2, 2, height=2.6)
    rows = np.argsort(report_data.inc_deg)
    at = np.arange(rows.size)
    for column, axis in enumerate(np.ravel(np.array(axes, dtype=object))):
        shaded = np.zeros(rows.size, dtype=bool)
        for place in places:
            if CELLS[column] in place.channels:
                for low, high in place.intervals:
                    inc = report_data.inc_deg[rows]
                    shaded |= (inc >= low - 1e-6) & (inc <= high + 1e-6)
        for k in np.flatnonzero(shaded):
            axis.axvspan(k - 0.5, k + 0.5, color=SHADE, alpha=0.14, linewidth=0)
        axis.axhspan(-1, 1, color=SHADE, alpha=0.12, linewidth=0)
        axis.plot(at, report_data.before[rows, column], "o", color=BEFORE, label=_("before"), markersize=4)
        axis.plot(at, report_data.after[rows, column], "o", color=AFTER, label=_("after"), markersize=4)
        axis.set_xticks(at, [f"{value:g}" for value in report_data.inc_deg[rows]], rotation=60)
        axis.set(ylabel=_("misfit, sigma"), title=_(CELL_TITLES[CELLS[column]]))
        if column == 0:
            axis.legend()
    return figure


def table_values(report_data: SummaryReportData) -> Figure:
    """What the table says beside what the simulated chain says, deg."""
    figure, axes = new_figure(2, 2, height=2.6)
    rows = np.argsort(report_data.inc_deg)
    at = np.arange(rows.size)
    for column, axis in enumerate(np.ravel(np.array(axes, dtype=object))):
        axis.errorbar(
            at,
            report_data.published[rows, column],
            report_data.sigma[rows, column],
            fmt="o",
            color=SHADE,
            markersize=4,
            label=_("the table, with sigma"),
        )
        axis.plot(at, report_data.base[rows, column], "-", color=BEFORE, label=_("simulated before"))
        axis.plot(at, report_data.fitted[rows, column], "-", color=AFTER, label=_("simulated after"))
        axis.set_xticks(at, [f"{value:g}" for value in report_data.inc_deg[rows]], rotation=60)
        axis.set(ylabel="°", title=_(CELL_TITLES[CELLS[column]]))
        if column == 0:
            axis.legend()
    return figure

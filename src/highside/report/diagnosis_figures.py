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
from highside.physics.covariates import COVARIATES
from highside.physics.covariates import covariate as covariate_of
from highside.physics.gravity import gravity_direction
from highside.physics.law import Law
from highside.report.diagnosis_words import axis_title, scale_of
from highside.report.drawing import Area, Level, Line, Panel, Picture, Points, Strip, Surface
from highside.report.misfit_steps import sigma_of, unit_of
from highside.words import _, said_later, told

if TYPE_CHECKING:
    from highside.diagnosis.table.engine import SummaryReportData

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
CELLS = tuple(CELL_TITLES)
"""the columns of an error table"""


def residuals(report_data: ReportData, location: Location, effect: str | None = None) -> list[Picture]:
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
        wide = max(10.5 / len(names), 3.5)
        picture = Picture(1, 1, wide, 3.0) if plain else Picture(2, 1, wide, 2.2)
        figures.append(picture)
        panels = [row[0] for row in picture.panels]
        panel = panels[0]
        how = _mean if _cancels_not(along, above[channel], report_data.after[channel]) else _rms
        for each in panels:
            _shade(each, along, location.intervals)
            each.add(Level(0.0, SHADE))
            each.x_label, each.legend = label, True
        if plain:
            _points(panel, along, size * report_data.after[channel], AFTER, _("residual"), how)
        else:
            word = _("before") if part is None else _("others taken off")
            _points(panel, along, size * above[channel], BEFORE, word, how)
            if part is not None:
                _line(panel, along, size * part[channel], how)
            left = report_data.after[channel] / sigma_of(report_data, channel)
            _points(panels[1], along, left, AFTER, _("left"), how)
            panels[1].y_label = _("left, sigma")
        left_over = _("residual")
        panel.y_label, panel.title = f"{left_over}, {unit}".rstrip(", "), name
    return figures


def over_time(report_data: ReportData) -> Picture:
    """A column a channel: the readings and the simulation where that misses them most, and what is left there in units
    of the noise; below, the misfit over the whole recording before and after."""
    t = np.asarray(report_data.session.state.t_s, dtype=float)
    sigmas = np.array([[sigma_of(report_data, k)] for k in range(len(report_data.channels))])
    rows = _worst_stretch(np.sum((report_data.before / sigmas) ** 2, axis=0))
    names = report_data.channels[:COLUMNS]
    picture = Picture(3, len(names), height=1.9)
    for channel, name in enumerate(names):
        size, unit = unit_of(report_data, channel)
        if unit == "ug":
            size, unit = 1.0, "g"
        top, left, whole = (row[channel] for row in picture.panels)
        _beside(top, t, size, report_data, channel, rows)
        what = _("misfit") if report_data.recorded is None else _("reading")
        top.y_label, top.title = f"{what}, {unit}", name
        sigma = float(sigmas[channel, 0])
        after = report_data.after[channel, rows] / sigma
        few = rows.stop - rows.start <= FEW
        left.add(
            Strip(-2.0, 2.0, SHADE, 0.12),
            Points(t[rows], after, AFTER) if few else Line(t[rows], after, AFTER, width=0.8),
        )
        left.y_label, left.x_label = _("left, sigma"), _("time, s")
        which, count, middle = _binned(t)
        for values, colour in ((report_data.before, BEFORE), (report_data.after, AFTER)):
            rms = _rms(values[channel] / sigma, which, count)[count > 0]
            whole.add(Line(middle[count > 0], rms, colour, dots=2.5))
        whole.log = True
        whole.y_label, whole.x_label = _("rms, sigma"), _("time, s (whole recording)")
    picture.legend = picture.panels[0][0].labelled()
    return picture


def law_curve(curve: Curve, label: str) -> Picture:
    """A smooth law over its covariate with twice its standard deviation, shaded where nothing was read."""
    picture = Picture(1, 1, height=2.6)
    panel = picture.panels[0][0]
    size, unit = scale_of(max((abs(v) for v in curve.value), default=0.0), curve.unit)
    grid, value, std = (np.asarray(v, dtype=float) for v in (curve.grid, curve.value, curve.std))
    for low, high in curve.unread:
        panel.add(Strip(low, high, SHADE, 0.18, upright=True))
    panel.add(
        Area(grid, size * (value - 2 * std), size * (value + 2 * std), AFTER, 0.2),
        Level(0.0, SHADE),
        Line(grid, size * value, AFTER),
    )
    law = _("law")
    panel.x_label, panel.y_label = label, f"{law}, {unit}".rstrip(", ")
    return picture


def law_surface(law: Law) -> Picture:
    """A law of two covariates: its value over both, and beside it the standard deviation."""
    picture = Picture(1, 2, height=3.2)
    first, second = law.axes[0], law.axes[1]
    u, v = (np.linspace(axis.low, axis.high, SURFACE) for axis in (first, second))
    at = [np.repeat(u, v.size), np.tile(v, u.size)]
    value, std = (np.asarray(f(at), dtype=float).reshape(u.size, v.size).T for f in (law.value, law.std))
    sizes = np.abs([value, std])
    # a law that is nothing anywhere is of the middle colour, and its deviation has a scale of its own
    top = next((float(t) for t in (_largest(sizes[0]), _largest(sizes[1])) if t > 0.0), 1.0)
    size, unit = scale_of(top, law.at.unit)
    names = [f"{told(c.title)}, {c.unit}".rstrip(", ") for c in map(covariate_of, law.depends_on[:2])]
    for panel, values, word, colours, low in (
        (picture.panels[0][0], value, _("law"), BOTH_SIGNS, -size * top),
        (picture.panels[0][1], std, _("its standard deviation"), ONE_SIGN, 0.0),
    ):
        panel.add(Surface(u, v, size * values, low, size * top, colours))
        panel.title = f"{word}, {unit}".rstrip(", ")
        panel.x_label, panel.y_label = names[0], names[1]
    return picture


def _largest(values: Array) -> float:
    return float(np.max(values, where=np.isfinite(values), initial=0.0))


BOTH_SIGNS = ("#1f5f9f", "#7fb2e0", "#f4f4f4", "#ecb27c", "#b0560f")
ONE_SIGN = ("#f8f8f8", "#9aa0a6", "#1a1c1e")
"""Colours of a law from its least value to its largest: blue and orange for the two signs, grey for a size."""
SURFACE = 60
"""Points of each axis of a law of two covariates."""


COLUMNS = 3
"""Channels side by side; of a recording with gyros the accelerometers."""
FEW = 60
"""No more rows than this are drawn as points: poses, not a curve."""


def _beside(panel: Panel, t: Array, size: float, report_data: ReportData, channel: int, rows: slice) -> None:
    """The readings and the simulation of one channel, before and after; without readings only what is left."""
    recorded = np.zeros_like(report_data.before) if report_data.recorded is None else report_data.recorded
    drawn = [
        (recorded - report_data.before, BEFORE, False, _("simulated before")),
        (recorded - report_data.after, AFTER, True, _("simulated after")),
    ]
    if np.array_equal(report_data.before, report_data.after):
        # nothing was taken in: one line, not two on one another
        drawn = [(recorded - report_data.after, AFTER, False, _("simulated"))]
        if report_data.recorded is None:
            drawn = [(report_data.after, AFTER, False, _("left"))]
    elif report_data.recorded is None:
        drawn = [(report_data.before, BEFORE, False, _("before")), (report_data.after, AFTER, False, _("after"))]
    if report_data.recorded is not None:
        panel.add(Points(t[rows], size * recorded[channel, rows], SHADE, _("recorded"), size=4.0))
    for values, colour, dashed, word in drawn:
        panel.add(Line(t[rows], size * values[channel, rows], colour, word, dashed=dashed))


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


def _line(panel: Panel, along: Array, values: Array, how: Callable[[Array, Ints, Ints], Array]) -> None:
    """What an effect does as fitted."""
    which, count, middle = _binned(along)
    shows = count > 0
    panel.add(Line(middle[shows], how(values, which, count)[shows], label=_("as fitted"), width=1.0, dashed=True))


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


def _shade(panel: Panel, along: Array, intervals: Sequence[tuple[float, float]]) -> None:
    pad = 0.01 * float(np.ptp(along) or 1.0)
    whole = intervals and intervals[0][0] <= np.min(along) and intervals[-1][1] >= np.max(along) and len(intervals) == 1
    for low, high in () if whole else intervals:
        panel.add(Strip(low - pad, high + pad, SHADE, 0.18, upright=True))


def _points(
    panel: Panel, along: Array, values: Array, colour: str, word: str, how: Callable[[Array, Ints, Ints], Array]
) -> None:
    """The points, and over them what those of a bin have in common; of many points a sample."""
    some = np.linspace(0, along.size - 1, min(along.size, MANY // 2)).astype(int)
    few = along.size <= MANY
    # so many points that the line over them must not be lost in them
    size, alpha = (2.8, 0.6) if few else (1.4, 0.3)
    panel.add(Points(along[some], values[some], colour, size=size, alpha=alpha))
    which, count, middle = _binned(along)
    kind = _("mean") if how is _mean else _("rms")
    shows = count > (0 if few else 1)
    panel.add(Line(middle[shows], how(values, which, count)[shows], colour, f"{word} ({kind})"))


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


def table_misfit(report_data: SummaryReportData, places: Sequence[Location]) -> Picture:
    """Misfit of each column in sigma over the rows, before and after; shaded where a claim sits."""
    picture = Picture(2, 2, height=2.6)
    rows = np.argsort(report_data.inc_deg)
    at = np.arange(rows.size, dtype=float)
    inc = report_data.inc_deg[rows]
    for column, panel in enumerate(panel for line in picture.panels for panel in line):
        shaded = np.zeros(rows.size, dtype=bool)
        for place in places:
            if CELLS[column] in place.channels:
                for low, high in place.intervals:
                    shaded |= (inc >= low - 1e-6) & (inc <= high + 1e-6)
        panel.add(*(Strip(k - 0.5, k + 0.5, SHADE, 0.14, upright=True) for k in np.flatnonzero(shaded)))
        panel.add(
            Strip(-1.0, 1.0, SHADE, 0.12),
            Points(at, report_data.before[rows, column], BEFORE, _("before"), size=4.0),
            Points(at, report_data.after[rows, column], AFTER, _("after"), size=4.0),
        )
        panel.x_names = [f"{value:g}" for value in inc]
        panel.y_label, panel.title = _("misfit, sigma"), _(CELL_TITLES[CELLS[column]])
        panel.legend = column == 0
    return picture


def table_values(report_data: SummaryReportData) -> Picture:
    """What the table says beside what the simulated chain says, deg."""
    picture = Picture(2, 2, height=2.6)
    rows = np.argsort(report_data.inc_deg)
    at = np.arange(rows.size, dtype=float)
    for column, panel in enumerate(panel for line in picture.panels for panel in line):
        published, sigma = report_data.published[rows, column], report_data.sigma[rows, column]
        panel.add(
            Points(at, published, SHADE, _("the table, with sigma"), size=4.0, std=sigma),
            Line(at, report_data.base[rows, column], BEFORE, _("simulated before")),
            Line(at, report_data.fitted[rows, column], AFTER, _("simulated after")),
        )
        panel.x_names = [f"{value:g}" for value in report_data.inc_deg[rows]]
        panel.y_label, panel.title = "°", _(CELL_TITLES[CELLS[column]])
        panel.legend = column == 0
    return picture

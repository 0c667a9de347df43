"""A chart as a matplotlib figure, for paper and for who wants to go on with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from highside.errors import InputError
from highside.shown.panel import Chart, PlotLine, PlotPanel, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure_of"]

WIDTH_IN, PANEL_IN = 9.0, 2.4
STYLES = {"line": "-", "dashed": "--", "points": "o"}


def figure_of(chart: Chart) -> Figure:
    """An axis a panel. Raises InputError where matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure as NewFigure
    except ImportError:
        raise InputError(
            "plots need matplotlib, which is not installed", remedy="pip install 'highside[plot]'"
        ) from None
    rows = max(len(chart.panels), 1)
    figure = NewFigure(figsize=(WIDTH_IN, PANEL_IN * rows), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False)[:, 0]
    for axis, panel in zip(axes, chart.panels, strict=False):
        _draw(axis, thinned(panel))
    figure.suptitle(chart.title, fontsize="medium")
    return figure


def _draw(axis: Axes, panel: PlotPanel) -> None:
    for line in panel.lines:
        _line(axis, panel, line)
    if panel.log:
        axis.set_yscale("log")
    if panel.names:
        axis.set_xticks(panel.x, panel.names, rotation=20, horizontalalignment="right", fontsize="small")
    axis.set(xlabel=panel.x_label, ylabel=panel.y_label)
    axis.grid(visible=True, alpha=0.3)
    axis.legend(loc="best", fontsize="small")


def _line(axis: Axes, panel: PlotPanel, line: PlotLine) -> None:
    style = STYLES[line.look]
    points = line.look == "points"
    if points and line.std is not None:
        axis.errorbar(panel.x, line.y, line.std, fmt=style, markersize=3, color=line.colour, label=line.name)
        return
    (drawn,) = axis.plot(
        panel.x,
        line.y,
        style,
        markersize=3 if panel.x.size < 500 else 1.5,
        linewidth=0.9,
        color=line.colour,
        label=line.name,
    )
    if line.std is not None:
        low, high = np.subtract(line.y, line.std), np.add(line.y, line.std)
        axis.fill_between(panel.x, low, high, color=drawn.get_color(), alpha=0.25, linewidth=0)

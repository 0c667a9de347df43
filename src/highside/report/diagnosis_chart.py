"""The residuals of a diagnosis as a chart to zoom and hover in: every row, before and with what was found."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from highside.diagnosis.core.problem import ReportData
from highside.report.diagnosis_figures import AFTER, BEFORE, CELL_TITLES, CELLS, FEW
from highside.report.misfit_steps import unit_of
from highside.shown.panel import Look, PlotLine, PlotPanel
from highside.shown.plot import Plot
from highside.words import _

if TYPE_CHECKING:
    from highside.diagnosis.table.engine import SummaryReportData

__all__ = ["misfit_chart"]


def misfit_chart(data: ReportData | SummaryReportData, title: str) -> Plot:
    """A panel a channel over time, or of an error table a panel a column over inclination."""
    return Plot(title, _of_rows(data) if isinstance(data, ReportData) else _of_table(data))


def _of_rows(data: ReportData) -> tuple[PlotPanel, ...]:
    t = np.asarray(data.session.state.t_s, dtype=float)
    residual = _("residual")
    look: Look = "points" if t.size <= FEW else "line"
    panels = []
    for channel, name in enumerate(data.channels):
        size, unit = unit_of(data, channel)
        lines = (
            PlotLine(_("before"), size * data.before[channel], None, look, BEFORE),
            PlotLine(_("with the claims"), size * data.after[channel], None, look, AFTER),
        )
        panels.append(PlotPanel(t, lines, _("time, s"), f"{name}, {residual}, {unit}".rstrip(", ")))
    return tuple(panels)


def _of_table(data: SummaryReportData) -> tuple[PlotPanel, ...]:
    order = np.argsort(data.inc_deg)
    return tuple(
        PlotPanel(
            data.inc_deg[order],
            (
                PlotLine(_("before"), data.before[order, column], None, "points", BEFORE),
                PlotLine(_("with the claims"), data.after[order, column], None, "points", AFTER),
            ),
            _("inclination, deg"),
            f"{_(CELL_TITLES[cell])}, sigma",
        )
        for column, cell in enumerate(CELLS)
    )

"""How a table shows itself: the first and last rows in a notebook, its columns over time in a chart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.recording.columns import NamedColumns, expected_in
from highside.shown.card import card
from highside.shown.panel import PlotLine, PlotPanel
from highside.shown.plot import Plot

__all__ = ["chart_of", "html_of"]

ENDS_SHOWN = 5
"""rows shown at each end of a longer table"""
ROWS_SHOWN = 3 * ENDS_SHOWN
"""a table of no more rows is shown whole"""
NOT_DRAWN = frozenset({"t_s", "seq", "pose", "direction", "noise_g"})
"""numbers of rows and stops, and what is said of every row, which show nothing over time"""


def html_of(table: NamedColumns, *below: str) -> str:
    """The table as HTML: all of a short one, the ends of a long one; below it how many rows and columns it has, and
    further lines."""
    n = table.n
    whole = n <= ROWS_SHOWN
    rows = list(range(n)) if whole else [*range(ENDS_SHOWN), *range(n - ENDS_SHOWN, n)]
    cells = [[str(row), *(_cell(table, name, row) for name in table.order)] for row in rows]
    if not whole:
        cells.insert(ENDS_SHOWN, ["..."] * (len(table.order) + 1))
    caption = f"{type(table).__name__}: {n} {table.rows_are}, {len(table.order)} columns"
    if table.source is not None:
        caption += f", of {table.source}"
    return card(["", *table.order], cells, caption, *below)


def chart_of(table: NamedColumns, names: Sequence[str]) -> Plot:
    """See `Table.plot`."""
    wanted = names or [name for name in table.order if name in table.columns and name not in NOT_DRAWN]
    columns = dict(zip(wanted, table.require(*wanted), strict=True))
    timed = table.has("t_s")
    along = table.require("t_s")[0] if timed else np.arange(table.n, dtype=float)
    groups: dict[str, list[str]] = {}
    for name in wanted:
        groups.setdefault(expected_in(name), []).append(name)
    panels = tuple(
        PlotPanel(
            along,
            tuple(PlotLine(name, columns[name]) for name in members),
            "time, s" if timed else "row",
            "" if unit == "numbers" else unit,
        )
        for unit, members in groups.items()
    )
    return Plot(table.source or type(table).__name__, panels)


def _cell(table: NamedColumns, name: str, row: int) -> str:
    if name in table.texts:
        return table.texts[name][row]
    value = table.columns[name][row]
    return "" if value != value else f"{value:.9g}"

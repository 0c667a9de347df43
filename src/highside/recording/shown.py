"""How a table shows itself: the first and last rows in a notebook, its columns over time in a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from highside.errors import InputError
from highside.recording.table import Table, expected_in

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["figure_of", "html_of", "html_table", "plot_of"]

ENDS_SHOWN = 5
"""rows shown at each end of a longer table"""
ROWS_SHOWN = 3 * ENDS_SHOWN
"""a table of no more rows is shown whole"""
POINTS_DRAWN = 20000
"""of a longer column every so many-th row is drawn: a figure of 1,600 pixels can show no more"""
NOT_DRAWN = frozenset({"t_s", "seq", "pose", "direction"})
"""numbers of rows and stops, which say nothing over time"""


def html_of(table: Table) -> str:
    """The table as HTML: all of a short one, the ends of a long one, below it how many rows and columns it has."""
    n = table.n
    whole = n <= ROWS_SHOWN
    rows = list(range(n)) if whole else [*range(ENDS_SHOWN), *range(n - ENDS_SHOWN, n)]
    cells = [[str(row), *(_cell(table, name, row) for name in table.order)] for row in rows]
    if not whole:
        cells.insert(ENDS_SHOWN, ["..."] * (len(table.order) + 1))
    caption = f"{type(table).__name__}: {n} {table.rows_are}, {len(table.order)} columns"
    if table.source is not None:
        caption += f", of {table.source}"
    return html_table(["", *table.order], cells, caption)


def html_table(header: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    """A plain HTML table, everything escaped, with a line below it."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    below = f"<p>{escape(caption)}</p>" if caption else ""
    return f"<div><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{below}</div>"


def plot_of(table: Table, names: Sequence[str]) -> Figure:
    """See `Table.plot`."""
    wanted = names or [name for name in table.order if name in table.columns and name not in NOT_DRAWN]
    columns = dict(zip(wanted, table.require(*wanted), strict=True))
    timed = table.has("t_s")
    along = table["t_s"] if timed else np.arange(table.n, dtype=float)
    groups: dict[str, list[str]] = {}
    for name in wanted:
        groups.setdefault(expected_in(name), []).append(name)
    figure = figure_of(len(groups))
    step = max(1, table.n // POINTS_DRAWN)
    for axis, (unit, members) in zip(figure.axes, groups.items(), strict=True):
        for name in members:
            axis.plot(along[::step], columns[name][::step], label=name, linewidth=0.8)
        axis.set(ylabel="" if unit == "numbers" else unit, xlabel="t, s" if timed else "row")
        axis.legend(loc="best", fontsize="small")
    return figure


def figure_of(rows: int, *, height: float = 2.4) -> Figure:
    """A figure of so many axes above one another. Raises InputError where matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure as NewFigure
    except ImportError:
        raise InputError(
            "plots need matplotlib, which is not installed", remedy="pip install 'highside[plot]'"
        ) from None
    figure = NewFigure(figsize=(9.0, max(height * rows, height)), layout="constrained")
    figure.subplots(max(rows, 1), 1, squeeze=False)
    return figure


def _cell(table: Table, name: str, row: int) -> str:
    if name in table.texts:
        return table.texts[name][row]
    value = table.columns[name][row]
    return "" if value != value else f"{value:.9g}"

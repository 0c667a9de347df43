"""Plots of the pages and of the certificate, as SVG.

Black lines and letters take the text colour of the page that holds them, so that a page can be read on a light and on a
dark screen and prints well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from highside.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK = "#010203"
"""Stands in a plot for the page's text colour."""
DPI = 150
"""of what is an image in a plot"""


def can_plot() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def need_plots() -> None:
    """Raises InputError where matplotlib is missing: checked before long work whose page is nothing without figures."""
    if not can_plot():
        raise InputError("plots need matplotlib, which is not installed", remedy="pip install 'highside[plot]'")


@contextmanager
def plotting() -> Iterator[None]:
    """All figures of a page are drawn within this. Raises InputError where matplotlib is missing."""
    need_plots()
    import matplotlib

    with matplotlib.rc_context(_plot_style()):
        yield


def new_figure(rows: int, columns: int, *, width: float = 10.5, height: float = 3.2) -> tuple[Figure, list[list[Axes]]]:
    """A figure of `rows` x `columns` axes, `height` inches a row; within `plotting`."""
    from matplotlib.figure import Figure as NewFigure

    figure = NewFigure(figsize=(width, height * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, [list(row) for row in axes]


def _plot_style() -> dict[Any, Any]:
    """Settings of matplotlib: transparent, ink for what is black, thin grid."""
    ink = dict.fromkeys(
        ("text.color", "axes.edgecolor", "axes.labelcolor", "axes.titlecolor", "xtick.color", "ytick.color"), _INK
    )
    return {
        **ink,
        # each figure says itself how its axes are laid out
        "figure.autolayout": False,
        "figure.constrained_layout.use": False,
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "savefig.facecolor": "none",
        "legend.frameon": False,
        "legend.fontsize": 8,
        "axes.titlesize": 9,
        "axes.labelsize": 8,
        "xtick.labelsize": 7.5,
        "ytick.labelsize": 7.5,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": "#808890",
        "grid.alpha": 0.3,
        "grid.linewidth": 0.6,
        "lines.linewidth": 1.2,
        "svg.fonttype": "none",
        "font.family": ["sans-serif"],
    }


def as_svg(figure: Figure, number: int) -> str:
    """A figure drawn within `plotting` as an SVG element; `number` keeps its ids apart from others' on the page."""
    import matplotlib

    _laid_out(figure)
    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": str(number)}):
        figure.savefig(buffer, format="svg", dpi=DPI, metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor")
    # one page holds several plots: their ids must differ
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\1f{number}-", svg)


def _laid_out(figure: Figure) -> None:
    """Its axes in their places. Left to `savefig`, all is drawn twice, the first time for the layout alone."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    engine = figure.get_layout_engine()
    if engine is not None:
        FigureCanvasSVG(figure)  # letters are as wide as in the SVG
        figure.set_dpi(DPI)
        engine.execute(figure)
        figure.set_layout_engine(None)

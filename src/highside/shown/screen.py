"""A chart for the screen: Bokeh draws it in the browser, to zoom and hover; its script goes along with the page."""

from __future__ import annotations

import base64
import gzip
import io
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from highside.errors import InputError
from highside.shown.card import templates
from highside.shown.panel import Chart, PlotLine, PlotPanel, thinned
from highside.shown.paper import figure_of

__all__ = ["can_draw", "chart_part", "frame_of", "library_part", "page_of"]

PANEL_PX, FRAME_PX = 230, 40
"""height of a panel, and of what stands around all of them"""
LEFT_PX, RIGHT_PX = 72, 24
"""what stands beside each panel at least, so that their axes lie below one another"""
INK, GRID = "#6b7680", "#808890"
"""read on light and on dark paper, since a chart cannot take the colour of the page's text"""
COLOURS = ("#2f7fd1", "#d9822b", "#2c9a62", "#a05bc0", "#c0504d", "#7a7a30", "#3aa5a5", "#888888", "#d16fa5")
MOST_HOVERED = 1500
"""points of a line beyond which a hover needs no point of its own: the nearest in x is shown"""
LIBRARY = ("bokeh.min.js", "bokeh-api.min.js")
"""BokehJS, and its public interface"""
INSTALL = "pip install 'highside[notebook]'"


def can_draw() -> bool:
    """Whether Bokeh is installed."""
    return find_spec("bokeh") is not None


def page_of(chart: Chart) -> str:
    """A page with one chart. Raises InputError where Bokeh is not installed."""
    template = templates().get_template("chart.html")
    return template.render(title=chart.title, item=_item(chart), packed=_library())


def frame_of(chart: Chart) -> str:
    """The chart within a notebook, apart from its styles and scripts; without Bokeh a still picture, without matplotlib
    too what to install."""
    if can_draw():
        height = PANEL_PX * len(chart.panels) + FRAME_PX
        return templates().get_template("frame.html").render(title=chart.title, page=page_of(chart), height=height)
    try:
        figure = figure_of(chart)
    except InputError:
        return str(Markup("<p>plots need Bokeh, which is not installed; {}</p>").format(INSTALL))
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg")
    svg = drawn.getvalue()
    return svg[svg.index("<svg") :]


def chart_part(chart: Chart) -> Markup:
    """The chart as a part of a larger page, which holds `library_part` once, behind its charts. Raises InputError."""
    return Markup(_macros().chart(_item(chart)))  # made by a template of our own, which escapes what it is given


def library_part() -> Markup:
    """What draws the charts of a page. Raises InputError where Bokeh is not installed."""
    return Markup(_macros().script(_library()))


def _macros() -> Any:
    return templates().get_template("screen.html").module


@cache
def _library() -> Markup:
    """BokehJS, zipped, in letters: a third of its size in a page. Raises InputError where it is not installed."""
    _need_bokeh()
    found = find_spec("bokeh")
    assert found is not None
    assert found.origin is not None
    folder = Path(found.origin).parent / "server" / "static" / "js"
    script = b"\n".join((folder / name).read_bytes() for name in LIBRARY)
    return Markup(base64.b64encode(gzip.compress(script, 4, mtime=0)).decode())


def _need_bokeh() -> None:
    if not can_draw():
        raise InputError("a chart with zoom and hover needs Bokeh, which is not installed", remedy=INSTALL)


def _item(chart: Chart) -> dict[str, Any]:
    """What `templates/chart.js` draws. Bokeh's own Python is not loaded for it: that takes a second."""
    _need_bokeh()
    return {"colours": {"ink": INK, "grid": GRID}, "panels": [_panel(thinned(panel)) for panel in chart.panels]}


def _panel(panel: PlotPanel) -> dict[str, Any]:
    return {
        "x": _packed(panel.x, "<f8"),
        "x_label": panel.x_label,
        "y_label": panel.y_label,
        "log": panel.log,
        "names": list(panel.names) or None,
        "lines": [_line(line, k) for k, line in enumerate(panel.lines)],
        "height": PANEL_PX,
        "left": LEFT_PX,
        "right": RIGHT_PX,
    }


def _line(line: PlotLine, k: int) -> dict[str, Any]:
    # in single precision, half the size: of what a screen shows no digit is lost
    drawn: dict[str, Any] = {"name": line.name, "look": line.look, "y": _packed(line.y, "<f4")}
    if line.std is not None:
        drawn |= {"low": _packed(line.y - line.std, "<f4"), "high": _packed(line.y + line.std, "<f4")}
    size = 6 if line.y.size < MOST_HOVERED else 3
    return {**drawn, "colour": line.colour or COLOURS[k % len(COLOURS)], "size": size}


def _packed(values: Any, kind: str) -> str:
    """The bytes of an array, in letters."""
    return base64.b64encode(np.asarray(values, dtype=kind).tobytes()).decode("ascii")

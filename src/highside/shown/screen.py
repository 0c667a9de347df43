"""A chart for the screen: Bokeh draws it in the browser, to zoom and hover; its script goes along with the page."""

from __future__ import annotations

import base64
import gzip
import io
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from highside.errors import InputError
from highside.shown.card import templates
from highside.shown.panel import Chart, PlotLine, PlotPanel, thinned
from highside.shown.paper import figure_of

if TYPE_CHECKING:
    from bokeh.plotting import figure

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
    """BokehJS, zipped, in letters: a third of its size in a page."""
    _need_bokeh()
    from bokeh.resources import Resources

    script = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)
    return Markup(base64.b64encode(gzip.compress(script.encode(), 9, mtime=0)).decode())


def _need_bokeh() -> None:
    if not can_draw():
        raise InputError("a chart with zoom and hover needs Bokeh, which is not installed", remedy=INSTALL)


def _item(chart: Chart) -> Any:
    """What BokehJS draws, as JSON."""
    _need_bokeh()
    from bokeh.embed import json_item
    from bokeh.layouts import gridplot

    shared: dict[str, Any] = {}
    drawn: list[figure] = []
    for panel in chart.panels:
        one = _figure(thinned(panel), shared.get(panel.x_label))
        if panel.x_label and not panel.names:
            shared.setdefault(panel.x_label, one.x_range)
        drawn.append(one)
    return json_item(gridplot([[one] for one in drawn], sizing_mode="stretch_width", toolbar_location="right"))


def _figure(panel: PlotPanel, x_range: Any) -> figure:
    from bokeh.models import HoverTool
    from bokeh.plotting import ColumnDataSource, figure

    made = figure(
        height=PANEL_PX,
        sizing_mode="stretch_width",
        tools="box_zoom,pan,xwheel_zoom,ywheel_zoom,reset,save",
        active_drag="box_zoom",
        x_axis_label=panel.x_label or None,
        y_axis_label=panel.y_label or None,
        y_axis_type="log" if panel.log else "linear",
        min_border_left=LEFT_PX,
        min_border_right=RIGHT_PX,
        **({} if x_range is None else {"x_range": x_range}),
    )
    data: dict[str, Any] = {"x": panel.x}
    for k, line in enumerate(panel.lines):
        data[f"y{k}"] = _single(line.y)
        if line.std is not None:
            data[f"low{k}"], data[f"high{k}"] = _single(line.y - line.std), _single(line.y + line.std)
    if panel.names:
        data["name"] = list(panel.names)
        made.xaxis.ticker = panel.x.tolist()
        made.xaxis.major_label_overrides = {float(x): name for x, name in zip(panel.x, panel.names, strict=True)}
    source = ColumnDataSource(data)
    drawn = [_line(made, source, k, line) for k, line in enumerate(panel.lines)]
    points = any(line.look == "points" for line in panel.lines)
    along = (panel.x_label or "x", "@name") if panel.names else (panel.x_label or "x", "@x{%.10g}")
    hover = HoverTool(
        renderers=drawn if points else drawn[:1],
        mode="mouse" if points else "vline",
        tooltips=[along, *((line.name, f"@y{k}{{%.7g}}") for k, line in enumerate(panel.lines))],
        formatters=dict.fromkeys(["@x", *(f"@y{k}" for k in range(len(panel.lines)))], "printf"),
    )
    made.add_tools(hover)
    _plain(made)
    return made


def _line(made: figure, source: Any, k: int, line: PlotLine) -> Any:
    colour = line.colour or COLOURS[k % len(COLOURS)]
    if line.std is not None and line.look == "points":
        made.segment("x", f"low{k}", "x", f"high{k}", source=source, color=colour, line_width=1.5)
    elif line.std is not None:
        made.varea("x", f"low{k}", f"high{k}", source=source, fill_color=colour, fill_alpha=0.25)
    if line.look == "points":
        size = 6 if len(source.data["x"]) < MOST_HOVERED else 3
        return made.scatter("x", f"y{k}", source=source, color=colour, size=size, legend_label=line.name)
    dash = "dashed" if line.look == "dashed" else "solid"
    return made.line("x", f"y{k}", source=source, color=colour, line_dash=dash, legend_label=line.name)


def _plain(made: figure) -> None:
    """Transparent, with ink that is read on light and on dark."""
    made.background_fill_alpha = made.border_fill_alpha = 0.0
    made.outline_line_color = None
    made.toolbar.logo = None
    made.grid.grid_line_color, made.grid.grid_line_alpha = GRID, 0.3
    for axis in made.axis:
        axis.axis_label_text_color = axis.major_label_text_color = axis.axis_line_color = INK
        axis.major_tick_line_color = axis.minor_tick_line_color = GRID
        axis.axis_label_text_font_style = "normal"
    for legend in made.legend:
        legend.background_fill_alpha, legend.border_line_color = 0.0, None
        legend.label_text_color, legend.label_text_font_size = INK, "9pt"
        legend.spacing = 2
        legend.click_policy, legend.location, legend.orientation = "hide", "top_left", "horizontal"
    if made.legend:
        made.add_layout(made.legend[0], "above")


def _single(values: Any) -> Any:
    """In single precision, half the size: of what a screen shows no digit is lost."""
    return np.asarray(values, dtype=np.float32)

"""Standalone HTML pages: headings, words, tables and plots in one file that needs nothing beside it.

Plots are embedded as SVG whose black lines and letters take the page's own text colour, so that a page can be read on
a light and on a dark screen and prints well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from html import escape
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from highside.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK = "#010203"
"""Stands in a plot for the page's text colour."""

_STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #ffffff; --soft: #5b6570; --line: #d4dae0; --band: #f3f5f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ec; --paper: #14171a; --soft: #9aa5b0; --line: #39424b; --band: #1d2226; }
}
body { color: var(--ink); background: var(--paper); font: 16px/1.5 system-ui, sans-serif; max-width: 70rem;
       margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; line-height: 1.25; } h2 { font-size: 1.25rem; margin-top: 2.5rem; }
p, li { max-width: 48rem; } .soft, caption, figcaption { color: var(--soft); }
figure { margin: 1.5rem 0; } figure svg { width: 100%; height: auto; color: var(--ink); }
figcaption { max-width: 48rem; font-size: .92rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92rem; margin: 1rem 0; }
caption { text-align: left; padding-bottom: .4rem; max-width: 48rem; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
td { white-space: nowrap; } td.words { white-space: normal; vertical-align: top; }
 thead th { font-weight: 600; vertical-align: bottom; }
dl.facts { display: grid; grid-template-columns: max-content 1fr; gap: .35rem 1.2rem; max-width: 60rem;
           margin: 1.2rem 0; }
dl.facts dt { color: var(--soft); } dl.facts dd { margin: 0; } dl.facts dd + dd { grid-column: 2; }
.badge { display: inline-block; padding: .05rem .6rem; border-radius: 1rem; border: 1px solid currentColor;
         font-size: .92rem; font-weight: 600; }
.good { color: #2c7a4b; } .bad { color: #b3402a; } .open { color: #8a6a00; } .found { color: #2f6fb5; }
@media (prefers-color-scheme: dark) { .good { color: #6cc592; } .bad { color: #ef8a74; } .open { color: #d9b64a; }
  .found { color: #7fb2ea; } }
td.words, th.words { text-align: left; } tbody tr:nth-child(even) { background: var(--band); }
.panels { display: flex; flex-wrap: wrap; gap: .5rem; } .panels svg { flex: 1 1 17rem; width: auto; min-width: 0; }
@media (max-width: 40rem) {
  dl.facts { grid-template-columns: 1fr; gap: 0; } dl.facts dd { margin-bottom: .6rem; }
  dl.facts dd + dd { grid-column: 1; }
  .told thead { display: none; } .told table, .told tbody, .told tr, .told td, .told caption { display: block; }
  .told td { text-align: left; white-space: normal; border: 0; padding: .05rem .5rem; }
  .told td:first-child { font-weight: 600; } .told tr { border-bottom: 1px solid var(--line); padding: .3rem 0; }
  .told td:not(:first-child)::before { content: attr(data-name) ": "; color: var(--soft); }
}
"""


class Page:
    """A page in the making; each method adds a part, `html` gives the whole."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = [f"<h1>{escape(title)}</h1>"]
        self._figures = 0

    def heading(self, text: str) -> None:
        self._parts.append(f"<h2>{escape(text)}</h2>")

    def paragraph(self, text: str, *, soft: bool = False) -> None:
        self._parts.append(f'<p class="soft">{escape(text)}</p>' if soft else f"<p>{escape(text)}</p>")

    def badge(self, text: str, kind: str, words: str) -> None:
        """A word that stands out (`kind` is good, bad, open or found) and a sentence beside it."""
        self._parts.append(f'<p><span class="badge {kind}">{escape(text)}</span> {escape(words)}</p>')

    def facts(self, rows: Sequence[tuple[str, str]]) -> None:
        """Pairs of a question and its answer, one below the other; an empty question goes on with the last answer."""
        inner = "".join(
            (f"<dt>{escape(name)}</dt>" if name else "") + f"<dd>{escape(text)}</dd>" for name, text in rows
        )
        self._parts.append(f'<dl class="facts">{inner}</dl>')

    def bullets(self, items: Sequence[str]) -> None:
        self._parts.append("<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>")

    def table(
        self, headers: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "", *, words: Sequence[int] = ()
    ) -> None:
        """`words`: indices of the columns that hold text and are set flush left.

        Where there are such, a narrow screen shows each row as lines with the headers before them.
        """

        def cell(tag: str, index: int, text: str) -> str:
            kind = ' class="words"' if index in words else ""
            name = f' data-name="{escape(headers[index])}"' if words and tag == "td" else ""
            return f"<{tag}{kind}{name}>{escape(text)}</{tag}>"

        head = "".join(cell("th", i, text) for i, text in enumerate(headers))
        body = "".join("<tr>" + "".join(cell("td", i, text) for i, text in enumerate(row)) + "</tr>" for row in rows)
        title = f"<caption>{escape(caption)}</caption>" if caption else ""
        kind = "wide told" if words else "wide"
        self._parts.append(
            f'<div class="{kind}"><table>{title}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
        )

    def figure(self, figure: Figure, caption: str) -> None:
        """Embed a matplotlib figure drawn within `plotting`."""
        self._figures += 1
        self._parts.append(
            f"<figure>{as_svg(figure, self._figures)}<figcaption>{escape(caption)}</figcaption></figure>"
        )

    def panels(self, figures: Sequence[Figure], caption: str) -> None:
        """Figures beside one another, or below where the screen is narrow, under one caption."""
        drawn = []
        for figure in figures:
            self._figures += 1
            drawn.append(as_svg(figure, self._figures))
        self._parts.append(
            f'<figure><div class="panels">{"".join(drawn)}</div><figcaption>{escape(caption)}</figcaption></figure>'
        )

    def html(self) -> str:
        return (
            f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(self._title)}</title>'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<style>{_STYLE}</style></head>\n<body>\n" + "\n".join(self._parts) + "\n</body></html>\n"
        )


def can_plot() -> bool:
    """Whether matplotlib is installed."""
    return find_spec("matplotlib") is not None


def need_plots() -> None:
    """Raises InputError where matplotlib is missing: asked before long work whose page is nothing without figures."""
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

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": str(number)}):
        figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(_INK, "currentColor")
    # one page holds several plots: their ids must differ
    return re.sub(r'(\bid="|href="#|url\(#)', rf"\1f{number}-", svg)

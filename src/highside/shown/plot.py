"""What a chart shows, said without a drawing library: panels above one another, each with lines over one axis.

The same chart becomes a page to zoom and hover in (`highside.shown.screen`) or a figure for paper
(`highside.shown.paper`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from highside.errors import InputError
from highside.shown.panel import PlotPanel

if TYPE_CHECKING:
    import os

    from matplotlib.figure import Figure

__all__ = ["Plot"]

PAPER = (".png", ".svg", ".pdf")


@dataclass(frozen=True, slots=True)
class Plot:
    """A picture of a result.

    A notebook shows it so that one can zoom and hover (extra `notebook`; with matplotlib alone as a still picture).
    `save` writes it as a page (`.html`) or for paper (`.png`, `.svg`, `.pdf`); `figure` is matplotlib's, to go on with.
    """

    title: str
    panels: tuple[PlotPanel, ...]

    def figure(self) -> Figure:
        """A matplotlib figure, an axis a panel. Raises InputError where matplotlib (extra `plot`) is not installed."""
        from highside.shown.paper import figure_of

        return figure_of(self)

    def html(self) -> str:
        """A page that needs nothing beside it, no network either. Raises InputError where Bokeh (extra `notebook`) is
        not installed."""
        from highside.shown.screen import page_of

        return page_of(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `.html` (zoom and hover), or `.png`, `.svg` or `.pdf`.

        Raises InputError for another ending, for a file that cannot be written, and where the library that draws it is
        not installed.
        """
        target = Path(path)
        kind = target.suffix.lower()
        if kind not in (".html", *PAPER):
            raise InputError("is no kind of picture", where=str(target), remedy=f"end it in .html, {', '.join(PAPER)}")
        drawn = self.html() if kind == ".html" else self.figure()
        try:
            if isinstance(drawn, str):
                target.write_text(drawn, encoding="utf-8")
            else:
                drawn.savefig(target)
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", where=str(target)) from None

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        from highside.shown.screen import frame_of

        return frame_of(self)

"""Lines over one axis: what a plot is made of, without a drawing library."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Chart", "Look", "PlotLine", "PlotPanel", "thinned"]

Look = Literal["line", "dashed", "points"]
ROWS_DRAWN = 4000
"""of a longer panel the extremes of intervals are drawn, so that no peak is lost: more than a wide screen has pixels,
and 0.1 MB a panel of three lines in a page"""


@dataclass(frozen=True, slots=True)
class PlotLine:
    """One quantity over the panel's axis: N values, NaN where there is none."""

    name: str
    y: NDArray[np.float64]
    std: NDArray[np.float64] | None = None
    """(N,) half width of the band about a line, or of the bars about points"""
    look: Look = "line"
    colour: str | None = None


@dataclass(frozen=True, slots=True)
class PlotPanel:
    """Lines over a common axis of N values."""

    x: NDArray[np.float64]
    lines: tuple[PlotLine, ...]
    x_label: str = ""
    y_label: str = ""
    log: bool = False
    names: tuple[str, ...] = ()
    """words along x in the place of its numbers, (N,)"""


class Chart(Protocol):
    """What can be drawn: panels above one another, under a title."""

    @property
    def title(self) -> str: ...

    @property
    def panels(self) -> tuple[PlotPanel, ...]: ...


def thinned(panel: PlotPanel, most: int = ROWS_DRAWN) -> PlotPanel:
    """The panel with about `most` rows at most: of each interval of rows those in which a line has its extremes."""
    n = panel.x.size
    if n <= most or panel.names:
        return panel
    keep = {0, n - 1}
    edges = np.linspace(0, n, max(most // (2 * max(len(panel.lines), 1)), 1) + 1).astype(int)
    for line in panel.lines:
        y = np.where(np.isfinite(line.y), line.y, np.nan)
        for low, high in pairwise(edges):
            part = y[low:high]
            if np.isfinite(part).any():
                keep |= {low + int(np.nanargmin(part)), low + int(np.nanargmax(part))}
    rows = np.array(sorted(keep))
    lines = tuple(
        replace(line, y=line.y[rows], std=None if line.std is None else line.std[rows]) for line in panel.lines
    )
    return replace(panel, x=panel.x[rows], lines=lines)

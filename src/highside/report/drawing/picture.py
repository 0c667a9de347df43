"""Panels in rows and columns as one picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, tostring

from highside.report.drawing.letters import LEGEND
from highside.report.drawing.marks import Line, Points
from highside.report.drawing.panel import TURN, Panel, legend

__all__ = ["Picture"]

INCH = 72.0
EDGE = 3.0
"""pt around all"""
NAMES = 0.4
"""of its panel that names in place of numbers take at most"""


@dataclass(slots=True)
class Picture:
    """`rows` x `columns` panels, `height` inches a row and `width` in all; the axes of a column lie below one another,
    those of a row beside."""

    rows: int
    columns: int
    width: float = 10.5
    height: float = 3.2
    legend: Sequence[Line | Points] = ()
    """entries in one line above all panels"""
    panels: list[list[Panel]] = field(init=False)

    def __post_init__(self) -> None:
        self.panels = [[Panel() for _ in range(self.columns)] for _ in range(self.rows)]

    def svg(self) -> str:
        """The picture as an SVG element."""
        wide, tall = INCH * self.width, INCH * self.height * self.rows
        above = EDGE + (1.8 * LEGEND if self.legend else 0.0)
        row = (tall - above - EDGE) / self.rows
        for panel in (panel for line in self.panels for panel in line):
            panel.widest = NAMES * row / math.sin(math.radians(TURN)), NAMES * wide / self.columns
        # letters take a third of a row; how many numbers stand beside its axes hardly changes what they take
        rooms = [[panel.room(0.66 * row) for panel in line] for line in self.panels]
        lefts = [max(line[k].left for line in rooms) for k in range(self.columns)]
        rights = [max(line[k].right for line in rooms) for k in range(self.columns)]
        column = (wide - 2 * EDGE - sum(lefts) - sum(rights)) / self.columns
        size = {"width": f"{wide:g}pt", "height": f"{tall:g}pt", "viewBox": f"0 0 {wide:g} {tall:g}"}
        drawn = Element("svg", {"xmlns": "http://www.w3.org/2000/svg", **size, "fill": "currentColor"})
        drawn.extend([*legend(self.legend, wide / 2, EDGE + LEGEND, wide - 2 * EDGE)] if self.legend else ())
        for i, line in enumerate(self.panels):
            top = above + i * row + max(room.top for room in rooms[i])
            foot = above + (i + 1) * row - max(room.foot for room in rooms[i])
            for k, panel in enumerate(line):
                left = EDGE + sum(lefts[: k + 1]) + sum(rights[:k]) + k * column
                # as a list: `extend` says of a generator that fails only that it is no sequence
                drawn.extend([*panel.svg(left, top, left + column, foot, lefts[k])])
        return tostring(drawn, encoding="unicode")

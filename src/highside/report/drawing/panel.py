"""A panel of a picture: axes with what is drawn between them, and how much room its letters take."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import numpy as np

from highside.report.drawing.letters import LABEL, LEGEND, TICK, TITLE, in_two, text, whole_on_rest, width
from highside.report.drawing.marks import INK, Line, Mark, Points, Surface, stroked
from highside.report.drawing.scale import Scale, Ticks, limits_of

__all__ = ["Panel", "Room"]

GRID = "#808890"
APART_X, APART_Y = 34.0, 19.0
"""pt between ticks at least"""
GAP, MARK = 3.0, 3.5
"""pt between letters and what they belong to; length of a tick"""
LINE = 1.15
"""from line to line, in the size of the letters"""
KEY, KEYS_APART = 18.0, 12.0
"""pt of a line in a legend, and between its entries"""
COLUMN = 10.0
"""pt of the colours beside a surface"""


@dataclass(frozen=True, slots=True)
class Room:
    """pt beside the axes that a panel's letters take."""

    left: float
    right: float
    top: float
    foot: float


@dataclass(slots=True)
class Panel:
    """Axes and marks. `x_names` or `y_names` stand at 0, 1, ... in place of numbers; of `y_names` the first is on top.
    `legend`: the labels of marks in a line above the axes."""

    marks: list[Mark] = field(default_factory=list)
    title: str = ""
    x_label: str = ""
    y_label: str = ""
    log: bool = False
    legend: bool = False
    x_names: Sequence[str] = ()
    y_names: Sequence[str] = ()
    x_limits: tuple[float, float] | None = None
    widest: tuple[float, float] = (math.inf, math.inf)
    """pt that the longest of `x_names` and of `y_names` may take: as much as the picture has room for"""

    def add(self, *marks: Mark) -> None:
        self.marks.extend(marks)

    def labelled(self) -> list[Line | Points]:
        """Marks that have an entry in a legend."""
        return [mark for mark in self.marks if isinstance(mark, Line | Points) and mark.label]

    def room(self, tall: float) -> Room:
        """What its letters take where its axes are about `tall` pt high."""
        _, y = self._scales(0.0, 1.0, tall, 0.0)
        numbers = self._y_ticks(y)
        widest = max((width(words, LABEL if self.y_names else TICK) for words in numbers.words), default=0.0)
        widest = min(widest, self.widest[1]) if self.y_names else widest
        left = MARK + GAP + widest + (GAP + 1.4 * LABEL if self.y_label else 0.0)
        top = (1.5 * TITLE if self.title or numbers.factor else 4.0) + (1.6 * LEGEND if self._has_legend else 0.0)
        turned = min(max((width(name, TICK) for name in self.x_names), default=0.0), self.widest[0])
        turned *= math.sin(math.radians(TURN))
        foot = MARK + GAP + (turned + TICK if self.x_names else TICK) + (GAP + LABEL if self.x_label else 0.0) + GAP
        surface = next((mark for mark in self.marks if isinstance(mark, Surface)), None)
        right = 8.0
        if surface is not None:
            right += (
                GAP + COLUMN + MARK + GAP + max((width(w, TICK) for w in _key_ticks(surface, tall).words), default=0.0)
            )
        return Room(left, right, top, foot)

    def svg(self, left: float, top: float, right: float, foot: float, margin: float) -> Iterator[Element]:
        """The panel with its axes between four edges, pt; its letters stand beyond them, `margin` pt to the left."""
        x, y = self._scales(left, right, foot, top)
        across = Ticks(tuple(range(len(self.x_names))), tuple(self.x_names)) if self.x_names else _beside(x)
        up = self._y_ticks(y)
        at, level = [float(v) for v in x(np.array(across.at))], [float(v) for v in y(np.array(up.at))]
        surface = next((mark for mark in self.marks if isinstance(mark, Surface)), None)
        grid = "".join(f"M{v:.1f},{foot:.1f}V{top:.1f}" for v in at) if surface is None else ""
        if surface is None and not self.y_names:
            grid += "".join(f"M{left:.1f},{v:.1f}H{right:.1f}" for v in level)
        axes = f"M{left:.1f},{top:.1f}V{foot:.1f}H{right:.1f}"
        axes += "".join(f"M{v:.1f},{foot:.1f}v{MARK:g}" for v in at)
        axes += "".join(f"M{left:.1f},{v:.1f}h-{MARK:g}" for v in level)
        yield stroked(grid, GRID, 0.6, alpha=0.3)
        for mark in self.marks:
            yield from mark.svg(x, y)
        yield stroked(axes, INK, 0.8)
        turned, named = bool(self.x_names), bool(self.y_names)
        yield from _numbers_across(at, across, foot, right, self.widest[0] if turned else math.inf, turned=turned)
        yield from _numbers_up(level, up, left, top, LABEL if named else TICK, self.widest[1] if named else math.inf)
        yield from self._words(left, top, right, foot, margin)
        if surface is not None:
            yield from _key(surface, right, top, foot)

    @property
    def _has_legend(self) -> bool:
        return self.legend and bool(self.labelled())

    def _scales(self, left: float, right: float, foot: float, top: float) -> tuple[Scale, Scale]:
        reaches = [mark.reach() for mark in self.marks]
        low, high = limits_of([along for along, _ in reaches])
        if self.x_limits is not None and np.isfinite(self.x_limits).all() and self.x_limits[0] < self.x_limits[1]:
            low, high = self.x_limits
        below, above = limits_of([up for _, up in reaches], log=self.log)
        if any(isinstance(mark, Surface) for mark in self.marks):
            (low, high), (below, above) = ((float(v.min()), float(v.max())) for v in reaches[0])
        start, end = (top, foot) if self.y_names else (foot, top)
        return Scale(low, high, left, right), Scale(below, above, start, end, self.log)

    def _y_ticks(self, y: Scale) -> Ticks:
        if self.y_names:
            return Ticks(tuple(range(len(self.y_names))), tuple(self.y_names))
        return y.ticks(APART_Y)

    def _words(self, left: float, top: float, right: float, foot: float, margin: float) -> Iterator[Element]:
        """Title, legend and what the axes are."""
        room, wide = self.room(foot - top), right - left

        def above_what(words: str, size: float) -> float:
            """The middle of the axes; of the whole panel for words that are wider than the axes."""
            return (left + right - (margin if width(words, size) > wide else 0.0)) / 2

        most = wide + margin
        if self.title:
            at = above_what(self.title, TITLE), top - room.top + 1.1 * TITLE
            yield text(*at, self.title, TITLE, "middle", most=most)
        if self._has_legend:
            yield from legend(self.labelled(), (left + right) / 2, top - 0.6 * LEGEND, wide)
        if self.x_label:
            at = above_what(self.x_label, LABEL), foot + room.foot - GAP
            yield text(*at, self.x_label, LABEL, "middle", most=most)
        if self.y_label:
            tall = foot - top + room.top + room.foot
            middle = (top + foot) / 2
            if width(self.y_label, LABEL) > foot - top:
                middle += (room.foot - room.top) / 2
            yield text(left - margin + LABEL, middle, self.y_label, LABEL, "middle", -90.0, tall)


TURN = 60.0
"""degrees by which names below an axis are turned"""


def legend(marks: Sequence[Line | Points], middle: float, y: float, most: float) -> Iterator[Element]:
    """A line of entries, centred, `most` pt wide or less; `y` is the foot of its letters."""
    letters = [width(mark.label, LEGEND) for mark in marks]
    room = most - (KEY + GAP) * len(marks) - KEYS_APART * (len(marks) - 1)
    # those that are longer than their share are cut to what the others leave
    share = room / len(marks)
    if sum(letters) > room:
        free = sum(max(share - own, 0.0) for own in letters)
        share += free / sum(own > share for own in letters)
    letters = [min(own, share) if sum(letters) > room else own for own in letters]
    wide = [KEY + GAP + own for own in letters]
    x = middle - (sum(wide) + KEYS_APART * (len(marks) - 1)) / 2
    for mark, own in zip(marks, wide, strict=True):
        if isinstance(mark, Points):
            sample: Mark = Points(np.array([x + KEY / 2]), np.zeros(1), mark.colour, size=mark.size)
        else:
            sample = Line(np.array([x, x + KEY]), np.zeros(2), mark.colour, "", mark.width, mark.dashed)
        yield from sample.svg(Scale(0.0, 1.0, 0.0, 1.0), Scale(0.0, 1.0, y - 0.35 * LEGEND, 0.0))
        yield text(x + KEY + GAP, y, mark.label, LEGEND, most=own - KEY - GAP + 0.1)
        x += own + KEYS_APART


def _numbers_across(
    at: list[float], ticks: Ticks, foot: float, right: float, most: float, *, turned: bool
) -> Iterator[Element]:
    y = foot + MARK + GAP
    for x, words in zip(at, ticks.words, strict=True):
        yield (
            text(x + 3.0, y + 3.0, words, TICK, "end", -TURN, most)
            if turned
            else text(x, y + 0.8 * TICK, words, TICK, "middle")
        )
    if ticks.factor:
        yield text(right, foot - GAP, ticks.factor, TICK, "end")


def _numbers_up(
    level: list[float], ticks: Ticks, left: float, top: float, size: float, most: float
) -> Iterator[Element]:
    for y, words in zip(level, ticks.words, strict=True):
        lines = in_two(words, size, most)
        for k, line in enumerate(lines):
            down = 0.35 * size + (k - 0.5 * (len(lines) - 1)) * LINE * size
            yield whole_on_rest(text(left - MARK - GAP, y + down, line, size, "end", most=most), line, words)
    if ticks.factor:
        yield text(left, top - GAP, ticks.factor, TICK)


def _beside(x: Scale) -> Ticks:
    """Numbers along x that do not touch one another."""
    ticks = x.ticks(APART_X)
    widest = max((width(words, TICK) for words in ticks.words), default=0.0) + 2 * GAP
    return ticks if widest <= APART_X else x.ticks(widest)


def _key_ticks(surface: Surface, tall: float) -> Ticks:
    return Scale(surface.low, surface.high, tall, 0.0).ticks(APART_Y)


def _key(surface: Surface, right: float, top: float, foot: float) -> Iterator[Element]:
    """The colours of a surface as a column, with numbers."""
    values = Scale(surface.low, surface.high, foot, top)
    up = (np.arange(64) + 0.5) / 64
    column = np.repeat((surface.low * (1.0 - up) + surface.high * up)[:, None], 2, axis=1)
    left = right + GAP + 3.0
    shown = Surface(np.array([0.0, 1.0]), up, column, surface.low, surface.high, surface.colours)
    yield from shown.svg(Scale(-0.5, 1.5, left, left + COLUMN), Scale(0.0, 1.0, foot, top))
    ticks = values.ticks(APART_Y)
    for y, words in zip(values(np.array(ticks.at)), ticks.words, strict=True):
        yield text(left + COLUMN + GAP, float(y) + 0.35 * TICK, words, TICK)
    if ticks.factor:
        yield text(left, top - GAP, ticks.factor, TICK)

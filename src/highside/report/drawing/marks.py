"""What is drawn within a panel. Each mark says which values it reaches to and how it looks as SVG."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol
from xml.etree.ElementTree import Element

import numpy as np

from highside.arrays import Array
from highside.report.drawing.letters import LABEL, text
from highside.report.drawing.scale import Scale

__all__ = ["INK", "Area", "Bar", "Level", "Line", "Mark", "Points", "Strip", "Surface", "Words", "stroked"]

INK = "currentColor"
"""the colour of the page's text"""
DASHES = "4 2"
UNKNOWN = (128.0, 136.0, 144.0)
"""red, green and blue of what is no number"""
NONE = np.zeros(0)


class Mark(Protocol):
    """Something drawn."""

    def reach(self) -> tuple[Array, Array]:
        """Values along x and along y that lie within the panel."""
        ...

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        """The mark in the picture."""
        ...


@dataclass(frozen=True, slots=True)
class Line:
    """A line through points (N,); it has a gap where a value is no number. `dots`: a dot of so many pt at each."""

    x: Array
    y: Array
    colour: str = INK
    label: str = ""
    width: float = 1.2
    dashed: bool = False
    dots: float = 0.0

    def reach(self) -> tuple[Array, Array]:
        return np.asarray(self.x), np.asarray(self.y)

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        at, up = x(self.x), y(self.y)
        known = np.isfinite(at) & np.isfinite(up)
        paths = ("M" + _points(at[k], up[k], "L") for k in _runs(known))
        yield stroked("".join(paths), self.colour, self.width, dashed=self.dashed)
        if self.dots:
            yield _dots(at[known], up[known], self.colour, self.dots, 1.0)


@dataclass(frozen=True, slots=True)
class Points:
    """Dots of `size` pt at points (N,), with one standard deviation (N,) up and down where it is known."""

    x: Array
    y: Array
    colour: str = INK
    label: str = ""
    size: float = 3.0
    alpha: float = 1.0
    std: Array | None = None

    def reach(self) -> tuple[Array, Array]:
        y = np.asarray(self.y)
        return np.asarray(self.x), y if self.std is None else np.concatenate([y - self.std, y + self.std])

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        at, up = x(self.x), y(self.y)
        known = np.isfinite(at) & np.isfinite(up)
        yield _dots(at[known], up[known], self.colour, self.size, self.alpha)
        if self.std is not None:
            low, high = y(self.y - self.std), y(self.y + self.std)
            known &= np.isfinite(low) & np.isfinite(high)
            ends = zip(at[known], low[known], high[known], strict=True)
            bars = "".join(f"M{a:.1f},{b:.1f}V{c:.1f}" for a, b, c in ends)
            yield stroked(bars, self.colour, 1.2)


@dataclass(frozen=True, slots=True)
class Area:
    """Between two lines (N,) over x (N,); it has a gap where one of them is no number."""

    x: Array
    low: Array
    high: Array
    colour: str
    alpha: float

    def reach(self) -> tuple[Array, Array]:
        return np.asarray(self.x), np.concatenate([self.low, self.high])

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        at, low, high = x(self.x), y(self.low), y(self.high)
        path = ""
        for k in _runs(np.isfinite(at) & np.isfinite(low) & np.isfinite(high)):
            there, back = _points(at[k], low[k], "L"), _points(at[k][::-1], high[k][::-1], "L")
            path += f"M{there}L{back}Z"
        yield Element("path", {"d": path, "fill": self.colour, "fill-opacity": f"{self.alpha:g}"})


@dataclass(frozen=True, slots=True)
class Level:
    """A straight line across the panel at a value: of y, or upright of x."""

    at: float
    colour: str
    width: float = 0.8
    dashed: bool = False
    upright: bool = False

    def reach(self) -> tuple[Array, Array]:
        own = np.array([self.at])
        return (own, NONE) if self.upright else (NONE, own)

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        if not np.isfinite(x(self.at) if self.upright else y(self.at)):
            return
        path = (
            f"M{x(self.at):.1f},{y.start:.1f}V{y.end:.1f}"
            if self.upright
            else f"M{x.start:.1f},{y(self.at):.1f}H{x.end:.1f}"
        )
        yield stroked(path, self.colour, self.width, dashed=self.dashed)


@dataclass(frozen=True, slots=True)
class Strip:
    """All between two values: of y, or upright of x."""

    low: float
    high: float
    colour: str
    alpha: float
    upright: bool = False

    def reach(self) -> tuple[Array, Array]:
        own = np.array([self.low, self.high])
        return (own, NONE) if self.upright else (NONE, own)

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        if np.isnan([self.low, self.high]).any():
            return
        # to the border of the panel where there is no end, or none that its scale knows
        along = x if self.upright else y
        low, high = (float(along(min(max(v, along.low), along.high))) for v in (self.low, self.high))
        box = _box(low, y.start, high, y.end) if self.upright else _box(x.start, low, x.end, high)
        yield Element("rect", {**box, "fill": self.colour, "fill-opacity": f"{self.alpha:g}"})


@dataclass(frozen=True, slots=True)
class Bar:
    """A bar of a row (row k lies around y = k), from one value of x to another."""

    row: int
    low: float
    high: float
    colour: str
    thick: float = 0.62

    def reach(self) -> tuple[Array, Array]:
        half = self.thick / 2
        return np.array([self.low, self.high]), np.array([self.row - half, self.row + half])

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        if not np.isfinite([self.low, self.high]).all():
            return
        half = self.thick / 2
        box = _box(x(self.low), y(self.row - half), x(self.high), y(self.row + half))
        yield Element("rect", {**box, "fill": self.colour})


@dataclass(frozen=True, slots=True)
class Words:
    """Words beside a point, to the right of it."""

    x: float
    y: float
    words: str

    def reach(self) -> tuple[Array, Array]:
        return np.array([self.x]), np.array([self.y])

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        if not np.isfinite([x(self.x), y(self.y)]).all():
            return
        yield text(float(x(self.x)) + 5.0, float(y(self.y)) + 0.35 * LABEL, self.words, LABEL)


@dataclass(frozen=True, slots=True)
class Surface:
    """Colours of values (M, N) at evenly spaced y (M,) and x (N,): from those of `low` to those of `high`; what is no
    number is grey."""

    x: Array
    y: Array
    values: Array
    low: float
    high: float
    colours: Sequence[str]
    """at even steps from low to high, "#rrggbb" """

    def reach(self) -> tuple[Array, Array]:
        (left, right), (below, above) = _edges(self.x), _edges(self.y)
        return np.array([left, right]), np.array([below, above])

    def svg(self, x: Scale, y: Scale) -> Iterator[Element]:
        (left, right), (below, above) = _edges(self.x), _edges(self.y)
        pixels = coloured(self.values[::-1], self.low, self.high, self.colours)
        box = _box(x(left), y(below), x(right), y(above))
        data = f"data:image/png;base64,{png(pixels)}"
        yield Element("image", {**box, "preserveAspectRatio": "none", "href": data})


def coloured(values: Array, low: float, high: float, colours: Sequence[str]) -> np.ndarray:
    """(M, N) -> (M, N, 3) red, green and blue, between the nearest two of the colours."""
    steps = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in colours], dtype=float)
    # halves: the range may be longer than the largest number
    share = (np.asarray(values) / 2 - low / 2) / ((high / 2 - low / 2) or 1.0)
    along = np.clip(share, 0.0, 1.0) * (len(colours) - 1)
    at = np.arange(len(colours))
    mixed = np.stack([np.interp(along, at, steps[:, k]) for k in range(3)], axis=-1)
    return np.where(np.isnan(along)[..., None], UNKNOWN, mixed).round().astype(np.uint8)


def png(pixels: np.ndarray) -> str:
    """An image (M, N, 3) of bytes as PNG (ISO/IEC 15948) in base64: rows without a filter, each after a zero."""
    rows, columns = pixels.shape[:2]
    raw = np.concatenate([np.zeros((rows, 1), dtype=np.uint8), pixels.reshape(rows, -1)], axis=1).tobytes()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    parts = chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(raw, 9)), chunk(b"IEND", b"")
    return base64.b64encode(b"\x89PNG\r\n\x1a\n" + b"".join(parts)).decode("ascii")


def _edges(at: Array) -> tuple[float, float]:
    """Of evenly spaced values: half a step beyond both ends."""
    half = float(at[1] - at[0]) / 2
    return float(at[0]) - half, float(at[-1]) + half


def stroked(path: str, colour: str, width: float, *, dashed: bool = False, alpha: float = 1.0) -> Element:
    """Lines along a path."""
    made = Element("path", {"d": path, "fill": "none", "stroke": colour, "stroke-width": f"{width:g}"})
    if dashed:
        made.set("stroke-dasharray", DASHES)
    if alpha < 1:
        made.set("stroke-opacity", f"{alpha:g}")
    return made


def _box(x0: float | Array, y0: float | Array, x1: float | Array, y1: float | Array) -> dict[str, str]:
    left, right = sorted((float(x0), float(x1)))
    top, foot = sorted((float(y0), float(y1)))
    sides = {"x": left, "y": top, "width": right - left, "height": foot - top}
    return {name: f"{value:.1f}" for name, value in sides.items()}


def _points(at: Array, up: Array, between: str) -> str:
    return between.join(f"{a:.1f},{b:.1f}" for a, b in zip(at.tolist(), up.tolist(), strict=True))


def _runs(known: np.ndarray) -> Iterator[np.ndarray]:
    """Which points follow one another without a gap: (N,) truth values to the places of each run."""
    for run in np.split(np.arange(known.size), np.flatnonzero(~known)):
        own = run[known[run]]
        if own.size:
            yield own


def _dots(at: Array, up: Array, colour: str, size: float, alpha: float) -> Element:
    """All dots in one path: lines of no length with round ends."""
    made = stroked(f"M{_points(at, up, 'h0M')}h0" if at.size else "", colour, size, alpha=alpha)
    made.set("stroke-linecap", "round")
    return made

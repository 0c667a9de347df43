"""Scales of a panel's axes: from values to points of the picture, and the values that are written beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.report.drawing.letters import raised

__all__ = ["Scale", "Ticks", "limits_of"]

MARGIN = 0.05
"""of the range of the values, at both ends"""
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
MOST = 9
"""steps between ticks at most, however long the axis"""
LARGE, SMALL = 5, -4
"""powers of ten beyond which one is written once for all ticks"""
FAR, SHIFT = 200, 150
"""powers of ten beyond which ticks are sought in units of another by so many: sums and steps of values that are so
large are beyond the largest number there is, and those of values that are so small lose their figures"""
LARGEST = float(np.finfo(float).max)
LEAST = float(np.finfo(float).smallest_subnormal)


@dataclass(frozen=True, slots=True)
class Ticks:
    """Values on an axis and what is written at each; `factor` stands once for all of them."""

    at: tuple[float, ...]
    words: tuple[str, ...]
    factor: str = ""


@dataclass(frozen=True, slots=True)
class Scale:
    """Values from `low` to `high` lie between two points of the picture; `log`: by powers of ten."""

    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, values: Array | float) -> Array:
        """Where values are; what is no number, or not positive on a scale of powers, is nowhere (NaN)."""
        v, low, high = np.asarray(values, dtype=float), self.low, self.high
        if self.log:
            v = np.log10(np.where(v > 0, v, np.nan))
            low, high = math.log10(low), math.log10(high)
        # halves: the range may be longer than the largest number
        with np.errstate(invalid="ignore"):
            share = (v / 2 - low / 2) / (high / 2 - low / 2)
        return np.asarray(self.start + (self.end - self.start) * np.where(np.isfinite(share), share, np.nan))

    def ticks(self, apart: float) -> Ticks:
        """Round values, about `apart` points from one another or more; none where all is one value."""
        if not self.low < self.high:
            return Ticks((), ())
        most = min(max(int(abs(self.end - self.start) / apart), 1), MOST)
        return _powers(self.low, self.high, most) if self.log else _even(self.low, self.high, most)


def limits_of(parts: list[Array], *, log: bool = False) -> tuple[float, float]:
    """The range of all values with a margin; where there is but one value, a range around it."""
    values = np.concatenate([np.ravel(np.asarray(p, dtype=float)) for p in parts]) if parts else np.zeros(1)
    values = values[np.isfinite(values) & ((values > 0) if log else True)]
    if values.size == 0:
        return (0.1, 10.0) if log else (-1.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        low, high = math.log10(low), math.log10(high)
    pad = 2 * (MARGIN * (high / 2 - low / 2))
    if pad <= 1e-13 * max(abs(low), abs(high)):
        pad = MARGIN * abs(high) or MARGIN
    low, high = low - pad, high + pad
    if log:
        with np.errstate(over="ignore", under="ignore"):
            low, high = float(np.power(10.0, low)), float(np.power(10.0, high))
    return max(low, LEAST if log else -LARGEST), min(high, LARGEST)


def _even(low: float, high: float, most: int) -> Ticks:
    """At most `most` + 1 values that are multiples of a round step."""
    power = math.floor(math.log10(max(abs(low), abs(high))))
    shift = 0 if abs(power) <= FAR else math.copysign(SHIFT, power)
    unit = 10.0**shift
    low, high = low / unit, high / unit
    least = (high - low) / most
    power = math.floor(math.log10(least))
    step = next(s for s in STEPS if s * 10.0**power >= 0.999999 * least) * 10.0**power
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    at = [k * step for k in range(first, last + 1)]
    top = max((abs(value) for value in at), default=0.0)
    common = math.floor(math.log10(top)) if top > 0 else 0
    common = common if shift or common >= LARGE or common <= SMALL else 0
    # a step of 2.5 has a figure more
    exact = math.floor(math.log10(step) + 1e-9)
    places = max(common - exact + (0 if round(step / 10.0**exact, 6) % 1 == 0 else 1), 0)
    words = (f"{value / 10.0**common:.{places}f}" for value in at)
    factor = int(common + shift)
    return Ticks(
        tuple(value * unit for value in at),
        tuple(map(_with_minus, words)),
        f"\N{MULTIPLICATION SIGN}{raised(factor)}" if factor else "",
    )


def _with_minus(number: str) -> str:
    """With a minus sign, but not before nothing."""
    return number.replace("-", "\N{MINUS SIGN}" if float(number) else "")


def _powers(low: float, high: float, most: int) -> Ticks:
    """Powers of ten; between a few of them their multiples too."""
    first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
    if last - first >= 1:
        every = max(math.ceil((last - first + 1) / (most + 1)), 1)
        powers = range(first, last + 1, every)
        return Ticks(tuple(10.0**p for p in powers), tuple(raised(p) for p in powers))
    for multiples in ((1, 2, 3, 4, 5, 6, 7, 8, 9), (1, 2, 3, 5), (1, 2, 5), (1, 3)):
        at = [m * 10.0**p for p in range(first - 1, last + 1) for m in multiples]
        at = [value for value in at if low <= value <= high]
        if 2 <= len(at) <= max(most, 2) + 1:
            return Ticks(tuple(at), tuple(_plain(value) for value in at))
    return _even(low, high, most)


def _plain(value: float) -> str:
    power = math.floor(math.log10(value) + 1e-9)
    if SMALL < power < LARGE:
        return f"{value:g}"
    factor = round(value / 10.0**power)
    return raised(power) if factor == 1 else f"{factor}\N{MULTIPLICATION SIGN}{raised(power)}"

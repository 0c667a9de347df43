"""The functions of one covariate that laws are made of, by their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from highside.arrays import AnyArray

MARGIN = 0.1
"""Share of the range visited by which that of a wide cosine is longer on either side. Source: a factor of 1.2 to 1.5 of
the whole is what series of a smooth process over a range need (Riutort-Mayol et al. 2023, Stat. Comput. 33, 17); six
cases of the open world of seed d31709b closed no more with 0.15 and 0.25"""

Span = tuple[float, float]
Shape = Callable[..., AnyArray]


def _cosine(u: AnyArray, span: Span, order: AnyArray | float) -> AnyArray:
    low, high = span
    return np.cos(np.pi * order * (u - low) / (high - low if high > low else 1.0))


def cosines_up_to(u: AnyArray, span: Span, count: int) -> AnyArray:
    """(count, n) the cosines of orders 1 to count, as powers of exp(i x): right to `count` roundings, in a tenth of the
    time that as many cosines take."""
    low, high = span
    first = np.exp(1j * np.pi * (u - low) / (high - low if high > low else 1.0))
    power, made = np.ones_like(first), np.empty((count, u.size))
    for row in made:
        power *= first
        row[:] = power.real
    return made


def _bump(u: AnyArray, span: Span, centre: float, width: float) -> AnyArray:
    return np.exp(-0.5 * ((u - centre) / width) ** 2)


def _dent(u: AnyArray, span: Span, centre: float, width: float) -> AnyArray:
    apart = np.mod(u - centre + 180.0, 360.0) - 180.0
    return np.exp(-0.5 * (apart / width) ** 2)


def _decay(u: AnyArray, span: Span, start: float, tau: float) -> AnyArray:
    return np.where(u >= start, np.exp(-np.maximum(u - start, 0.0) / tau), 0.0)


def _straight(u: AnyArray, span: Span) -> AnyArray:
    low, high = span
    return (2 * u - low - high) / (high - low if high > low else 1.0)


def _wide_cosine(u: AnyArray, span: Span, order: AnyArray | float) -> AnyArray:
    """A cosine over a range that is wider than the one visited: within that it has a slope at the ends as well."""
    return _cosine(u, wider(span), order)


def wider(span: Span) -> Span:
    low, high = span
    room = MARGIN * (high - low)
    return low - room, high + room


FUNCTIONS: dict[str, tuple[Shape, int, str]] = {
    "one": (lambda u, s: np.ones_like(u), 0, ""),
    "cosine": (_cosine, 1, "cos(pi {0} (({u}) - low) / (high - low))"),
    "straight": (_straight, 0, "(2 ({u} - low) / (high - low) - 1)"),
    "square": (lambda u, s: _straight(u, s) ** 2, 0, "(2 ({u} - low) / (high - low) - 1)^2"),
    "wide_cosine": (_wide_cosine, 1, f"cos(pi {{0}} (({{u}} - low) / (high - low) + {MARGIN}) / {1 + 2 * MARGIN})"),
    "cos": (lambda u, s, k: np.cos(k * np.radians(u)), 1, "cos({0} {u})"),
    "sin": (lambda u, s, k: np.sin(k * np.radians(u)), 1, "sin({0} {u})"),
    "linear": (lambda u, s, c: u - c, 1, "({u} - {0})"),
    "power": (lambda u, s, c, p: np.abs(u - c) ** p, 2, "|{u} - {0}|^{1}"),
    "odd_power": (lambda u, s, c, p: np.sign(u - c) * np.abs(u - c) ** p, 2, "sign({u} - {0}) |{u} - {0}|^{1}"),
    "modulus": (lambda u, s, c: np.abs(u - c), 1, "|{u} - {0}|"),
    "step": (lambda u, s, c: np.where(u >= c, 1.0, 0.0), 1, "[{u} >= {0}]"),
    "sign": (lambda u, s: np.sign(u), 0, "sign({u})"),
    "ramp": (lambda u, s, c: np.maximum(u - c, 0.0), 1, "max({u} - {0}, 0)"),
    "decay": (_decay, 2, "[{u} >= {0}] exp(-({u} - {0}) / {1})"),
    "exponential": (lambda u, s, c, w: np.exp((u - c) / w), 2, "exp(({u} - {0}) / {1})"),
    "sine": (lambda u, s, p: np.sin(2 * np.pi * u / p), 1, "sin(2 pi {u} / {0})"),
    "cosine_of": (lambda u, s, p: np.cos(2 * np.pi * u / p), 1, "cos(2 pi {u} / {0})"),
    "bump": (_bump, 2, "exp(-(({u} - {0}) / {1})^2 / 2)"),
    "dent": (_dent, 2, "exp(-(({u} - {0}) / {1})^2 / 2)"),
    "saturation": (lambda u, s, c, w: np.tanh((u - c) / w), 2, "tanh(({u} - {0}) / {1})"),
}
"""Functions of one covariate: (values (n,), range visited, numbers ...), how many numbers, and how it is written."""


@dataclass(frozen=True)
class Function:
    """A name of `FUNCTIONS` with its numbers."""

    kind: str
    numbers: tuple[float, ...] = ()

    def __call__(self, u: AnyArray, span: Span) -> AnyArray:
        """(n,)."""
        return np.asarray(FUNCTIONS[self.kind][0](u, span, *self.numbers))

    def text(self, name: str) -> str:
        """As it is written, of a covariate of that name."""
        return FUNCTIONS[self.kind][2].format(*(f"{number:.4g}" for number in self.numbers), u=name)

"""Shapes of laws: smooth random processes and formulas, as functions of covariates scaled to -1..1.

The processes are sums of waves of random frequency (the spectral representation of a stationary Gaussian process,
Rahimi and Recht 2007), of a length drawn for each; over an angle they are sums of its harmonics, so that they close.
Formulas are what a laboratory book writes down. Everything is a value: a shape can be stored and evaluated again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

Params = dict[str, Any]
WAVES = 40

FORMULAS = (
    "power", "modulus", "kink", "saturation", "exponential", "sine", "bump", "threshold_tanh",
)  # fmt: skip
CIRCLE_FORMULAS = ("dent", "line", "square")
"""of an angle: a dent at one place, a line of non-integer order, a square wave with round corners"""


@dataclass(frozen=True)
class Shape:
    """A function of one scaled covariate, or of two."""

    kind: str
    params: Params

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """Its values (n,) for covariates (k, n): -1..1, or rad of an angle."""
        if self.kind == "product":
            first, second = (Shape(**part) for part in self.params["parts"])
            return first(u[:1]) * second(u[1:])
        if self.kind == "process":
            p = self.params
            phase = np.einsum("wk,kn->wn", np.array(p["frequencies"]), u) + np.array(p["phases"])[:, None]
            return np.sqrt(2.0 / WAVES) * np.cos(phase).sum(axis=0)
        if self.kind == "harmonics":
            p = self.params
            orders = np.arange(1, len(p["cos"]) + 1)[:, None]
            return np.array(p["cos"]) @ np.cos(orders * u[0]) + np.array(p["sin"]) @ np.sin(orders * u[0])
        return _formula(self.kind, self.params, u[0])


def _formula(kind: str, p: Params, x: np.ndarray) -> np.ndarray:
    a = p.get("at", 0.0)
    w = p.get("width", 1.0)
    if kind == "power":
        return np.abs(x - a) ** p["exponent"] * (np.sign(x - a) if p["odd"] else 1.0)
    if kind == "modulus":
        return np.abs(x - a)
    if kind == "kink":
        return np.maximum(x - a, 0.0)
    if kind == "saturation":
        return (x - a) / (w + np.abs(x - a))
    if kind == "exponential":
        return np.exp((x + 1.0) / w)
    if kind == "sine":
        return np.sin(p["frequency"] * x + p["phase"])
    if kind == "bump":
        return np.exp(-0.5 * ((x - a) / w) ** 2)
    if kind == "threshold_tanh":
        return np.tanh((x - a) / w)
    if kind == "identity":
        return x.copy()
    if kind == "sign":
        return np.sign(x)
    if kind == "dent":
        return np.exp((np.cos(x - a) - 1.0) / w**2)
    if kind == "line":
        return np.cos(p["order"] * x + p["phase"])
    if kind == "square":
        return np.tanh(np.cos(p["order"] * x + p["phase"]) / w)
    raise ValueError(kind)


def drawn(rng: np.random.Generator, angle: bool, *, formula: bool) -> Shape:
    """A shape of one covariate."""
    return _drawn_formula(rng, angle) if formula else _drawn_process(rng, angle)


def _drawn_process(rng: np.random.Generator, angle: bool) -> Shape:
    if angle:
        orders = np.arange(1, int(rng.integers(4, 9)))
        size = np.where(orders < 3, 0.5, 1.0) * np.exp(-orders / rng.uniform(1.5, 5.0))
        parts = {"cos": (rng.standard_normal(orders.size) * size).tolist()}
        return Shape("harmonics", parts | {"sin": (rng.standard_normal(orders.size) * size).tolist()})
    length = rng.uniform(0.25, 0.9)
    return process(rng, (length,))


def process(rng: np.random.Generator, lengths: tuple[float, ...]) -> Shape:
    """A smooth process of as many covariates as there are lengths."""
    frequencies = rng.standard_normal((WAVES, len(lengths))) / np.array(lengths)
    return Shape("process", {"frequencies": frequencies.tolist(), "phases": rng.uniform(0, 2 * np.pi, WAVES).tolist()})


def _drawn_formula(rng: np.random.Generator, angle: bool) -> Shape:
    if angle:
        kind = str(rng.choice(CIRCLE_FORMULAS))
        order = rng.uniform(1.3, 7.7) if kind == "line" else float(rng.integers(2, 5))
        return Shape(
            kind, {"at": rng.uniform(0, 2 * np.pi), "width": rng.uniform(0.3, 0.8), "order": order,
                   "phase": rng.uniform(0, 2 * np.pi)},
        )  # fmt: skip
    kind = str(rng.choice(FORMULAS))
    exponent = float(rng.choice([1.5, 2.5, 4.0, 5.0]))
    return Shape(
        kind, {"at": rng.uniform(-0.5, 0.5) if kind != "power" else 0.0, "width": rng.uniform(0.2, 0.6),
               "exponent": exponent, "odd": bool(rng.integers(2)), "frequency": rng.uniform(2.0, 8.0),
               "phase": rng.uniform(0, 2 * np.pi)},
    )  # fmt: skip

"""Shapes of slow effects at rest between the values of their grids: the instant of a step, the length of a warm-up.

A grid is fine enough for an effect that is hardly larger than the noise. Of a large one, what lies between two values
is large as well, and runs like a random walk: the larger the effect, the less it would be named. So each effect with
one shape gets a further variant where it explains the residual best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Variant
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import MAGNITUDE_SHAPES
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel


def sharpened(
    observed: Magnitudes, model: ForwardModel, candidates: Sequence[Candidate], base: Array, residual: Array
) -> list[Candidate]:
    """Candidates of a rest, each with one shape at its best as well. `base` (P, 1, n), `residual` (1, n)."""
    space = span(base[:, 0])
    return [_sharpened(observed, model, one, space, outside(space, residual[0])) for one in candidates]


def _sharpened(observed: Magnitudes, model: ForwardModel, candidate: Candidate, space: Array, left: Array) -> Candidate:
    effect = candidate.effect
    if effect is None or len(effect.shapes) != 1:
        return candidate
    shape = effect.shapes[0]
    whole = [v for v in candidate.variants if v.whole]
    if not (shape.epoch or shape.time_constant) or not whole:
        return candidate

    def columns(value: float) -> Array:
        return observed.columns(model, effect, {shape.name: value})

    def gain(value: float) -> float:
        return _gain(columns(value), space, left)

    tried = sorted({v.shape[shape.name] for v in whole})
    gains = [_gain(next(v for v in whole if v.shape[shape.name] == value).columns, space, left) for value in tried]
    k = int(np.argmax(gains))
    low, high = tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]
    if shape.epoch:
        t_s = observed.session.t_s - observed.session.t_s[0]
        between = (t_s[:-1] + t_s[1:]) / 2
        inner = between[(between > low) & (between < high)]
        best = max((float(value) for value in inner), key=gain, default=tried[k])
    else:
        best = _highest(gain, low, high)
    if best in tried or gain(best) <= gains[k]:
        return candidate
    made = columns(best)
    new = [
        Variant({shape.name: best}, made[list(part)], whole=len(part) == len(candidate.amplitudes))
        for part in _parts(effect)
        if np.any(made[list(part)] != 0)
    ]
    return replace(candidate, variants=(*candidate.variants, *new))


def _parts(effect: Effect) -> Sequence[Sequence[int]]:
    return [tuple(part) for part in effect.parts]


def _gain(columns: Array, space: Array, left: Array) -> float:
    own = span(outside(space, columns[:, 0]), tolerance=MAGNITUDE_SHAPES.independent)
    return float(np.sum((own @ left) ** 2))


def _highest(gain: Callable[[float], float], low: float, high: float) -> float:
    """The time constant between two that explains most, by its logarithm."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda x: -gain(float(np.exp(x))),
        bounds=(float(np.log(low)), float(np.log(high))),
        method="bounded",
        options={"xatol": MAGNITUDE_SHAPES.settled},
    )
    return float(np.exp(found.x))

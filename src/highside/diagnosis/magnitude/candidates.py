"""Candidates and covariates of a session of which only the magnitude of gravity is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Unobservable, Variant, observed_through
from highside.diagnosis.core.location import Basis
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import MAGNITUDE_BASES, MAGNITUDE_CHOICE
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.physics.forward import ForwardModel


def visible(
    observed: Magnitudes, model: ForwardModel, candidates: list[Candidate], unobservable: list[Unobservable]
) -> tuple[list[Candidate], list[Unobservable]]:
    """Candidates by what they do to the magnitude; those that only turn the reading become unobservable."""
    shown = projected(observed, model, candidates)
    kept = {c.id for c in shown}
    turns = "it only turns the reading, and a magnitude does not show that"
    return shown, [*unobservable, *(Unobservable(c.effect, turns) for c in candidates if c.effect and c.id not in kept)]


def projected(observed: Magnitudes, model: ForwardModel, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates by what they do to the magnitude, columns (k, 1, n); without those that do nothing to it."""
    return observed_through(candidates, partial(observed.project, observed.aligned(model)))


def short_enough(candidates: Sequence[Candidate], length_s: float) -> list[Candidate]:
    """Without transients (warm-ups) that take longer than half of a rest: such a one is a drift with a slight
    curvature, and curves like whatever else went up meanwhile."""
    found = []
    for candidate in candidates:
        effect = candidate.effect
        times = [p.name for p in effect.shapes if p.time_constant] if effect and effect.follows_time_alone else []
        variants = tuple(v for v in candidate.variants if all(v.shape[name] < length_s / 2 for name in times))
        if variants:
            found.append(replace(candidate, variants=variants))
    return found


def finer_step(
    variant: Variant, others: Sequence[Variant], onset: str, elapsed: Array, space: Array, residual: Array
) -> Variant:
    """A step of a rest at the instant at which it fits best between its neighbours among the instants of `others`.

    A rest has more readings than instants are searched, and a step a few readings beside the true one is too small.
    `onset` names the parameter; `space` (r, n) is what else is explained, `residual` and `elapsed` (n,).
    """
    own = variant.shape[onset]
    after = variant.columns[..., elapsed >= own]
    if np.any(np.ptp(after, axis=-1) > MAGNITUDE_CHOICE.flat * np.abs(after.mean(axis=-1))):
        # it begins there, but is no step
        return variant
    tried = np.array(sorted({v.shape[onset] for v in others}))
    k = int(np.searchsorted(tried, own))
    low, high = tried[max(k - 1, 0)], tried[min(k + 1, tried.size - 1)]
    between = (elapsed[:-1] + elapsed[1:]) / 2
    between = np.append(between[(between > low) & (between < high)], own)
    left = outside(space, (elapsed >= between[:, None]).astype(float))
    gain = (left @ residual) ** 2 / np.maximum(np.sum(left**2, axis=1), 1e-12)
    best = float(between[int(np.argmax(gain))])
    height = after.mean(axis=-1, keepdims=True)
    return replace(variant, shape={onset: best}, columns=np.where(elapsed >= best, height, 0.0))


def beyond_linear(candidates: list[Candidate], base: Array) -> list[Candidate]:
    """The next order of an effect (a curvature with temperature) by what it adds to the effect itself.

    Counted from a temperature far away, a square is almost a straight line, and would be named in its place.
    """
    found = []
    for candidate in candidates:
        first = candidate.effect.next_order_of if candidate.effect is not None else ""
        linear = [v.columns[:, 0] for c in candidates if c.id == first for v in c.variants if v.whole]
        if linear:
            space = span(np.concatenate([base[:, 0], *linear]))
            variants = (replace(v, columns=outside(space, v.columns)) for v in candidate.variants)
            candidate = replace(candidate, variants=tuple(variants))
        found.append(candidate)
    return found


def bases_of(session: MagnitudeSession, n: int) -> list[Basis]:
    """Covariates of still readings: the direction of the load, temperature, time."""
    x, y, z = session.direction
    inc_deg = np.degrees(np.arccos(np.clip(z, -1, 1)))
    found: list[Basis] = []

    def add(covariate: str, along: Array, functions: Sequence[Array]) -> None:
        found.append(Basis(covariate, np.asarray(along), np.stack(functions)))

    if not session.rest:
        square = [x * x - y * y, 2 * z * z - x * x - y * y, x * y, x * z, y * z]
        add("gravity_direction", inc_deg, square)
        add("gravity_direction (third order)", inc_deg, [x**3, y**3, z**3, x * y * z])
        if n >= MAGNITUDE_BASES.many:
            add("gravity_direction (fourth order)", inc_deg, [x**4, y**4, z**4, x * x * y * y, x * x * z * z])
    if np.ptp(session.temp_c) > MAGNITUDE_BASES.warm_span_c:
        q = (session.temp_c - session.temp_c.mean()) / session.temp_c.std()
        add("temp_c", session.temp_c, [q, q**2, q**3])
        if not session.rest:
            add("temp_c x gravity_direction", session.temp_c, [q * x, q * y, q * z])
    if np.ptp(session.vibration_rms_g) > 0:
        add("vibration_rms_g", session.vibration_rms_g, [session.vibration_rms_g, session.vibration_rms_g**2])
    u = (session.t_s - session.t_s[0]) / max(float(np.ptp(session.t_s)), 1e-9)
    add(
        "t_s",
        session.t_s,
        [
            np.cos(np.pi * k * u)
            for k in range(1, MAGNITUDE_BASES.few_waves if n < MAGNITUDE_BASES.many else MAGNITUDE_BASES.waves)
        ],
    )
    return found

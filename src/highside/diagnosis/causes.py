"""Where a named effect sits, told by its cause: an error of the toolface encoder follows the toolface, whatever its
shape in the readings; sag follows the inclination.

The readings of an effect of the bench follow the direction of gravity as well, because that is what they are made of.
What the effect itself adds at its own stage of the chain (an angle, a force) follows one covariate or none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.location import HARMONICS, intervals
from highside.diagnosis.result import Claim, Diagnosis, Location
from highside.physics.effect import Effect, Stage
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

Array = NDArray[np.float64]

FINE = 400
"""cells of a covariate, where every setting is not one: what an effect adds has no noise"""
FOLLOWS = 0.02
"""Share of its variance that may be left within equal values of the covariate it follows."""
TOLD = (Stage.POSE, Stage.GRAVITY, Stage.THERMAL)
"""Stages whose effects are located by cause; those of the sensor follow the load, which their readings show."""


def located_by_cause(diagnosis: Diagnosis, model: ForwardModel, state: ChainState) -> Diagnosis:
    """The diagnosis of poses with its claims' locations along what the effects follow, where that is one covariate.

    Claims and locations stand in the same order; `model` is what the claims come on top of.
    """
    if not diagnosis.claims or len(diagnosis.location) != len(diagnosis.claims):
        return diagnosis
    places = [
        _by_cause(claim, place, model, state)
        for claim, place in zip(diagnosis.claims, diagnosis.location, strict=True)
    ]  # fmt: skip
    return replace(diagnosis, location=tuple(places))


def _by_cause(claim: Claim, place: Location, model: ForwardModel, state: ChainState) -> Location:
    effect = all_effects()[claim.effect]
    if effect.stage not in TOLD:
        return place
    values = {name: p.value for name, p in claim.parameters.items()}
    covariate = followed_covariate(effect, effect.vector(values), model, state)
    if covariate is None:
        return place
    along = covariates(state)[covariate]
    added = model.with_effects({claim.effect: values}).predict(state) - model.without(claim.effect).predict(state)
    energy = np.sum(np.asarray(added, dtype=float) ** 2, axis=0)
    harmonic = _harmonic(effect, effect.vector(values), model, state) if covariate == "tf_ref_deg" else None
    return replace(place, covariate=covariate, intervals=intervals(covariate, along, energy, FINE), harmonic=harmonic)


def covariates(state: ChainState) -> Mapping[str, Array]:
    """What an effect may follow, by its name in a recording, in the order in which a tie is decided."""
    return {
        "direction": np.asarray(state.direction, dtype=float),
        "inc_ref_deg": np.degrees(state.inc_rad),
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "temp_c": np.asarray(state.temp_c, dtype=float),
        "t_s": np.asarray(state.t_s, dtype=float),
    }


def followed_covariate(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> str | None:
    """The covariate of which the effect's own increment is a function; None where it is none of one alone.

    An error of the vertical is fixed in the room and seen turning with the toolface.
    """
    if effect.stage is Stage.GRAVITY:
        return "tf_ref_deg" if np.ptp(state.tf_rad) > 0 else None
    delta = _increment(effect, p, model, state)
    left = delta - delta.mean(axis=1, keepdims=True)
    total = float(np.sum(left**2))
    if total <= 1e-24:
        return None
    for name, values in covariates(state).items():
        settings, group = np.unique(np.round(values, 3), return_inverse=True)
        if settings.size < 2:
            continue
        if settings.size <= state.n / 2:
            count = np.bincount(group)
            within = sum(float(np.sum((row - (np.bincount(group, row) / count)[group]) ** 2)) for row in left)
        else:
            # hardly a value twice: neighbours along the covariate must agree
            within = float(np.sum(np.diff(left[:, np.argsort(values)], axis=1) ** 2)) / 2
        if within < FOLLOWS * total:
            return name
    return None


def _increment(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> Array:
    """(3, n) what the effect adds at its stage."""
    chain = model.chain(state)
    reading = np.stack([state.inc_rad, np.zeros(state.n), state.tf_rad])
    added = effect.delta(state, p, reading if effect.stage is Stage.POSE else chain.force)
    return np.asarray(np.broadcast_to(added, (3, state.n)), dtype=float)


def _harmonic(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> int:
    """The harmonic of the toolface that carries most of an effect; an error of the vertical turns once."""
    if effect.stage is Stage.GRAVITY:
        return 1
    delta = _increment(effect, p, model, state)
    power = [float(np.sum(np.abs(delta @ np.exp(1j * k * state.tf_rad)) ** 2)) for k in range(1, HARMONICS + 1)]
    return int(np.argmax(power)) + 1

"""Where a named effect sits, given by its cause: an error of the toolface encoder follows the toolface, whatever its
shape in the readings; sag follows the inclination; a lever arm follows the rate, a step is there from its time on.

The readings of an effect of the bench follow the direction of gravity as well, because that is what they are made of.
What the effect itself adds at its own stage of the chain (an angle, a force) follows one covariate or none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.location import intervals
from highside.diagnosis.core.policy import CAUSES, PLACES
from highside.diagnosis.core.result import Claim, DiagnosisResult, Location
from highside.diagnosis.core.support import cells_of
from highside.long_arrays import is_long
from highside.physics.effect import Effect, Stage
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

DRIVEN = {"rotor_rate_radps": "rotor_rate_dps", "temp_c": "temp_c", "vibration_rms_g": "vibration_rms_g", "t_s": "t_s"}
"""covariates that an effect says it needs, by their names in a recording"""
AT_THEIR_STAGE = (Stage.POSE, Stage.THERMAL, Stage.SENSOR)
"""Stages at which an effect's own increment is evaluated; for others, what it adds to the readings of a plain tool."""


def located_by_cause(diagnosis: DiagnosisResult, model: ForwardModel, state: ChainState) -> DiagnosisResult:
    """The diagnosis with its claims' locations along what the effects follow, where that is one covariate.

    Claims and locations stand in the same order; `model` is what the claims come on top of.
    """
    if not diagnosis.claims or len(diagnosis.location) != len(diagnosis.claims):
        return diagnosis
    if state.n > CAUSES.most_rows or is_long(state.t_s):
        state = state.rows(slice(None, None, -(-state.n // CAUSES.most_rows)))
    places = [
        _by_cause(claim, place, model, state) for claim, place in zip(diagnosis.claims, diagnosis.location, strict=True)
    ]
    return replace(diagnosis, location=tuple(places))


def _by_cause(claim: Claim, place: Location, model: ForwardModel, state: ChainState) -> Location:
    effect = all_effects()[claim.effect]
    values = {name: p.value for name, p in claim.parameters.items()}
    covariate = followed_covariate(effect, effect.vector(values), model, state)
    driven = [DRIVEN[name] for name in effect.needs if name in DRIVEN and np.ptp(covariates(state)[DRIVEN[name]]) > 0]
    if covariate is None and not driven:
        return place
    energy = np.sum(_added(effect, effect.vector(values), model, state) ** 2, axis=0)
    harmonic = _harmonic(effect, effect.vector(values), model, state) if covariate == "tf_ref_deg" else None
    if covariate is None:
        # its size is driven by one covariate, what it does with that turns with the load
        along = covariates(state)[driven[0]]
        load = "gravity_direction" if np.ptp(state.inc_rad) > CAUSES.inclined_rad else "tf_ref_deg"
        words = driven[0] if driven[0] == "t_s" else f"{driven[0]} x {load}"
        return replace(place, covariate=words, intervals=intervals(driven[0], along, energy), harmonic=None)
    along = covariates(state)[covariate]
    return replace(
        place, covariate=covariate, intervals=intervals(covariate, along, energy, CAUSES.fine), harmonic=harmonic
    )


def covariates(state: ChainState) -> Mapping[str, Array]:
    """What an effect may follow, by its name in a recording, in the order in which a tie is decided.

    While the tool turns all is smooth in time: that comes last.
    """
    return {
        "direction": np.asarray(state.direction, dtype=float),
        "inc_ref_deg": np.degrees(state.inc_rad),
        "vibration_rms_g": np.asarray(state.vibration_rms_g, dtype=float),
        "rotor_rate_dps": np.degrees(state.rotor_rate_radps),
        "tf_ref_deg": np.mod(np.degrees(state.tf_rad), 360.0),
        "temp_c": np.asarray(state.temp_c, dtype=float),
        "t_s": np.asarray(state.t_s, dtype=float),
    }


def followed_covariate(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> str | None:
    """The covariate of which the effect's own increment is a function; None where it is none of one alone.

    An error of the vertical is fixed in the room and observed turning with the toolface.
    """
    if effect.stage is Stage.GRAVITY:
        return "tf_ref_deg" if np.ptp(state.tf_rad) > 0 else None
    delta = _increment(effect, p, model, state)
    left = delta - delta.mean(axis=1, keepdims=True)
    total = float(np.sum(left**2))
    if total <= CAUSES.nothing:
        return None
    for name, values in covariates(state).items():
        settings, group = np.unique(np.round(values, 3), return_inverse=True)
        if settings.size < 2:
            continue
        if settings.size > CAUSES.fine:
            # as good as continuous: hardly any variance may be left within a narrow cell
            group = cells_of(name, values, count=CAUSES.cells_to_agree).of
        if settings.size <= state.n / 2 or settings.size > CAUSES.fine:
            count = np.maximum(np.bincount(group), 1)
            within = sum(float(np.sum((row - (np.bincount(group, row) / count)[group]) ** 2)) for row in left)
        else:
            # hardly a value twice: neighbours along the covariate must agree
            within = float(np.sum(np.diff(left[:, np.argsort(values)], axis=1) ** 2)) / 2
        if within < CAUSES.follows * total:
            return name
    return None


def _increment(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> Array:
    """(3, n) what the effect adds at its stage."""
    if effect.stage not in AT_THEIR_STAGE:
        return _added(effect, p, ForwardModel.of({}), state)
    chain = model.chain(state)
    reading = np.stack([state.inc_rad, np.zeros(state.n), state.tf_rad])
    added = effect.delta(state, p, reading if effect.stage is Stage.POSE else chain.force)
    return np.asarray(np.broadcast_to(added, (3, state.n)), dtype=float)


def _added(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> Array:
    """(3, n) what the effect adds to the readings: of the gyros, where it is theirs."""
    values = dict(zip((q.name for q in effect.parameters), p.tolist(), strict=True))
    with_it, without = model.with_effects({effect.id: values}), model.without(effect.id)
    if effect.stage is Stage.GYRO:
        return np.asarray(with_it.gyro(state) - without.gyro(state), dtype=float)
    return np.asarray(with_it.predict(state) - without.predict(state), dtype=float)


def _harmonic(effect: Effect, p: Array, model: ForwardModel, state: ChainState) -> int:
    """The harmonic of the toolface that carries most of an effect; an error of the vertical turns once."""
    if effect.stage is Stage.GRAVITY:
        return 1
    delta = _increment(effect, p, model, state)
    power = [float(np.sum(np.abs(delta @ np.exp(1j * k * state.tf_rad)) ** 2)) for k in range(1, PLACES.harmonics + 1)]
    return int(np.argmax(power)) + 1

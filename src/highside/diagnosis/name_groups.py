"""Effects of the library as groups that compete with laws, and which of them a law resembles.

An effect with shape parameters (a time constant, an order, a time of onset) is a group at each value that is tried of
them, priced by their number; the best is sharpened between its neighbours once it is chosen.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import product

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.regression import flattened
from highside.diagnosis.law_sessions import LawSession
from highside.diagnosis.laws.effects import EffectGroup
from highside.diagnosis.laws.evidence import orthonormal
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.policy import LAW_VERDICT
from highside.physics import effects as library
from highside.physics.effect import Effect, Stage
from highside.physics.forward import ForwardModel
from highside.physics.parameter import AXES


def name_groups(session: LawSession, model: ForwardModel, name: str) -> list[EffectGroup]:
    """An effect of the library as groups, one for each value that is tried of its shapes; none where it does nothing,
    cannot be known, or is free anyway."""
    effect = library.all_effects().get(name)
    if effect is None or effect.random or name in session.free:
        return []
    if effect.stage is Stage.GYRO and len(session.channels) <= len(AXES):
        return []
    tried = session.shapes_of(effect)
    made = []
    for shape in tried:
        columns = session.effect_columns(model, name, shape)[0]
        if not np.any(columns) or not np.isfinite(columns).all():
            continue
        group = EffectGroup.of(name, columns, session.floor, tries=len(tried))
        if shape:
            near = {p.name: _neighbours(p.name, shape, tried) for p in effect.shapes if not p.integer}
            epochs = frozenset(p.name for p in effect.shapes if p.epoch)
            group = group.shaped(shape, near, epochs, partial(_columns, session, model, name))
        made.append(group)
    return made


def _columns(session: LawSession, model: ForwardModel, name: str, shape: Mapping[str, float]) -> Array:
    return session.effect_columns(model, name, dict(shape))[0]


def _neighbours(name: str, shape: Mapping[str, float], tried: list[dict[str, float]]) -> tuple[float, float]:
    """The values of a shape that are tried next to its own, below and above; its own at an end."""
    values = sorted({one[name] for one in tried})
    k = values.index(shape[name])
    return values[max(k - 1, 0)], values[min(k + 1, len(values) - 1)]


def resembled(session: LawSession, model: ForwardModel, found: Found, effect: Array) -> tuple[str, ...]:
    """Names of the library's effects that do nearly what `effect` (C, n) does here, the nearest first."""
    problem = found.problem
    scale = session.floor * found.noise.factor[:, None]

    def white(columns: Array) -> Array:
        return flattened(columns / scale)

    free = orthonormal(white(problem.free))
    target = white(effect[None])[0]
    target = target - free.T @ (free @ target)
    size = float(target @ target)
    scores: dict[str, float] = {}
    for name, made in _all_columns(session, model):
        columns = white(made)
        columns = columns - (columns @ free.T) @ free
        basis = orthonormal(columns)
        share = float(np.sum((basis @ target) ** 2)) / max(size, 1e-300)
        scores[name] = max(scores.get(name, 0.0), share)
    # an effect that has another as a case is never behind it: of those that do the same the one with fewer parameters
    near = sorted(
        (name for name in scores if scores[name] > LAW_VERDICT.resembles),
        key=lambda n: (-round(scores[n], 2), len(library.get(n).parameters)),
    )
    return tuple(near[: LAW_VERDICT.names])


def _all_columns(session: LawSession, model: ForwardModel) -> list[tuple[str, Array]]:
    """Id and columns (k, C, n) of each effect of the library that the model lacks, at each of its shapes: of the last
    model they are kept, for every law is held beside them."""
    for one, made in session.looked_at:
        if one is model:
            return made
    known = {*model.ids, *session.free}
    wanted: list[tuple[Effect, Array]] = []
    for effect in library.all_effects().values():
        if not effect.random and effect.id not in known:
            wanted += [(effect, p) for p in _shapes(session, effect)]
    derivatives = session.derivatives(model, wanted)
    pairs = (
        (effect.id, np.asarray(one, dtype=float)[list(effect.amplitudes)])
        for (effect, _), one in zip(wanted, derivatives, strict=True)
    )
    found = [(name, columns) for name, columns in pairs if np.isfinite(columns).all()]
    session.looked_at[:] = [(model, found)]
    return found


def _shapes(session: LawSession, effect: Effect) -> list[Array]:
    """Parameter vectors at which an effect's columns are looked at: a shape at each of its values, or at some."""
    grids = [p.grid or (p.typical,) for p in effect.shapes]
    by_grid = [dict(zip((p.name for p in effect.shapes), found, strict=True)) for found in product(*grids)]
    values = session.shapes_of(effect) or by_grid
    every = -(-len(values) // LAW_VERDICT.most_shapes)
    return [np.asarray(effect.vector(one), dtype=float) for one in values[::every]]

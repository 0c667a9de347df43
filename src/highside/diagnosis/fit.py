"""Least-squares fits of the forward model: the base alone, and base and claims jointly with intervals.

Gauss-Newton on the full model, whitened. A parameter that shapes an effect smoothly (a time constant) is fitted too,
so that its uncertainty reaches the amplitudes; one that does not (a harmonic order, the time of a step) stays where the
selection found it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.candidates import Candidate, columns_of
from highside.diagnosis.noise import PoseNoise
from highside.diagnosis.result import FittedParameter
from highside.diagnosis.selection import Member
from highside.diagnosis.session import PoseSession
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

Array = NDArray[np.float64]

STEPS = 4


def base_fit(
    model: ForwardModel, state: ChainState, mean: Array, free: Sequence[str]
) -> tuple[ForwardModel, Array, Array]:
    """The model with its free effects fitted to means (3, n), their columns (P, 3, n), and the residual (3, n) in g."""
    if not free:
        return model, np.empty((0, 3, state.n)), np.asarray(mean - model.predict(state), dtype=float)
    for _ in range(STEPS):
        columns = np.asarray(model.jacobian(state, free), dtype=float)
        step = _solve(columns.reshape(len(columns), -1), (mean - model.predict(state)).reshape(-1))
        model = model.set_free(model.get_free(free) + step, free)
        if np.max(np.abs(step), initial=0.0) < 1e-12:
            break
    columns = np.asarray(model.jacobian(state, free), dtype=float)
    return model, columns, np.asarray(mean - model.predict(state), dtype=float)


def _solve(columns: Array, residual: Array) -> Array:
    norm = np.linalg.norm(columns, axis=1)
    norm = np.where(norm > 0, norm, 1.0)
    return np.asarray(np.linalg.lstsq((columns / norm[:, None]).T, residual, rcond=1e-10)[0] / norm)


@dataclass(frozen=True)
class JointFit:
    """Fitted parameters of the claims by effect, residual (3, n) in g, and parameters outside of plausible ranges."""

    parameters: dict[str, dict[str, FittedParameter]]
    residual: Array
    outside_gate: tuple[str, ...]


def joint_fit(
    model: ForwardModel,
    session: PoseSession,
    free: Sequence[str],
    candidates: Sequence[Candidate],
    members: Sequence[Member],
    noise: PoseNoise,
    freedom: float,
) -> JointFit:
    """Refit base and members together, whitened by `noise`; intervals by Student's t with `freedom`."""
    from scipy.stats import t as student

    state = session.state
    chosen = [(candidates[m.candidate], candidates[m.candidate].variants[m.variant]) for m in members]
    names = list(free)
    start: dict[str, dict[str, float]] = {}
    for candidate, variant in chosen:
        assert candidate.effect is not None
        start[candidate.id] = {
            **dict(
                zip((p.name for p in candidate.effect.parameters), model.vector_of(candidate.id).tolist(), strict=True)
            ),
            **variant.shape,
        }
    now = model.with_effects(start) if start else model
    amplitude_names = [f"{c.id}.{a}" for c, _ in chosen for a in c.amplitudes]
    shape_names = [
        f"{c.id}.{p.name}"
        for c, _ in chosen
        if c.effect is not None and c.id != "bias_step"
        for p in c.effect.parameters
        if p.shape and not p.integer
    ]

    def columns(at: ForwardModel, which: Sequence[str]) -> Array:
        base = np.asarray(at.jacobian(state, names), dtype=float) if names else np.empty((0, 3, state.n))
        parts = [base]
        for candidate, variant in chosen:
            assert candidate.effect is not None
            shape = {p.name: at.parameters()[candidate.id][p.name] for p in candidate.effect.parameters if p.shape}
            parts.append(columns_of(at, state, candidate.effect, shape or variant.shape))
        if which:
            parts.append(np.asarray(at.jacobian(state, list(which)), dtype=float))
        return np.concatenate(parts)

    every = [*now.free_names(names or []), *amplitude_names]
    inverse = np.zeros((len(every), len(every)))
    for step_number in range(2 * STEPS):
        which = shape_names if step_number >= 2 else []
        white = noise.white(columns(now, which))
        step = _solve(white, noise.white(np.asarray(session.mean - now.predict(state), dtype=float)))
        moved = [*every, *which]
        values = now.get_free(moved) + step if moved else step
        for k, name in enumerate(which, start=len(every)):
            # a time constant moves by no more than a third at a time
            old = now.get_free([name])[0]
            values[k] = float(np.clip(values[k], old / 1.33, old * 1.33))
        now = now.set_free(values, moved) if moved else now
        scale = np.linalg.norm(white, axis=1)
        scale = np.where(scale > 0, scale, 1.0)
        gram = (white / scale[:, None]) @ (white / scale[:, None]).T
        inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True) / (scale[:, None] * scale[None, :])
    every = [*every, *shape_names]
    std = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    half = float(student.ppf(0.975, freedom))
    fitted: dict[str, dict[str, FittedParameter]] = {}
    implausible = []
    for candidate, variant in chosen:
        assert candidate.effect is not None
        table: dict[str, FittedParameter] = {}
        for parameter in candidate.effect.parameters:
            name = f"{candidate.id}.{parameter.name}"
            value = float(now.get_free([name])[0])
            error = float(std[every.index(name)]) if name in every else 0.0
            table[parameter.name] = FittedParameter(
                value, error, value - half * error, value + half * error, parameter.unit
            )
            low, high = parameter.gate
            if value + 2 * error < low or value - 2 * error > high:
                implausible.append(name)
        fitted[candidate.id] = table
        del variant
    residual = np.asarray(session.mean - now.predict(state), dtype=float)
    return JointFit(fitted, residual, tuple(implausible))

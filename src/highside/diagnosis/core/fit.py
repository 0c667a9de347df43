"""Least-squares fits of the forward model: the base alone, and base and claims jointly with intervals.

Gauss-Newton on the full model, whitened. A parameter that shapes an effect smoothly (a time constant) is fitted too,
so that its uncertainty reaches the amplitudes; one that does not (a harmonic order, the time of a step) stays where the
selection found it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate, Variant
from highside.diagnosis.core.observed import (
    ObservationModel,
    Observed,
    RowNoise,
    Weighted,
    Whitening,
    energy,
    from_normal_equations,
    least_squares,
    works_by_runs,
)
from highside.diagnosis.core.policy import FITS, INTERVALS
from highside.diagnosis.core.probability import student_quantile
from highside.diagnosis.core.result import FittedParameter
from highside.physics.forward import ForwardModel
from highside.scratch_arrays import stored


def base_fit(
    model: ForwardModel, observed: ObservationModel, free: Sequence[str], steps: int = FITS.steps
) -> tuple[ForwardModel, Array]:
    """The model with its free effects fitted to n readings, and the residual (C, n)."""
    if not free:
        return model, observed.residual(model)
    # rates and accelerations have units of their own: each kind counts by the size of what it cannot explain
    noise = Weighted(np.ones((observed.channels, 1)))
    for turn in range(steps):
        step, _ = _step(observed, noise, model, partial(_columns, model, free=free, chosen=()), model.free_names(free))
        model = model.set_free(model.get_free(free) + step, free)
        if observed.gyros and turn == 0:
            noise = Weighted(1 / np.maximum(observed.residual(model).std(axis=1, keepdims=True), 1e-12))
        elif np.max(np.abs(step), initial=0.0) < 1e-12:
            break
    return model, observed.residual(model)


def _step(
    observed: ObservationModel,
    noise: Whitening,
    at: ForwardModel,
    columns: Callable[[ObservationModel], Array],
    names: Sequence[str],
) -> tuple[Array, Array]:
    """(P,) least-squares step of the named parameters, and (P, P) the inner products of their whitened columns."""
    if works_by_runs(observed, at):
        assert isinstance(observed, Observed) and isinstance(noise, RowNoise)
        inner = observed.inner(at, columns, noise)
        return from_normal_equations(inner[:-1, :-1], inner[:-1, -1]), inner[:-1, :-1]
    white = noise.white(columns(observed))
    return observed.step(white, noise.white(observed.residual(at)), names), np.asarray(white @ white.T)


@dataclass(frozen=True)
class JointFit:
    """Fitted parameters of the claims by effect, residual (C, n), and parameters outside of plausible ranges."""

    parameters: dict[str, dict[str, FittedParameter]]
    residual: Array
    outside_gate: tuple[str, ...]
    second_order: Array | None = None
    """(C, n) what base and claims do at their fitted sizes beyond first order, if that shows and fits no worse"""
    chi_square: float = np.nan
    """of what is left, in units of the noise"""
    model: ForwardModel | None = None
    """base and claims at their fitted sizes"""
    beyond: float = 0.0
    """chi-square of `second_order` outside of what base and claims do to first order"""
    amounts: Mapping[str, tuple[tuple[int, float], ...]] = field(default_factory=dict)
    """of each claim the columns of a design, by number, and how much of each was fitted; of rows beside a prediction"""


Chosen = Sequence[tuple[Candidate, Variant]]


def _begun(model: ForwardModel, chosen: Chosen) -> ForwardModel:
    """The model with the chosen effects, nothing of them fitted yet."""
    start: dict[str, dict[str, float]] = {}
    for candidate, variant in chosen:
        assert candidate.effect is not None
        names = (p.name for p in candidate.effect.parameters)
        start[candidate.id] = {
            **dict(zip(names, model.vector_of(candidate.id).tolist(), strict=True)),
            **variant.shape,
        }
    return model.with_effects(start) if start else model


def _columns(
    at: ForwardModel, observed: ObservationModel, free: Sequence[str], chosen: Chosen, also: Sequence[str] = ()
) -> Array:
    """(P, C, n) derivatives by the free parameters, by the amplitudes of the chosen effects, and by those of `also`."""
    if all(candidate.effect is not None and candidate.effect.complex_safe for candidate, _ in chosen):
        # of all at once the chain is evaluated once
        return observed.jacobian(at, [*free, *(f"{c.id}.{a}" for c, _ in chosen for a in c.amplitudes), *also])
    parts = [observed.jacobian(at, free)]
    for candidate, variant in chosen:
        assert candidate.effect is not None
        shape = {p.name: at.parameters()[candidate.id][p.name] for p in candidate.effect.parameters if p.shape}
        parts.append(observed.columns(at, candidate.effect, shape or variant.shape))
    if also:
        parts.append(observed.jacobian(at, list(also)))
    return np.concatenate(parts)


def _beyond(total: Array, moved: Array, first_order: Array) -> Array:
    """(C, n) of what is done in all (C, n) the part beyond sizes (P,) times columns (P, C, n)."""
    return np.asarray(total - np.tensordot(moved, first_order, 1))


def second_order_of(
    model: ForwardModel,
    fit: JointFit,
    observed: ObservationModel,
    free: Sequence[str],
    candidates: Sequence[Candidate],
    terms: Sequence[Term],
) -> Array:
    """(C, n) what base and terms do beyond first order, at the sizes of a fit to these readings or some of them."""
    assert fit.model is not None
    chosen = [(candidates[m.candidate], candidates[m.candidate].variants[m.variant]) for m in terms]
    first = _begun(model, chosen)
    sizes = [*first.free_names(list(free) or []), *(f"{c.id}.{a}" for c, _ in chosen for a in c.amplitudes)]
    fitted = fit.model
    moved = fitted.get_free(sizes) - first.get_free(sizes)

    def of(subset: ObservationModel) -> Array:
        return _beyond(subset.residual(first) - subset.residual(fitted), moved, _columns(first, subset, free, chosen))

    if not works_by_runs(observed, fitted):
        return of(observed)
    assert isinstance(observed, Observed)
    return stored(observed.readings, observed.readings.shape, observed.of_runs(fitted, lambda _, run: of(run)[:, 1:]))


def joint_fit(
    model: ForwardModel,
    observed: ObservationModel,
    free: Sequence[str],
    candidates: Sequence[Candidate],
    terms: Sequence[Term],
    noise: Whitening,
    freedom: float,
    steps: int = 2 * FITS.steps,
    near: ForwardModel | None = None,
    with_second_order: bool = True,
) -> JointFit:
    """Refit base and terms together, whitened by `noise`; intervals by Student's t with `freedom`.

    `near` is the same fitted before to a subsample: from there one step does. Without `with_second_order` what is done
    beyond first order is not computed.
    """
    chosen = [(candidates[m.candidate], candidates[m.candidate].variants[m.variant]) for m in terms]
    names = list(free)
    first = _begun(model, chosen)
    now = first if near is None else near
    amplitude_names = [f"{c.id}.{a}" for c, _ in chosen for a in c.amplitudes]
    shape_names = [f"{c.id}.{p.name}" for c, _ in chosen if c.effect is not None for p in c.effect.shapes if p.fitted]

    every = [*now.free_names(names or []), *amplitude_names]
    if not every:
        return JointFit({}, observed.residual(now), (), model=now)
    precision = _Precision(np.zeros((len(every), len(every))), np.zeros(len(every), dtype=bool))
    for step_number in range(steps):
        which = shape_names if step_number >= 2 or near is not None else []
        moved = [*every, *which]
        step, inner = _step(observed, noise, now, partial(_columns, now, free=names, chosen=chosen, also=which), moved)
        values = now.get_free(moved) + step if moved else step
        for k, name in enumerate(which, start=len(every)):
            # a time constant moves by no more than a third at a time
            old = now.get_free([name])[0]
            values[k] = float(np.clip(values[k], old / FITS.stride, old * FITS.stride))
        now = now.set_free(values, moved) if moved else now
        precision = _precision(inner)
        if which == shape_names and float(step @ inner @ step) < FITS.settled:
            break
    fitted, implausible = _intervals(now, chosen, [*every, *shape_names], precision, freedom)
    left = observed.residual(now)
    chi_square = energy(noise, left)
    second_order, beyond = None, 0.0
    if with_second_order:
        sizes = [*now.free_names(names or []), *amplitude_names]
        makes = partial(_columns, first, free=names, chosen=chosen)
        if isinstance(observed, Observed) and observed.long:
            second_order, beyond, linear = _by_runs(observed, noise, first, now, sizes, makes)
        else:
            first_order, before = makes(observed), observed.residual(first)
            white, unfitted = noise.white(first_order), noise.white(before)
            linear = float(np.sum((unfitted - observed.step(white, unfitted, sizes) @ white) ** 2))
            second_order = _beyond(before - left, now.get_free(sizes) - first.get_free(sizes), first_order)
            rest = noise.white(second_order)
            beyond = float(np.sum((rest - least_squares(white, rest) @ white) ** 2))
        if beyond < FITS.second_order or linear - chi_square <= -FITS.second_order:
            second_order = None
    return JointFit(fitted, left, implausible, second_order, chi_square, now, beyond)


def _by_runs(
    observed: Observed,
    noise: Whitening,
    first: ForwardModel,
    now: ForwardModel,
    sizes: Sequence[str],
    makes: Callable[[ObservationModel], Array],
) -> tuple[Array, float, float]:
    """Of rows that are not in the memory (C, n) what is done beyond first order, its chi-square outside of what is done
    to first order, and the chi-square that a fit to first order leaves."""
    assert isinstance(noise, RowNoise)
    moved = now.get_free(sizes) - first.get_free(sizes)

    def rows(run: ObservationModel) -> Array:
        columns, before = makes(run), run.residual(first)
        return np.concatenate([columns, before[None], _beyond(before - run.residual(now), moved, columns)[None]])

    inner = observed.inner(now, rows, noise)
    count = len(sizes)
    gram, before, beyond = inner[:count, :count], inner[:count, count], inner[:count, count + 1]
    left = [
        float(inner[k, k] - moment @ from_normal_equations(gram, moment))
        for k, moment in ((count, before), (count + 1, beyond))
    ]
    second_order = stored(
        observed.readings, observed.readings.shape, observed.of_runs(now, lambda _, run: rows(run)[-1][:, 1:])
    )
    return second_order, max(left[1], 0.0), left[0]


class _Precision(NamedTuple):
    """(P, P) covariance of what a fit determines, and (P,) what it does not."""

    covariance: Array
    undetermined: NDArray[np.bool_]


def _precision(inner: Array) -> _Precision:
    """Of (P, P) inner products of whitened columns."""
    scale = np.sqrt(np.diag(inner))
    # what a design does not move is determined no better for being scaled up
    scale = np.where(scale > FITS.unmoved * scale.max(initial=0.0), scale, np.inf)
    gram = inner / np.outer(scale, scale)
    scale = np.where(np.isfinite(scale), scale, 1.0)
    powers, vectors = np.linalg.eigh(gram)
    determined = powers > FITS.undetermined * powers[-1]
    inverse = (vectors[:, determined] / powers[determined]) @ vectors[:, determined].T / np.outer(scale, scale)
    return _Precision(inverse, np.sum(vectors[:, ~determined] ** 2, axis=1) > FITS.partly_undetermined)


def _intervals(
    fitted: ForwardModel, chosen: Chosen, names: Sequence[str], precision: _Precision, freedom: float
) -> tuple[dict[str, dict[str, FittedParameter]], tuple[str, ...]]:
    """The parameters of the chosen effects by effect, with intervals, and those outside of what is plausible."""
    std = np.sqrt(np.maximum(np.diag(precision.covariance), 0.0))
    half = student_quantile(INTERVALS.upper, freedom)
    found: dict[str, dict[str, FittedParameter]] = {}
    implausible = []
    for candidate, _ in chosen:
        assert candidate.effect is not None
        table: dict[str, FittedParameter] = {}
        for parameter in candidate.effect.parameters:
            name = f"{candidate.id}.{parameter.name}"
            value = float(fitted.get_free([name])[0])
            low, high = parameter.gate
            if name in names and precision.undetermined[names.index(name)]:
                # the recording says nothing of it beyond what is plausible, but that the smallest explanation is not
                table[parameter.name] = FittedParameter(value, (high - low) / np.sqrt(12), low, high, parameter.unit)
                implausible += [] if low <= value <= high else [name]
                continue
            error = float(std[names.index(name)]) if name in names else 0.0
            table[parameter.name] = FittedParameter(
                value, error, value - half * error, value + half * error, parameter.unit
            )
            if value + 2 * error < low or value - 2 * error > high:
                implausible.append(name)
        found[candidate.id] = table
    return found, tuple(implausible)

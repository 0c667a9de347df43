"""Least-squares fits of the forward model: the base alone, and base and claims jointly with intervals.

Gauss-Newton on the full model, whitened. A parameter that shapes an effect smoothly (a time constant) is fitted too,
so that its uncertainty reaches the amplitudes; one that does not (a harmonic order, the time of a step) stays where the
selection found it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidate_set import Term
from highside.diagnosis.core.candidates import Candidate, Variant, columns_of
from highside.diagnosis.core.chunks import chunks_of, in_order
from highside.diagnosis.core.policy import FITS, INTERVALS
from highside.diagnosis.core.probability import student_quantile
from highside.diagnosis.core.result import FittedParameter
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState


class Whitening(Protocol):
    """A noise, as a fit sees it."""

    def white(self, columns: Array) -> Array:
        """(..., C, n) readings -> (..., C n) in units of the noise."""
        ...


class ObservationModel(Protocol):
    """Readings, as a fit sees them: how they differ from a model's, and what would change that."""

    @property
    def gyros(self) -> bool: ...
    @property
    def channels(self) -> int: ...
    def residual(self, model: ForwardModel) -> Array: ...
    def jacobian(self, model: ForwardModel, names: Sequence[str]) -> Array: ...
    def columns(self, model: ForwardModel, effect: Effect, shape: dict[str, float]) -> Array: ...
    def step(self, columns: Array, residual: Array, names: Sequence[str]) -> Array: ...


@runtime_checkable
class RowNoise(Whitening, Protocol):
    """A noise that whitens run by run."""

    @property
    def lead(self) -> int:
        """Rows before a run that its whitening needs."""
        ...

    def whiten(self, channel: int, functions: Array, part: slice) -> Array:
        """Functions (m, lead + n) of a channel, whitened for the n rows of `part`."""
        ...


@dataclass(frozen=True)
class _Weighted:
    """Readings of each channel times a weight (C, 1)."""

    weight: Array
    lead: int = 0

    def white(self, columns: Array) -> Array:
        return np.asarray((columns * self.weight).reshape(*columns.shape[:-2], -1))

    def whiten(self, channel: int, functions: Array, part: slice) -> Array:
        return np.asarray(functions * self.weight[channel])


@dataclass(frozen=True)
class Observed:
    """Readings (C, n) at n states: accelerometers in g and, below them, gyros in rad/s if there are any.

    Many rows are evaluated `by_parts`, run by run: what stands between the stages of the chain is thirty times them.
    """

    state: ChainState
    readings: Array
    by_parts: bool = False

    @property
    def gyros(self) -> bool:
        """Whether rates are among the readings."""
        return bool(self.readings.shape[0] > 3)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return int(self.readings.shape[0])

    def residual(self, model: ForwardModel) -> Array:
        """(C, n) readings minus prediction."""
        if _apart(self, model):
            left = np.empty(self.readings.shape)
            parts = chunks_of(self.state.n)
            for part, own in zip(parts, in_order(lambda part: self.run(part).residual(model), parts), strict=True):
                left[:, part] = own[:, 1:]
            return left
        predicted = model.predict(self.state)
        if self.gyros:
            predicted = np.concatenate([predicted, model.gyro(self.state)])
        return np.asarray(self.readings - predicted, dtype=float)

    def jacobian(self, model: ForwardModel, names: Sequence[str]) -> Array:
        """(P, C, n) derivatives by the free parameters."""
        if not names:
            return np.empty((0, *self.readings.shape))
        found = model.jacobian(self.state, names)
        if self.gyros:
            found = np.concatenate([found, model.gyro_jacobian(self.state, names)], axis=1)
        return np.asarray(found, dtype=float)

    def columns(self, model: ForwardModel, effect: Effect, shape: dict[str, float]) -> Array:
        """(k, C, n) by the amplitudes of an effect."""
        return columns_of(model, self.state, effect, shape, gyros=self.gyros)

    def step(self, columns: Array, residual: Array, names: Sequence[str]) -> Array:
        """(P,) least-squares step of the named parameters, from whitened columns (P, N) and residual (N,)."""
        return _solve(columns, residual)

    def run(self, part: slice) -> Observed:
        """A run of rows; the first of all stands before it, as effects reckon time from that."""
        rows = np.concatenate([[0], np.arange(part.start, part.stop)])
        return Observed(self.state.rows(rows), self.readings[:, rows])

    def inner(self, at: ForwardModel, columns: Callable[[ObservationModel], Array], noise: RowNoise) -> Array:
        """(P + 1, P + 1) of whitened columns and, last, the residual, from run to run of rows."""

        def of(part: slice) -> Array:
            run = self.run(slice(max(0, part.start - noise.lead), part.stop))
            both = np.concatenate([columns(run), run.residual(at)[None]])[:, :, 1:]
            white = [noise.whiten(c, both[:, c], part) for c in range(self.channels)]
            return np.asarray(sum((w @ w.T for w in white), np.zeros((len(both), len(both)))))

        return np.asarray(sum(in_order(of, chunks_of(self.state.n))))


def base_fit(
    model: ForwardModel, observed: ObservationModel, free: Sequence[str], steps: int = FITS.steps
) -> tuple[ForwardModel, Array]:
    """The model with its free effects fitted to n readings, and the residual (C, n)."""
    if not free:
        return model, observed.residual(model)
    # rates and accelerations have units of their own: each kind counts by the size of what it cannot explain
    noise = _Weighted(np.ones((observed.channels, 1)))
    for turn in range(steps):
        step, _ = _step(observed, noise, model, partial(_columns, model, free=free, chosen=()), model.free_names(free))
        model = model.set_free(model.get_free(free) + step, free)
        if observed.gyros and turn == 0:
            noise = _Weighted(1 / np.maximum(observed.residual(model).std(axis=1, keepdims=True), 1e-12))
        elif np.max(np.abs(step), initial=0.0) < 1e-12:
            break
    return model, observed.residual(model)


def _solve(columns: Array, residual: Array) -> Array:
    """Least squares; of a long recording the normal equations, of few readings the columns themselves."""
    norm = np.linalg.norm(columns, axis=1)
    # what a design does not move at all (a load that is zero but for rounding) is not fitted
    norm = np.where(norm > FITS.unmoved * norm.max(initial=0.0), norm, np.inf)
    scaled = columns / norm[:, None]
    if columns.shape[1] > FITS.many:
        return np.asarray(
            np.linalg.pinv(scaled @ scaled.T, rcond=FITS.rank, hermitian=True) @ (scaled @ residual) / norm
        )
    return np.asarray(np.linalg.lstsq(scaled.T, residual, rcond=FITS.rank)[0] / norm)


def _apart(observed: ObservationModel, at: ForwardModel) -> bool:
    """Whether runs of rows can be worked on each for itself."""
    return (
        isinstance(observed, Observed) and observed.by_parts and not any(at.effect(name).remembers for name in at.ids)
    )


def _step(
    observed: ObservationModel,
    noise: Whitening,
    at: ForwardModel,
    columns: Callable[[ObservationModel], Array],
    names: Sequence[str],
) -> tuple[Array, Array]:
    """(P,) least-squares step of the named parameters, and (P, P) the inner products of their whitened columns."""
    if _apart(observed, at):
        assert isinstance(observed, Observed) and isinstance(noise, RowNoise)
        inner = observed.inner(at, columns, noise)
        norm = np.sqrt(np.diag(inner)[:-1])
        norm = np.where(norm > FITS.unmoved * norm.max(initial=0.0), norm, np.inf)
        scaled = inner[:-1, :-1] / np.outer(norm, norm)
        step = np.linalg.pinv(scaled, rcond=FITS.rank, hermitian=True) @ (inner[:-1, -1] / norm) / norm
        return np.asarray(step), inner[:-1, :-1]
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

    if not _apart(observed, fitted):
        return of(observed)
    assert isinstance(observed, Observed)
    return np.concatenate(
        list(in_order(lambda part: of(observed.run(part))[:, 1:], chunks_of(observed.state.n))), axis=1
    )


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
    chi_square = float(np.sum(noise.white(left) ** 2))
    second_order, beyond = None, 0.0
    if with_second_order:
        sizes = [*now.free_names(names or []), *amplitude_names]
        first_order, before = _columns(first, observed, names, chosen), observed.residual(first)
        white, unfitted = noise.white(first_order), noise.white(before)
        linear = float(np.sum((unfitted - observed.step(white, unfitted, sizes) @ white) ** 2))
        second_order = _beyond(before - left, now.get_free(sizes) - first.get_free(sizes), first_order)
        rest = noise.white(second_order)
        beyond = float(np.sum((rest - _solve(white, rest) @ white) ** 2))
        if beyond < FITS.second_order or linear - chi_square <= -FITS.second_order:
            second_order = None
    return JointFit(fitted, left, implausible, second_order, chi_square, now, beyond)


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
                # the recording says nothing of it beyond what is plausible
                table[parameter.name] = FittedParameter(value, (high - low) / np.sqrt(12), low, high, parameter.unit)
                continue
            error = float(std[names.index(name)]) if name in names else 0.0
            table[parameter.name] = FittedParameter(
                value, error, value - half * error, value + half * error, parameter.unit
            )
            if value + 2 * error < low or value - 2 * error > high:
                implausible.append(name)
        found[candidate.id] = table
    return found, tuple(implausible)

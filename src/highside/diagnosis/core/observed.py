"""Readings as a fit sees them: how they differ from a model's, and what would change that; run of rows by run of rows
where there are many."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import columns_of
from highside.diagnosis.core.chunks import chunks_of, of_runs
from highside.diagnosis.core.policy import FITS
from highside.long_arrays import is_long
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel
from highside.physics.memory import Carry, carried
from highside.physics.state import ChainState
from highside.scratch_arrays import stored

T = TypeVar("T")


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
class Weighted:
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
        if works_by_runs(self, model):
            made = self.of_runs(model, lambda part, run: run.residual(model)[:, 1:])
            return stored(self.readings, self.readings.shape, made)
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
        return least_squares(columns, residual)

    def run(self, part: slice) -> Observed:
        """A run of rows; the first of all stands before it, as effects reckon time from that."""
        rows = np.concatenate([[0], np.arange(part.start, part.stop)])
        return Observed(self.state.rows(rows), self.readings[:, rows])

    @property
    def long(self) -> bool:
        """Whether the rows are not in the memory."""
        return is_long(self.readings)

    def of_runs(
        self,
        at: ForwardModel,
        work: Callable[[slice, Observed], T],
        lead: int = 0,
        both: Callable[[T, T], T] | None = None,
    ) -> Iterator[T]:
        """What `work` makes of each run of rows, in order. It is given the run with `lead` rows before it, and before
        these the first of all; what the model `at` remembers reaches from run to run. `both` as in `chunks.of_runs`."""
        parts = chunks_of(self.state.n)
        if not remembers(at):
            yield from of_runs(lambda part: work(part, self.run(_led(part, lead))), parts, both)
            return
        carry = Carry(lead)
        for part in parts:
            with carried(carry):
                made = work(part, self.run(_led(part, lead)))
            yield made

    def inner(self, at: ForwardModel, columns: Callable[[ObservationModel], Array], noise: RowNoise) -> Array:
        """(P + 1, P + 1) of whitened columns and, last, the residual, from run to run of rows."""

        def of(part: slice, run: Observed) -> Array:
            both = np.concatenate([columns(run), run.residual(at)[None]])[:, :, 1:]
            white = [noise.whiten(c, both[:, c], part) for c in range(self.channels)]
            return np.asarray(sum((w @ w.T for w in white), np.zeros((len(both), len(both)))))

        return np.asarray(sum(self.of_runs(at, of, noise.lead, np.add)))


def _led(part: slice, lead: int) -> slice:
    return slice(max(0, part.start - lead), part.stop)


def remembers(model: ForwardModel) -> bool:
    """Whether what a model reads depends on rows before."""
    return any(model.effect(name).remembers for name in model.ids)


def works_by_runs(observed: ObservationModel, at: ForwardModel) -> bool:
    """Whether runs of rows are worked on one after the other: of many rows, all where they are not in the memory."""
    return isinstance(observed, Observed) and (observed.long or (observed.by_parts and not remembers(at)))


def energy(noise: Whitening, rows: Array) -> float:
    """Sum of squares of (C, n) rows in units of a noise."""
    if not is_long(rows):
        return float(np.sum(noise.white(rows) ** 2))
    assert isinstance(noise, RowNoise)

    def of(part: slice) -> float:
        led = rows[:, _led(part, noise.lead)]
        return sum(float(np.sum(noise.whiten(c, own[None], part) ** 2)) for c, own in enumerate(led))

    return float(sum(of_runs(of, chunks_of(rows.shape[-1]), operator.add)))


def least_squares(columns: Array, residual: Array) -> Array:
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


def from_normal_equations(gram: Array, moment: Array) -> Array:
    """Least squares from inner products of columns (P, P) and with what is fitted (P,)."""
    norm = np.sqrt(np.diag(gram))
    norm = np.where(norm > FITS.unmoved * norm.max(initial=0.0), norm, np.inf)
    scaled = gram / np.outer(norm, norm)
    return np.asarray(np.linalg.pinv(scaled, rcond=FITS.rank, hermitian=True) @ (moment / norm) / norm)

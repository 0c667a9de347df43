"""A session with known attitudes as a problem of laws: how a number at each row enters in each place, by the chain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.laws.problem import CovariateValues, LawProblem, PlaceField, fields_that_act
from highside.physics.covariates import COVARIATES, covariate
from highside.physics.effect import AXES
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_direction
from highside.physics.law import Axis, Law, LawEffect
from highside.physics.law_functions import Function
from highside.physics.places import PLACES
from highside.physics.state import ChainState

if TYPE_CHECKING:
    from highside.diagnosis.laws.cell_noise import CellNoise

OF_POSES = ("offset", "scale", "scale_all", "matrix", "inclination", "toolface", "level")
LOADS = ("load", "previous_load")
"""what names of covariates begin with that read the load"""
OF_ROTATION = (*OF_POSES, "timing")
OF_GYROS = ("gyro_offset", "gyro_scale")
CHANNELS, GYROS = ("ax", "ay", "az"), ("gx", "gy", "gz")


def unit_law(place: str, channel: str) -> Law:
    """The law whose value is 1 everywhere."""
    return Law("unit", place, (channel,), (Axis("time", 0.0, 0.0, (Function("one"),)),), ((1.0,),))


def place_fields(model: ForwardModel, state: ChainState, places: Sequence[str], *, gyros: bool) -> list[PlaceField]:
    """What one unit of a law's value does in each place and channel."""
    names = [(place, channel) for place in places for channel in PLACES[place].channels]
    wanted = [(LawEffect(unit_law(*name)), np.zeros(1)) for name in names]
    made = model.derivatives(state, wanted, gyros=gyros)
    return [
        PlaceField(place, channel, np.asarray(field[0], dtype=float), unit_law(place, channel).axis_of(channel))
        for (place, channel), field in zip(names, made, strict=True)
    ]


class Rows(Protocol):
    """What takes all rows (N,) to the values that stand for them."""

    def mean(self, values: Array) -> Array: ...
    def nodes(self, values: Array) -> tuple[Array, Array, Array]: ...
    def extent(self, values: Array) -> tuple[Array, Array]: ...
    def within(self, wanted: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Callable[[Array], Array]]: ...


@dataclass(frozen=True)
class AllRows:
    """All rows (N,) of a session that fewer values stand for, and what takes them to these."""

    state: ChainState
    cells: Rows

    def mean(self, values: Array) -> Array:
        """(..., N) to (..., n)."""
        return self.cells.mean(values)

    def nodes(self, values: Array) -> tuple[Array, Array, Array]:
        """Of values (N,) nodes and weights (k, n) of the means of smooth functions of them, and their scatter (n,)."""
        return self.cells.nodes(values)

    def extent(self, values: Array) -> tuple[Array, Array]:
        """Of values (N,) the smallest and the largest (n,)."""
        return self.cells.extent(values)

    def within(self, wanted: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Callable[[Array], Array]]:
        """The rows (M,) for which the values `wanted` (n,) stand, and what takes (..., M) to (..., n)."""
        return self.cells.within(wanted)

    @property
    def n(self) -> int:
        """Number of rows."""
        return self.state.n

    def of(self, name: str) -> Array | None:
        """(N,) a covariate; None of one that reads the load."""
        if name.startswith(LOADS):
            return None
        return np.asarray(np.real(covariate(name).of(self.state, np.zeros((3, self.n)), 0)), dtype=float)


def covariate_values(state: ChainState, load: Array, among: AllRows | None = None) -> CovariateValues:
    """(n,) of each covariate; (3, n) where it differs from axis to axis.

    Where the states stand for more rows (`among`), what depends on the clock or on what came before is that of all of
    them: a temperature that lags begins at the first row, not at the first that was chosen.
    """
    found: dict[str, Array] = {}
    for name, known in COVARIATES.items():
        if known.own:
            found[name] = np.stack([known.of(state, load, axis) for axis in range(len(AXES))])
        elif among is not None and known.clock:
            # none of these reads the load
            found[name] = among.mean(np.asarray(known.of(among.state, load, 0), dtype=float))
        else:
            found[name] = np.asarray(known.of(state, load, 0), dtype=float)
    for name in state.extra:
        values = np.asarray(covariate(name).of(state, load, 0), dtype=float)
        if np.isfinite(values).all():
            found[name] = values
    # one pose from first to last: the time since a move is the time
    if not state.n or state.pose[0] == state.pose[-1]:
        for name in ("time_since_move", "previous_load"):
            del found[name]
    if among is None:
        return CovariateValues(found, state.t_s)
    return CovariateValues(found, among.state.t_s, among)


def chain_problem(
    model: ForwardModel,
    state: ChainState,
    residual: Array,
    free: Array,
    floor: Array,
    *,
    places: Sequence[str] = OF_POSES,
    jitter: Array | None = None,
    orders: tuple[float, ...] = (),
    every_pair: bool = False,
    measured: bool = True,
    among: AllRows | None = None,
    cells: CellNoise | None = None,
) -> LawProblem:
    """The problem of a residual (C, n) beside what is free (P, C, n), of states that may stand for more rows."""
    gyros = residual.shape[0] > len(AXES)
    fields = place_fields(model, state, [*places, *(OF_GYROS if gyros else ())], gyros=gyros)
    load = np.asarray(gravity_direction(state.inc_rad, state.tf_rad), dtype=float)
    if not gyros:
        load = np.asarray(model.chain(state).force, dtype=float)
    names = (*CHANNELS, *GYROS)[: residual.shape[0]]
    return LawProblem(
        residual,
        free,
        fields_that_act(fields),
        covariate_values(state, load, among),
        floor,
        state.t_s,
        jitter,
        names,
        orders,
        every_pair=every_pair,
        measured=measured,
        cells=cells,
    )

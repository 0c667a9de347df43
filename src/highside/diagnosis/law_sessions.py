"""Sessions with known attitudes as the search for laws sees them: poses as they are, rows averaged in cells.

A cell is a sector of toolface within some turns at one rate: what follows the toolface keeps its shape, what is slow
its time, and averaging loses no strength. A few thousand values stand for any number of rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import shapes_tried, step_times
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.floor import lattice_step, rounding_error
from highside.diagnosis.core.observed import ObservationModel, Observed
from highside.diagnosis.laws.chain import OF_POSES, OF_ROTATION, AllRows, chain_problem, covariate_values, unit_law
from highside.diagnosis.laws.groups import HISTORY
from highside.diagnosis.laws.noise import step_of
from highside.diagnosis.laws.policy import LAW_CELLS, LAW_FLOOR
from highside.diagnosis.laws.problem import CovariateValues, LawProblem, PlaceField, fields_that_act
from highside.diagnosis.poses.session import PoseSession
from highside.physics.covariates import covariate
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel
from highside.physics.law import LawEffect
from highside.physics.places import PLACES
from highside.physics.state import ChainState

if TYPE_CHECKING:
    from highside.diagnosis.magnitude.observed import Magnitudes
    from highside.diagnosis.magnitude.session import MagnitudeSession
    from highside.diagnosis.rows.session import RotationSession

Ints = NDArray[np.intp]
Effects = Mapping[str, Mapping[str, float]]
"""values of the parameters of effects, by effect"""
OF_MAGNITUDES = ("offset", "scale", "scale_all", "matrix")


AVERAGED = (
    "inc_rad",
    "temp_c",
    "rotor_rate_radps",
    "rotor_accel_radps2",
    "inc_rate_radps",
    "vibration_rms_g",
    "vibration_x_rms_g",
    "vibration_y_rms_g",
    "vibration_z_rms_g",
)
"""of a state, what is averaged over a cell as it is"""
LibraryColumns = list[tuple[ForwardModel, list[tuple[str, Array]]]]
"""a model, and what effects of the library do beside it, by id: made when first asked for"""


@dataclass(frozen=True)
class CellMeans:
    """Means over cells of rows: `number` (n,) of each row's cell, in time order; -1 for a row of none."""

    number: Ints
    count: Array
    """(m,) rows of each"""
    middle: Ints
    """(m,) the row that stands for a cell"""

    def mean(self, values: Array) -> Array:
        """(..., n) -> (..., m)."""
        used = self.number >= 0
        flat = values.reshape(-1, values.shape[-1])
        sums = [np.bincount(self.number[used], weights=row[used], minlength=self.count.size) for row in flat]
        return np.asarray((np.stack(sums) / self.count).reshape(*values.shape[:-1], self.count.size))

    def state(self, state: ChainState) -> ChainState:
        """The states of the cells: what varies within one is its mean, as its reading is; of the rest the middle row's.

        A function of the middle row alone departs from the mean reading to first order, which strong laws show.
        """
        made = state.rows(self.middle)
        away = state.tf_rad - made.tf_rad[np.maximum(self.number, 0)]
        away = (away + np.pi) % (2 * np.pi) - np.pi
        averaged: dict[str, Any] = {name: self.mean(np.asarray(getattr(state, name), dtype=float)) for name in AVERAGED}
        extra = {name: self.mean(np.asarray(values, dtype=float)) for name, values in state.extra.items()}
        return replace(made, tf_rad=made.tf_rad + self.mean(np.asarray(away)), extra=extra, **averaged)


@dataclass(frozen=True)
class ChainSession:
    """Readings (C, n) at n states, in the chain; `cells` stand for them where there are many."""

    state: ChainState
    readings: Array
    free: tuple[str, ...]
    channels: tuple[str, ...]
    floor: Array
    """(C, m) of a pose, a row or a cell"""
    places: tuple[str, ...]
    cells: CellMeans | None = None
    jitters: bool = False
    delay_s: float = 0.0
    """how much later than the time zero of the claims its first value is"""
    orders: tuple[float, ...] = ()
    """of the turn, at which the readings have a line"""
    measured: bool = True
    """whether the floor was measured"""
    looked_at: LibraryColumns = field(default_factory=list, compare=False, repr=False)

    @classmethod
    def of_poses(cls, session: PoseSession, free: Sequence[str]) -> ChainSession:
        """Each pose a value; its floor is the scatter of its rows."""
        mean = session.mean
        least = LAW_FLOOR.least * float(np.sqrt(np.mean(mean**2)))
        floor, known = np.full(mean.shape, least), session.floor is not None
        if session.floor is not None:
            floor = np.maximum(floor, session.floor.sigma)
        return cls(session.state, mean, tuple(free), ("ax", "ay", "az"), floor, OF_POSES, None, True, measured=known)

    @classmethod
    def of_rotation(cls, session: RotationSession, free: Sequence[str], residual: Array) -> ChainSession:
        """Cells of the rows; their floor is the scatter within. `residual` (C, n) is what the base fit leaves."""
        from highside.diagnosis.rotation.lines import found_orders

        orders = found_orders(session, residual)
        cells = cells_of(session, _sectors(session, orders))
        # a cell of one row has no scatter within
        used = (cells.number >= 0) & (cells.count[np.maximum(cells.number, 0)] > 1)
        within = residual - cells.mean(residual)[:, np.maximum(cells.number, 0)]
        rows, several = float(used.sum()), float(np.sum(cells.count > 1))
        lost = np.sqrt(rows / max(rows - several, 1.0))
        if rows < LAW_FLOOR.rows:
            # of single rows the scatter is what bends from row to row, of variance 6 for white noise of variance 1
            bent = residual[:, 2:] - 2 * residual[:, 1:-1] + residual[:, :-2]
            within, lost = np.pad(bent, ((0, 0), (1, 1)), mode="edge") / np.sqrt(1 + 4 + 1), 1.0
            used = cells.number >= 0
        own = np.array([np.sqrt(np.median(row[used] ** 2)) for row in within]) / LAW_FLOOR.mad
        least = LAW_FLOOR.least * np.sqrt(np.mean(session.readings**2, axis=1))
        floor = np.maximum(own * lost, least)[:, None] / np.sqrt(cells.count)
        return cls(
            session.state, session.readings, tuple(free), session.channels, floor, OF_ROTATION, cells, orders=orders
        )

    @cached_property
    def lattice(self) -> Array:
        """(C,) step of the readings of single rows; 0 where they lie on no lattice, or are means."""
        if self.cells is None:
            return np.zeros(len(self.channels))
        return np.array([lattice_step(row) for row in self.readings])

    def rounding(self, model: ForwardModel) -> Array:
        """(C,) the error that rounding leaves in means beside a model; 0 where readings lie on no lattice."""
        if not np.any(self.lattice):
            return np.zeros(len(self.channels))
        left, tf_rad = self.observed.residual(model), np.asarray(self.state.tf_rad, dtype=float)
        return np.array([rounding_error(*one, tf_rad) for one in zip(self.readings, left, strict=True)])

    @property
    def step_s(self) -> float:
        """Median time from value to value."""
        return step_of(self.reduced_state.t_s)

    @cached_property
    def reduced_state(self) -> ChainState:
        """The states at which laws are looked for."""
        return self.state if self.cells is None else self.cells.state(self.state)

    @cached_property
    def observed(self) -> Observed:
        """All readings."""
        if self.cells is None:
            return Observed(self.state, self.readings, False)
        from highside.diagnosis.rotation.policy import PILOT

        return Observed(self.state, self.readings, self.state.n > PILOT.many_rows)

    @cached_property
    def reduced_observed(self) -> Observed:
        """Those that stand for them."""
        return Observed(self.reduced_state, np.zeros((len(self.channels), self.reduced_state.n)))

    def reduced(self, values: Array) -> Array:
        """(..., n) -> (..., m)."""
        return values if self.cells is None else self.cells.mean(values)

    def beside(self, model: ForwardModel, values: Effects) -> ForwardModel:
        """The model itself: readings of known attitude are in proportion to what is free."""
        return model

    def residual(self, model: ForwardModel) -> Array:
        """(C, m) readings minus the model."""
        return self.reduced(self.observed.residual(model))

    def problem(self, model: ForwardModel, residual: Array, also: Sequence[str] = ()) -> LawProblem:
        """The problem of a residual (C, m) at a model; names `effect.parameter` of `also` are free too."""
        state = self.reduced_state
        columns = self.reduced_observed.jacobian(model, [*model.free_names(list(self.free)), *also])
        jitter = None
        if self.jitters:
            angles = np.asarray(model.pose_sensitivity(state), dtype=float)[:, [0, 2]].transpose(1, 0, 2)
            force = np.asarray(model.chain(state).force, dtype=float)
            # a shaken bench moves the level to all sides alike, a toolface only as far as the tool is inclined
            across = np.cross(force, angles[0], axis=0) / np.linalg.norm(force, axis=0)
            jitter = np.concatenate([angles, across[None]])
        return chain_problem(
            model,
            state,
            residual,
            columns,
            self.floor,
            places=self.places,
            jitter=jitter,
            orders=self.orders,
            every_pair=self.cells is None,
            measured=self.measured,
            among=None if self.cells is None else AllRows(self.state, self.cells.mean),
        )

    def derivatives(self, model: ForwardModel, wanted: Sequence[tuple[Effect, Array]]) -> list[Array]:
        """(k, C, m) by the parameters of each effect, at its vector."""
        gyros = len(self.channels) > len("xyz")
        if self.cells is None:
            return model.derivatives(self.state, wanted, gyros=gyros)
        # what remembers, or follows the clock, does so from the first row on
        early = [_from_the_first_row(effect) for effect, _ in wanted]
        own, others = (
            [one for one, is_early in zip(wanted, early, strict=True) if is_early is k] for k in (True, False)
        )
        of_all = iter(model.derivatives(self.state, own, gyros=gyros, rows=self.cells.middle) if own else [])
        of_cells = iter(model.derivatives(self.reduced_state, others, gyros=gyros) if others else [])
        return [next(of_all if is_early else of_cells) for is_early in early]

    def effect_columns(self, model: ForwardModel, effect: str, values: dict[str, float]) -> tuple[Array, Array]:
        """(k, C, m) what one unit of each amplitude of an effect does, and the amplitudes' values (k,)."""
        known = model.effect(effect)
        shape = {p.name: values.get(p.name, p.default) for p in known.shapes}
        names = [known.parameters[k].name for k in known.amplitudes]
        if any(p.epoch for p in known.shapes):
            # what sets in within a cell acts on a part of its rows, of which their mean time knows nothing
            columns = self.reduced(self.observed.columns(model, known, shape))
        else:
            columns = self.reduced_observed.columns(model, known, shape)
        return columns, np.array([values.get(name, 0.0) for name in names])

    def shapes_of(self, effect: Effect) -> list[dict[str, float]]:
        """The values of an effect's shapes that are tried; one without any where it has none, none for a line of a
        spectrum."""
        if effect.line is not None:
            return []
        return shapes_tried(effect, self.reduced_state, step_times(self.reduced_state))


@dataclass(frozen=True)
class MagnitudeLaws:
    """Still readings of which only the magnitude is known, (1, n): a law shows by what it adds along gravity."""

    session: MagnitudeSession
    observed: Magnitudes
    free: tuple[str, ...]
    floor: Array
    """(1, n)"""
    channels: tuple[str, ...] = ("g_total",)
    looked_at: LibraryColumns = field(default_factory=list, compare=False, repr=False)

    @property
    def delay_s(self) -> float:
        """Time of the first reading since the recording's first row, from which claims count."""
        return float(self.session.t_s[0] - self.session.began_s)

    @classmethod
    def of(cls, session: MagnitudeSession, observed: Magnitudes, free: Sequence[str]) -> MagnitudeLaws:
        """The floor is the scatter of the rows of a reading, along gravity."""
        least = LAW_FLOOR.least * float(np.sqrt(np.mean(session.mean**2)))
        floor = np.full((1, session.n), least)
        if session.floor is not None:
            floor = np.maximum(floor, session.floor.sigma)
        return cls(session, observed, tuple(free), floor)

    def beside(self, model: ForwardModel, values: Effects) -> ForwardModel:
        """The model, what is free fitted beside effects of these values.

        Fitted without them an offset takes a part of what they do, and a tenth of a g of offset lengthens |g| by 5 mg
        beyond first order, which laws would stand for.
        """
        fitted = base_fit(model.with_effects(values), self.observed, self.free)[0]
        known = model.parameters()
        kept = {name: known[name] for name in values if name in known}
        fitted = fitted.without(*(name for name in values if name not in known))
        return fitted.with_effects(kept) if kept else fitted

    def residual(self, model: ForwardModel) -> Array:
        """(1, n) |g| - 1."""
        return self.observed.residual(model)

    def derivatives(self, model: ForwardModel, wanted: Sequence[tuple[Effect, Array]]) -> list[Array]:
        """(k, 1, n) by the parameters of each effect, at its vector."""
        aligned = self.observed.aligned(model)
        made = model.derivatives(aligned.state, wanted)
        return [self.observed.project(aligned, np.asarray(one, dtype=float)) for one in made]

    def problem(self, model: ForwardModel, residual: Array, also: Sequence[str] = ()) -> LawProblem:
        """The problem of a residual (1, n) at a model; names `effect.parameter` of `also` are free too."""
        aligned = self.observed.aligned(model)
        names = model.free_names(list(self.free)) if self.free else []
        free = self.observed.shown(self.observed.jacobian(model, names), names) if names else np.empty((0, 1, self.n))
        free = np.concatenate([free, self.observed.jacobian(model, list(also))])
        wanted = [(place, channel) for place in OF_MAGNITUDES for channel in PLACES[place].channels]
        made = self.derivatives(model, [(LawEffect(unit_law(*one)), np.zeros(1)) for one in wanted])
        fields = fields_that_act(
            PlaceField(place, channel, one[0], unit_law(place, channel).axis_of(channel))
            for (place, channel), one in zip(wanted, made, strict=True)
        )
        known = covariate_values(aligned.state, np.asarray(model.chain(aligned.state).force, dtype=float))
        # where it points is not known but from what it reads: that is the load
        unknown = {"inc", "tf", "tf_fraction", *(HISTORY if self.session.rest else ())}
        t_s = self.session.t_s
        covariates = CovariateValues({k: values for k, values in known.items() if k not in unknown}, aligned.state.t_s)
        return LawProblem(residual, free, fields, covariates, self.floor, t_s, None, self.channels)

    def rounding(self, model: ForwardModel) -> Array:
        """(1,) 0: readings are means."""
        return np.zeros(1)

    @property
    def step_s(self) -> float:
        """Median time from reading to reading."""
        return step_of(self.session.t_s)

    @property
    def n(self) -> int:
        """Number of readings."""
        return self.session.n

    def effect_columns(self, model: ForwardModel, effect: str, values: dict[str, float]) -> tuple[Array, Array]:
        """(k, 1, n) what one unit of each amplitude of an effect does, and the amplitudes' values (k,)."""
        known = model.effect(effect)
        shape = {p.name: values.get(p.name, p.default) for p in known.shapes}
        names = [known.parameters[k].name for k in known.amplitudes]
        return self.observed.columns(model, known, shape), np.array([values.get(name, 0.0) for name in names])

    def shapes_of(self, effect: Effect) -> list[dict[str, float]]:
        """One without any where an effect has no shapes; the others are not offered beside laws."""
        return [] if effect.shapes else [{}]


class LawSession(Protocol):
    """A session as laws and names compete in it; C channels of m values."""

    @property
    def channels(self) -> tuple[str, ...]: ...
    @property
    def looked_at(self) -> LibraryColumns: ...
    @property
    def delay_s(self) -> float: ...
    @property
    def step_s(self) -> float: ...
    @property
    def free(self) -> tuple[str, ...]: ...
    @property
    def floor(self) -> Array: ...
    @property
    def observed(self) -> ObservationModel: ...
    def beside(self, model: ForwardModel, values: Effects) -> ForwardModel: ...
    def residual(self, model: ForwardModel) -> Array: ...
    def rounding(self, model: ForwardModel) -> Array: ...
    def problem(self, model: ForwardModel, residual: Array, also: Sequence[str] = ()) -> LawProblem: ...
    def derivatives(self, model: ForwardModel, wanted: Sequence[tuple[Effect, Array]]) -> list[Array]: ...
    def effect_columns(self, model: ForwardModel, effect: str, values: dict[str, float]) -> tuple[Array, Array]: ...
    def shapes_of(self, effect: Effect) -> list[dict[str, float]]: ...


def _from_the_first_row(effect: Effect) -> bool:
    """Whether what it does at a row depends on those before it, or on the time since the first."""
    if isinstance(effect, LawEffect):
        return effect.remembers or any(covariate(name).clock for name in effect.law.depends_on)
    return effect.remembers or "t_s" in effect.needs


def _sectors(session: RotationSession, orders: Sequence[float]) -> int:
    """Sectors of a turn in which lines of these orders keep their size, as far as the rows tell sectors apart."""
    turning = np.abs(session.state.rotor_rate_radps) * session.step_s
    most = 2 * np.pi / max(float(np.median(turning)), 1e-9)
    wanted = min(LAW_CELLS.a_wave * max(orders, default=0.0), most)
    return max(LAW_CELLS.sectors, round(wanted))


def cells_of(session: RotationSession, sectors: int = LAW_CELLS.sectors) -> CellMeans:
    """Sectors of toolface within some turns at one rate; where rows are few each is its own.

    Where a rate that never rests would leave nearly every row a cell of its own, sectors and then rates are wider: the
    cost of a search is that of its cells.
    """
    n = session.n
    rows = np.arange(n)
    kept = np.ones(n, dtype=bool) if session.omitted is None else ~session.omitted
    if n <= LAW_CELLS.most:
        number = np.where(kept, np.cumsum(kept) - 1, -1)
        return CellMeans(number, np.ones(int(kept.sum())), rows[kept])
    number, count = _numbered(session, kept, sectors, 1)
    while count.size > LAW_CELLS.limit and sectors > LAW_CELLS.sectors:
        sectors = max(LAW_CELLS.sectors, sectors // 2)
        number, count = _numbered(session, kept, sectors, 1)
    for wider in LAW_CELLS.wider:
        if count.size <= LAW_CELLS.limit:
            break
        number, count = _numbered(session, kept, sectors, wider)
    # the row in the middle of a cell stands for it, and says where it stands in time: rows of one cell lie turns apart
    used = number >= 0
    by_cell = np.argsort(number[used], kind="stable")
    starts = np.concatenate([[0], np.cumsum(count)[:-1]])
    middle = rows[used][by_cell[starts + count // 2]]
    order = np.argsort(middle, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    number = np.where(used, place[np.maximum(number, 0)], -1)
    count, middle = count[order], middle[order]
    return CellMeans(number, count.astype(float), middle)


def _numbered(session: RotationSession, kept: NDArray[np.bool_], sectors: int, wider: int) -> tuple[Ints, Ints]:
    """Number (n,) of each row's cell, -1 for one that is left out, and the rows of each. A cell ends where the rate has
    changed; with rates `wider` than usual it goes on when the rate is back."""
    state, turn = session.state, 2 * np.pi
    angle = state.tf_rad - state.tf_rad.min()
    sector = np.floor(np.mod(angle, turn) / turn * sectors).astype(int)
    way = np.cumsum(np.abs(np.diff(angle, prepend=angle[:1]))) / turn
    rate = state.rotor_rate_radps
    level = np.round(rate / max(wider * LAW_CELLS.rate * float(np.abs(rate).max()), 1e-12)).astype(int)
    blocks = max(2, LAW_CELLS.most // sectors)
    each = max(1.0, float(way[-1]) / blocks)
    seconds = max(float(state.t_s[-1] - state.t_s[0]), 1e-9) / blocks
    # a block ends after so many turns, after so long, or where the rate changes
    block = (
        np.floor(way / each).astype(int),
        np.floor((state.t_s - state.t_s[0]) / seconds / LAW_CELLS.slow).astype(int),
    )
    borders = (np.diff(block[0], prepend=0) != 0) | (np.diff(block[1], prepend=0) != 0)
    if wider > 1:
        of_rate = level - level.min()
        run = np.cumsum(borders).astype(np.int64) * (int(of_rate.max()) + 1) + of_rate
    else:
        run = np.cumsum(borders | (np.diff(level, prepend=level[:1]) != 0)).astype(np.int64)
    key = run * sectors + sector
    _, number, count = np.unique(np.where(kept, key, -1), return_inverse=True, return_counts=True)
    number = number.reshape(-1)
    return (number, count) if kept.all() else (number - 1, count[1:])

"""Sessions with known attitudes as the search for laws sees them: poses as they are, rows averaged in cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import shapes_tried, step_times
from highside.diagnosis.core.fit import base_fit
from highside.diagnosis.core.floor import lattice_step, rounding_errors, rounding_variance
from highside.diagnosis.core.observed import ObservationModel, Observed
from highside.diagnosis.core.set_angle_errors import turned_by_set_angles
from highside.diagnosis.laws.chain import OF_POSES, OF_ROTATION, AllRows, chain_problem, covariate_values, unit_law
from highside.diagnosis.laws.groups import HISTORY
from highside.diagnosis.laws.noise_filters import step_of
from highside.diagnosis.laws.policy import LAW_FLOOR
from highside.diagnosis.laws.problem import CovariateValues, LawProblem, PlaceField, fields_that_act
from highside.diagnosis.poses.session import PoseSession
from highside.physics.effect import Effect
from highside.physics.forward import ForwardModel
from highside.physics.law import LawEffect
from highside.physics.places import PLACES
from highside.physics.state import ChainState

if TYPE_CHECKING:
    from highside.diagnosis.law_cells import CellMeans
    from highside.diagnosis.laws.cell_noise import CellNoise
    from highside.diagnosis.magnitude.observed import Magnitudes
    from highside.diagnosis.magnitude.session import MagnitudeSession
    from highside.diagnosis.rows.session import RotationSession

Ints = NDArray[np.intp]
Effects = Mapping[str, Mapping[str, float]]
"""values of the parameters of effects, by effect"""
OF_MAGNITUDES = ("offset", "scale", "scale_all", "matrix")


LibraryColumns = list[tuple[ForwardModel, list[tuple[str, Array]]]]
"""a model, and what effects of the library do beside it, by id: made when first asked for"""


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
    forgets: Array | None = None
    """(C,) of each channel how the noise of rows is forgotten, as in `floor_of_cell_means`"""
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
        from highside.diagnosis.cell_floor import floor_of_cell_means
        from highside.diagnosis.law_cells import cells_of, sectors_of
        from highside.diagnosis.rotation.lines import found_orders

        orders = found_orders(session, residual)
        cells = cells_of(session, sectors_of(session, orders))
        least = LAW_FLOOR.least * np.sqrt(np.mean(session.readings**2, axis=1))
        # what rounding does at a toolface it does at every passage, so that differences of passages do not show it
        rounded = [np.sqrt(rounding_variance(lattice_step(row))) for row in session.readings]
        least = np.maximum(least, rounded)
        slopes = cells.from_middle(session.state.tf_rad), session.state.t_s - session.state.t_s[0]
        floor, forgets = floor_of_cell_means(residual, cells, least, slopes)
        # a function of the reading, and no law: as large in a mean as it is in all of its rows
        error = cells.mean(_rounding_of(session.readings, residual, session.state))
        floor = np.sqrt(floor**2 + error**2 / 3.0)
        return cls(
            session.state,
            session.readings,
            tuple(free),
            session.channels,
            floor,
            OF_ROTATION,
            cells,
            orders=orders,
            forgets=forgets,
        )

    @cached_property
    def lattice(self) -> Array:
        """(C,) step of the readings of single rows; 0 where they lie on no lattice, or are means."""
        if self.cells is None:
            return np.zeros(len(self.channels))
        return np.array([lattice_step(row) for row in self.readings])

    def rounding(self, model: ForwardModel) -> Array:
        """(C, m) the error that rounding leaves in means beside a model; 0 where readings lie on no lattice."""
        if not np.any(self.lattice):
            return np.zeros_like(self.floor)
        return self.reduced(_rounding_of(self.readings, self.observed.residual(model), self.state))

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
        jitter = turned_by_set_angles(model, state) if self.jitters else None
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
            among=None if self.cells is None else AllRows(self.state, self.cells),
            cells=self._cell_noise,
        )

    @cached_property
    def _cell_noise(self) -> CellNoise | None:
        """The noise of means; None where each value is one row or one pose."""
        if self.cells is None or self.forgets is None or not np.any(self.cells.count > 1):
            return None
        from highside.diagnosis.laws.cell_noise import CellNoise

        return CellNoise(self.cells, self.state.t_s, self.floor, self.forgets)

    def derivatives(self, model: ForwardModel, wanted: Sequence[tuple[Effect, Array]]) -> list[Array]:
        """(k, C, m) by the parameters of each effect, at its vector."""
        gyros = len(self.channels) > len("xyz")
        if self.cells is None:
            return model.derivatives(self.state, wanted, gyros=gyros)
        own, others = ([one for one in wanted if one[0].remembers is k] for k in (True, False))
        # what remembers does so from row to row, and what follows the clock from the first row on
        of_all = iter(model.derivatives(self.state, own, gyros=gyros, rows=self.cells.middle) if own else [])
        after_first = np.arange(1, self.cells.count.size + 1)
        of_cells = iter(model.derivatives(self._since_first, others, gyros=gyros, rows=after_first) if others else [])
        return [next(of_all if effect.remembers else of_cells) for effect, _ in wanted]

    @cached_property
    def _since_first(self) -> ChainState:
        """The first row, and the states of the cells."""
        assert self.cells is not None
        return self.cells.state(self.state, since_first=True)

    def effect_columns(self, model: ForwardModel, effect: str, values: dict[str, float]) -> tuple[Array, Array]:
        """(k, C, m) what one unit of each amplitude of an effect does, and the amplitudes' values (k,)."""
        known = model.effect(effect)
        shape = {p.name: values.get(p.name, p.default) for p in known.shapes}
        names = [known.parameters[k].name for k in known.amplitudes]
        epochs = [p.name for p in known.shapes if p.epoch]
        if epochs and self.cells is not None:
            columns = self._setting_in(model, known, shape, epochs)
        else:
            columns = self.reduced_observed.columns(model, known, shape)
        return columns, np.array([values.get(name, 0.0) for name in names])

    def _setting_in(self, model: ForwardModel, effect: Effect, shape: dict[str, float], epochs: list[str]) -> Array:
        """(k, C, m) by the amplitudes of an effect that sets in: within a cell it acts on a part of its rows, of which
        their mean time knows nothing."""
        assert self.cells is not None
        if effect.remembers:
            return self.reduced(self.observed.columns(model, effect, shape))
        all_cells = Observed(self._since_first, np.zeros((len(self.channels), self.cells.count.size + 1)))
        columns = all_cells.columns(model, effect, shape)[..., 1:]
        first, last = self._ends
        onsets = np.array([shape[name] for name in epochs])[:, None]
        within = np.any((first < onsets) & (onsets <= last), axis=0)
        if within.any():
            rows, mean = self.cells.within(within)
            own = Observed(self.state.rows(np.concatenate([[0], rows])), np.zeros((len(self.channels), rows.size + 1)))
            columns[..., within] = mean(own.columns(model, effect, shape)[..., 1:])[..., within]
        return columns

    @cached_property
    def _ends(self) -> tuple[Array, Array]:
        """(m,) seconds since the first row at the first and at the last row of each cell."""
        assert self.cells is not None
        elapsed, used = self.state.t_s - self.state.t_s[0], self.cells.number >= 0
        first, last = np.full(self.cells.count.size, np.inf), np.zeros(self.cells.count.size)
        np.minimum.at(first, self.cells.number[used], elapsed[used])
        np.maximum.at(last, self.cells.number[used], elapsed[used])
        return first, last

    def shapes_of(self, effect: Effect) -> list[dict[str, float]]:
        """The values of an effect's shapes that are tried; one without any where it has none, none for a line of a
        spectrum."""
        if effect.line is not None:
            return []
        return shapes_tried(effect, self.reduced_state, step_times(self.reduced_state))


def _rounding_of(readings: Array, left: Array, state: ChainState) -> Array:
    """(C, n) the error, at most, that rounding of readings leaves in means beside a fit, of which `left` is left; a
    third of its square is its mean square."""
    tf_rad = np.asarray(state.tf_rad, dtype=float)
    return np.stack([rounding_errors(*one, tf_rad) for one in zip(readings, left, strict=True)])


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
        """(1, n) 0: readings are means."""
        return np.zeros_like(self.floor)

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

"""All columns of a long recording, made chunk by chunk: base, effects of the library, unnamed interactions and locating
groups.

A *column* (what one amplitude of an effect adds) has on each channel one *function* of the rows, or none. Functions are
numbered channel by channel: first the channel's own (what comes through the chain), then those that only follow
covariates, which are the same on every channel and made once. What a column is made of is found out on a few rows (a
probe), so nothing here knows single effects; an effect declares how a shape that is not smooth is searched (the time of
a step, the frequency of a line).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate, Unobservable, Variant, shapes_tried, what_lacks
from highside.diagnosis.core.chunks import chunks_of
from highside.diagnosis.core.untestable import one_sided
from highside.diagnosis.rows.bases import BasisGroup, Recipe, Rows, rotation_groups, rotation_interactions
from highside.diagnosis.rows.policy import DESIGN
from highside.diagnosis.rows.scratch import all_with_memory, kept, rows_with_memory
from highside.diagnosis.rows.session import FIRST_GYRO, RotationSession
from highside.long_arrays import runs_of
from highside.physics.effect import Effect, Stage
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.outside_effects import EPOCHS, wave_of
from highside.physics.state import ChainState
from highside.scratch_arrays import stored

Ints = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Line:
    """A line found in the residual: `value` of the frequency of an `effect`, among so many that were searched."""

    effect: str
    value: float
    searched: int


@dataclass(frozen=True)
class _Source:
    """An effect through the chain: amplitudes (k,), and numbers (k, C) of what they do on the channels, -1 for none."""

    effect: Effect
    vector: Array
    amplitudes: tuple[int, ...]
    numbers: Ints
    stored: dict[tuple[int, int], Array] | None
    """(N,) by amplitude and channel where the effect has hysteresis and cannot be made in chunks"""

    def row(self, amplitude: int, channel: int, part: slice) -> Array:
        """A run of rows of what is stored."""
        assert self.stored is not None
        return np.asarray(self.stored[amplitude, channel][part])

    def among(self, place: Sequence[Ints]) -> bool:
        """Whether any of its functions has a place (m_c,) on its channel."""
        return any(bool(np.any(own[n[n >= 0]] >= 0)) for own, n in zip(place, self.numbers.T, strict=True))


def _over_time(effect: Effect) -> bool:
    """Whether the frequency of a line is counted in time, not in turns."""
    return effect.line is not None and effect.line.line_over == "time"


def _probe_rows(state: ChainState) -> Ints:
    """Rows at which every effect shows that shows at all: evenly spread, and where each covariate is extreme."""
    rows = [np.linspace(0, state.n - 1, DESIGN.probe).astype(np.intp)]
    for along in (
        state.inc_rad,
        state.temp_c,
        state.rotor_rate_radps,
        state.rotor_accel_radps2,
        state.inc_rate_radps,
        state.vibration_rms_g,
    ):
        rows += _extremes(along)
    return np.unique(np.concatenate(rows))


def _extremes(along: Array) -> list[Ints]:
    """The rows of the smallest and of the largest values (N,): of equal ones the first, and the last."""
    low, high = np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp)
    for part in runs_of(along.shape[-1]):
        order = part.start + np.argsort(along[part], kind="stable")
        both = [np.concatenate([low, order[: DESIGN.extremes]]), np.concatenate([high, order[-DESIGN.extremes :]])]
        low, high = (every[np.argsort(along[every], kind="stable")] for every in both)
        low, high = low[: DESIGN.extremes], high[-DESIGN.extremes :]
    return [low, high]


class Design(ABC):
    """The columns of a session beside a base whose effects `free` are adjusted anyway.

    `where` (P, C): for each column the number of its function on each channel, -1 for none. `base` are the numbers of
    the base's columns; `cells` those of each (channel, group), in the order of `cell_of`; `sizes` (C,) how many
    functions a channel has.
    """

    where: Ints
    base: Ints
    sizes: list[int]
    groups: list[BasisGroup]

    def __init__(self, session: RotationSession, free: Sequence[str], lines: Sequence[Line] = ()) -> None:
        self.session, self.free, self.lines = session, tuple(free), tuple(lines)
        self.candidates: list[Candidate] = []
        self.unobservable: list[Unobservable] = []
        self.cells: list[Ints] = []
        self.cell_of: list[tuple[int, int]] = []
        self._columns: list[Ints] = []
        """of each column the numbers on the channels"""

    @abstractmethod
    def functions(self, part: slice, below: Array | None = None, only: Sequence[Ints] | None = None) -> list[Array]:
        """The functions (m_c, n) of each channel on a run of rows; with rows `below` (C, N), (m_c + 1, n).

        Or `only` those of the numbers (k_c,) of each channel, in their order.
        """

    def turns(self) -> list[Array]:
        """(N,) revolutions of the tool, then of each line, from any beginning."""
        state = self.session.state
        turned = state.tf_rad / (2 * np.pi)
        return [turned] + [
            line.value * (state.t_s if _over_time(all_effects()[line.effect]) else turned) for line in self.lines
        ]

    # -- what the rows become

    def chunks(self) -> Iterator[slice]:
        """Runs of rows that together are the whole recording."""
        yield from chunks_of(self.session.n)

    def readings_of(self, column: int, amplitude: float, part: slice) -> Array:
        """(C, n) what a column adds on a run of rows."""
        functions = self.functions(part)
        result = np.zeros((len(functions), functions[0].shape[1]))
        for c, number in enumerate(self.where[column]):
            if number >= 0:
                result[c] = amplitude * functions[c][number]
        return result

    def _add(self, own: Ints) -> int:
        self._columns.append(own)
        return len(self._columns) - 1


class ChainDesign(Design):
    """The columns beside a fitted base `model`: effects go through its chain.

    While columns are gathered, shared functions are numbered from `DESIGN.far` on: their place is known at the end.
    """

    def __init__(
        self,
        session: RotationSession,
        model: ForwardModel,
        free: Sequence[str],
        lines: Sequence[Line] = (),
        onset_s: float | None = None,
    ) -> None:
        """`onset_s` is an instant since the first row that is tried beside the grid of those at which something may
        begin."""
        super().__init__(session, free, lines)
        self._onset_s = onset_s
        self.model = model
        self._sources: list[_Source] = []
        self._recipes: list[tuple[int, int, Recipe]] = []
        """of the shared functions: the first of a recipe, how many it makes"""
        self._shared = 0
        self._own = np.zeros(len(session.channels), dtype=np.intp)
        self._slow_functions: dict[tuple[tuple[float, ...], bool, bytes], int] = {}
        """the shared functions of time or temperature, by their shape and their values on the probe"""
        self._probe_state = session.state.rows(np.concatenate([[0], _probe_rows(session.state)]))
        self.base = np.array(self._add_base(), dtype=np.intp)
        self._add_effects(lines)
        self._add_interactions()
        self.groups = rotation_groups(session.state)
        for b, group in enumerate(self.groups):
            functions = self._share(group.make)
            for c in range(len(session.channels)):
                self.cell_of.append((c, b))
                self.cells.append(np.array([self._on(c, f) for f in functions]))
        where = np.array(self._columns)
        self.where = np.where(where >= DESIGN.far, where - DESIGN.far + self._own, where)
        self.sizes = [int(own) + self._shared for own in self._own]

    def functions(self, part: slice, below: Array | None = None, only: Sequence[Ints] | None = None) -> list[Array]:
        wanted = [np.arange(m) for m in self.sizes] if only is None else only
        place = [np.full(m, -1, dtype=np.intp) for m in self.sizes]
        for own, numbers in zip(place, wanted, strict=True):
            own[numbers] = np.arange(numbers.size)
        result = [np.empty((w.size + (below is not None), part.stop - part.start)) for w in wanted]
        # the first row of all stands before the run: effects reckon time from it
        state = self.session.state.rows(np.concatenate([[0], np.arange(part.start, part.stop)]))
        sources = [s for s in self._sources if only is None or s.among(place)]
        made = [s for s in sources if s.stored is None]
        blocks = iter(self._evaluate(state, [(s.effect, s.vector, s.amplitudes) for s in made]) if made else [])
        for source in sources:
            block = next(blocks)[:, :, 1:] if source.stored is None else None
            for k, c in zip(*np.nonzero(source.numbers >= 0), strict=True):
                at = place[c][source.numbers[k, c]]
                if at >= 0:
                    result[c][at] = source.row(int(k), int(c), part) if block is None else block[k, c]
        rows = Rows(state.rows(slice(1, None)), part.start, state)
        for first, count, recipe in self._recipes:
            at = np.array(
                [own[int(m) + first : int(m) + first + count] for own, m in zip(place, self._own, strict=True)]
            )
            if (at >= 0).any():
                for k, function in enumerate(recipe(rows)):
                    for c in np.flatnonzero(at[:, k] >= 0):
                        result[c][at[c, k]] = function
        if below is not None:
            for c, made_of in enumerate(result):
                made_of[-1] = below[c, part]
        return result

    # -- what there is

    def _add_base(self) -> list[int]:
        by_effect: dict[str, list[int]] = {}
        for name in self.model.free_names(list(self.free)) if self.free else []:
            effect_id, _, parameter = name.partition(".")
            names = [p.name for p in self.model.effect(effect_id).parameters]
            by_effect.setdefault(effect_id, []).append(names.index(parameter))
        numbers: list[int] = []
        for effect_id, amplitudes in by_effect.items():
            numbers += self._through(self.model.effect(effect_id), self.model.vector_of(effect_id), amplitudes)
        return [n for n in numbers if n >= 0]

    def _add_effects(self, lines: Sequence[Line]) -> None:
        for effect in all_effects().values():
            absent = effect.stage is Stage.GYRO and not self.session.gyros
            absent |= one_sided(effect, self.session.state)
            if effect.random or effect.id in self.free:
                continue
            searched = 0
            tried: list[tuple[dict[str, float], list[int]]] = []
            if effect.line is not None:
                own = [line for line in lines if line.effect == effect.id]
                searched = max((line.searched for line in own), default=0)
                tried = [({effect.line.name: line.value}, self._line(effect, line.value)) for line in own]
            elif not absent and self._follows_time(effect) and self._axes(effect) is not None:
                tried = [(shape, self._slow(effect, shape)) for shape in self._shapes(effect)]
            elif not absent:
                vectors = [(shape, self._vector(effect, shape)) for shape in self._shapes(effect)]
                tried = [(shape, self._through(effect, vector, effect.amplitudes)) for shape, vector in vectors]
            names = tuple(effect.parameters[k].name for k in effect.amplitudes)
            variants = []
            for shape, columns in tried:
                for part in effect.parts:
                    numbers = np.array([columns[k] for k in part])
                    if np.any(numbers >= 0):
                        variants.append(Variant(shape, numbers, whole=len(part) == len(names)))
            if variants:
                self.candidates.append(Candidate(effect.id, effect, names, tuple(variants), searched))
            elif effect.line is None:
                self.unobservable.append(Unobservable(effect, what_lacks(effect, self.session.state)))

    def _add_interactions(self) -> None:
        groups = rotation_interactions(self.session.state)
        # without a name they are one family: whatever else it may be
        family = sum(len(group.labels) for group in groups) * 3
        for group in groups:
            functions = self._share(group.make)
            variants = []
            for c, axis in enumerate("xyz"):
                each = 2 if group.pairs else 1
                for k, label in enumerate(group.labels):
                    if not (group.off_axis and label == axis):
                        numbers = np.array([self._on(c, f) for f in functions[each * k : each * (k + 1)]])
                        words = group.name if group.pairs else f"{group.name} x {label}"
                        variants.append(Variant({}, numbers, f"{words} on {self.session.channels[c]}"))
            self.candidates.append(
                Candidate(f"interaction:{group.name}:{group.labels[0]}", None, ("a",), tuple(variants), family)
            )

    def _shapes(self, effect: Effect) -> list[dict[str, float]]:
        length = float(np.ptp(self.session.state.t_s))
        epochs = np.linspace(DESIGN.step_margin * length, (1 - DESIGN.step_margin) * length, EPOCHS)
        shapes = shapes_tried(effect, self.session.state, [float(t) for t in epochs])
        if self._onset_s is not None and len(effect.shapes) == 1 and effect.shapes[0].epoch:
            shapes.append({effect.shapes[0].name: self._onset_s})
        return shapes

    def _vector(self, effect: Effect, shape: dict[str, float]) -> Array:
        vector = np.array(self.model.vector_of(effect.id), dtype=float)
        for k, parameter in enumerate(effect.parameters):
            if parameter.name in shape:
                vector[k] = shape[parameter.name]
            elif not parameter.shape and not effect.complex_safe and parameter.gate[0] == 0.0 and vector[k] == 0.0:
                # a slack has no derivative at zero: its slope is taken where it has some size
                vector[k] = parameter.typical
        return vector

    def _through(self, effect: Effect, vector: Array, amplitudes: Sequence[int]) -> list[int]:
        """Columns of an effect through the chain; -1 for one that leaves no trace."""
        wanted = tuple(amplitudes)
        columns: dict[tuple[int, int], Array] | None = None
        if effect.complex_safe:
            probe = self._evaluate(self._probe_state, [(effect, vector, wanted)])[0][:, :, 1:]
            shows = np.max(np.abs(probe), axis=2) > DESIGN.nothing
        else:
            # a play has hysteresis: all rows, one after the other
            shows, columns = self._all_rows(effect, vector, wanted)
        of_channels = np.where(shows, self._own + np.cumsum(shows, axis=0) - 1, -1)
        self._own += shows.sum(axis=0)
        self._sources.append(_Source(effect, vector, wanted, of_channels, columns))
        return [self._add(own) if (own >= 0).any() else -1 for own in of_channels]

    def _all_rows(
        self, effect: Effect, vector: Array, wanted: tuple[int, ...]
    ) -> tuple[NDArray[np.bool_], dict[tuple[int, int], Array]]:
        """Whether each amplitude shows on each channel (k, C), and where it does what it adds to all rows (N,)."""
        session, count = self.session, (len(wanted), len(self.session.channels))
        if not session.long:
            whole = self._evaluate(session.state, [(effect, vector, wanted)])[0]
            shows = np.max(np.abs(whole), axis=2) > DESIGN.nothing
            return shows, {(k, c): kept(whole[k, c]) for k, c in np.argwhere(shows).tolist()}
        made = rows_with_memory(session.state, lambda state: self._evaluate(state, [(effect, vector, wanted)])[0])
        flat = (np.reshape(rows, (count[0] * count[1], -1)) for rows in made)
        every = stored(session.readings, (count[0] * count[1], session.n), flat)
        shows = np.reshape(np.abs(every).max(axis=1) > DESIGN.nothing, count)
        return shows, {(k, c): every[k * count[1] + c] for k, c in np.argwhere(shows).tolist()}

    def _only(self, effect: Effect, shape: dict[str, float], k: int) -> Array:
        """(K,) one unit of the k-th amplitude alone."""
        vector = self._vector(effect, shape)
        vector[list(effect.amplitudes)] = 0.0
        vector[effect.amplitudes[k]] = 1.0
        return vector

    @staticmethod
    def _follows_time(effect: Effect) -> bool:
        """Whether it is made of functions of time or temperature alone, the same on whatever channel they are."""
        return not effect.depends_on_input and (
            effect.stage is Stage.THERMAL or (effect.stage is Stage.GYRO and effect.slow)
        )

    def _axes(self, effect: Effect) -> list[tuple[int, int]] | None:
        """Of each amplitude the axis that it acts on (-1: none), and the first amplitude that does the same on its own:
        what a few rows show. None where one acts on several."""
        shape = self._shapes(effect)[0]
        nothing = np.zeros((3, self._probe_state.n))
        found: list[tuple[int, int]] = []
        rows: list[Array] = []
        for k in range(len(effect.amplitudes)):
            added = np.asarray(effect.delta(self._probe_state, self._only(effect, shape, k), nothing))
            axes = np.flatnonzero(np.any(added != 0, axis=1))
            if axes.size > 1:
                return None
            rows.append(added[axes[0]] if axes.size else nothing[0])
            same = next(j for j, row in enumerate(rows) if np.array_equal(row, rows[-1]))
            found.append((int(axes[0]) if axes.size else -1, same))
        return found

    def _slow(self, effect: Effect, shape: dict[str, float]) -> list[int]:
        """Columns of an effect of time or temperature alone: what is the same on several axes is made once."""
        state = self.session.state
        first_channel = FIRST_GYRO if effect.stage is Stage.GYRO else 0
        functions: dict[int, int] = {}
        numbers = []
        for k, (axis, same) in enumerate(self._axes(effect) or []):
            if axis < 0:
                numbers.append(-1)
                continue
            if same not in functions:
                functions[same] = self._slow_function(effect, shape, k, axis)
            numbers.append(self._on(first_channel + axis, functions[same]))
        if np.ptp(state.temp_c) == 0.0 and "temp_c" in effect.needs:
            return [-1] * len(numbers)
        return numbers

    def _slow_function(self, effect: Effect, shape: dict[str, float], k: int, axis: int) -> int:
        """Number of the function of the k-th amplitude; one that another effect has already serves both."""
        vector = self._only(effect, shape, k)
        probe = np.asarray(
            effect.delta(self._probe_state, vector, np.zeros((3, self._probe_state.n)))[axis], dtype=float
        )
        key = (tuple(shape.values()), effect.remembers, probe.tobytes())
        if key not in self._slow_functions:
            self._slow_functions[key] = self._share(self._slow_recipe(effect, vector, axis))[0]
        return self._slow_functions[key]

    def _slow_recipe(self, effect: Effect, vector: Array, axis: int) -> Recipe:
        if not effect.remembers and any(p.epoch for p in effect.shapes):
            # of the many times of onset none is stored

            def begun(rows: Rows) -> list[Array]:
                state = rows.state if rows.begun is None else rows.begun
                added = np.asarray(effect.delta(state, vector, np.zeros((3, state.n)))[axis], dtype=float)
                return [added if rows.begun is None else added[1:]]

            return begun
        # it may have hysteresis: all rows, one after the other
        session = self.session

        def added(state: ChainState) -> Array:
            return np.asarray(effect.delta(state, vector, np.zeros((3, state.n)))[axis])

        if session.long:
            every = stored(session.readings, (session.n,), rows_with_memory(session.state, added))
        else:
            every = kept(all_with_memory(session.state, added))
        return lambda rows: [every[rows.first : rows.first + rows.state.n]]

    def _line(self, effect: Effect, value: float) -> list[int]:
        """A cosine or a sine on one axis for each amplitude of a line."""

        def wave(rows: Rows) -> list[Array]:
            phase = value * (2 * np.pi * rows.state.t_s if _over_time(effect) else rows.state.tf_rad)
            return [np.asarray(np.cos(phase)), np.asarray(np.sin(phase))]

        functions = self._share(wave)
        return [self._on(axis, functions[phase]) for axis, phase in wave_of(effect)]

    def _share(self, recipe: Recipe) -> list[int]:
        """Numbers of the functions of a recipe among the shared ones."""
        count = len(recipe(Rows(self.session.state.rows(slice(0, 2)))))
        self._recipes.append((self._shared, count, recipe))
        numbers = list(range(self._shared, self._shared + count))
        self._shared += count
        return numbers

    def _on(self, channel: int, function: int) -> int:
        """A new column: a shared function on one channel."""
        own = np.full(self._own.size, -1, dtype=np.intp)
        own[channel] = DESIGN.far + function
        return self._add(own)

    def _evaluate(self, state: ChainState, wanted: Sequence[tuple[Effect, Array, tuple[int, ...]]]) -> list[Array]:
        """(k, C, n) of each (effect, vector, amplitudes)."""
        found = self.model.derivatives(state, [(e, v) for e, v, _ in wanted], gyros=self.session.gyros)
        return [np.asarray(f[list(a)], dtype=float) for f, (_, _, a) in zip(found, wanted, strict=True)]

"""What could have been left out: the columns that each effect of the library would add to the readings, per unit.

Effects are taken to first order at the fitted base model. A parameter that only shapes an effect (a time constant, a
harmonic order, the time of a step) is tried at several values, and all amplitudes or one of the groups that the effect
declares are let act: the *variants* of the candidate.

Beside the named effects stand *unnamed interactions*: products of temperature, time or direction of approach with
powers of the load. They are there so that an interaction outside of the library is not given the name of the nearest
effect inside it; an unnamed interaction that wins is reported as unknown, with its covariates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from highside.arrays import AnyArray, Array
from highside.diagnosis.core.policy import CANDIDATES
from highside.diagnosis.core.untestable import one_sided
from highside.physics.effect import Effect, Parameter, Stage
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel
from highside.physics.outside_effects import EPOCHS, MOST_SHAPES
from highside.physics.state import ChainState

CHANNELS = ("ax", "ay", "az")
ONE_SIDE = "every attitude is reached from one side, so it is a constant; or the side is not recorded"
INCLINATION_STATION = "interaction:inclination_station"
"""Id of what is off on one inclination station alone: measured in one go, it looks like serially correlated noise."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A candidate at one value of its shape: `columns` (k, 3, n), one for each amplitude that is let act.

    For a long recording `columns` (k,) are their numbers in the `Design` instead. `whole` says that all amplitudes act;
    else only some do (one axis, one order of a polynomial), so that an effect on one axis is not judged as if it had
    needed three.
    """

    shape: dict[str, float]
    columns: AnyArray
    label: str = ""
    whole: bool = True


@dataclass(frozen=True, slots=True)
class Candidate:
    """An effect of the library, or an unnamed interaction (`effect` is None, each variant one product of
    covariates)."""

    id: str
    effect: Effect | None
    amplitudes: tuple[str, ...]
    variants: tuple[Variant, ...]
    searched: int = 0
    """how many values of a shape were looked through to find the variants, where these are only the best"""

    @property
    def named(self) -> bool:
        """Whether this has a name a report may give."""
        return self.effect is not None

    @property
    def slow(self) -> bool:
        """Whether it is a function of time or temperature alone: a random walk may look like it."""
        return self.effect is not None and self.effect.slow

    def unit(self) -> Array:
        """(k,) a typical size of each amplitude; 1 for unnamed interactions."""
        if self.effect is None:
            return np.ones(len(self.amplitudes))
        return np.array([p.typical for p in self.effect.parameters if not p.shape])


@dataclass(frozen=True, slots=True)
class Unobservable:
    """An effect that the recording cannot show because what it follows is constant or not recorded."""

    effect: Effect
    why: str


def pose_candidates(
    model: ForwardModel, state: ChainState, free: Sequence[str]
) -> tuple[list[Candidate], list[Unobservable]]:
    """Candidates among the library's effects for a session of poses, and those that leave no trace at all in it.

    `free` are the effects that the base fit adjusts anyway. Gyro effects are no matter of the triad and left out.
    """
    wanted = [
        effect
        for effect in all_effects().values()
        if not effect.random and effect.stage is not Stage.GYRO and effect.id not in free
    ]
    plain = [effect for effect in wanted if len(effect.amplitudes) == len(effect.parameters)]
    columns = _plain_columns(model, state, plain)
    found: list[Candidate] = []
    unobservable: list[Unobservable] = []
    for effect in wanted:
        names = tuple(effect.parameters[k].name for k in effect.amplitudes)
        if one_sided(effect, state):
            unobservable.append(Unobservable(effect, ONE_SIDE))
            continue
        if effect.averages_out:
            unobservable.append(Unobservable(effect, effect.averages_out))
            continue
        variants = [Variant({}, columns[effect.id])] if effect in plain else _shaped(model, state, effect)
        variants = [
            Variant(v.shape, v.columns[list(part)], whole=len(part) == len(names))
            for v in variants
            for part in effect.parts
            if np.any(np.abs(v.columns[list(part)]) > 1e-12)
        ]
        if variants:
            found.append(Candidate(effect.id, effect, names, tuple(variants)))
        else:
            unobservable.append(Unobservable(effect, what_lacks(effect, state)))
    return found, unobservable


def columns_of(
    model: ForwardModel,
    state: ChainState,
    effect: Effect,
    shape: dict[str, float],
    force: Array | None = None,
    *,
    gyros: bool = False,
) -> Array:
    """(k, 3, n): change of the report with each amplitude of an effect at the given shape; with `gyros` (k, 6, n).

    `force` (3, n), the model's specific force where it is known already, saves the evaluation of the chain.
    """
    start = dict(zip((p.name for p in effect.parameters), model.vector_of(effect.id).tolist(), strict=True))
    for k in effect.amplitudes:
        parameter = effect.parameters[k]
        if not effect.complex_safe and parameter.gate[0] == 0.0 and start[parameter.name] == 0.0:
            # a slack has no derivative at zero: its slope is taken where it has some size
            start[parameter.name] = parameter.typical
    if effect.stage in (Stage.SENSOR, Stage.THERMAL) and force is not None:
        # at the end of the chain: what the effect adds is what the report changes by
        vector = effect.vector({**start, **shape})
        return np.asarray(effect.derivative(state, vector, force), dtype=float)[list(effect.amplitudes)]
    names = [f"{effect.id}.{effect.parameters[k].name}" for k in effect.amplitudes]
    with_it = model.with_effects({effect.id: {**start, **shape}})
    found = with_it.jacobian(state, names)
    if gyros:
        found = np.concatenate([found, with_it.gyro_jacobian(state, names)], axis=1)
    return np.asarray(found, dtype=float)


def _plain_columns(model: ForwardModel, state: ChainState, effects: Sequence[Effect]) -> dict[str, Array]:
    """Columns of effects without shapes: those that are smooth in one evaluation of the chain."""
    smooth = [effect for effect in effects if effect.complex_safe]
    every = np.asarray(model.jacobian(state, [effect.id for effect in smooth]), dtype=float)
    result: dict[str, Array] = {}
    at = 0
    for effect in smooth:
        size = len(effect.amplitudes)
        result[effect.id] = every[at : at + size]
        at += size
    for effect in effects:
        if effect.id not in result:
            result[effect.id] = columns_of(model, state, effect, {})
    return result


def _shaped(model: ForwardModel, state: ChainState, effect: Effect) -> list[Variant]:
    force = np.asarray(model.chain(state).force, dtype=float)
    shapes = shapes_tried(effect, state, step_times(state))
    return [Variant(shape, columns_of(model, state, effect, shape, force)) for shape in shapes]


def shapes_tried(effect: Effect, state: ChainState, epochs: Sequence[float]) -> list[dict[str, float]]:
    """Every combination of the values that are tried of an effect's shapes; `epochs` are those of a time of onset."""
    values = [
        tuple(epochs) if p.epoch else time_constants(p, state) if p.time_constant else p.grid for p in effect.shapes
    ]
    # beside another shape a time of onset is looked for more coarsely
    every = max(1, -(-math.prod(len(v) for v in values) // MOST_SHAPES))
    values = [v[::every] if p.epoch else v for p, v in zip(effect.shapes, values, strict=True)]
    return [dict(zip((p.name for p in effect.shapes), found, strict=True)) for found in product(*values)]


def time_constants(shape: Parameter, state: ChainState) -> tuple[float, ...]:
    """The grid of a time constant, halved and doubled on to all that are plausible and that a recording distinguishes.

    The shortest is longer than from one reading to the next; the longest curves within the recording hardly at all.
    """
    length = float(np.ptp(state.t_s))
    shortest = max(shape.gate[0], length * CANDIDATES.shortest, length / max(state.n - 1, 1))
    values = list(shape.grid)
    while values[0] / 2 >= shortest:
        values.insert(0, values[0] / 2)
    while values[-1] < min(length, shape.gate[1]):
        values.append(min(2 * values[-1], shape.gate[1]))
    return tuple(values)


def step_times(state: ChainState) -> tuple[float, ...]:
    """Instants between poses, away from both ends, for a step that could be anywhere; of one attitude, whose means are
    many and alike, fewer."""
    elapsed = state.t_s - state.t_s[0]
    between = (elapsed[:-1] + elapsed[1:]) / 2
    inner = between[CANDIDATES.from_the_ends : -CANDIDATES.from_the_ends]
    moves = max(float(np.ptp(state.inc_rad)), float(np.ptp(state.tf_rad))) > 0.0
    most = min(CANDIDATES.onsets if moves else EPOCHS, inner.size)
    keep = np.unique(np.linspace(0, inner.size - 1, most).round().astype(int))
    return tuple(float(value) for value in inner[keep])


def what_lacks(effect: Effect, state: ChainState) -> str:
    """Why an effect leaves no trace at all."""
    words = {
        "temp_c": "the temperature does not change, or is not recorded",
        "rotor_rate_radps": "the tool does not rotate while it is read",
        "rotor_accel_radps2": "the rotation is not sped up or slowed down",
        "vibration_rms_g": "vibration is not recorded, or there is none",
        "vibration_x_rms_g": "vibration is not recorded axis by axis, or there is none",
        "since_move_s": "every pose is read after the same time, or the recording has no poses",
        "direction": ONE_SIDE,
        "t_s": "the recording has no length",
    }
    lacking = [words[name] for name in effect.needs if name in words and np.ptp(getattr(state, name)) == 0.0]
    if effect.known_size and np.isnan(state.latitude_rad):
        return "latitude and azimuth of the bench are not known"
    if effect.stage is Stage.GYRO and not lacking:
        return "gyros are not recorded, or do not respond to it here"
    if lacking:
        return lacking[0]
    moves = max(float(np.ptp(state.inc_rad)), float(np.ptp(state.tf_rad))) > 0.0
    return "it does not act in any attitude of this recording" if moves else "the tool does not move while it is read"


def observed_through(candidates: Sequence[Candidate], project: Callable[[Array], Array]) -> list[Candidate]:
    """Candidates by what they do to other observations than the readings, without those that do nothing to them;
    `project` takes columns (k, 3, n) to (k, C, n)."""
    found = []
    for candidate in candidates:
        variants = [replace(variant, columns=project(variant.columns)) for variant in candidate.variants]
        shown = tuple(variant for variant in variants if np.any(variant.columns != 0))
        if shown:
            found.append(replace(candidate, variants=shown))
    return found


def unnamed_interactions(state: ChainState, force: Array) -> list[Candidate]:
    """Unnamed interactions; `force` (3, n) in g. Each variant is one column on one channel."""
    x, y, z = force
    linear = {"x": x, "y": y, "z": z}
    square = {"x^2": x * x, "y^2": y * y, "z^2": z * z, "x y": x * y, "x z": x * z, "y z": y * z}
    cubic = {"x^3": x**3, "y^3": y**3, "z^3": z**3, "|x|": abs(x), "|y|": abs(y), "|z|": abs(z), "x y z": x * y * z}
    elapsed = state.t_s - state.t_s[0]
    time = elapsed / max(float(elapsed[-1]), 1e-9)
    found: list[Candidate] = []

    def add(name: str, covariate: Array, terms: dict[str, Array], own_axis: bool = True) -> None:
        variants = []
        for channel, axis in enumerate("xyz"):
            for label, term in terms.items():
                if label == axis and not own_axis:
                    continue
                column = np.zeros((1, 3, state.n))
                column[0, channel] = covariate * term
                words = label if name == "one" else f"{name} x {label}"
                variants.append(Variant({}, column, f"{words} on {CHANNELS[channel]}"))
        kind = "inclination_station" if name == "one" else name
        found.append(Candidate(f"interaction:{kind}:{next(iter(terms))}", None, ("a",), tuple(variants)))

    if np.ptp(state.temp_c) > CANDIDATES.warm_span_c:
        warm = (state.temp_c - state.temp_c.mean()) / state.temp_c.std()
        add("temperature", warm, linear, own_axis=False)
        add("temperature", warm, square)
        add("temperature", warm, cubic)
        add("temperature^2", warm**2, linear)
    add("time", time, linear)
    add("time", time, square)
    if np.ptp(state.direction) > 0:
        add("direction of approach", np.asarray(state.direction), linear)
    numbers, first = np.unique(state.inclination_station, return_index=True)
    if numbers.size > CANDIDATES.inclination_stations and CANDIDATES.least_at_station * numbers.size <= state.n:
        inclination_stations = {
            f"inclination station at {np.degrees(state.inc_rad[i]):g} deg": np.asarray(
                state.inclination_station == k, dtype=float
            )
            for k, i in zip(numbers, first, strict=True)
        }
        add("one", np.ones(state.n), inclination_stations)
    return found

"""The forward model: from where the bench says the tool is to what the triad reports, with any set of effects.

    t        = stamp + sum of TIMING effects                                  (s; the covariates follow by their rates)
    I, E, T  = encoder readings + sum of POSE effects                         (rad)
    w        = Rz(T) Rx(E) Ry(I) v/|v|,  v = (0, 0, 1) + sum of GRAVITY effects  (true gravity in the tool frame, g)
    f        = exp([mounting]) w + sum of KINEMATIC effects                   (specific force at the triad, g)
    m        = f + sum of SENSOR and THERMAL effects of f                     (reported, g)
    rates    = [I' sin T, -I' cos T, -T'] + sum of GYRO effects               (reported by gyros, rad/s)

The Jacobian follows the same way by the chain rule, effect by effect in closed form or by complex step. Pure: a model
is a value, and `predict` and `jacobian` change nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import AnyArray
from highside.errors import InputError
from highside.physics import effects as library
from highside.physics.effect import Effect, RandomEffect, RecordEffect, Stage
from highside.physics.gravity import attitude_of, rotate_x, rotate_y, rotate_z, rotation_matrix, unit
from highside.physics.law import Law, LawEffect
from highside.physics.state import ChainState

Draws = Mapping[Stage, AnyArray]
"""realised random increments by the stage they disturb"""
Rows = NDArray[np.intp] | None
STEP_S = 1e-4
"""Half-width of the differences that give how fast the bench's own error of angle changes."""


@dataclass(frozen=True, slots=True)
class Chain:
    """What stands between the stages of one evaluation; arrays (3, N)."""

    state: ChainState
    """with the TIMING effects"""
    pose: AnyArray
    """I, E, T in rad after the POSE effects"""
    vertical: AnyArray
    """the lab's vertical, unit"""
    lab: AnyArray
    """before normalisation"""
    after_inc: AnyArray
    after_cross: AnyArray
    gravity: AnyArray
    """true gravity in the tool frame, unit: what a perfect instrument must report"""
    mounting: AnyArray
    """rotation vector, (3,) rad"""
    rotation: AnyArray
    """tool frame to triad frame, (3, 3)"""
    force: AnyArray
    """specific force at the triad, g: the input of the SENSOR and THERMAL stages"""
    reported: AnyArray
    """g"""


@dataclass(frozen=True, slots=True)
class Linearisation:
    """A forward model and its first derivatives at one set of parameters; N rows."""

    reported: AnyArray
    """(3, N) g"""
    columns: AnyArray
    """(P, 3, N): change of the report with each parameter, effect by effect"""
    by_pose: AnyArray
    """(3, 3, N) g/rad: change of the report with I, E and T, as [:, 0], [:, 1] and [:, 2]"""


@dataclass(frozen=True)
class ForwardModel:
    """A set of effects with their parameters. `effects` are pairs (effect, vector); make one with `ForwardModel.of`."""

    effects: tuple[tuple[Effect, AnyArray], ...]

    @classmethod
    def of(cls, effects: Iterable[tuple[str, Mapping[str, float]]] | Mapping[str, Mapping[str, float]]) -> ForwardModel:
        """From pairs (id, {parameter: value}). Raises InputError for unknown or repeated ids and unknown parameters."""
        pairs = effects.items() if isinstance(effects, Mapping) else effects
        built = tuple((library.get(effect_id), library.get(effect_id).vector(values)) for effect_id, values in pairs)
        ids = [effect.id for effect, _ in built]
        if len(set(ids)) != len(ids):
            twice = next(effect_id for effect_id in ids if ids.count(effect_id) > 1)
            raise InputError(f"effect '{twice}' is given twice")
        return cls(built)

    # -- looking in

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the effects included."""
        return tuple(effect.id for effect, _ in self.effects)

    def parameters(self) -> dict[str, dict[str, float]]:
        """{effect id: {parameter: value}}."""
        return {
            effect.id: {parameter.name: float(value) for parameter, value in zip(effect.parameters, p, strict=True)}
            for effect, p in self.effects
        }

    def effect(self, effect_id: str) -> Effect:
        """The effect of that id: the model's own (which need not be of the library), else the library's."""
        return next((effect for effect, _ in self.effects if effect.id == effect_id), None) or library.get(effect_id)

    def vector_of(self, effect_id: str) -> AnyArray:
        """Parameter vector of an effect; its defaults if it is not part of this model."""
        own = next((p for effect, p in self.effects if effect.id == effect_id), None)
        return library.get(effect_id).vector() if own is None else own

    @property
    def laws(self) -> tuple[Law, ...]:
        """The laws of the model."""
        return tuple(effect.law for effect, _ in self.effects if isinstance(effect, LawEffect))

    # -- changing (a new value)

    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> ForwardModel:
        """With these effects added, or with other parameters where they are already there."""
        kept = tuple((effect, p) for effect, p in self.effects if effect.id not in effects)
        return ForwardModel((*kept, *((self.effect(name), self.effect(name).vector(v)) for name, v in effects.items())))

    def with_laws(self, laws: Iterable[Law]) -> ForwardModel:
        """With these laws added, as they were learnt; one of the same id is replaced."""
        added = tuple((LawEffect(law), np.array([1.0])) for law in laws)
        ids = [effect.id for effect, _ in added]
        return ForwardModel((*((e, p) for e, p in self.effects if e.id not in ids), *added))

    def without(self, *effect_ids: str) -> ForwardModel:
        """Without these effects."""
        return ForwardModel(tuple((effect, p) for effect, p in self.effects if effect.id not in effect_ids))

    def free_names(self, free: Sequence[str] | None = None) -> list[str]:
        """Names `effect.parameter` of what `free` stands for: ids of effects (their amplitudes) or such names.

        None: the amplitudes of all (not random) effects of the model.
        """
        wanted = [effect.id for effect, _ in self.effects if not effect.random] if free is None else free
        names: list[str] = []
        for item in wanted:
            effect_id, _, parameter = item.partition(".")
            effect = self.effect(effect_id)
            known = [p.name for p in effect.parameters]
            if parameter and parameter not in known:
                raise InputError(
                    f"effect '{effect_id}' has no parameter '{parameter}'", remedy=f"it has: {', '.join(known)}"
                )
            names += [item] if parameter else [f"{effect_id}.{known[k]}" for k in effect.amplitudes]
        return names

    def get_free(self, free: Sequence[str] | None = None) -> AnyArray:
        """(P,) values of the free parameters, in the order of `free_names`."""
        return np.array([self.vector_of(e)[self._index(e, p)] for e, p in _split(self.free_names(free))])

    def set_free(self, values: AnyArray, free: Sequence[str] | None = None) -> ForwardModel:
        """With other values of the free parameters; effects that are not part of the model yet are added."""
        vectors = {effect.id: p.copy() for effect, p in self.effects}
        for (effect_id, parameter), value in zip(_split(self.free_names(free)), values, strict=True):
            vectors.setdefault(effect_id, self.effect(effect_id).vector())[self._index(effect_id, parameter)] = value
        return ForwardModel(tuple((self.effect(effect_id), p) for effect_id, p in vectors.items()))

    # -- evaluating

    def predict(self, state: ChainState) -> AnyArray:
        """Reported gravity direction, (3, N) in g, without anything random."""
        return self.chain(state).reported

    def truth(self, state: ChainState, draws: Draws | None = None) -> tuple[AnyArray, AnyArray]:
        """Where the tool is, not where the bench says: inclination in [0, pi], toolface in [0, 2 pi), (N,) rad."""
        return attitude_of(self.chain(state, draws).gravity)

    def draw(self, state: ChainState, rng: np.random.Generator) -> dict[Stage, AnyArray]:
        """One realisation of all random effects, summed by the stage they disturb.

        Each effect has its own stream, so adding one leaves the others' draws as they were.
        """
        draws: dict[Stage, AnyArray] = {}
        root = int(rng.integers(2**63))
        for effect, p in self.effects:
            if isinstance(effect, RandomEffect):
                own = np.random.default_rng([root, *effect.id.encode()])
                increment = effect.draw(state, p, own)
                draws[effect.draws_at] = draws.get(effect.draws_at, 0.0) + increment
        return draws

    def simulate(self, state: ChainState, rng: np.random.Generator) -> AnyArray:
        """Reported gravity direction, (3, N) in g, with one realisation of everything random, as it is written down.

        The rows that a link loses or repeats are given by `recorded_rows`.
        """
        return self.recorded(state, self.chain(state, self.draw(state, rng)).reported, rng)

    def recorded(self, state: ChainState, values: AnyArray, rng: np.random.Generator) -> AnyArray:
        """The values (3, N) after the DIGITAL effects."""
        for effect, p in self.effects:
            if isinstance(effect, RecordEffect):
                values = effect.record(state, p, values, rng)
        return values

    def recorded_rows(self, state: ChainState, rng: np.random.Generator) -> AnyArray:
        """Indices of the rows that reach the recording."""
        rows: AnyArray = np.arange(state.n)
        for effect, p in self.effects:
            if isinstance(effect, RecordEffect):
                rows = rows[effect.rows(state.rows(rows), p, rng)]
        return rows

    def gyro(self, state: ChainState, draws: Draws | None = None) -> AnyArray:
        """Reported rates about the tool's axes, (3, N) in rad/s; without anything random unless `draws` are given.

        The state's rates are those of the bench's readings; where the bench does not point where it reads, the tool
        turns at a rate of its own.
        """
        draws = draws or {}
        sampled = self._sampled(state, draws)
        rates = self._true_rates(sampled)
        reported = rates
        for effect, p in self.effects:
            if effect.stage is Stage.GYRO:
                reported = reported + effect.delta(sampled, p, rates)
        return reported + draws[Stage.GYRO] if Stage.GYRO in draws else reported

    def gyro_jacobian(self, state: ChainState, free: Sequence[str] | None = None) -> AnyArray:
        """d(reported rates)/d(free parameters), (P, 3, N); zero for what acts on the accelerometers alone."""
        names = _split(self.free_names(free))
        sampled = self._sampled(state, {})
        rates = self._true_rates(sampled)
        by_effect: dict[str, AnyArray] = {}
        for effect_id in dict.fromkeys(effect_id for effect_id, _ in names):
            effect, p = self.effect(effect_id), self.vector_of(effect_id)
            by_effect[effect_id] = self._gyro_columns(state, sampled, rates, effect, p)
        return np.stack([by_effect[e][self._index(e, p)] for e, p in names]) if names else np.empty((0, 3, state.n))

    def _sampled(self, state: ChainState, draws: Draws) -> ChainState:
        """The state at the instants at which the rows were truly sampled."""
        late: AnyArray | None = draws.get(Stage.TIMING)
        for effect, p in self.effects:
            if effect.stage is Stage.TIMING:
                delta = effect.delta(state, p, state.reading)
                late = delta if late is None else late + delta
        return state if late is None else state.shifted(late.reshape(-1))

    def chain(self, state: ChainState, draws: Draws | None = None) -> Chain:
        """All stages of one evaluation."""
        draws = draws or {}

        def total(stage: Stage, start: AnyArray, x: AnyArray) -> AnyArray:
            result = start
            for effect, p in self.effects:
                if effect.stage is stage and not effect.random:
                    result = result + effect.delta(state, p, x)
            return result + draws[stage] if stage in draws else result

        state = self._sampled(state, draws)
        reading = state.reading
        pose = total(Stage.POSE, reading, reading)
        level = np.array([[0.0], [0.0], [1.0]])
        lab = total(Stage.GRAVITY, level, level)
        vertical = unit(lab)
        after_inc = rotate_y(pose[0], vertical)
        after_cross = rotate_x(pose[1], after_inc)
        gravity = rotate_z(pose[2], after_cross)
        mounting = total(Stage.MOUNTING, np.zeros((3, 1)), np.zeros((3, 1)))[:, 0]
        rotation = rotation_matrix(mounting) if mounting.any() else np.eye(3)
        force = total(Stage.KINEMATIC, rotation @ gravity, gravity)
        reported = total(Stage.SENSOR, force, force)
        reported = total(Stage.THERMAL, reported, force)
        reported = total(Stage.NOISE, reported, force)
        return Chain(state, pose, vertical, lab, after_inc, after_cross, gravity, mounting, rotation, force, reported)

    def sensitivity(self, state: ChainState, chain: Chain | None = None) -> AnyArray:
        """dm/df, (3, 3, N): how the report follows the specific force, at the present parameters."""
        chain = chain or self.chain(state)
        result = np.repeat(np.eye(3)[:, :, None], state.n, axis=2)
        for effect, p in self.effects:
            if effect.stage in (Stage.SENSOR, Stage.THERMAL) and not effect.random and effect.depends_on_input:
                result += effect.input_jacobian(chain.state, p, chain.force)
        return result

    def pose_sensitivity(self, state: ChainState, chain: Chain | None = None) -> AnyArray:
        """dm/d(I, E, T), (3, 3, N) in g/rad: [:, 0] and [:, 2] are what an error of inclination or toolface does."""
        chain = chain or self.chain(state)
        return _apply(self.sensitivity(state, chain), _turned(chain.rotation, _pose_tangents(chain)))

    def jacobian(self, state: ChainState, free: Sequence[str] | None = None) -> AnyArray:
        """dm/d(free parameters), (P, 3, N), in the order of `free_names(free)`.

        Effects that are not part of the model are taken at their defaults (nothing): their columns are then what the
        model omits.
        """
        names = _split(self.free_names(free))
        chain = self.chain(state)
        sensitivity = self.sensitivity(state, chain)
        by_effect: dict[str, AnyArray] = {}
        for effect_id in dict.fromkeys(effect_id for effect_id, _ in names):
            effect, p = self.effect(effect_id), self.vector_of(effect_id)
            by_effect[effect_id] = self._columns(state, chain, sensitivity, effect, p)
        return np.stack([by_effect[e][self._index(e, p)] for e, p in names]) if names else np.empty((0, 3, state.n))

    def derivatives(
        self, state: ChainState, wanted: Sequence[tuple[Effect, AnyArray]], *, gyros: bool = False, rows: Rows = None
    ) -> list[AnyArray]:
        """d(report)/d(parameters) of each (effect, vector) beside this model, from one evaluation of the chain.

        Each (K, 3, N); with `gyros` (K, 6, N), the rates in rad/s below the readings in g. The vectors say where the
        derivative is taken; the chain itself is that of the model as it is. `rows`: those that are kept.
        """
        chain = self.chain(state)
        sensitivity = self.sensitivity(state, chain)
        sampled = chain.state
        rates = self._true_rates(sampled) if gyros else np.empty((3, 0))
        result = []
        for effect, p in wanted:
            columns = self._columns(state, chain, sensitivity, effect, p)
            if gyros:
                of_gyros = self._gyro_columns(state, sampled, rates, effect, p)
                columns = np.concatenate([np.broadcast_to(columns, of_gyros.shape), of_gyros], axis=1)
            result.append(columns if rows is None else columns[..., rows])
        return result

    def linearise(self, state: ChainState) -> Linearisation:
        """Prediction, and first derivatives by every parameter of all effects and by the pose, from one evaluation."""
        chain = self.chain(state)
        sensitivity = self.sensitivity(state, chain)
        by_pose = _apply(sensitivity, _turned(chain.rotation, _pose_tangents(chain)))
        columns = [
            _through(by_pose, effect.derivative(chain.state, p, chain.state.reading))
            if effect.stage is Stage.POSE
            else self._columns(state, chain, sensitivity, effect, p)
            for effect, p in self.effects
        ]
        return Linearisation(chain.reported, np.concatenate(columns) if columns else np.empty((0, 3, state.n)), by_pose)

    def _gyro_columns(
        self, state: ChainState, sampled: ChainState, rates: AnyArray, effect: Effect, p: AnyArray
    ) -> AnyArray:
        """(K, 3, N): change of the reported rates with each parameter of one effect."""
        if effect.stage is Stage.TIMING:
            h = 1e-5
            by_time = (self.gyro(state.shifted(h)) - self.gyro(state.shifted(-h))) / (2 * h)
            return by_time * effect.derivative(state, p, state.reading)
        if effect.stage is Stage.GYRO:
            return effect.derivative(sampled, p, rates)
        if effect.stage is Stage.POSE and effect.turns_the_tool:
            # what the tool feels of it is how fast it changes
            later, earlier = sampled.shifted(STEP_S), sampled.shifted(-STEP_S)
            change = effect.derivative(later, p, later.reading) - effect.derivative(earlier, p, earlier.reading)
            return rates_of(sampled.tf_rad, np.broadcast_to(change, (len(change), 3, state.n)) / (2 * STEP_S))
        return np.zeros((len(effect.parameters), 3, state.n))

    def _true_rates(self, sampled: ChainState) -> AnyArray:
        """Rates at which the tool turns, (3, N): those of the readings and of what the bench adds to them."""
        rates = tool_rates(sampled)
        bench = [(effect, p) for effect, p in self.effects if effect.stage is Stage.POSE and effect.turns_the_tool]
        moved = [(effect, p) for effect, p in bench if not effect.random]
        if not moved:
            return rates
        later, earlier = sampled.shifted(STEP_S), sampled.shifted(-STEP_S)
        for effect, p in moved:
            change = effect.delta(later, p, later.reading) - effect.delta(earlier, p, earlier.reading)
            rates = rates + rates_of(sampled.tf_rad, np.broadcast_to(change, rates.shape) / (2 * STEP_S))
        return rates

    def _index(self, effect_id: str, parameter: str) -> int:
        return [p.name for p in self.effect(effect_id).parameters].index(parameter)

    def _columns(self, state: ChainState, chain: Chain, sensitivity: AnyArray, effect: Effect, p: AnyArray) -> AnyArray:
        """(K, 3, N): change of the report with each parameter of one effect."""
        if effect.stage is Stage.TIMING:
            h = 1e-5
            by_time = (self.chain(state.shifted(h)).reported - self.chain(state.shifted(-h)).reported) / (2 * h)
            return by_time * effect.derivative(state, p, state.reading)
        state = chain.state
        if effect.stage in (Stage.SENSOR, Stage.THERMAL, Stage.NOISE, Stage.DIGITAL):
            return effect.derivative(state, p, chain.force)
        if effect.stage is Stage.GYRO:
            return np.zeros((len(effect.parameters), 3, state.n))
        if effect.stage is Stage.KINEMATIC:
            return _through(sensitivity, effect.derivative(state, p, chain.gravity))
        if effect.stage is Stage.POSE:
            reading = state.reading
            tangents = _turned(chain.rotation, _pose_tangents(chain))
            return _through(_apply(sensitivity, tangents), effect.derivative(state, p, reading))
        if effect.stage is Stage.GRAVITY:
            change = effect.derivative(state, p, np.array([[0.0], [0.0], [1.0]]))
            norm = np.sqrt(np.sum(chain.lab**2, axis=0))
            # derivative of v / |v|: the part along v is taken away
            change = (change - chain.vertical * np.sum(chain.vertical * change, axis=1, keepdims=True)) / norm
            inc, cross, tf = chain.pose
            turned = rotate_z(tf, rotate_x(cross, rotate_y(inc, change.transpose(1, 0, 2))))
            return _through(sensitivity, _turned(chain.rotation, turned).transpose(1, 0, 2))
        change = effect.derivative(state, p, np.zeros((3, 1)))[:, :, 0]
        vector = sum(
            (e.delta(state, q, np.zeros((3, 1)))[:, 0] for e, q in self.effects if e.stage is Stage.MOUNTING),
            np.zeros(3),
        )
        columns = [np.imag(rotation_matrix(vector + 1e-30j * column)) / 1e-30 @ chain.gravity for column in change]
        return _through(sensitivity, np.stack(columns))


def tool_rates(state: ChainState) -> AnyArray:
    """True rates about the tool's axes, (3, N) in rad/s, relative to the Earth.

    A direction fixed in space obeys dG/dt = -w x G in the tool frame, and the toolface grows clockwise looking
    down-hole (about -z): w = [I' sin T, -I' cos T, -T'].
    """
    inc_rate = state.inc_rate_radps
    return rates_of(state.tf_rad, np.stack([inc_rate, np.zeros(state.n), state.rotor_rate_radps]))


def rates_of(tf: AnyArray, pose_rate: AnyArray) -> AnyArray:
    """Rates about the tool's axes, (..., 3, N), that belong to d(I, E, T)/dt (..., 3, N) at the toolface `tf` (N,)."""
    inc, cross, turn = pose_rate[..., 0, :], pose_rate[..., 1, :], pose_rate[..., 2, :]
    sin, cos = np.sin(tf), np.cos(tf)
    return np.stack([inc * sin - cross * cos, -inc * cos - cross * sin, -turn], axis=-2)


def _pose_tangents(chain: Chain) -> AnyArray:
    """d gravity / d(I, E, T), (3, 3, N) in 1/rad: a rotation about an axis moves a vector v by (axis x v)."""
    _, cross, tf = chain.pose
    u, v, w = chain.after_inc, chain.after_cross, chain.gravity
    zero = np.zeros(w.shape[1])
    by_inc = rotate_z(tf, rotate_x(cross, np.stack([u[2], zero, -u[0]])))
    by_cross = rotate_z(tf, np.stack([zero, -v[2], v[1]]))
    by_tf = np.stack([-w[1], w[0], zero])
    return np.stack([by_inc, by_cross, by_tf], axis=1)


def _turned(rotation: AnyArray, v: AnyArray) -> AnyArray:
    """(3, 3) applied to (3, ..., N)."""
    return np.asarray((rotation @ v.reshape(3, -1)).reshape(v.shape))


def _apply(matrices: AnyArray, others: AnyArray) -> AnyArray:
    """Row-wise product of (3, 3, N) matrices."""
    return np.einsum("ijn,jkn->ikn", matrices, others)


def _through(matrices: AnyArray, columns: AnyArray) -> AnyArray:
    """(3, 3, N) applied to each of (K, 3, N)."""
    return np.einsum("ijn,kjn->kin", matrices, np.broadcast_to(columns, (len(columns), 3, matrices.shape[2])))


def _split(names: Sequence[str]) -> list[tuple[str, str]]:
    return [(name.partition(".")[0], name.partition(".")[2]) for name in names]

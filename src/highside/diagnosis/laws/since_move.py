"""Laws of the time since the last move: what readings do while a pose is held.

A pose counts by its mean, so nothing of what its rows do about that mean is left for the search among poses. It is
looked for here. With a time constant tau each pose gives one number per channel, the amplitude of exp(-s / tau) in its
rows (s since its first row, both less their means), and how well it is known. These numbers are a session of their own:
nothing static shows in them, so nothing is free, and what they follow is found by the same search as any law.

The time constant is that with which simple functions of the load explain most. A decay that is slower than a pose is
held is not told from a drift and is not claimed: it must explain more than a straight line in time does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.laws.chain import CHANNELS, OF_POSES, covariate_values, place_fields
from highside.diagnosis.laws.claims import ReportedLaw, reported_laws
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import LawGroup, axis_of, each_place, varying
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_SEARCH, LAW_SINCE_MOVE
from highside.diagnosis.laws.problem import LawProblem, fields_that_act
from highside.diagnosis.laws.search import Search
from highside.physics.forward import ForwardModel
from highside.physics.law import Axis, Function
from highside.physics.state import ChainState

Ints = NDArray[np.intp]
SINCE = "time_since_move"


@dataclass(frozen=True)
class HeldRows:
    """Rows of n poses: readings `accel` (3, N) in g at times `t_s` (N,), and the numbers of each pose's rows."""

    accel: Array
    t_s: Array
    rows: Sequence[Ints]

    def since(self, pose: int) -> Array:
        """(L,) s since the first row of a pose."""
        own = self.t_s[self.rows[pose]]
        return np.asarray(own - own[0])


@dataclass(frozen=True)
class _Amplitudes:
    """Of exp(-s / tau) in each pose: `value` (3, n) in g and `sigma` (3, n)."""

    tau_s: float
    value: Array
    sigma: Array

    def explained(self, simple: Array) -> float:
        """Half the chi-square that simple functions (3, k, n) explain, each channel's by itself."""
        total = 0.0
        for value, sigma, functions in zip(self.value, self.sigma, simple, strict=True):
            columns = (functions / sigma).T
            fitted = columns @ np.linalg.lstsq(columns, value / sigma, rcond=None)[0]
            total += 0.5 * float(fitted @ fitted)
        return total


def laws_since_move(held: HeldRows, state: ChainState, model: ForwardModel) -> tuple[list[ReportedLaw], Found] | None:
    """The laws of what the rows of n poses do while these are held; None where there is none.

    `state` has one row for each pose.
    """
    long = np.array([k for k, r in enumerate(held.rows) if r.size >= LAW_SINCE_MOVE.rows], dtype=np.intp)
    if long.size < LAW_SINCE_MOVE.poses:
        return None
    held, state = replace(held, rows=[held.rows[k] for k in long]), state.rows(long)
    load = np.asarray(model.chain(state).force, dtype=float)
    covariates = covariate_values(state, load)
    simple = _simple(load, covariates.get("previous_load", load))
    sigma = _row_noise(held)
    tau = _time_constant(held, sigma, simple)
    if tau is None:
        return None
    own = _amplitudes(held, sigma, tau)
    covariates[SINCE] = np.zeros(state.n)
    names = tuple(CHANNELS)
    fields = fields_that_act(place_fields(model, state, OF_POSES, gyros=False))
    nothing = np.empty((0, *own.value.shape))
    problem = LawProblem(own.value, nothing, fields, covariates, own.sigma, state.t_s, channels=names, memory=False)
    longest = max(float(held.since(k)[-1]) for k in range(len(held.rows)))
    decay = Axis(SINCE, 0.0, longest, (Function("decay", (0.0, tau)),))
    found = Search(problem, list(_decaying(problem, decay)), variants=False).run()
    # what follows something else as well contains the simple decay, and is no rival of it
    classes = tuple(
        tuple(g for g in alike if len(t.group.axes) > 1 or g is t.group or len(g.axes) == 1)
        for t, alike in zip(found.terms, found.classes, strict=True)
    )
    found = replace(found, classes=classes)
    return (reported_laws(found, model.ids), found) if found.terms else None


def _simple(load: Array, previous: Array) -> Array:
    """(3, k, n) what an amplitude may follow, roughly: nothing, the loads, the move to the pose along the own axis."""
    moved = load - (previous if previous.ndim == 2 else np.broadcast_to(previous, load.shape))
    ones = np.ones(load.shape[1])
    return np.stack([np.stack([ones, *load, np.abs(load[k]), moved[k]]) for k in range(len(load))])


def _row_noise(held: HeldRows) -> Array:
    """(3,) standard deviation of a row as it counts in a slow function of time: from differences of neighbouring rows,
    with what their correlation adds."""
    found = []
    for channel in held.accel:
        steps = [channel[r] for r in held.rows]
        one = np.mean(np.concatenate([np.diff(s, n=2) for s in steps]) ** 2) / (1 + 4 + 1)
        two = np.mean(np.concatenate([s[4:] - 2 * s[2:-2] + s[:-4] for s in steps]) ** 2) / (1 + 4 + 1)
        found.append(np.sqrt(max(one, two)))
    return np.asarray(np.maximum(np.array(found), LAW_SINCE_MOVE.least * float(np.abs(held.accel).max())))


def _amplitudes(held: HeldRows, sigma: Array, tau_s: float) -> _Amplitudes:
    value, power = np.empty((len(held.accel), len(held.rows))), np.empty(len(held.rows))
    for k, rows in enumerate(held.rows):
        shape = np.exp(-held.since(k) / tau_s)
        shape = shape - shape.mean()
        power[k] = max(float(shape @ shape), np.finfo(float).tiny)
        value[:, k] = held.accel[:, rows] @ shape / power[k]
    return _Amplitudes(tau_s, value, sigma[:, None] / np.sqrt(power))


def _time_constant(held: HeldRows, sigma: Array, simple: Array) -> float | None:
    """The time constant of a decay that explains more than noise does, and more than a straight line in time."""
    stay = float(np.median([held.since(k)[-1] for k in range(len(held.rows))]))
    step = stay / (float(np.median([r.size for r in held.rows])) - 1)
    if not step > 0.0:
        return None

    def gain(tau: float) -> float:
        return _amplitudes(held, sigma, tau).explained(simple)

    tried = np.geomspace(LAW_SINCE_MOVE.shortest * step, stay, LAW_SINCE_MOVE.tried)
    gains = [gain(float(tau)) for tau in tried]
    best = int(np.argmax(gains))
    if gains[best] < max(LAW_SEARCH.gain, gain(LAW_SINCE_MOVE.straight * stay) + LAW_SEARCH.gain):
        return None
    near = np.geomspace(tried[max(best - 1, 0)], tried[min(best + 1, tried.size - 1)], LAW_SINCE_MOVE.tried)
    return float(near[int(np.argmax([gain(float(tau)) for tau in near]))])


def _decaying(problem: LawProblem, decay: Axis) -> Iterator[LawGroup]:
    """Each place with an amplitude that is one number, or a smooth function of a covariate."""
    for units in each_place(problem.places):
        one = np.ones((len(units), 1, problem.n))
        yield LawGroup(units, (decay,), np.zeros(1), one)
        for name, values, distinct in varying(problem, units):
            if name in ("tf_fraction", SINCE):
                continue
            turns = min(LAW_GROUPS.orders, max(1, distinct // 2))
            axis, order = axis_of(name, values, min(LAW_GROUPS.cosines, distinct - 1), constant=True, turns=turns)
            own = [problem.covariates[name] if problem.covariates[name].ndim == 1 else values for _ in units]
            yield LawGroup(units, (axis, decay), order, np.stack([axis.basis(u) for u in own]))


def without_laws(accel: Array, rows: ChainState, model: ForwardModel, laws: Sequence[ReportedLaw]) -> Array:
    """Readings (3, N) less what the laws do at their rows."""
    added = model.with_laws([one.law for one in laws]).predict(rows) - model.predict(rows)
    return np.asarray(accel - added)

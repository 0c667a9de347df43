"""Laws of the time since the last move: what readings do while a pose is held.

A pose counts by its mean, so nothing of what its rows do about that mean is left for the search among poses. It is
looked for here. With a time constant tau each pose gives one number per channel, the amplitude of exp(-s / tau) in its
rows (s since its first row, both less their means), and how well it is known. These numbers are a session of their own:
nothing static shows in them, so nothing is free, and what they follow is found by the same search as any law.

The time constant is that with which simple functions of the load explain most. A decay that is slower than a pose is
held is not told from a drift and is not claimed: it must explain more than a straight line in time does. Where by how
much a pose drifts follows the load, it is no drift of something else, and the straight line is the course.

What is no decay has a free course (`laws.course`), which must predict poses that it was not learnt from better than
the decay and the straight line do.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from highside.arrays import Array
from highside.diagnosis.laws.chain import CHANNELS, OF_POSES, covariate_values, place_fields
from highside.diagnosis.laws.claims import ReportedLaw, proved, reported_laws
from highside.diagnosis.laws.classes import Class
from highside.diagnosis.laws.course import (
    SINCE,
    Course,
    HeldRows,
    Ints,
    Sums,
    course_beyond,
    course_in_common,
    decay_course,
    of_unit_size,
)
from highside.diagnosis.laws.curves import curve_of
from highside.diagnosis.laws.found import Found
from highside.diagnosis.laws.groups import Bases, LawGroup, axis_of, each_place, varying
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_SEARCH
from highside.diagnosis.laws.problem import LawProblem, fields_that_act
from highside.diagnosis.laws.search import Search
from highside.diagnosis.laws.since_move_policy import LAW_SINCE_MOVE
from highside.physics.forward import ForwardModel
from highside.physics.law import Axis
from highside.physics.law_functions import Function
from highside.physics.state import ChainState


def laws_since_move(held: HeldRows, state: ChainState, model: ForwardModel) -> tuple[list[ReportedLaw], Found] | None:
    """The laws of what the rows of n poses do while these are held; None where there is none, and no laws where none
    predicts poses that were held out.

    `state` has one row for each pose.
    """
    long = whole_poses(held)
    if long.size < LAW_SINCE_MOVE.poses:
        return None
    held, state = replace(held, rows=[held.rows[k] for k in long]), state.rows(long)
    load = np.asarray(model.chain(state).force, dtype=float)
    covariates = covariate_values(state, load)
    simple = _simple(load, covariates.get("previous_load", load))
    sigma = _row_noise(held, simple)
    tau = _time_constant(held, sigma, simple)
    course = None if tau is None else decay_course(tau, held.longest_s)
    course = course_beyond(held, sigma, simple, course) or course
    drifts = course is None
    course = course or _drift_of_the_load(held, simple)
    if course is None:
        return None
    course = of_unit_size(course, held)
    value, power = Sums.of(held, course.axis).amplitudes(course.weights)
    # the amplitudes are known for any time since a move: what they follow is sought with that left out
    covariates[SINCE] = np.zeros(state.n)
    names = tuple(CHANNELS)
    fields = fields_that_act(place_fields(model, state, OF_POSES, gyros=False))
    nothing, noise = np.empty((0, *value.shape)), sigma[:, None] / np.sqrt(power)
    problem = LawProblem(value, nothing, fields, covariates, noise, state.t_s, channels=names, memory=False)
    # what drifts alike in every pose is a drift of something else
    groups = [group for group in _courses(problem, course) if len(group.axes) > 1 or not drifts]
    found = Search(problem, groups, variants=False).run()
    # what follows something else as well contains the simple course, and is no rival of it
    pairs = zip(found.terms, found.classes, strict=True)
    found = replace(found, classes=tuple(partial(_no_wider, t.group, alike) for t, alike in pairs))
    if not found.terms:
        return None
    told = proved(found)
    return [_with_course(one, told, course) for one in reported_laws(told, model.ids)], told


def _no_wider(own: LawGroup, alike: Class) -> tuple[LawGroup, ...]:
    """The class of a simple course without what follows something else as well."""
    return tuple(g for g in alike() if len(own.axes) > 1 or g is own or len(g.axes) == 1)


def whole_poses(held: HeldRows) -> Ints:
    """The poses of enough rows; where most are held equally long, those that are: of a shorter one the first rows may
    be lost, and with them when it began."""
    long = np.array([k for k, r in enumerate(held.rows) if r.size >= LAW_SINCE_MOVE.rows], dtype=np.intp)
    if not long.size:
        return long
    spans = np.array([held.since(k)[-1] for k in long])
    step = float(np.median(np.concatenate([np.diff(held.since(k)) for k in long])))
    whole = long[spans > spans.max() - 0.5 * step]
    return whole if whole.size > LAW_SINCE_MOVE.equally_long * len(held.rows) else long


def _simple(load: Array, previous: Array) -> Array:
    """(3, k, n) what an amplitude may follow, roughly: nothing, the loads, the move to the pose along the own axis."""
    moved = load - (previous if previous.ndim == 2 else np.broadcast_to(previous, load.shape))
    ones = np.ones(load.shape[1])
    return np.stack([np.stack([ones, *load, np.abs(load[k]), moved[k]]) for k in range(len(load))])


def _row_noise(held: HeldRows, simple: Array) -> Array:
    """(3,) standard deviation of a row as it counts in a slow function of time: from differences of neighbouring rows,
    with what their correlation adds. What every pose goes through alike, at sizes that simple functions (3, k, n) give,
    is taken off before: of a few rows that are far apart it is no smaller from one to the next than over the pose."""
    alike = course_in_common(held, simple)
    found = []
    for readings, (fitted, share) in zip(held.accel, alike, strict=True):
        channel = readings - fitted
        steps = [channel[r] for r in held.rows]
        one = np.mean(np.concatenate([np.diff(s, n=2) for s in steps]) ** 2) / (1 + 4 + 1)
        two = np.mean(np.concatenate([s[4:] - 2 * s[2:-2] + s[:-4] for s in steps]) ** 2) / (1 + 4 + 1)
        found.append(np.sqrt(max(one, two) / (1.0 - share)))
    return np.asarray(np.maximum(np.array(found), LAW_SINCE_MOVE.least * float(np.abs(held.accel).max())))


def _explained(held: HeldRows, sigma: Array, simple: Array, course: Course) -> float:
    """Half the chi-square that simple functions (3, k, n) explain of a course's amplitudes, channel by channel."""
    values, power = Sums.of(held, course.axis).amplitudes(course.weights)
    total = 0.0
    for value, noise, functions in zip(values, sigma, simple, strict=True):
        own = noise / np.sqrt(power)
        columns = (functions / own).T
        fitted = columns @ np.linalg.lstsq(columns, value / own, rcond=None)[0]
        total += 0.5 * float(fitted @ fitted)
    return total


def _time_constant(held: HeldRows, sigma: Array, simple: Array) -> float | None:
    """The time constant of a decay that explains more than noise does, and more than a straight line in time."""
    stay = float(np.median([held.since(k)[-1] for k in range(len(held.rows))]))
    step = stay / (float(np.median([r.size for r in held.rows])) - 1)
    if not step > 0.0:
        return None

    def gain(tau: float) -> float:
        return _explained(held, sigma, simple, decay_course(tau, held.longest_s))

    tried = np.geomspace(LAW_SINCE_MOVE.shortest * step, stay, LAW_SINCE_MOVE.tried)
    gains = [gain(float(tau)) for tau in tried]
    best = int(np.argmax(gains))
    if gains[best] < max(LAW_SEARCH.gain, gain(LAW_SINCE_MOVE.straight * stay) + LAW_SEARCH.gain):
        return None
    near = np.geomspace(tried[max(best - 1, 0)], tried[min(best + 1, tried.size - 1)], LAW_SINCE_MOVE.tried)
    return float(near[int(np.argmax([gain(float(tau)) for tau in near]))])


def _drift_of_the_load(held: HeldRows, simple: Array) -> Course | None:
    """A straight line in time where by how much each pose drifts follows the load or the move, as a drift of something
    else would not; judged by the scatter of the drifts themselves, whatever noise makes that."""
    axis = Axis(SINCE, 0.0, held.longest_s, (Function("straight"),))
    line = Course(axis, np.ones(1), np.zeros((1, 1)))
    values, power = Sums.of(held, axis).amplitudes(line.weights)
    root, gains = np.sqrt(power), []
    for value, functions in zip(values, simple, strict=True):
        left = [_left(value * root, own * root) for own in (functions[:1], functions)]
        cost = 0.5 * (len(functions) - 1) * np.log(value.size)
        gains.append(0.5 * value.size * np.log(left[0] / left[1]) - cost)
    return line if max(gains) >= LAW_SEARCH.each else None


def _left(values: Array, functions: Array) -> float:
    """Sum of the squares that functions (k, n) leave of values (n,)."""
    fitted = functions.T @ np.linalg.lstsq(functions.T, values, rcond=None)[0]
    return max(float(np.sum((values - fitted) ** 2)), np.finfo(float).tiny)


def _courses(problem: LawProblem, course: Course) -> Iterator[LawGroup]:
    """Each place with an amplitude that is one number, one that sets in, or a smooth function of a covariate.

    The course stands in the groups as a constant, as the values of the problem are its amplitudes."""
    held = Axis(SINCE, course.axis.low, course.axis.high, (Function("one"),))
    in_time = [axis for axis in Bases(problem).in_time if axis.sets_in]
    for units in each_place(problem.places):
        yield LawGroup(units, (held,), np.zeros(1), np.ones((len(units), 1, problem.n)))
        for step in in_time:
            since = step.basis(problem.covariates["time"])
            basis = np.broadcast_to(since, (len(units), *since.shape))
            yield LawGroup(units, (held, step), np.zeros(1), basis, len(in_time))
        for name, values, distinct in varying(problem, units):
            if name in ("tf_fraction", SINCE):
                continue
            turns = min(LAW_GROUPS.orders, max(1, distinct // 2))
            axis, order = axis_of(name, values, min(LAW_GROUPS.cosines, distinct - 1), constant=True, turns=turns)
            own = [problem.covariates[name] if problem.covariates[name].ndim == 1 else values for _ in units]
            yield LawGroup(units, (axis, held), order, np.stack([axis.basis(u) for u in own]))


def _with_course(told: ReportedLaw, found: Found, course: Course) -> ReportedLaw:
    """A law of amplitudes as the law of the rows: with the course in the place of the constant, uncertain as both are
    to first order."""
    law = told.law
    place = law.depends_on.index(SINCE)
    first = int(np.prod([len(axis.functions) for axis in law.axes[:place]]))

    def spread(rows: Array, weights: Array) -> Array:
        """(..., m) with the weights put in at their axis: (..., m K)."""
        by_axis = rows.reshape(*rows.shape[:-1], first, 1, -1) * weights[:, None]
        return by_axis.reshape(*rows.shape[:-1], -1)

    rows = np.array(law.coefficients)
    channels, count = rows.shape
    every = np.kron(np.eye(channels), np.stack([spread(one, course.weights) for one in np.eye(count)]))
    slopes = np.stack([spread(rows, one).reshape(-1) for one in np.eye(course.weights.size)])
    covariance = every.T @ np.array(law.covariance) @ every + slopes.T @ course.covariance @ slopes
    axes = (*law.axes[:place], course.axis, *law.axes[place + 1 :])
    made = replace(
        law,
        axes=axes,
        coefficients=tuple(tuple(map(float, row)) for row in spread(rows, course.weights)),
        covariance=tuple(tuple(map(float, row)) for row in covariance),
    )
    group = next(t.group for t in found.terms if (t.group.place, t.group.axes) == (law.place, law.axes))
    ranges = tuple((axis.low, axis.high) for axis in axes)
    claim = replace(told.claim, law=made.to_dict(), curve=curve_of(found, group, made), range=ranges)
    return replace(told, law=made, told=lambda: claim)


def without_laws(accel: Array, rows: ChainState, model: ForwardModel, laws: Sequence[ReportedLaw]) -> Array:
    """Readings (3, N) less what the laws do at their rows."""
    added = model.with_laws([one.law for one in laws]).predict(rows) - model.predict(rows)
    return np.asarray(accel - added)

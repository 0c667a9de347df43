"""Calibration records over time: how fast sensors wander, which calibration departed, when the next is due.

Each parameter of a tool is taken for a random walk that calibrations look at now and then: between two that are dt days
apart it moves by `w sqrt(dt)` (one standard deviation), and each record states its own error. The rate w is one for all
tools of a group, by maximum likelihood of the innovations (local level model: Durbin and Koopman, Time Series Analysis
by State Space Methods, chapter 2), with the interval where the log likelihood is within 1.92 of the best (95 %). A
calibration X
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from highside.arrays import Array
from highside.calibration.record import CalibrationRecord
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES
from highside.errors import InputError
from highside.fleet.policy import STABILITY
from highside.physics.gravity import gravity_direction, gravity_jacobians
from highside.special import stdtr
from highside.words import said

__all__ = ["NAMES", "Departure", "Point", "RandomWalk", "Stability", "ToolHistory", "point_of", "stability"]

NAMES = (*MATRIX_NAMES, *OFFSET_NAMES)
"""the twelve parameters that are followed: A row by row (no unit), b (g)"""
DAY_S = 86400.0


@dataclass(frozen=True)
class Point:
    """One calibration."""

    tool: str
    record: str
    at_s: float
    """UTC epoch"""
    values: Array
    """(12,) in the order of `NAMES`"""
    covariance: Array
    """(12, 12)"""


@dataclass(frozen=True)
class RandomWalk:
    """How fast one parameter drifts: one standard deviation after a day; after n days sqrt(n) times that."""

    parameter: str
    rate: float
    low: float
    high: float
    """95 %"""


@dataclass(frozen=True)
class Departure:
    """A calibration that is further from the one before than the random walk and both errors explain."""

    record: str
    at_s: float
    parameter: str
    change: float
    deviations: float
    """in standard deviations of what was expected"""
    p: float
    """that any would be so far in the whole group, were all of one kind"""


@dataclass(frozen=True)
class ToolHistory:
    """One tool."""

    tool: str
    points: tuple[Point, ...]
    departures: tuple[Departure, ...]
    due_s: float | None
    """UTC epoch at which the next calibration is due; None: not within what is looked ahead"""


@dataclass(frozen=True)
class Stability:
    """A group of tools."""

    random_walks: tuple[RandomWalk, ...]
    tools: tuple[ToolHistory, ...]
    pairs: int
    """of calibrations of one tool that follow one another: what the random walks rest on"""
    limit_deg: float
    refused: str = ""
    """why no random walk is given"""


def point_of(record: CalibrationRecord) -> Point:
    """What is followed of a record. Raises InputError for one that does not determine it."""
    parameters = record.result.main.parameters
    own = [parameters.names.index(name) for name in NAMES if name in parameters.names]
    if len(own) != len(NAMES):
        lacking = ", ".join(name for name in NAMES if name not in parameters.names)
        raise InputError(f"does not determine {lacking}", where=record.id, remedy="leave this record out")
    covariance = parameters.covariance + (0.0 if parameters.student is None else parameters.student)
    return Point(record.tool_id, record.id, record.valid_from_s, parameters.values[own], covariance[np.ix_(own, own)])


def stability(points: Sequence[Point], limit_deg: float) -> Stability:
    """Judge the calibrations of a group of tools; `limit_deg`: of the direction of gravity, at k = 2."""
    by_tool: dict[str, list[Point]] = {}
    for point in sorted(points, key=lambda one: (one.at_s, one.record)):
        by_tool.setdefault(point.tool, []).append(point)
    pairs = sum(len(own) - 1 for own in by_tool.values())
    if pairs < STABILITY.fewest_pairs:
        why = said(
            "repeated calibrations: %(pairs)s; %(needed)s are needed to state a random walk of the sensors",
            pairs=pairs,
            needed=STABILITY.fewest_pairs,
        )
        plain = tuple(ToolHistory(tool, tuple(own), (), None) for tool, own in sorted(by_tool.items()))
        return Stability((), plain, pairs, limit_deg, why)
    histories = list(by_tool.values())
    random_walks = tuple(_random_walk(histories, k) for k in range(len(NAMES)))
    tools = tuple(
        ToolHistory(tool, tuple(own), _departures(own, random_walks, pairs), _due(own[-1], random_walks, limit_deg))
        for tool, own in sorted(by_tool.items())
    )
    return Stability(random_walks, tools, pairs, limit_deg)


def _innovations(own: Sequence[Point], k: int, rate: float) -> tuple[Array, Array]:
    """(n-1,) innovations of parameter k and their variances, by the filter of the local level model."""
    level, variance = float(own[0].values[k]), float(own[0].covariance[k, k])
    away, spread = [], []
    for before, now in pairwise(own):
        variance += rate**2 * (now.at_s - before.at_s) / DAY_S
        stated = float(now.covariance[k, k])
        away.append(float(now.values[k]) - level)
        spread.append(variance + stated)
        gain = variance / spread[-1]
        level, variance = level + gain * away[-1], variance * (1.0 - gain)
    return np.array(away), np.array(spread)


def _random_walk(histories: Sequence[Sequence[Point]], k: int) -> RandomWalk:
    """The rate of one parameter by maximum likelihood, on a grid: robust, and the interval comes with it."""
    several = [own for own in histories if len(own) > 1]
    days = np.concatenate([np.diff([point.at_s for point in own]) for own in several]) / DAY_S
    moved = np.concatenate([np.diff([point.values[k] for point in own]) for own in several])
    typical = float(np.sqrt(np.median([point.covariance[k, k] for own in several for point in own])))
    largest = max(float(np.max(np.abs(moved))), typical) / np.sqrt(max(float(np.min(days)), STABILITY.shortest_days))
    smallest = STABILITY.smallest * typical / np.sqrt(float(np.max(days)))
    rates = np.concatenate([[0.0], np.geomspace(smallest, max(largest, 10 * smallest), STABILITY.grid)])
    likelihood = np.zeros(rates.size)
    for i, rate in enumerate(rates):
        for own in several:
            away, spread = _innovations(own, k, float(rate))
            # a tool that was dropped does not widen the random walk of all others: beyond some deviations one more
            # costs nothing
            square = np.minimum(away**2 / spread, STABILITY.most_deviations**2)
            likelihood[i] -= 0.5 * float(np.sum(np.log(spread) + square))
    near = rates[likelihood > likelihood.max() - STABILITY.interval]
    return RandomWalk(NAMES[k], float(rates[np.argmax(likelihood)]), float(near.min()), float(near.max()))


def _departures(own: Sequence[Point], random_walks: Sequence[RandomWalk], pairs: int) -> tuple[Departure, ...]:
    found = []
    for k, random_walk in enumerate(random_walks):
        away, spread = _innovations(own, k, random_walk.rate)
        deviations = away / np.sqrt(spread)
        # the random walk is known from so many pairs: Student's t
        p_of = 2 * stdtr(pairs, -np.abs(deviations)) * pairs * len(random_walks)
        for i in np.flatnonzero(p_of < STABILITY.alarm_p).tolist():
            point, p = own[i + 1], float(p_of[i])
            found.append(
                Departure(point.record, point.at_s, random_walk.parameter, float(away[i]), float(deviations[i]), p)
            )
    return tuple(sorted(found, key=lambda one: one.p))


def _due(point: Point, random_walks: Sequence[RandomWalk], limit_deg: float) -> float | None:
    """When twice the standard deviation of gravity's direction reaches the limit, at the worst attitude."""
    inc = np.deg2rad(np.repeat(STABILITY.inclinations_deg, len(STABILITY.toolfaces_deg)))
    tf = np.deg2rad(np.tile(STABILITY.toolfaces_deg, len(STABILITY.inclinations_deg)))
    gravity = gravity_direction(inc, tf)
    by_inc, by_tf = gravity_jacobians(inc, tf)
    across = np.stack([by_inc, by_tf / np.sin(inc)])  # (2, 3, n), unit vectors
    inverse = np.linalg.inv(point.values[:9].reshape(3, 3))
    turned = np.einsum("din,ij->djn", across, inverse)
    levers = np.concatenate([np.einsum("din,jn->dijn", turned, gravity).reshape(2, 9, -1), turned], axis=1)
    now = np.einsum("dpn,pq,eqn->nde", levers, point.covariance, levers)
    growth = np.einsum("dpn,p,epn->nde", levers, [random_walk.rate**2 for random_walk in random_walks], levers)
    variance = (np.deg2rad(limit_deg) / 2.0) ** 2

    def over(days: float) -> bool:
        return bool(np.max(np.linalg.eigvalsh(now + days * growth)) > variance)

    low, high = 0.0, STABILITY.ahead_days
    if not over(high):
        return None
    for _ in range(STABILITY.halvings):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if over(middle) else (middle, high)
    return point.at_s + low * DAY_S

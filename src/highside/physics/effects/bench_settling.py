"""Bench that goes on moving a little after it was led to a pose."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Effect, Parameter, Stage, singles
from highside.physics.state import ChainState

SHORT = 1e-2
"""Half of what a row averages, in time constants, below which a series is exact to 1e-10 and differences are not."""


class BenchSettling(Effect):
    id = "bench_settling"
    title = "Settling of the bench after a move"
    stage = Stage.POSE
    formula = "dI = e_inc (last move of I) exp(-s / tau), dT = e_tf (last move of T) exp(-s / tau), s since the stop"
    story = (
        "After a move the belts, the glue and the cables of a bench go on yielding, by a share of the move that dies"
        " away. It shows where poses are held for different times; after equal times it is a constant share of each"
        " move, and of a single move nothing."
    )
    # creep of belts and plastics is some per cent of what was strained
    parameters = (
        Parameter("e_inc", "1", 1e-4, (-0.05, 0.05)),
        Parameter("e_tf", "1", 1e-4, (-0.05, 0.05)),
        Parameter(
            "tau",
            "s",
            30.0,
            (0.5, 5e3),
            default=30.0,
            shape=True,
            grid=(3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 400.0),
        ),
    )
    confused_with = ("backlash", "stiction", "thermal_lag")
    splitter = "hold the same pose briefly and long, and reach it by a short and by a long move"
    needs = ("since_move_s",)
    depends_on_input = False
    complex_safe = False
    remembers = True
    groups = singles(2)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        left = _left(state, float(p[2]))
        tilt, turn = last_moves(state)
        delta = np.zeros((3, state.n))
        delta[0], delta[2] = p[0] * tilt * left, p[1] * turn * left
        return delta

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        tau, h = float(p[2]), 1e-4 * float(p[2])
        tilt, turn = last_moves(state)
        columns = np.zeros((3, 3, state.n))
        left = _left(state, tau)
        columns[0, 0], columns[1, 2] = tilt * left, turn * left
        slope = (_left(state, tau + h) - _left(state, tau - h)) / (2 * h)
        columns[2, 0], columns[2, 2] = p[0] * tilt * slope, p[1] * turn * slope
        return columns


def _left(state: ChainState, tau: float) -> AnyArray:
    """(N,) what is left of a unit, on average over what each row averages. Nothing where all were held alike."""
    since, stay = state.since_move_s, state.stay_s
    if not state.n or np.ptp(since) == 0.0:
        return np.zeros(state.n)
    u = stay / (2 * tau)
    long = np.where(u > SHORT, u, 1.0)
    mean = (np.exp(long - since / tau) - np.exp(-long - since / tau)) / (2 * long)
    return np.asarray(np.where(u > SHORT, mean, np.exp(-since / tau) * (1 + u * u / 6)))


def last_moves(state: ChainState) -> tuple[AnyArray, AnyArray]:
    """(N,) rad each, by how much the inclination and the toolface were moved to the pose of a row; 0 at the first.

    The toolface goes round in the sense in which the pose is approached.
    """
    new = np.flatnonzero(np.diff(state.pose) != 0) + 1
    number = np.zeros(state.n, dtype=np.int64)
    number[new] = 1
    sense = np.where(state.direction[new] < 0, -1.0, 1.0)
    turn = np.mod((state.tf_rad[new] - state.tf_rad[new - 1]) * sense, 2 * np.pi) * sense
    tilt = state.inc_rad[new] - state.inc_rad[new - 1]
    at = np.cumsum(number)
    return np.concatenate([[0.0], tilt])[at], np.concatenate([[0.0], turn])[at]


EFFECT = BenchSettling()

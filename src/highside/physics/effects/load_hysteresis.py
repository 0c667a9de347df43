"""Reading that remembers from which side the load came."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, on_own_axis, singles
from highside.physics.gravity import gravity_direction
from highside.physics.memory import play
from highside.physics.state import ChainState

BETWEEN = 8
"""Points of the way from one pose to the next: a play asks which load came last, not how fast; an eighth of a turn of
90 deg is finer than any slack that is tried."""


class LoadHysteresis(Effect):
    id = "load_hysteresis"
    title = "Hysteresis over the load"
    stage = Stage.SENSOR
    formula = "h_i (f_i - play(f_i)) / width: +h after the load rose, -h after it fell, turning over within 2 width"
    story = (
        "At the same load the reading differs, depending on whether the load rose or fell to it: a suspension or a glue"
        " that slips and sticks. It shows where the same loads are reached from both sides."
    )
    # as the thermal one; the hysteresis of MEMS data sheets is 0.1 % of a range of some g
    parameters = (
        *(Parameter(f"h_{axis}", "g", 1e-4, (-5e-3, 5e-3)) for axis in AXES),
        Parameter("width", "g", 0.1, (5e-3, 1.0), default=0.1, shape=True, grid=(0.03, 0.1, 0.3)),
    )
    confused_with = ("backlash", "bandwidth_lag", "asymmetry")
    splitter = (
        "the same poses from both sides at two inclinations: a backlash acts across gravity and grows with sin I, this"
        " does not; when turning, two rates: a lag grows with the rate"
    )
    depends_on_input = False
    complex_safe = False
    remembers = True
    groups = singles(3)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return p[:3, None] * _side(state, p[3])

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        width, h = p[3], 1e-5 * p[3]
        by_width = p[:3, None] * (_side(state, width + h) - _side(state, width - h)) / (2 * h) if p[:3].any() else 0.0
        return np.concatenate([on_own_axis(_side(state, width)), np.broadcast_to(by_width, (1, 3, state.n))])


def _side(state: ChainState, width: float) -> AnyArray:
    """(3, N) on which side of its slack the load of each axis stands, -1 to 1; the load by the bench's angles."""
    load, rows = _way(state)
    return np.stack([(f - play(f, width))[rows] / width for f in load])


def _way(state: ChainState) -> tuple[AnyArray, AnyArray]:
    """Loads (3, M) on the way through all rows, and which of them are the rows.

    From pose to pose the toolface goes round in the sense in which the next one is approached.
    """
    new = np.flatnonzero(np.diff(state.pose) != 0) + 1
    if not new.size:
        return gravity_direction(state.inc_rad, state.tf_rad), np.arange(state.n)
    sense = np.where(state.direction[new] < 0, -1.0, 1.0)
    turn = np.mod((state.tf_rad[new] - state.tf_rad[new - 1]) * sense, 2 * np.pi) * sense
    tilt = state.inc_rad[new] - state.inc_rad[new - 1]
    back = 1.0 - np.arange(1, BETWEEN) / BETWEEN
    inc = np.insert(
        state.inc_rad, np.repeat(new, BETWEEN - 1), (state.inc_rad[new, None] - tilt[:, None] * back).ravel()
    )
    tf = np.insert(state.tf_rad, np.repeat(new, BETWEEN - 1), (state.tf_rad[new, None] - turn[:, None] * back).ravel())
    passed = np.zeros(state.n, dtype=np.int64)
    passed[new] = BETWEEN - 1
    return gravity_direction(inc, tf), np.arange(state.n) + np.cumsum(passed)


EFFECT = LoadHysteresis()

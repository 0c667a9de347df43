"""Offset that remembers from which side the temperature came."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, on_own_axis, singles
from highside.physics.memory import play
from highside.physics.state import ChainState


class ThermalHysteresis(Effect):
    id = "thermal_hysteresis"
    title = "Thermal hysteresis"
    stage = Stage.THERMAL
    formula = "h_i (T - play(T)) / width: +h while warming, -h while cooling, turning over within 2 width"
    story = (
        "At the same temperature the offset differs between the way up and the way down, however slow the ramp: "
        "something slips and sticks."
    )
    parameters = (
        *(Parameter(f"h_{axis}", "g", 2e-4, (-5e-3, 5e-3)) for axis in AXES),
        Parameter("width", "C", 3.0, (0.1, 50.0), default=3.0, shape=True, grid=(1.0, 1.5, 2.2, 3.2, 4.6, 6.8, 10.0)),
    )
    confused_with = ("thermal_lag", "temperature_bias")
    splitter = "two ramp rates: this loop does not close when the ramp is slow"
    needs = ("t_s", "temp_c")
    depends_on_input = False
    complex_safe = False
    remembers = True
    groups = singles(3)
    slow = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        side = (state.temp_c - play(state.temp_c, p[3])) / p[3]
        return p[:3, None] * side

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        # the play is the costly part: once for the three heights, twice for the width
        width, h = p[3], 1e-5 * p[3]
        side, wider, narrower = ((state.temp_c - play(state.temp_c, w)) / w for w in (width, width + h, width - h))
        by_width = p[:3, None] * (wider - narrower) / (2 * h)
        return np.concatenate([on_own_axis(np.broadcast_to(side, (3, state.n))), by_width[None]])


EFFECT = ThermalHysteresis()

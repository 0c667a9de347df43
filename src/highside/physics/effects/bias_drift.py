"""Zero offset that changes at a constant rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import ANY, SLOW, Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class BiasDrift(AxisEffect):
    id = "bias_drift"
    title = "Linear drift of the zero offset"
    stage = Stage.THERMAL
    formula = "d_i (t - t_start)"
    story = "The zero offset creeps at a constant rate: ageing, creep of the suspension."
    parameters = triad("d", "g/s", 1e-8, 1e-5)
    confused_with = ("temperature_bias", "wander", "warmup", "thermal_lag")
    splitter = "return to a reference pose every 10 to 15 minutes, at constant temperature"
    needs = ("t_s",)
    depends_on_input = False
    slow = True

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.broadcast_to(state.t_s - state.t_s[:1], (3, state.n))

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.zeros((3, state.n))

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        elapsed = data.t_s - data.t_s.mean()
        parameters = tuple(
            Parameter(f"d_{n}", f"{u}/s", 1e-6, ANY) for n, u in zip(data.names, data.units, strict=True)
        )
        return [ChannelTerm(parameters, (data.on([(c, elapsed) for c in range(len(data.names))]),), (SLOW, 0, 0))]


EFFECT = BiasDrift()

"""Zero offset that follows the temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import ANY, SLOW, Channels, ChannelTerm
from highside.physics.effect import REFERENCE_TEMP_C, AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class TemperatureBias(AxisEffect):
    id = "temperature_bias"
    title = "Temperature coefficient of the zero offset"
    stage = Stage.THERMAL
    formula = "bt_i (T - 25 C)"
    story = "The zero offset follows the temperature, in proportion, up and down alike."
    parameters = triad("bt", "g/C", 1e-4, 3e-3)
    confused_with = ("bias_drift", "warmup", "thermal_lag", "wander")
    splitter = "an up and a down temperature ramp: what follows temperature comes back, what follows time does not"
    needs = ("temp_c",)
    depends_on_input = False
    slow = True
    channel_needs = "the temperature (temp_c) is not recorded, or does not change"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.broadcast_to(state.temp_c - REFERENCE_TEMP_C, (3, state.n))

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.zeros((3, state.n))

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        if data.temp_c is None:
            return ()
        warm = data.temp_c - data.temp_c.mean()
        parameters = tuple(
            Parameter(f"bt_{n}", f"{u}/C", 1e-4, ANY) for n, u in zip(data.names, data.units, strict=True)
        )
        return [ChannelTerm(parameters, (data.on([(c, warm) for c in range(len(data.names))]),), (SLOW, 0, 1))]


EFFECT = TemperatureBias()

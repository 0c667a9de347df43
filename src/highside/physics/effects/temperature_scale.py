"""Scale factor that follows the temperature."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import SLOW, Channels, ChannelTerm
from highside.physics.effect import REFERENCE_TEMP_C, AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class TemperatureScale(AxisEffect):
    id = "temperature_scale"
    title = "Temperature coefficient of the scale factor"
    stage = Stage.THERMAL
    formula = "st_i f_i (T - 25 C)"
    story = "The scale factor follows the temperature."
    parameters = triad("st", "1/C", 1e-4, 1e-3)
    confused_with = ("temperature_bias", "scale")
    splitter = "the same temperatures at poses that load the axis differently"
    needs = ("temp_c",)
    channel_needs = "the temperature (temp_c) is not recorded, or does not change"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f * (state.temp_c - REFERENCE_TEMP_C)

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.broadcast_to(state.temp_c - REFERENCE_TEMP_C, f.shape)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        if data.temp_c is None:
            return ()
        warm = data.temp_c - data.temp_c.mean()
        parameters = tuple(Parameter(f"st_{n}", "1/C", 1e-4, (-0.01, 0.01)) for n in data.names)
        return [
            ChannelTerm(parameters, (data.on([(c, warm * s) for c, s in enumerate(data.predicted)]),), (SLOW, 0, 2))
        ]


EFFECT = TemperatureScale()

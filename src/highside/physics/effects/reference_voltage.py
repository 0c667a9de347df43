"""One scale factor for all channels, that follows temperature or time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import SLOW, Channels, ChannelTerm
from highside.physics.effect import REFERENCE_TEMP_C, LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class ReferenceVoltage(LinearEffect):
    id = "reference_voltage"
    title = "Reference voltage of the converter"
    stage = Stage.THERMAL
    formula = "f_i (vt (T - 25 C) + vd (t - t_start)), the same on every axis"
    story = (
        "The converter of all axes measures against one voltage. As that follows the temperature or ages, every reading"
        " becomes larger or smaller by the same share. A voltage that is off and stays so is part of the scale factors."
    )
    # voltage references 10 to 100 ppm/C, a regulator used as one 300 ppm/C; vd: 1 % in a quarter of an hour is a fault
    parameters = (
        Parameter("vt", "1/C", 2e-5, (-5e-4, 5e-4)),
        Parameter("vd", "1/s", 1e-7, (-1e-5, 1e-5)),
    )
    confused_with = ("temperature_scale",)
    splitter = "loads on all axes at two temperatures: scale factors of their own differ from axis to axis"
    needs = ("t_s",)
    groups = singles(2)
    channel_needs = "the temperature (temp_c) is not recorded, or does not change"

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return np.stack([x * (state.temp_c - REFERENCE_TEMP_C), x * (state.t_s - state.t_s[:1])])

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # of one channel alone it is a scale factor like any other
        if data.temp_c is None or len(data.names) < 2:
            return ()
        columns = np.asarray(data.predicted * (data.temp_c - data.temp_c.mean()))
        return [ChannelTerm(self.parameters[:1], (columns[None],), (SLOW, 0, 4))]


EFFECT = ReferenceVoltage()

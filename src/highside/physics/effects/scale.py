"""Error of the scale factor of each accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Stage, triad
from highside.physics.state import ChainState


class Scale(AxisEffect):
    id = "scale"
    title = "Scale factor error"
    stage = Stage.SENSOR
    formula = "s_i f_i"
    story = "Each accelerometer exaggerates or understates what it feels by a fixed share."
    parameters = triad("s", "1", 5e-3, 0.1)
    confused_with = ("misalignment", "cubic", "temperature_scale")
    splitter = "poses with the axis along and against gravity; several temperatures"
    calibrated = True

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.ones(f.shape)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.gains(*own) for own in data.of_kind("accel")]


EFFECT = Scale()

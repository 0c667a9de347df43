"""Zero rate offset of each gyro."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import LinearEffect, Stage, on_own_axis, singles, triad
from highside.physics.state import ChainState


class GyroBias(LinearEffect):
    id = "gyro_bias"
    title = "Bias of the gyros (zero-rate offset)"
    stage = Stage.GYRO
    formula = "b_i"
    story = "Each gyro shows a small rotation even when the tool stands still."
    parameters = triad("b", "rad/s", 5e-5, 0.1)
    confused_with = ("earth_rotation", "gyro_g_sensitivity")
    splitter = "several attitudes: earth rotation and g-sensitivity turn with the tool, the offset does not"
    depends_on_input = False
    groups = singles(3)
    constant = True
    channel_story = "The gyro shows a small rotation where there is none."

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(np.ones((3, state.n)))

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.offsets(*own) for own in data.of_kind("rate")]


EFFECT = GyroBias()

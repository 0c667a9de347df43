"""Scale factor error of each gyro."""

from __future__ import annotations

from collections.abc import Sequence

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import LinearEffect, Stage, on_own_axis, singles, triad
from highside.physics.state import ChainState


class GyroScale(LinearEffect):
    id = "gyro_scale"
    title = "Scale factor error of the gyros"
    stage = Stage.GYRO
    formula = "s_i w_i"
    story = "Each gyro exaggerates or understates the rotation by a fixed share."
    parameters = triad("s", "1", 1e-3, 0.1)
    confused_with = ("gyro_asymmetry", "gyro_nonlinearity")
    splitter = "several rates of both signs against the encoder"
    groups = singles(3)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(x)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.gains(*own) for own in data.of_kind("rate")]


EFFECT = GyroScale()

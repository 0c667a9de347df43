"""Zero offset of each accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Stage, triad
from highside.physics.state import ChainState


class Bias(AxisEffect):
    id = "bias"
    title = "Bias (zero offset)"
    stage = Stage.SENSOR
    formula = "b_i"
    story = "Each accelerometer reads a constant amount too much or too little, whatever its attitude."
    parameters = triad("b", "g", 2e-3, 0.15)
    confused_with = ("misalignment", "turn_on_bias")
    splitter = "a second inclination: at one inclination M_iz cos I is a constant too"
    depends_on_input = False
    constant = True
    calibrated = True

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.ones(f.shape)

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.zeros(f.shape)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.offsets(*own) for own in data.of_kind("accel")]


EFFECT = Bias()

"""Odd second-order term of each accelerometer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import EACH, Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class OddQuadratic(AxisEffect):
    id = "odd_quadratic"
    title = "Odd quadratic non-linearity"
    stage = Stage.SENSOR
    formula = "ko_i f_i |f_i|"
    story = (
        "The accelerometer's error grows with the square of the load and has its sign: two halves of a sensor with"
        " second-order terms of their own."
    )
    # the term K_oq of the model equation in IEEE Std 1293; its gate is that of the even term K2
    parameters = triad("ko", "g/g^2", 5e-4, 5e-3)
    confused_with = ("cubic", "scale", "asymmetry")
    splitter = (
        "many poses at intermediate loads, 0.1 to 0.8 g on the axis: beside a scale factor a cubic does the same but"
        " for a sixth of it"
    )

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f * f * np.sign(f.real)

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return 2 * f * np.sign(f.real)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        terms, bent = [], data.made(lambda s: s * np.abs(s))
        for place, members in data.of_kind("accel"):
            parameters = tuple(
                Parameter(f"ko_{data.names[c]}", f"1/({data.units[c]})", 1e-3, (-0.1, 0.1)) for c in members
            )
            columns = data.on([(c, bent[c]) for c in members])
            terms.append(ChannelTerm(parameters, (columns,), (EACH, place, 4)))
        return terms


EFFECT = OddQuadratic()

"""Even second-order term of each accelerometer, K2."""

from __future__ import annotations

from collections.abc import Sequence

from highside.arrays import AnyArray
from highside.physics.channels import EACH, Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class Quadratic(AxisEffect):
    id = "quadratic"
    title = "Scale-factor nonlinearity K2 (quadratic)"
    stage = Stage.SENSOR
    formula = "k2_i f_i^2"
    story = (
        "The output has a term in the square of the input: its error is the same at +1 g and at -1 g and "
        "vanishes at 0 g."
    )
    parameters = triad("k2", "g/g^2", 5e-4, 5e-3)
    confused_with = ("asymmetry", "encoder_first_harmonic", "bias", "sag")
    splitter = "poses with |f| below 0.5 g on the axis (a parabola against a kink), or a centrifuge"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f**2

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return 2 * f

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        terms, bent = [], data.made(lambda s: s**2)
        for place, members in data.of_kind("accel"):
            parameters = tuple(
                Parameter(f"k2_{data.names[c]}", f"1/({data.units[c]})", 1e-3, (-0.1, 0.1)) for c in members
            )
            columns = data.on([(c, bent[c]) for c in members])
            terms.append(ChannelTerm(parameters, (columns,), (EACH, place, 2)))
        return terms


EFFECT = Quadratic()

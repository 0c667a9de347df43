"""Odd third-order term of each accelerometer, K3."""

from __future__ import annotations

from collections.abc import Sequence

from highside.arrays import AnyArray
from highside.physics.channels import EACH, Channels, ChannelTerm
from highside.physics.effect import AxisEffect, Parameter, Stage, triad
from highside.physics.state import ChainState


class Cubic(AxisEffect):
    id = "cubic"
    title = "Scale-factor nonlinearity K3 (cubic)"
    stage = Stage.SENSOR
    formula = "k3_i f_i^3"
    story = "The output has a term in the cube of the input: a scale factor error that grows with the input."
    parameters = triad("k3", "g/g^3", 5e-4, 5e-3)
    confused_with = ("scale", "encoder_second_harmonic")
    splitter = "poses at intermediate loads (near 0.58 g the cubic differs most from a scale error)"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f * f * f

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return 3 * f * f

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        terms, bent = [], data.made(lambda s: s**3)
        for place, members in data.of_kind("accel"):
            parameters = tuple(
                Parameter(f"k3_{data.names[c]}", f"1/({data.units[c]})^2", 1e-3, (-0.1, 0.1)) for c in members
            )
            columns = data.on([(c, bent[c]) for c in members])
            terms.append(ChannelTerm(parameters, (columns,), (EACH, place, 3)))
        return terms


EFFECT = Cubic()

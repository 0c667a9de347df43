"""Odd third-order term of each accelerometer, K3."""

from __future__ import annotations

from highside.arrays import AnyArray
from highside.physics.effect import AxisEffect, Stage, triad
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


EFFECT = Cubic()

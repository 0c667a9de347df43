"""Even second-order term of each accelerometer, K2."""

from __future__ import annotations

from highside.arrays import AnyArray
from highside.physics.effect import AxisEffect, Stage, triad
from highside.physics.state import ChainState


class Quadratic(AxisEffect):
    id = "quadratic"
    title = "Quadratic non-linearity (K2)"
    stage = Stage.SENSOR
    formula = "k2_i f_i^2"
    story = (
        "The accelerometer reads a little more in both directions the harder it is loaded: its error is the same at"
        " +1 g and -1 g and vanishes at 0 g."
    )
    parameters = triad("k2", "g/g^2", 5e-4, 5e-3)
    confused_with = ("asymmetry", "encoder_first_harmonic", "bias", "sag")
    splitter = "poses with |f| below 0.5 g on the axis (a parabola against a kink), or a centrifuge"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f**2

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return 2 * f


EFFECT = Quadratic()

"""Different scale factors for the two signs of the input."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AxisEffect, Stage, triad
from highside.physics.state import ChainState


class Asymmetry(AxisEffect):
    id = "asymmetry"
    title = "Scale factor asymmetry"
    stage = Stage.SENSOR
    formula = "ka_i |f_i|"
    story = "The scale factor differs between the two signs of the input: a kink at zero load."
    parameters = triad("ka", "1", 3e-4, 0.01)
    confused_with = ("quadratic",)
    splitter = "poses with |f| below 0.5 g on the axis: a kink against a parabola"

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return f * np.sign(f.real)

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.sign(f.real)


EFFECT = Asymmetry()

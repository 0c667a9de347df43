"""Play of the gears."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class Backlash(LinearEffect):
    id = "backlash"
    title = "Backlash (direction of approach)"
    stage = Stage.POSE
    formula = "dT = h_tf d, dI = h_inc d, d = +1 or -1 the direction of approach"
    story = "The gear rests on one flank or the other, depending on the side from which the position was approached."
    parameters = (
        Parameter("h_tf", "rad", 2e-4, (-0.02, 0.02)),
        Parameter("h_inc", "rad", 1e-4, (-0.02, 0.02)),
    )
    confused_with = ("time_offset", "stiction", "mounting")
    splitter = "approach the same poses from both sides; with one direction it is a constant"
    needs = ("direction",)
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((2, 3, state.n))
        basis[0, 2] = basis[1, 0] = state.direction
        return basis


EFFECT = Backlash()

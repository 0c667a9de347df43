"""Zero rate offset of each gyro."""

from __future__ import annotations

import numpy as np

from highside.physics.effect import LinearEffect, Stage, on_own_axis, triad
from highside.physics.gravity import Array
from highside.physics.state import ChainState


class GyroBias(LinearEffect):
    id = "gyro_bias"
    title = "Zero rate offset of the gyros"
    stage = Stage.GYRO
    formula = "b_i"
    story = "Each gyro shows a small rotation even when the tool stands still."
    parameters = triad("b", "rad/s", 5e-5, 0.1)
    confused_with = ("earth_rotation", "gyro_g_sensitivity")
    splitter = "several attitudes: earth rotation and g-sensitivity turn with the tool, the offset does not"
    depends_on_input = False

    def basis(self, state: ChainState, x: Array) -> Array:
        return on_own_axis(np.ones((3, state.n)))


EFFECT = GyroBias()

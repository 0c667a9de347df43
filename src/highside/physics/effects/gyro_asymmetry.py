"""Different scale factors for the two senses of rotation."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Stage, on_own_axis, singles, triad
from highside.physics.state import ChainState


class GyroAsymmetry(LinearEffect):
    id = "gyro_asymmetry"
    title = "Scale factor asymmetry of the gyros"
    stage = Stage.GYRO
    formula = "ka_i |w_i|"
    story = "A gyro's scale factor is different for the two senses of rotation."
    parameters = triad("ka", "1", 2e-4, 0.01)
    confused_with = ("backlash", "gyro_nonlinearity", "gyro_scale")
    splitter = "the same rates in both senses: a kink at zero"
    groups = singles(3)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(x * np.sign(x.real))


EFFECT = GyroAsymmetry()

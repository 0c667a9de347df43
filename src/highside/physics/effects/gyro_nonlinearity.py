"""Second and third order of each gyro."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Stage, across, on_own_axis, runs, triad
from highside.physics.state import ChainState


class GyroNonlinearity(LinearEffect):
    id = "gyro_nonlinearity"
    title = "Scale-factor nonlinearity of the gyros (K2, K3)"
    stage = Stage.GYRO
    formula = "k2_i w_i^2 + k3_i w_i^3"
    story = "A gyro's scale factor changes with the rate."
    parameters = (*triad("k2", "s/rad", 2e-5, 1e-3), *triad("k3", "s^2/rad^2", 2e-6, 1e-4))
    confused_with = ("gyro_asymmetry", "gyro_scale")
    splitter = "at least five rates of each sign"
    groups = (*runs(6, 3), *across(6, 3))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return np.concatenate([on_own_axis(x**2), on_own_axis(x**3)])


EFFECT = GyroNonlinearity()

"""Sensors of the triad at different places."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, across, runs
from highside.physics.state import ChainState


class SizeEffect(LinearEffect):
    id = "size_effect"
    title = "Size effect"
    stage = Stage.KINEMATIC
    formula = "x: -w^2 x_x + T'' y_x, y: -w^2 y_y - T'' x_y, (x_i, y_i) the place of sensor i"
    story = (
        "The accelerometers cannot all sit in the same spot: each has its own distance from the axis and feels its "
        "own share of the rotation."
    )
    parameters = (
        Parameter("x_x", "m", 5e-3, (-0.1, 0.1)),
        Parameter("y_x", "m", 5e-3, (-0.1, 0.1)),
        Parameter("x_y", "m", 5e-3, (-0.1, 0.1)),
        Parameter("y_y", "m", 5e-3, (-0.1, 0.1)),
    )
    confused_with = ("lever_arm", "vibration_rectification")
    splitter = "fast ramps of the rotor rate: at constant rate a common lever arm explains the same"
    needs = ("rotor_rate_radps", "rotor_accel_radps2")
    depends_on_input = False
    groups = (*runs(4, 2), *across(4, 2))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        square, angular = -(state.rotor_rate_radps**2), -state.rotor_accel_radps2
        basis = np.zeros((4, 3, state.n))
        basis[0, 0], basis[1, 0] = square, -angular
        basis[2, 1], basis[3, 1] = angular, square
        return basis / state.gravity_mps2


EFFECT = SizeEffect()

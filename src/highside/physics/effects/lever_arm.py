"""Triad away from the axis of rotation."""

from __future__ import annotations

import numpy as np

from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.gravity import Array
from highside.physics.state import ChainState


class LeverArm(LinearEffect):
    id = "lever_arm"
    title = "Lever arm"
    stage = Stage.KINEMATIC
    formula = "(w x (w x r) + a x r) / g: x: -w^2 r_x + T'' r_y, y: -w^2 r_y - T'' r_x, with w = T'"
    story = (
        "The accelerometers do not sit on the axis of rotation, so turning throws them outward and speeding up "
        "drags them sideways."
    )
    parameters = (Parameter("r_x", "m", 0.01, (-0.2, 0.2)), Parameter("r_y", "m", 0.01, (-0.2, 0.2)))
    confused_with = ("size_effect", "vibration_rectification", "bias", "coriolis")
    splitter = "at least three rates, of both signs, with ramps between them"
    needs = ("rotor_rate_radps",)
    depends_on_input = False

    def basis(self, state: ChainState, x: Array) -> Array:
        # the toolface grows clockwise looking down-hole, about -z: the angular acceleration about z is -T''
        square, angular = -(state.rotor_rate_radps**2), -state.rotor_accel_radps2
        basis = np.zeros((2, 3, state.n))
        basis[0, 0], basis[0, 1] = square, angular
        basis[1, 1], basis[1, 0] = square, -angular
        return basis / state.gravity_mps2


EFFECT = LeverArm()

"""Gyros that feel gravity."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, pairs, runs, singles
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState


class GyroGSensitivity(LinearEffect):
    id = "gyro_g_sensitivity"
    title = "g-sensitivity of the gyros"
    stage = Stage.GYRO
    formula = "G_ij f_j, f the gravity in the tool frame"
    story = "Gravity deflects the gyros' proof masses, so they show a rotation that depends on the attitude."
    parameters = tuple(
        Parameter(f"g_{AXES[i]}{AXES[j]}", "rad/s/g", 3e-4, (-0.02, 0.02)) for i in range(3) for j in range(3)
    )
    confused_with = ("earth_rotation", "gyro_bias")
    splitter = "a second inclination or another azimuth: earth rotation has a known size and direction"
    depends_on_input = False
    groups = (*runs(9, 3), *pairs(runs(9, 3)), *singles(9))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        gravity = gravity_direction(state.inc_rad, state.tf_rad)
        basis = np.zeros((9, 3, state.n))
        for i in range(3):
            basis[3 * i : 3 * i + 3, i] = gravity
        return basis


EFFECT = GyroGSensitivity()

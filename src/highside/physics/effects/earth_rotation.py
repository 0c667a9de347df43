"""The rotation of the Earth."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.gravity import EARTH_RATE_RADPS, rotate_y, rotate_z
from highside.physics.state import ChainState


class EarthRotation(LinearEffect):
    id = "earth_rotation"
    title = "Earth rotation"
    stage = Stage.GYRO
    formula = (
        "share * Rz(T) Ry(I) W (cos lat cos A, cos lat sin A, sin lat), W = 15.041 deg/h, A the azimuth of the hole"
    )
    story = (
        "The bench stands on a rotating Earth: gyros at rest see 15 degrees an hour, in a direction known from "
        "latitude and azimuth. Its size is no free number: the share must be 1."
    )
    parameters = (Parameter("share", "1", 1.0, (-0.03, 1.03)),)
    confused_with = ("gyro_g_sensitivity", "gyro_bias")
    splitter = "latitude and azimuth fix its size and direction; turn the bench by 180 deg in azimuth"
    known_size = True
    depends_on_input = False

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        if np.isnan(state.latitude_rad):
            # where the bench stands is not known: nothing is said of its direction
            return rotate_z(state.tf_rad, rotate_y(state.inc_rad, np.zeros((3, 1))))[None]
        level = EARTH_RATE_RADPS * np.cos(state.latitude_rad)
        lab = np.array(
            [
                [level * np.cos(state.azimuth_rad)],
                # the lab's y axis points 90 deg to the left of x
                [level * np.sin(state.azimuth_rad)],
                [EARTH_RATE_RADPS * np.sin(state.latitude_rad)],
            ]
        )
        return rotate_z(state.tf_rad, rotate_y(state.inc_rad, lab))[None]


EFFECT = EarthRotation()

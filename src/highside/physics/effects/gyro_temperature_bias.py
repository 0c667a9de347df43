"""Zero rate offset of the gyros that follows the temperature."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import REFERENCE_TEMP_C, LinearEffect, Stage, on_own_axis, singles, triad
from highside.physics.state import ChainState


class GyroTemperatureBias(LinearEffect):
    id = "gyro_temperature_bias"
    title = "Temperature coefficient of the gyros' offset"
    stage = Stage.GYRO
    formula = "bt_i (T - 25 C)"
    story = (
        "The small rotation that a gyro shows at rest follows the temperature, up and down alike. Shows where the"
        " gyros and a changing temperature are recorded."
    )
    # data sheets of MEMS gyros: 0.05 deg/s/C (Bosch BMI160) to 0.16 deg/s/C (InvenSense MPU-6050, 20 deg/s over 125 C)
    parameters = triad("bt", "rad/s/C", 1e-5, 3e-3)
    confused_with = ("gyro_warmup", "gyro_bias_step", "gyro_wander")
    splitter = "an up and a down temperature ramp: what follows temperature comes back, what follows time does not"
    needs = ("temp_c",)
    depends_on_input = False
    groups = singles(3)
    slow = True

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(np.broadcast_to(state.temp_c - REFERENCE_TEMP_C, (3, state.n)))


EFFECT = GyroTemperatureBias()

"""Scale factor of the gyros that follows the temperature."""

from __future__ import annotations

from highside.arrays import AnyArray
from highside.physics.effect import REFERENCE_TEMP_C, LinearEffect, Stage, on_own_axis, singles, triad
from highside.physics.state import ChainState


class GyroTemperatureScale(LinearEffect):
    id = "gyro_temperature_scale"
    title = "Temperature coefficient of the gyros' scale factor"
    stage = Stage.GYRO
    formula = "st_i w_i (T - 25 C)"
    story = (
        "A gyro exaggerates the rotation more, or less, the warmer it is. Shows where the gyros and a changing"
        " temperature are recorded while the tool turns."
    )
    # data sheets of MEMS gyros: 0.02 %/C (Bosch BMI160, InvenSense MPU-6050: 2 % over 125 C); five times that
    parameters = triad("st", "1/C", 5e-5, 1e-3)
    confused_with = ("gyro_temperature_bias", "gyro_scale")
    splitter = "the same temperatures at rates of both signs: a scale factor's error turns over with the rate"
    needs = ("temp_c", "rotor_rate_radps")
    groups = singles(3)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return on_own_axis(x * (state.temp_c - REFERENCE_TEMP_C))


EFFECT = GyroTemperatureScale()

"""Gyros that settle after power-up."""

from __future__ import annotations

from highside.physics.effect import AXES, Parameter, Stage
from highside.physics.effects.warmup import Warmup


class GyroWarmup(Warmup):
    id = "gyro_warmup"
    title = "Warm-up of the gyros"
    stage = Stage.GYRO
    formula = "a_i exp(-(t - t_start) / tau)"
    story = (
        "After it is switched on the gyros warm themselves, and the rotation that they show at rest settles, quickly"
        " at first and then more slowly. Shows where the gyros are recorded from the start."
    )
    # self-heating of some 20 C at the 0.05 deg/s/C of MEMS data sheets (Bosch BMI160) is 0.017 rad/s
    parameters = (
        *(Parameter(f"a_{axis}", "rad/s", 1e-4, (-0.02, 0.02)) for axis in AXES),
        next(p for p in Warmup.parameters if p.time_constant),
    )
    confused_with = ("gyro_temperature_bias", "gyro_bias_step", "gyro_wander")
    splitter = "switch off and on again at constant temperature"


EFFECT = GyroWarmup()

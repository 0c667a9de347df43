"""Gyros that settle after power-up."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, singles
from highside.physics.effects.warmup import EFFECT as WARMUP
from highside.physics.state import ChainState


class GyroWarmup(Effect):
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
        next(p for p in WARMUP.parameters if p.time_constant),
    )
    confused_with = ("gyro_temperature_bias", "gyro_bias_step", "gyro_wander")
    splitter = "switch off and on again at constant temperature"
    needs = ("t_s",)
    depends_on_input = False
    groups = singles(3)
    slow = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        elapsed = state.t_s - state.t_s[:1]
        return p[:3, None] * np.exp(-elapsed / p[3])

    def restarted(self, p: AnyArray, earlier_s: float) -> tuple[AnyArray, AnyArray]:
        return WARMUP.restarted(p, earlier_s)


EFFECT = GyroWarmup()

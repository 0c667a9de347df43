"""Zero rate offset of the gyros that jumps once."""

from __future__ import annotations

from highside.physics.effect import AXES, Parameter, Stage
from highside.physics.effects.bias_step import BiasStep


class GyroBiasStep(BiasStep):
    id = "gyro_bias_step"
    title = "Step of the gyros' offset"
    stage = Stage.GYRO
    formula = "a_i for t >= t0 (seconds since the start), else 0"
    story = (
        "Once during the recording the rotation that a gyro shows at rest jumped and stayed: a shock, a supply that"
        " changed. Shows where the gyros are recorded."
    )
    # a step is no larger than what the offset may be at all: 3 deg/s at zero rate in data sheets (Bosch BMI160)
    parameters = (
        *(Parameter(f"a_{axis}", "rad/s", 1e-4, (-0.05, 0.05)) for axis in AXES),
        Parameter("t0", "s", 300.0, (0.0, 1e9), shape=True, epoch=True),
    )
    confused_with = ("gyro_wander", "gyro_temperature_bias", "gyro_warmup")
    splitter = "stand still before and after: a step separates two levels, a random walk has none"

    def steps_on(self, kind: str) -> bool:
        return kind == "rate"


EFFECT = GyroBiasStep()

"""Zero offset that changes from one power-up to the next."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.state import ChainState


class TurnOnBias(RandomEffect):
    id = "turn_on_bias"
    title = "Turn-on bias"
    stage = Stage.NOISE
    draws_at = Stage.SENSOR
    formula = "one draw b_i ~ N(0, sigma_i) a power-up"
    story = (
        "Each time the tool is switched on its zero offsets settle at slightly different values and stay there "
        "until it is switched off."
    )
    parameters = tuple(Parameter(f"sigma_{axis}", "g", 3e-4, (0.0, 0.05)) for axis in AXES)
    confused_with = ("bias", "bias_step")
    splitter = "power-cycle at the same pose; in the hole, the centre of the (gx, gy) circle over a turn"

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        return np.repeat((p * rng.standard_normal(3))[:, None], state.n, axis=1)


EFFECT = TurnOnBias()

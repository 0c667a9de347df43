"""Vibration tied to the rotation."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, across
from highside.physics.memory import unwrapped_angle
from highside.physics.state import ChainState


class AliasedVibration(Effect):
    id = "aliased_vibration"
    title = "Rotation-synchronous vibration (aliased)"
    stage = Stage.SENSOR
    formula = "c_i cos(n phi) + s_i sin(n phi), phi the rotor angle without wrapping, n the order"
    story = (
        "Something that turns with the tool (a bearing, a gear) shakes it n times a turn; sampled too slowly it "
        "appears at another frequency, which moves with the rate."
    )
    parameters = (
        *(Parameter(f"c_{axis}", "g", 1e-4, (-0.5, 0.5)) for axis in AXES),
        *(Parameter(f"s_{axis}", "g", 1e-4, (-0.5, 0.5)) for axis in AXES),
        Parameter("n", "1", 7.3, (0.1, 1e3), default=7.3, shape=True, line_over="turns"),
    )
    confused_with = ("tone", "wobble")
    splitter = "change the rate of rotation or of sampling by 1 %: the line moves"
    needs = ("rotor_rate_radps",)
    remembers = True
    depends_on_input = False
    groups = across(6, 3)
    averages_out = "vibration in step with the rotation needs rotation"

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        phase = p[6] * unwrapped_angle(state.tf_rad)
        return p[:3, None] * np.cos(phase) + p[3:6, None] * np.sin(phase)


EFFECT = AliasedVibration()

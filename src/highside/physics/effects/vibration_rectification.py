"""Offset in proportion to the square of the vibration."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AxisEffect, Stage, triad
from highside.physics.state import ChainState


class VibrationRectification(AxisEffect):
    id = "vibration_rectification"
    title = "Vibration rectification"
    stage = Stage.SENSOR
    formula = "kv_i v_rms^2"
    story = (
        "Vibration that averages to zero leaves a constant behind, because the sensor answers unequally to"
        " the two signs of the input; it grows with the square of the vibration."
    )
    parameters = triad("kv", "g/g^2", 5e-5, 5e-3)
    confused_with = ("lever_arm", "size_effect", "tone")
    splitter = "vibration without rotation (a shaker): there is no centripetal term at standstill"
    needs = ("vibration_rms_g",)
    depends_on_input = False

    def term(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.broadcast_to(state.vibration_rms_g**2, (3, state.n))

    def slope(self, state: ChainState, f: AnyArray) -> AnyArray:
        return np.zeros((3, state.n))


EFFECT = VibrationRectification()

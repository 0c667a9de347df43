"""Deflection under gravity."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState


class Sag(LinearEffect):
    id = "sag"
    title = "Gravity sag of the collar or of the arm"
    stage = Stage.POSE
    formula = "dI = s sin I"
    story = (
        "The tool or the arm that holds it deflects under its own weight: nothing when vertical, most when horizontal."
    )
    parameters = (Parameter("s", "rad", 2e-3, (-0.035, 0.035)),)
    confused_with = ("base_tilt", "quadratic", "scale")
    splitter = "roll the tool by 180 deg: sag stays fixed in the room, a misalignment turns with the tool"
    depends_on_input = False

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((1, 3, state.n))
        basis[0, 0] = np.sin(state.inc_rad)
        return basis


EFFECT = Sag()

"""The vertical in the bench's own frame."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class BaseTilt(LinearEffect):
    id = "base_tilt"
    title = "Levelling error of the bench"
    stage = Stage.GRAVITY
    formula = "vertical = (tilt_x, tilt_y, 1): I + tilt_x, T + tilt_y / sin I"
    story = (
        "The bench stands on a floor that is not level: its whole frame leans, so inclination and toolface are off "
        "by amounts fixed in the room."
    )
    parameters = (
        Parameter("tilt_x", "rad", 5e-4, (-0.05, 0.05)),
        Parameter("tilt_y", "rad", 5e-4, (-0.05, 0.05)),
    )
    confused_with = ("scale", "misalignment", "encoder_first_harmonic", "sag", "mounting")
    splitter = "a second inclination; best the same one reversed (the table turned to -I or beyond 90 deg)"
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return np.array([[[1.0], [0.0], [0.0]], [[0.0], [1.0], [0.0]]])


EFFECT = BaseTilt()

"""Rotation of the triad in its housing."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class Mounting(LinearEffect):
    id = "mounting"
    title = "Mounting misalignment of the triad"
    stage = Stage.MOUNTING
    formula = "f = exp([roll about z, tilt about x and y]) w"
    story = (
        "The triad sits slightly turned in its housing, so it is right about its own axes and wrong about the tool's."
    )
    parameters = (
        Parameter("tilt_x", "rad", 3e-3, (-0.06, 0.06)),
        Parameter("tilt_y", "rad", 3e-3, (-0.06, 0.06)),
        Parameter("roll", "rad", 3e-3, (-0.06, 0.06)),
    )
    confused_with = ("misalignment", "wobble", "base_tilt")
    splitter = "an independent mark of the housing; the antisymmetric part of a misalignment is the same thing"
    depends_on_input = False
    groups = (*singles(3), (0, 1))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((3, 3, 1))
        basis[[0, 1, 2], [0, 1, 2], 0] = 1.0
        return basis


EFFECT = Mounting()

"""Toolface zero that depends on the inclination: confounded with the non-orthogonality of the axes."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState


class ReferenceTwist(LinearEffect):
    id = "reference_twist"
    title = "Toolface reference twist (depends on the inclination)"
    stage = Stage.POSE
    formula = "dT = k cos I"
    story = (
        "The toolface zero of the bench turns a little as the stage tilts: the chuck or the frame twists under its "
        "own weight."
    )
    parameters = (Parameter("k", "rad", 5e-4, (-0.05, 0.05)),)
    confused_with = ("axis_nonorthogonality", "base_tilt", "mounting")
    splitter = "inclination stations near vertical: the non-orthogonality grows there as cot I, the twist stays"
    depends_on_input = False

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((1, 3, state.n))
        basis[0, 2] = np.cos(state.inc_rad)
        return basis


EFFECT = ReferenceTwist()

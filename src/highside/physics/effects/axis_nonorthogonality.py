"""Angle between the spindle and the plane square to the inclination axis."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState


class AxisNonorthogonality(LinearEffect):
    id = "axis_nonorthogonality"
    title = "Non-orthogonality of the spindle and inclination axes"
    stage = Stage.POSE
    formula = "w = Rz(T) Rx(eps) Ry(I) (0, 0, 1): T - eps cot I"
    story = (
        "The spindle that turns the tool is not square to the axis that tilts it, so the toolface is off by an "
        "amount that depends on the inclination."
    )
    parameters = (Parameter("eps", "rad", 3e-4, (-0.01, 0.01)),)
    confused_with = ("reference_twist", "base_tilt", "misalignment")
    splitter = "inclination stations on both sides of 90 deg and near vertical: cot I grows where cos I does not"
    depends_on_input = False

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((1, 3, state.n))
        basis[0, 1] = 1.0
        return basis


EFFECT = AxisNonorthogonality()

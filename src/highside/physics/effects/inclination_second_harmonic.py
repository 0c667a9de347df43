"""Second harmonic of the inclination encoder."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class InclinationSecondHarmonic(LinearEffect):
    id = "inclination_second_harmonic"
    title = "Inclination encoder, second harmonic (ellipticity, coupling)"
    stage = Stage.POSE
    formula = "dI = c2 cos 2I + s2 sin 2I"
    story = "The inclination encoder runs ahead and behind twice a turn: an oval disc or an angled coupling."
    # as the second harmonic of the toolface encoder: twice the angle between coupled shafts squared, 0.1 rad
    parameters = (
        Parameter("c2", "rad", 1e-4, (-0.01, 0.01)),
        Parameter("s2", "rad", 1e-4, (-0.01, 0.01)),
    )
    confused_with = ("inclination_first_harmonic", "sag", "base_tilt", "scale")
    splitter = "at least eight unequally spaced inclinations over more than a quarter turn, some beyond 90 deg"
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((2, 3, state.n))
        basis[0, 0], basis[1, 0] = np.cos(2 * state.inc_rad), np.sin(2 * state.inc_rad)
        return basis


EFFECT = InclinationSecondHarmonic()

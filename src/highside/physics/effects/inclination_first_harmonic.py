"""First harmonic of the inclination encoder: eccentric axis."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState


class InclinationFirstHarmonic(LinearEffect):
    id = "inclination_first_harmonic"
    title = "Inclination encoder, first harmonic (eccentricity)"
    stage = Stage.POSE
    formula = "dI = c1 cos I + s1 sin I"
    story = (
        "The axis of the inclination runs off the centre of its graduated disc, so the reading is ahead on one side"
        " of the turn and behind on the other. Its sine alone is what a sag does, and is told as that."
    )
    # the error is the eccentricity over the radius of the disc: 0.4 mm of 40 mm
    parameters = (
        Parameter("c1", "rad", 2e-4, (-0.01, 0.01)),
        Parameter("s1", "rad", 2e-4, (-0.01, 0.01)),
    )
    confused_with = ("sag", "base_tilt", "inclination_second_harmonic")
    splitter = (
        "at least six unequally spaced inclinations over more than a quarter turn, some beyond 90 deg; another weight"
        " on the arm: sag follows the weight, an encoder does not"
    )
    depends_on_input = False

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((2, 3, state.n))
        basis[0, 0], basis[1, 0] = np.cos(state.inc_rad), np.sin(state.inc_rad)
        return basis


EFFECT = InclinationFirstHarmonic()

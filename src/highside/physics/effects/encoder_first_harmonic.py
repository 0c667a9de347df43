"""First harmonic of the toolface encoder: eccentric disc."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class EncoderFirstHarmonic(LinearEffect):
    id = "encoder_first_harmonic"
    title = "Toolface encoder, first harmonic (eccentricity)"
    stage = Stage.POSE
    formula = "dT = c1 cos T + s1 sin T"
    story = (
        "The graduated disc of the toolface encoder is not centred, so its reading runs ahead on one side of the "
        "turn and behind on the other."
    )
    parameters = (
        Parameter("c1", "rad", 2e-4, (-0.01, 0.01)),
        Parameter("s1", "rad", 2e-4, (-0.01, 0.01)),
    )
    confused_with = ("quadratic", "encoder_second_harmonic", "base_tilt")
    splitter = "at least six unequally spaced toolfaces, at two inclinations"
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((2, 3, state.n))
        basis[0, 2], basis[1, 2] = np.cos(state.tf_rad), np.sin(state.tf_rad)
        return basis


EFFECT = EncoderFirstHarmonic()

"""Second harmonic of the toolface encoder."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class EncoderSecondHarmonic(LinearEffect):
    id = "encoder_second_harmonic"
    title = "Toolface encoder, second harmonic (ellipticity, universal joint)"
    stage = Stage.POSE
    formula = "dT = c2 cos 2T + s2 sin 2T"
    story = "The toolface encoder runs ahead and behind twice a turn: an oval disc or an angled coupling."
    parameters = (
        Parameter("c2", "rad", 1e-4, (-0.01, 0.01)),
        Parameter("s2", "rad", 1e-4, (-0.01, 0.01)),
    )
    confused_with = ("cubic", "encoder_first_harmonic", "misalignment")
    splitter = "at least eight unequally spaced toolfaces"
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((2, 3, state.n))
        basis[0, 2], basis[1, 2] = np.cos(2 * state.tf_rad), np.sin(2 * state.tf_rad)
        return basis


EFFECT = EncoderSecondHarmonic()

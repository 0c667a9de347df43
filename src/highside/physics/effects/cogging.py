"""A higher harmonic of the toolface drive."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Effect, Parameter, Stage, singles
from highside.physics.state import ChainState


class Cogging(Effect):
    id = "cogging"
    title = "Cogging (k-th harmonic of the drive)"
    stage = Stage.POSE
    formula = "dT = ck cos kT + sk sin kT"
    story = "The drive rests a little off at each tooth or pole: an error that repeats k times a turn."
    parameters = (
        Parameter("ck", "rad", 5e-5, (-0.01, 0.01)),
        Parameter("sk", "rad", 5e-5, (-0.01, 0.01)),
        Parameter(
            "k", "1", 6.0, (3.0, 720.0), default=6.0, shape=True, integer=True, grid=(3.0, 4.0, 5.0, 6.0, 8.0, 12.0)
        ),
    )
    confused_with = ("wobble", "pose_error")
    splitter = "toolfaces that are not equally spaced: a harmonic aliases with the spacing"
    depends_on_input = False
    groups = singles(2)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        ck, sk, k = p
        delta = np.zeros((3, state.n), dtype=p.dtype)
        delta[2] = ck * np.cos(k * state.tf_rad) + sk * np.sin(k * state.tf_rad)
        return delta

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        ck, sk, k = p
        cos, sin = np.cos(k * state.tf_rad), np.sin(k * state.tf_rad)
        columns = np.zeros((3, 3, state.n))
        columns[0, 2], columns[1, 2] = cos, sin
        columns[2, 2] = state.tf_rad * (sk * cos - ck * sin)
        return columns


EFFECT = Cogging()

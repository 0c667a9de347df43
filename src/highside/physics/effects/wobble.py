"""Nutation of the spindle axis with the turn."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Effect, Parameter, Stage, runs, singles
from highside.physics.state import ChainState


class Wobble(Effect):
    id = "wobble"
    title = "Spindle wobble"
    stage = Stage.POSE
    formula = "dI = ck cos kT + sk sin kT, dE = dk cos kT + tk sin kT"
    story = "The spindle's bearings let its axis nod as it turns, k times a turn."
    parameters = (
        Parameter("ck", "rad", 1e-4, (-5e-3, 5e-3)),
        Parameter("sk", "rad", 1e-4, (-5e-3, 5e-3)),
        Parameter("dk", "rad", 1e-4, (-5e-3, 5e-3)),
        Parameter("tk", "rad", 1e-4, (-5e-3, 5e-3)),
        Parameter(
            "k", "1", 2.0, (1.0, 100.0), default=2.0, shape=True, integer=True, grid=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        ),
    )
    confused_with = ("encoder_second_harmonic", "quadratic", "misalignment", "mounting")
    splitter = (
        "inclination error against toolface error at several inclinations; k = 1 in step with the turn is a "
        "mounting error"
    )
    depends_on_input = False
    groups = (*runs(4, 2), *singles(4))

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        ck, sk, dk, tk, k = p
        cos, sin = np.cos(k * state.tf_rad), np.sin(k * state.tf_rad)
        return np.stack([ck * cos + sk * sin, dk * cos + tk * sin, np.zeros(state.n)])

    def derivative(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        ck, sk, dk, tk, k = p
        cos, sin = np.cos(k * state.tf_rad), np.sin(k * state.tf_rad)
        columns = np.zeros((5, 3, state.n))
        columns[0, 0], columns[1, 0], columns[2, 1], columns[3, 1] = cos, sin, cos, sin
        columns[4, 0] = state.tf_rad * (sk * cos - ck * sin)
        columns[4, 1] = state.tf_rad * (tk * cos - dk * sin)
        return columns


EFFECT = Wobble()

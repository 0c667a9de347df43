"""Noise with memory."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import autoregressive
from highside.physics.state import ChainState


class ColouredNoise(RandomEffect):
    id = "coloured_noise"
    title = "Coloured noise"
    stage = Stage.NOISE
    formula = "first-order autoregressive, standard deviation sigma_i, correlation time tau"
    story = (
        "Neighbouring readings tremble together: low-frequency noise of the electronics, or the sway of the building."
    )
    parameters = (
        *(Parameter(f"sigma_{axis}", "g", 5e-5, (0.0, 0.02)) for axis in AXES),
        Parameter("tau", "s", 1.0, (1e-4, 1e5), default=1.0, shape=True),
    )
    confused_with = ("wander", "reading_noise")
    splitter = "a long record at rest: its spectrum is flat below 1 / (2 pi tau)"
    draws_at = Stage.NOISE
    needs = ("t_s",)

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        step = float(np.median(np.diff(state.t_s))) if state.n > 1 else 1.0
        return p[:3, None] * autoregressive((3, state.n), 1.0, float(np.exp(-step / p[3])), rng)


EFFECT = ColouredNoise()

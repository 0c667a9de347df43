"""Random walk of the zero offset (bias random walk)."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import random_walk
from highside.physics.state import ChainState


class BiasRandomWalk(RandomEffect):
    id = "wander"
    title = "Bias random walk"
    stage = Stage.NOISE
    formula = "random walk of sigma_i sqrt(t)"
    story = (
        "The zero offset changes at random: no shape, no cause to be named, only a spread that grows with the "
        "square root of time."
    )
    parameters = tuple(Parameter(f"sigma_{axis}", "g/sqrt(s)", 2e-6, (0.0, 1e-3)) for axis in AXES)
    confused_with = ("bias_drift", "warmup", "thermal_lag", "bias_step")
    splitter = "return to a reference pose every 10 to 15 minutes, twice over: what has a shape repeats, this does not"
    draws_at = Stage.SENSOR
    needs = ("t_s",)

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        return random_walk(state.t_s, p, rng)


EFFECT = BiasRandomWalk()

"""Rate random walk: the random walk of the gyros' biases."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import random_walk
from highside.physics.state import ChainState


class RateRandomWalk(RandomEffect):
    id = "gyro_wander"
    title = "Rate random walk (gyro bias random walk)"
    stage = Stage.NOISE
    formula = "random walk of sigma_i sqrt(t)"
    story = "The gyros' biases change at random: their spread grows with the square root of the time that passes."
    parameters = tuple(Parameter(f"sigma_{axis}", "rad/s/sqrt(s)", 1e-6, (0.0, 1e-2)) for axis in AXES)
    confused_with = ("gyro_noise", "gyro_bias")
    splitter = "the Allan deviation of an hour at rest: slope -1/2 against +1/2"
    draws_at = Stage.GYRO
    needs = ("t_s",)

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        return random_walk(state.t_s, p, rng)


EFFECT = RateRandomWalk()

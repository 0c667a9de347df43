"""White noise of the gyros (angle random walk)."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import std_of_average
from highside.physics.state import ChainState


class AngleRandomWalk(RandomEffect):
    id = "gyro_noise"
    title = "Angle random walk (gyro noise)"
    stage = Stage.NOISE
    formula = "std of a row = density / sqrt(2 x averaging time)"
    story = "White noise of the rate; integrated, the error of the angle grows with the square root of time."
    parameters = tuple(Parameter(f"density_{axis}", "rad/s/sqrt(Hz)", 1e-4, (0.0, 0.1)) for axis in AXES)
    confused_with = ("gyro_wander",)
    splitter = "the Allan deviation of an hour at rest: slope -1/2 against +1/2"
    draws_at = Stage.GYRO

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        sigma = np.array([std_of_average(density, state.row_seconds) for density in p])
        return sigma[:, None] * rng.standard_normal((3, state.n))


EFFECT = AngleRandomWalk()

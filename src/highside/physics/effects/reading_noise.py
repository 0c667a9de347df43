"""White noise of the accelerometers."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import std_of_average
from highside.physics.state import ChainState


class ReadingNoise(RandomEffect):
    id = "reading_noise"
    title = "Reading noise (velocity random walk)"
    stage = Stage.NOISE
    draws_at = Stage.NOISE
    formula = "std of a row = density / sqrt(2 x averaging time)"
    story = "White noise of the reading; the mean of a longer average scatters less, by the square root of the time."
    parameters = tuple(Parameter(f"density_{axis}", "g/sqrt(Hz)", 5e-5, (0.0, 0.02)) for axis in AXES)
    confused_with = ("pose_error", "quantisation")
    splitter = "rest at one pose: reading noise falls with the averaging time, the pose error does not"

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        sigma = np.array([std_of_average(density, state.row_seconds) for density in p])
        return sigma[:, None] * rng.standard_normal((3, state.n))


EFFECT = ReadingNoise()

"""Irregular sampling instants."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Parameter, RandomEffect, Stage
from highside.physics.state import ChainState


class SamplingJitter(RandomEffect):
    id = "sampling_jitter"
    title = "Sampling jitter"
    stage = Stage.NOISE
    formula = "sampled at t + N(0, sigma)"
    story = (
        "Each reading is taken a little early or late at random, which looks like noise that grows with the rate of"
        " rotation."
    )
    parameters = (Parameter("sigma", "s", 2e-4, (0.0, 0.1)),)
    confused_with = ("vibration_noise", "reading_noise")
    splitter = "rest against rotation: its noise is across the gravity vector and in proportion to the rate"
    draws_at = Stage.TIMING
    needs = ("rotor_rate_radps",)

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        return p[0] * rng.standard_normal((1, state.n))


EFFECT = SamplingJitter()

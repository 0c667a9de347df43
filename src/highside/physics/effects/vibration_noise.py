"""Noise that grows with vibration."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RandomEffect, Stage
from highside.physics.noise import vibration_modulated
from highside.physics.state import ChainState


class VibrationNoise(RandomEffect):
    id = "vibration_noise"
    title = "Vibration-modulated noise"
    stage = Stage.NOISE
    formula = "standard deviation q_i v_rms"
    story = "Where the tool shakes more, the readings scatter more, without any shift of their mean."
    parameters = tuple(Parameter(f"q_{axis}", "g/g", 1e-3, (0.0, 1.0)) for axis in AXES)
    confused_with = ("vibration_rectification", "sampling_jitter")
    splitter = "long averages: scatter averages out, a rectified offset stays"
    draws_at = Stage.NOISE
    needs = ("vibration_rms_g",)

    def draw(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        return vibration_modulated(state.vibration_rms_g, p, rng)


EFFECT = VibrationNoise()

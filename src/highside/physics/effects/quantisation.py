"""Steps of the converter."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RecordEffect, Stage
from highside.physics.noise import quantised
from highside.physics.state import ChainState


class Quantisation(RecordEffect):
    id = "quantisation"
    title = "Quantisation"
    stage = Stage.DIGITAL
    formula = "round(m_i / lsb_i) lsb_i"
    story = "The converter knows only whole steps, so a reading is rounded to the nearest."
    parameters = tuple(Parameter(f"lsb_{axis}", "g", 6.1e-5, (0.0, 0.05)) for axis in AXES)
    confused_with = ("reading_noise",)
    splitter = "the histogram: a comb of equal spacing"

    def record(self, state: ChainState, p: AnyArray, values: AnyArray, rng: np.random.Generator) -> AnyArray:
        return np.stack([quantised(row, float(step)) for row, step in zip(values, p, strict=True)])


EFFECT = Quantisation()

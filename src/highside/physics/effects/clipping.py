"""Readings beyond the range."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RecordEffect, Stage
from highside.physics.state import ChainState


class Clipping(RecordEffect):
    id = "clipping"
    title = "Clipping"
    stage = Stage.DIGITAL
    formula = "min(max(m_i, -limit_i), limit_i); a limit of 0 stands for none"
    story = "The load goes beyond what the converter can show, and all larger values read the same."
    parameters = tuple(Parameter(f"limit_{axis}", "g", 0.9, (0.0, 1e3)) for axis in AXES)
    confused_with = ("cubic", "quadratic")
    splitter = "the histogram: many readings share the extreme value"

    def record(self, state: ChainState, p: AnyArray, values: AnyArray, rng: np.random.Generator) -> AnyArray:
        limit = np.where(p > 0, p, np.inf)[:, None]
        return np.clip(values, -limit, limit)


EFFECT = Clipping()

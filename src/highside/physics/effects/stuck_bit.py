"""A bit of the converter or of the wire that never changes."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Parameter, RecordEffect, Stage
from highside.physics.state import ChainState


class StuckBit(RecordEffect):
    id = "stuck_bit"
    title = "Stuck bit"
    stage = Stage.DIGITAL
    formula = "bit `bit` of round(m_i / lsb) held at `level`, on the axes whose `stuck` is 1"
    story = "One line of the converter is broken, so one binary digit of the reading always shows the same."
    parameters = (
        *(Parameter(f"stuck_{axis}", "1", 1.0, (0.0, 1.0), integer=True) for axis in AXES),
        Parameter("bit", "1", 4.0, (0.0, 30.0), default=4.0, shape=True, integer=True),
        Parameter("level", "1", 1.0, (0.0, 1.0), default=1.0, shape=True, integer=True),
        Parameter("lsb", "g", 6.1e-5, (1e-9, 0.05), default=6.1e-5, shape=True),
    )
    confused_with = ("quantisation",)
    splitter = "count how often each bit toggles"

    def record(self, state: ChainState, p: AnyArray, values: AnyArray, rng: np.random.Generator) -> AnyArray:
        stuck, mask, lsb = p[:3] > 0.5, 1 << int(p[3]), p[5]
        counts = np.round(values / lsb).astype(np.int64)
        held = np.where(p[4] > 0.5, counts | mask, counts & ~mask)
        return np.where(stuck[:, None], held * lsb, values)


EFFECT = StuckBit()

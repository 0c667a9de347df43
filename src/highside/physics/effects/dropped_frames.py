"""Frames that are lost or come twice."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Parameter, RecordEffect, Stage
from highside.physics.state import ChainState


class DroppedFrames(RecordEffect):
    id = "dropped_frames"
    title = "Dropped and repeated frames"
    stage = Stage.DIGITAL
    formula = "a row is omitted with probability `lost`, repeated with probability `repeated`"
    story = "The link loses some frames and delivers others twice, so the rows are not evenly spaced any more."
    parameters = (Parameter("lost", "1", 0.01, (0.0, 0.5)), Parameter("repeated", "1", 0.005, (0.0, 0.5)))
    confused_with = ("clock_skew",)
    splitter = "the counter of the frames, or the differences of their times"

    def rows(self, state: ChainState, p: AnyArray, rng: np.random.Generator) -> AnyArray:
        lot = rng.random(state.n)
        times = np.where(lot < p[0], 0, np.where(lot < p[0] + p[1], 2, 1))
        return np.repeat(np.arange(state.n), times)


EFFECT = DroppedFrames()

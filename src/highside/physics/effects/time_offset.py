"""Readings stamped too early or too late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import TIMED, Channels, ChannelTerm
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState

LATEST_S = 600.0
"""s; by more than ten minutes two files on one clock are not apart."""


class TimeOffset(LinearEffect):
    id = "time_offset"
    title = "Time offset (synchronisation error)"
    stage = Stage.TIMING
    formula = "all channels sampled at t - t0"
    story = (
        "The readings and the angle they are compared with were not taken at the same instant, so the angle is off "
        "by rate times delay."
    )
    parameters = (Parameter("t0", "s", 5e-3, (-0.5, 0.5)),)
    confused_with = ("bandwidth_lag", "encoder_first_harmonic", "backlash", "coriolis")
    splitter = "two rates and a ramp of the gyro: the delay shows in all channels, the lag only in the accelerometers"
    needs = ("rotor_rate_radps",)
    depends_on_input = False
    channel_story = "The recording and the prediction do not mean the same instant by the same time."
    channel_needs = "the two files are on clocks of their own: aligning them has taken any offset away"

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return np.full((1, 1, state.n), -1.0)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        (delay_s,) = data.about.get(self.id, (0.0,))
        parameter = Parameter("t0", "s", 1e-3, (-LATEST_S, LATEST_S))
        tangent = -data.slope
        whole = (data.at(np.full(data.n, delay_s)) - data.at(np.zeros(data.n))) / delay_s if delay_s else tangent
        # where each file has its own zero of time, the offset is none of the physics
        return [
            ChannelTerm(
                (parameter,),
                (whole[None],),
                (TIMED, 0, 0),
                relinearised=True,
                tangents=tangent[None],
                adjusted=not data.same_clock,
            )
        ]


EFFECT = TimeOffset()

"""Clock that runs fast or slow."""

from __future__ import annotations

from collections.abc import Sequence

from highside.arrays import AnyArray
from highside.physics.channels import TIMED, Channels, ChannelTerm
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState

FASTEST = 0.2
"""Share by which another program's motion may run fast or slow: a length or a stiffness of it that is off."""


class ClockSkew(LinearEffect):
    id = "clock_skew"
    title = "Clock drift"
    stage = Stage.TIMING
    formula = "sampled at t + eps (t - t_start)"
    story = (
        "The tool's clock and the bench's run at slightly different speed, so the mistake in angle grows as the "
        "recording goes on."
    )
    parameters = (Parameter("eps", "1", 5e-5, (-0.01, 0.01)),)
    confused_with = ("bias_drift", "time_offset")
    splitter = "a mark (a stop, a reversal) at the start and at the end"
    needs = ("t_s", "rotor_rate_radps")
    depends_on_input = False
    channel_story = (
        "The phase between the recording and the prediction grows with time: the rate of the clock or of the motion is "
        "off, as by a frequency, a length or a stiffness of the simulation that is not the real one."
    )

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return (state.t_s - state.t_s[:1])[None, None, :]

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        (rate,) = data.about.get(self.id, (0.0,))
        elapsed = data.t_s - data.t_s[:1]
        (delay_s,) = data.about.get("time_offset", (0.0,))
        tangent = -elapsed * data.slope
        whole = (data.at(delay_s + rate * elapsed) - data.at(delay_s + 0 * elapsed)) / rate if rate else tangent
        parameter = Parameter("eps", "1", 1e-4, (-FASTEST, FASTEST))
        return [ChannelTerm((parameter,), (whole[None],), (TIMED, 0, 2), relinearised=True, tangents=tangent[None])]


EFFECT = ClockSkew()

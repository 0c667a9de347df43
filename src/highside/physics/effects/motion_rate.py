"""Motion of a simulation that runs fast or slow."""

from __future__ import annotations

from collections.abc import Sequence

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import Stage


class MotionRate(ChannelEffect):
    """Fitted as `clock_skew` and `gyro_scale`, told where both are of one size (`diagnosis.simulation.constants`)."""

    id = "motion_rate"
    title = "Motion faster or slower than simulated"
    stage = Stage.KINEMATIC
    formula = "s(t - eps (t - t_start)), rates times 1 - eps"
    story = (
        "The motion of the simulation is faster or slower than the real one: a frequency, a length or a stiffness of "
        "it is off. Its courses drift apart from the recorded ones as time goes on, and its rates are off in the same "
        "proportion, which those of a clock would not be."
    )
    confused_with = ("clock_skew",)
    splitter = "a motion of which the frequency is measured by itself"

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # its two parts are fitted, each by itself: that they are of one size is what shows it
        return ()


EFFECT = MotionRate()

"""Error of the gain of a channel that is neither an acceleration nor a rate."""

from __future__ import annotations

from collections.abc import Sequence

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import Stage


class Gain(ChannelEffect):
    id = "gain"
    title = "Scale factor error of a channel"
    stage = Stage.SENSOR
    formula = "k s"
    story = "The channel's gain is off."
    splitter = "repeat with a larger input"

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.gains(*own) for own in data.others()]


EFFECT = Gain()

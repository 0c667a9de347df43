"""Constant error of a channel that is neither an acceleration nor a rate."""

from __future__ import annotations

from collections.abc import Sequence

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import Stage


class ChannelOffset(ChannelEffect):
    id = "offset"
    title = "Zero offset of a channel"
    stage = Stage.SENSOR
    formula = "b"
    story = "The channel has a constant offset."
    splitter = "repeat with the input at zero"
    constant = True

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [data.offsets(*own) for own in data.others()]


EFFECT = ChannelOffset()

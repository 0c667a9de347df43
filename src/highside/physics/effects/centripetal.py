"""Acceleration towards the inside of a curve."""

from __future__ import annotations

from collections.abc import Sequence

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import MOVED, Channels, ChannelTerm
from highside.physics.effect import Parameter, Stage


class Centripetal(ChannelEffect):
    id = "centripetal"
    title = "Centripetal acceleration of travel"
    stage = Stage.KINEMATIC
    formula = "k v w"
    story = "What moves along a curve at the speed v and turns at the rate w is accelerated by v w towards the inside."
    splitter = "the same curve at another speed, and the same speed straight on"
    channel_needs = "the speed (speed_mps) or a rate is not recorded, or no channel is an acceleration of a named axis"

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        axes = data.accel_axes()
        if not axes or not data.rates or data.speed is None:
            return ()
        rows = [
            (c, size * data.speed * data.rates[other], f"k_{data.names[c]}_{other}")
            for c, (axis, size) in axes.items()
            for other in data.rates
            if other != axis
        ]
        parameters = tuple(Parameter(name, "1", 0.1, (-1.5, 1.5)) for _, _, name in rows)
        columns = data.on([(c, function) for c, function, _ in rows])
        return [ChannelTerm(parameters, (columns,), (MOVED, 0, 1))] if rows else []


EFFECT = Centripetal()

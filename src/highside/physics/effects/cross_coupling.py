"""One channel that takes a share of what another measures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import ACROSS, ANY, Channels, ChannelTerm
from highside.physics.effect import Parameter, Stage


class CrossCoupling(ChannelEffect):
    id = "cross_coupling"
    title = "Cross-coupling"
    stage = Stage.SENSOR
    formula = "m s_d"
    story = "The channel also answers to what another channel measures."
    splitter = "move one quantity at a time"

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        own = [term for other in data.others() for term in data.couplings(*other, "1")]
        kinds = data.kinds()
        across = [
            (c, d)
            for kind, members in kinds.items()
            for c in members
            for other, sources in kinds.items()
            if other != kind
            for d in sources
        ]
        if not across:
            return own
        parameters = tuple(
            Parameter(
                f"m_{data.names[c]}_{data.names[d]}",
                f"{data.units[c]}/({data.units[d]})",
                0.01 * float(data.readings[c].std()) / max(float(data.predicted[d].std()), 1e-12),
                ANY,
            )
            for c, d in across
        )
        columns = data.on([(c, data.predicted[d]) for c, d in across])
        if not own:
            return [ChannelTerm(parameters, (columns,), (ACROSS, len(kinds), 0))]
        # between channels of one kind and between kinds it is one effect
        first, *more = own
        both = np.concatenate([first.columns[0], columns])
        return [ChannelTerm((*first.parameters, *parameters), (both,), first.place), *more]


EFFECT = CrossCoupling()

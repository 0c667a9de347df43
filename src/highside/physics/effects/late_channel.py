"""Channels of another program's output that are late, each by a time of its own."""

from __future__ import annotations

from collections.abc import Sequence

from highside.physics.channel_effect import ChannelEffect
from highside.physics.channels import TIMED, Channels, ChannelTerm
from highside.physics.effect import Parameter, Stage

LATEST_S = 0.5
"""s; by how much a channel may be late beside the others of its instrument."""


class LateChannel(ChannelEffect):
    id = "late_channel"
    title = "Delay of single channels"
    stage = Stage.TIMING
    formula = "s(t - t0) on the channel"
    story = (
        "Single channels are late beside the others: they are read one after the other, pass a longer filter, or come "
        "over another line."
    )
    confused_with = ("time_offset", "bandwidth_lag")
    splitter = "faster motion of the same axis: a delay leaves the amplitude, a filter takes of it"

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # what all are late by is the clock's: of one of them it is told
        others = [c for c in range(len(data.names)) if c != data.in_time]
        if not others:
            return []
        later = data.later_s
        rows = []
        for c, own_s in zip(others, data.about.get(self.id, (0.0,) * len(others)), strict=True):
            # to first order where none was found yet; what a delay that was found does, in proportion
            changed = (data.at(later + own_s)[c] - data.at(later)[c]) / own_s if own_s else -data.slope[c]
            rows.append((c, changed))
        parameters = tuple(Parameter(f"t0_{data.names[c]}", "s", 1e-3, (-LATEST_S, LATEST_S)) for c in others)
        kinds = [tuple(k for k, c in enumerate(others) if c in own) for own in data.kinds().values()]
        groups = (*((k,) for k in range(len(others))), *(kind for kind in kinds if len(kind) > 1))
        return [ChannelTerm(parameters, (data.on(rows),), (TIMED, 0, 3), relinearised=True, groups=groups)]


EFFECT = LateChannel()

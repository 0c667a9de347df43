"""Zero offset that jumps once."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

from highside.arrays import AnyArray
from highside.physics.channels import ANY, SLOW, Channels, ChannelTerm
from highside.physics.effect import AXES, Effect, Parameter, Stage, singles
from highside.physics.state import ChainState


class BiasStep(Effect):
    id = "bias_step"
    title = "Step of the zero offset"
    stage = Stage.THERMAL
    formula = "a_i for t >= t0 (seconds since the start), else 0"
    story = (
        "Once during the recording the zero offset jumped and stayed: a shock, a connection, a part that re-seated "
        "itself."
    )
    parameters = (
        *(Parameter(f"a_{axis}", "g", 5e-4, (-0.05, 0.05)) for axis in AXES),
        Parameter("t0", "s", 300.0, (0.0, 1e9), shape=True, epoch=True),
    )
    confused_with: tuple[str, ...] = ("wander", "bias_drift", "turn_on_bias")
    splitter = "return to a reference pose often: a step separates two levels, a random walk has none"
    needs = ("t_s",)
    depends_on_input = False
    groups = singles(3)
    slow = True
    lasting = MappingProxyType({"t0": 0.0})

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        after = state.t_s - state.t_s[:1] >= p[3].real
        return p[:3, None] * after

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # of another program's output the instant is looked for: `about` says which was found
        members = [c for kind, own in data.kinds().items() if self.steps_on(kind) for c in own]
        if self.id not in data.about or not members:
            return []
        risen = data.risen(data.about[self.id][0])
        parameters = tuple(
            Parameter(f"a_{data.names[c]}", data.units[c], max(0.01 * float(data.predicted[c].std()), 1e-9), ANY)
            for c in members
        )
        return [ChannelTerm(parameters, (data.on([(c, risen) for c in members]),), (SLOW, 0, 5))]

    def steps_on(self, kind: str) -> bool:
        """Whether channels of a kind are its own."""
        return kind != "rate"


EFFECT = BiasStep()

"""Line of mains or of other machinery."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import ANY, SLOW, Channels, ChannelTerm
from highside.physics.effect import AXES, Effect, Parameter, Stage, across
from highside.physics.state import ChainState


class Tone(Effect):
    id = "tone"
    title = "Periodic disturbance of fixed frequency"
    stage = Stage.SENSOR
    formula = "c_i cos(2 pi f t) + s_i sin(2 pi f t)"
    story = (
        "A hum of fixed frequency, from the mains or a machine nearby, sits on the readings; a slow recording shows"
        " its alias."
    )
    parameters = (
        *(Parameter(f"c_{axis}", "g", 1e-4, (-0.05, 0.05)) for axis in AXES),
        *(Parameter(f"s_{axis}", "g", 1e-4, (-0.05, 0.05)) for axis in AXES),
        Parameter("f", "Hz", 50.0, (0.0, 1e5), default=50.0, shape=True, grid=(50.0, 60.0), line_over="time"),
    )
    confused_with = ("aliased_vibration", "vibration_rectification")
    splitter = "another rate of rotation: the hum stays where it is"
    needs = ("t_s",)
    depends_on_input = False
    groups = across(6, 3)
    averages_out = "a tone averages out while a pose is held"

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        phase = 2 * np.pi * p[6] * state.t_s
        return p[:3, None] * np.cos(phase) + p[3:6, None] * np.sin(phase)

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # of another program's output any frequency is looked for: `about` says which was found
        if self.id not in data.about:
            return []
        phase = 2 * np.pi * data.about[self.id][0] * (data.t_s - data.t_s[:1])
        waves = (("c", np.cos(phase)), ("s", np.sin(phase)))
        parameters = tuple(
            Parameter(f"{part}_{n}", u, max(0.01 * float(data.predicted[c].std()), 1e-9), ANY)
            for c, (n, u) in enumerate(zip(data.names, data.units, strict=True))
            for part, _ in waves
        )
        columns = data.on([(c, wave) for c in range(len(data.names)) for _, wave in waves])
        groups = tuple((2 * c, 2 * c + 1) for c in range(len(data.names)))
        return [ChannelTerm(parameters, (columns,), (SLOW, 0, 1), groups=groups)]


EFFECT = Tone()

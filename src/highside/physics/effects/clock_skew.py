"""Clock that runs fast or slow."""

from __future__ import annotations

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage
from highside.physics.state import ChainState


class ClockSkew(LinearEffect):
    id = "clock_skew"
    title = "Clock skew"
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

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        return (state.t_s - state.t_s[:1])[None, None, :]


EFFECT = ClockSkew()

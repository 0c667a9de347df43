"""Zero offset that jumps once."""

from __future__ import annotations

from highside.arrays import AnyArray
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

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        after = state.t_s - state.t_s[:1] >= p[3].real
        return p[:3, None] * after


EFFECT = BiasStep()

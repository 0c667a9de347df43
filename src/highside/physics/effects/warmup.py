"""Settling after power-up."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, singles
from highside.physics.state import ChainState


class Warmup(Effect):
    id = "warmup"
    title = "Warm-up"
    stage = Stage.THERMAL
    formula = "a_i exp(-(t - t_start) / tau)"
    story = (
        "After it is switched on the electronics warm up and the zero offsets settle, quickly at first and then "
        "more slowly."
    )
    parameters = (
        *(Parameter(f"a_{axis}", "g", 5e-4, (-0.02, 0.02)) for axis in AXES),
        Parameter(
            "tau",
            "s",
            300.0,
            (5.0, 2e4),
            default=300.0,
            shape=True,
            time_constant=True,
            grid=(30.0, 60.0, 120.0, 240.0, 480.0, 900.0, 1700.0),
        ),
    )
    confused_with: tuple[str, ...] = ("thermal_lag", "wander", "bias_drift", "temperature_bias")
    splitter = "switch off and on again at constant temperature"
    needs = ("t_s",)
    depends_on_input = False
    groups = singles(3)
    slow = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        elapsed = state.t_s - state.t_s[:1]
        return p[:3, None] * np.exp(-elapsed / p[3])

    def restarted(self, p: AnyArray, earlier_s: float) -> tuple[AnyArray, AnyArray]:
        # what has decayed since then was larger
        growth = float(np.exp(earlier_s / p[3]))
        return np.array([growth, growth, growth, 1.0]), np.zeros(4)


EFFECT = Warmup()

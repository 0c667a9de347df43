"""Curved dependence of the zero offset on temperature."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, REFERENCE_TEMP_C, LinearEffect, Parameter, Stage, across, on_own_axis, runs
from highside.physics.state import ChainState


class TemperatureBiasCurvature(LinearEffect):
    id = "temperature_bias_curvature"
    title = "Temperature nonlinearity of the zero offset"
    stage = Stage.THERMAL
    formula = "b2_i (T - 25 C)^2 + b3_i (T - 25 C)^3"
    story = "The zero offset follows the temperature along a curve, not a line."
    parameters = (
        *(Parameter(f"b2_{axis}", "g/C^2", 1e-6, (-3e-5, 3e-5)) for axis in AXES),
        *(Parameter(f"b3_{axis}", "g/C^3", 1e-8, (-5e-7, 5e-7)) for axis in AXES),
    )
    confused_with = ("temperature_bias", "thermal_lag")
    splitter = "at least four temperatures, well apart"
    needs = ("temp_c",)
    depends_on_input = False
    groups = (*runs(6, 3), *across(6, 3))
    slow = True
    next_order_of = "temperature_bias"

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        warm = state.temp_c - REFERENCE_TEMP_C
        return np.concatenate([on_own_axis(np.broadcast_to(warm**k, (3, state.n))) for k in (2, 3)])


EFFECT = TemperatureBiasCurvature()

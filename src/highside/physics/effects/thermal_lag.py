"""Sensor whose temperature runs behind the thermometer."""

from __future__ import annotations

from highside.arrays import AnyArray
from highside.physics.effect import AXES, Effect, Parameter, Stage, singles
from highside.physics.memory import low_pass
from highside.physics.state import ChainState


class ThermalLag(Effect):
    id = "thermal_lag"
    title = "Thermal lag"
    stage = Stage.THERMAL
    formula = "c_i (T_s - T), tau dT_s/dt = T - T_s"
    story = (
        "The sensor warms up later than the thermometer beside it, so its offset belongs to a temperature of some "
        "minutes ago."
    )
    parameters = (
        *(Parameter(f"c_{axis}", "g/C", 1e-4, (-3e-3, 3e-3)) for axis in AXES),
        Parameter(
            "tau",
            "s",
            300.0,
            (10.0, 5e3),
            default=300.0,
            shape=True,
            time_constant=True,
            grid=(60.0, 100.0, 170.0, 300.0, 500.0, 850.0, 1500.0),
        ),
    )
    confused_with = ("warmup", "bias_drift", "thermal_hysteresis", "temperature_bias")
    splitter = "two ramp rates: the loop opens with the rate and closes when it is slow"
    needs = ("t_s", "temp_c")
    remembers = True
    depends_on_input = False
    groups = singles(3)
    slow = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        behind = low_pass(state.t_s, state.temp_c, p[3]) - state.temp_c
        return p[:3, None] * behind


EFFECT = ThermalLag()

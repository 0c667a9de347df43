"""Reading in proportion to the rate of turning, as of a sideways velocity of a rotating tool."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState


class Coriolis(LinearEffect):
    id = "coriolis"
    title = "Offset in proportion to the rate (Coriolis form)"
    stage = Stage.KINEMATIC
    formula = "2 (w x v) / g with v across the tool axis: x: 2 T' v_y, y: -2 T' v_x"
    story = (
        "Across the tool axis a reading is added that is in proportion to the rate and turns over with it, the same at"
        " every toolface. A steady sideways velocity in the tool's own frame would do that (2 w x v), but none lasts: 1"
        " mm/s is 3.6 m in an hour. What is found under this name over more than some seconds is more likely the"
        " current of the drive picked up by the wires. It shows where several rates are recorded."
    )
    parameters = (Parameter("v_x", "m/s", 2e-3, (-0.05, 0.05)), Parameter("v_y", "m/s", 2e-3, (-0.05, 0.05)))
    confused_with = ("lever_arm", "time_offset")
    splitter = "rates of both signs: it follows the rate, the lever arm its square; a wire that picks up: another load"
    needs = ("rotor_rate_radps",)
    depends_on_input = False
    groups = singles(2)

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        # about z the tool turns at -T'
        spin = -state.rotor_rate_radps
        basis = np.zeros((2, 3, state.n))
        basis[0, 1], basis[1, 0] = 2 * spin, -2 * spin
        return basis / state.gravity_mps2


EFFECT = Coriolis()

"""Lost motion of the toolface drive at reversal."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import Effect, Parameter, Stage
from highside.physics.memory import play
from highside.physics.state import ChainState


class Stiction(Effect):
    id = "stiction"
    title = "Lost motion of the toolface drive (play at reversal)"
    stage = Stage.POSE
    formula = "T = play(T_read, w): follows with a slack of w on each side"
    story = (
        "When the drive reverses, the tool stays where it is until the slack is used up, and only then follows. It is"
        " a play, not the jerks of dry friction. It shows at reversals smaller than twice the slack; after larger ones"
        " it is what a backlash of the same size is, and is told as that."
    )
    parameters = (Parameter("w", "rad", 2e-4, (0.0, 0.02)),)
    confused_with = ("backlash", "time_offset")
    splitter = "small reversals: within the slack the tool does not move at all"
    needs = ("direction",)
    depends_on_input = False
    complex_safe = False
    remembers = True

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        delta = np.zeros((3, state.n))
        delta[2] = play(state.tf_rad, p[0]) - state.tf_rad
        return delta


EFFECT = Stiction()

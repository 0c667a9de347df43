"""Offset in proportion to the square of the vibration along each axis."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, runs, singles
from highside.physics.state import ChainState


class AxisVibrationRectification(LinearEffect):
    id = "axis_vibration_rectification"
    title = "Vibration rectification axis by axis"
    stage = Stage.SENSOR
    formula = "sum over j of kv_ij v_j^2, v_j the rms vibration along axis j"
    story = (
        "Vibration leaves a constant behind that depends on the direction in which the tool is shaken, along the"
        " sensitive axis or across it. It shows where the vibration is recorded for each axis (vibration_x_rms_g,"
        " vibration_y_rms_g, vibration_z_rms_g) and changes its direction."
    )
    # as of the total vibration; data sheets of MEMS accelerometers for shock and vibration: 0.1 to 1 mg/g^2
    parameters = tuple(
        Parameter(f"kv_{AXES[i]}{AXES[j]}", "g/g^2", 5e-5, (-5e-3, 5e-3)) for i in range(3) for j in range(3)
    )
    confused_with = ("vibration_rectification", "lever_arm", "tone")
    splitter = "shake the tool along one axis after the other"
    needs = ("vibration_x_rms_g", "vibration_y_rms_g", "vibration_z_rms_g")
    depends_on_input = False
    groups = (*runs(9, 3), (0, 4, 8), *singles(9))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        squares = np.stack([state.vibration_x_rms_g, state.vibration_y_rms_g, state.vibration_z_rms_g]) ** 2
        basis = np.zeros((9, 3, state.n))
        for i in range(3):
            basis[3 * i : 3 * i + 3, i] = squares
        return basis


EFFECT = AxisVibrationRectification()

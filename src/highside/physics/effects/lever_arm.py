"""Triad away from the axis of rotation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import MOVED, Channels, ChannelTerm
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, singles
from highside.physics.state import ChainState

ARM_M = 3.0
"""Longest arm between the point that another program predicts and the sensor."""


class LeverArm(LinearEffect):
    id = "lever_arm"
    title = "Lever arm"
    stage = Stage.KINEMATIC
    formula = "(w x (w x r) + a x r) / g: x: -w^2 r_x + T'' r_y, y: -w^2 r_y - T'' r_x, with w = T'"
    story = (
        "The accelerometers do not sit on the axis of rotation, so turning throws them outward and speeding up "
        "drags them sideways."
    )
    parameters = (Parameter("r_x", "m", 0.01, (-0.2, 0.2)), Parameter("r_y", "m", 0.01, (-0.2, 0.2)))
    confused_with = ("size_effect", "vibration_rectification", "bias", "coriolis")
    splitter = "at least three rates, of both signs, with ramps between them"
    needs = ("rotor_rate_radps",)
    depends_on_input = False
    groups = singles(2)
    channel_story = (
        "The accelerometers do not sit at the point whose motion is predicted, so turning throws them outward and "
        "speeding up drags them sideways."
    )
    channel_needs = "rates (gx_dps, gy_dps, gz_dps) are not recorded, or no channel is an acceleration of a named axis"

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        # the toolface grows clockwise looking down-hole, about -z: the angular acceleration about z is -T''
        square, angular = -(state.rotor_rate_radps**2), -state.rotor_accel_radps2
        basis = np.zeros((2, 3, state.n))
        basis[0, 0], basis[0, 1] = square, angular
        basis[1, 1], basis[1, 0] = square, -angular
        return basis / state.gravity_mps2

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        # here all three rates may be known, and the point of which the motion is predicted may be anywhere
        axes = data.accel_axes()
        if not axes or not data.rates or not data.angular:
            return ()
        nothing = np.zeros(data.n)
        rate = np.stack([data.rates.get(axis, nothing) for axis in AXES])
        angular = np.stack([data.angular.get(axis, nothing) for axis in AXES])
        arms = np.zeros((3, len(data.names), data.n))
        for k in range(3):
            unit = np.zeros((3, 1))
            unit[k] = 1.0
            felt = np.cross(rate, np.cross(rate, unit, axis=0), axis=0) + np.cross(angular, unit, axis=0)
            for c, (axis, size) in axes.items():
                arms[k, c] = size * felt[AXES.index(axis)]
        shown = [k for k in range(3) if np.any(arms[k] != 0)]
        parameters = tuple(Parameter(f"r_{AXES[k]}", "m", 0.01, (-ARM_M, ARM_M)) for k in shown)
        return [ChannelTerm(parameters, (arms[shown],), (MOVED, 0, 0))] if shown else []


EFFECT = LeverArm()

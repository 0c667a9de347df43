"""Sensitive axes of the gyros that are not square."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, pairs, runs, singles
from highside.physics.state import ChainState

PAIRS = [(i, j) for i in range(3) for j in range(3) if i != j]


class GyroMisalignment(LinearEffect):
    id = "gyro_misalignment"
    title = "Misalignment of the gyros"
    stage = Stage.GYRO
    formula = "m_ij w_j"
    story = "The gyros' axes are not square to the tool, so the rotation about one leaks into the others."
    parameters = tuple(Parameter(f"m_{AXES[i]}{AXES[j]}", "rad", 2e-3, (-0.06, 0.06)) for i, j in PAIRS)
    confused_with = ("lever_arm", "mounting")
    splitter = "rotation about each axis in turn; x and y share of a rotation about z"
    groups = (*runs(6, 2), *pairs(runs(6, 2)), *singles(6))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((6, 3, state.n), dtype=x.dtype)
        for k, (i, j) in enumerate(PAIRS):
            basis[k, i] = x[j]
        return basis

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [term for own in data.of_kind("rate") for term in data.couplings(*own, "rad")]


EFFECT = GyroMisalignment()

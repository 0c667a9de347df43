"""Sensitive axes that are not square to each other or to the tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import Channels, ChannelTerm
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, pairs, runs, singles
from highside.physics.state import ChainState

PAIRS = [(i, j) for i in range(3) for j in range(3) if i != j]
ROWS, COLUMNS = (list(indices) for indices in zip(*PAIRS, strict=True))


class Misalignment(LinearEffect):
    id = "misalignment"
    title = "Misalignment"
    stage = Stage.SENSOR
    formula = "m_ij f_j (i the axis that reads, j the axis that leaks in)"
    story = (
        "The sensitive axes are not square to each other or to the tool, so each accelerometer also feels a share "
        "of the others' load."
    )
    parameters = tuple(Parameter(f"m_{AXES[i]}{AXES[j]}", "rad", 3e-3, (-0.06, 0.06)) for i, j in PAIRS)
    confused_with = ("mounting", "base_tilt", "axis_nonorthogonality", "bias")
    splitter = "the symmetric part shows in |a| alone; the antisymmetric part needs a reference of attitude"
    groups = (*runs(6, 2), *pairs(runs(6, 2)), *singles(6))
    calibrated = True

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((6, 3, x.shape[1]), dtype=x.dtype)
        for k, (i, j) in enumerate(PAIRS):
            basis[k, i] = x[j]
        return basis

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.asarray(_matrix(p) @ x)

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.broadcast_to(_matrix(p)[:, :, None], (3, 3, x.shape[1]))

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        return [term for own in data.of_kind("accel") for term in data.couplings(*own, "rad")]


def _matrix(p: AnyArray) -> AnyArray:
    matrix = np.zeros((3, 3), dtype=p.dtype)
    matrix[ROWS, COLUMNS] = p
    return matrix


EFFECT = Misalignment()

"""Products of the loads on two axes (pendulous sensors)."""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, across, pairs, runs
from highside.physics.state import ChainState

PRODUCTS = [(0, 1), (0, 2), (1, 2)]
TERMS = [(i, a, b) for i in range(3) for a, b in PRODUCTS]


class CrossProduct(LinearEffect):
    id = "cross_product"
    title = "Cross-axis nonlinearity (products of two inputs)"
    stage = Stage.SENSOR
    formula = "k_i_xy f_x f_y + k_i_xz f_x f_z + k_i_yz f_y f_z on axis i"
    story = (
        "A load along one axis deflects the pendulum of the sensor, and a load along another then acts on a turned "
        "arm: the error is the product of two loads."
    )
    parameters = tuple(Parameter(f"k_{AXES[i]}_{AXES[a]}{AXES[b]}", "g/g^2", 3e-4, (-5e-3, 5e-3)) for i, a, b in TERMS)
    confused_with = ("sag", "base_tilt", "quadratic")
    splitter = "poses with two axes loaded alike (inclination near 45 deg, toolface near 45 deg), in all signs"
    groups = (*runs(9, 3), *across(9, 3), *pairs(runs(9, 3)))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        basis = np.zeros((9, 3, x.shape[1]), dtype=x.dtype)
        for k, (i, a, b) in enumerate(TERMS):
            basis[k, i] = x[a] * x[b]
        return basis

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.asarray(p.reshape(3, 3) @ np.stack([x[a] * x[b] for a, b in PRODUCTS]))

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        xy, xz, yz = p.reshape(3, 3).T[:, :, None]
        jacobian = np.empty((3, 3, x.shape[1]))
        jacobian[:, 0] = xy * x[1] + xz * x[2]
        jacobian[:, 1] = xy * x[0] + yz * x[2]
        jacobian[:, 2] = xz * x[0] + yz * x[1]
        return jacobian


EFFECT = CrossProduct()

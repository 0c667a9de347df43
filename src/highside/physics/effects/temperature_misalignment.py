"""Sensitive axes that turn as the temperature changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from highside.arrays import AnyArray
from highside.physics.channels import SLOW, Channels, ChannelTerm
from highside.physics.effect import (
    AXES,
    REFERENCE_TEMP_C,
    LinearEffect,
    Parameter,
    Stage,
    runs,
    singles,
)
from highside.physics.state import ChainState

PAIRS = tuple((i, j) for i in range(3) for j in range(3) if i != j)


class TemperatureMisalignment(LinearEffect):
    id = "temperature_misalignment"
    title = "Temperature coefficient of the misalignment"
    stage = Stage.THERMAL
    formula = "mt_ij f_j (T - 25 C)"
    story = (
        "Warm, the mount of a sensor bends: each axis takes a share of the others' load that follows the temperature."
    )
    # 0.2 mrad/C turns an axis by 1 deg over 90 C: more is a mount that has come loose
    parameters = tuple(Parameter(f"mt_{AXES[i]}{AXES[j]}", "rad/C", 1e-5, (-2e-4, 2e-4)) for i, j in PAIRS)
    groups = (*runs(6, 2), *singles(6))
    confused_with = ("misalignment", "temperature_scale")
    splitter = "the same poses at two temperatures"
    needs = ("temp_c",)
    channel_needs = "the temperature (temp_c) is not recorded, or does not change"

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        warm = state.temp_c - REFERENCE_TEMP_C
        basis = np.zeros((6, 3, state.n), dtype=x.dtype)
        for k, (i, j) in enumerate(PAIRS):
            basis[k, i] = warm * x[j]
        return basis

    def on_channels(self, data: Channels) -> Sequence[ChannelTerm]:
        if data.temp_c is None:
            return ()
        warm, terms = data.temp_c - data.temp_c.mean(), []
        for place, members in data.of_kind("accel"):
            both = [(c, d) for c in members for d in members if c != d]
            parameters = tuple(
                Parameter(f"mt_{data.names[c]}_{data.names[d]}", "1/C", 1e-5, (-2e-4, 2e-4)) for c, d in both
            )
            if both:
                columns = data.on([(c, warm * data.predicted[d]) for c, d in both])
                terms.append(ChannelTerm(parameters, (columns,), (SLOW, place, 3)))
        return terms


EFFECT = TemperatureMisalignment()

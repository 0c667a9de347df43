"""The range of a covariate that a mismatch of a rotation needs: inner products of its cells, in a pass of their own.

The search is that of `support`; here the whitened cells are set beside the columns that are fitted anyway. Of a long
recording the rows that places are found by stand for the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.location import TOOLFACE
from highside.diagnosis.core.policy import CHUNKS, PLACES, SUPPORT
from highside.diagnosis.core.support import Cells, Window, cells_of, support
from highside.diagnosis.rotation.policy import ROTATION_SUPPORT
from highside.diagnosis.rows.design import Design
from highside.diagnosis.rows.noise import RotationNoise
from highside.physics.state import ChainState

Ints = NDArray[np.intp]


def rotation_cells(state: ChainState, *, slow: bool) -> list[Cells]:
    """The covariates of a rotation that a mismatch may have a range of; `slow` ones too where no offset follows a
    random walk."""
    found = []
    for covariate, along, count, wanted in (
        (
            TOOLFACE,
            np.mod(np.degrees(state.tf_rad), 360.0),
            ROTATION_SUPPORT.fine_cells,
            float(np.ptp(state.tf_rad)) > 2 * np.pi,
        ),
        ("inc_ref_deg", np.degrees(state.inc_rad), SUPPORT.cells, True),
        ("rotor_rate_dps", np.degrees(state.rotor_rate_radps), SUPPORT.cells, True),
        ("temp_c", state.temp_c, SUPPORT.cells, slow),
        ("vibration_rms_g", state.vibration_rms_g, SUPPORT.cells, slow),
        ("t_s", state.t_s, PLACES.time_cells, slow),
    ):
        if wanted and np.ptp(along) > ROTATION_SUPPORT.varies:
            found.append(cells_of(covariate, along, circular=covariate == TOOLFACE, count=count))
    return found


def windows(
    design: Design,
    noise: RotationNoise,
    residual: Array,
    fitted: Ints,
    cells: Sequence[Cells],
    channels: Sequence[int],
    parts: Sequence[slice],
) -> list[Window]:
    """For each covariate the range that explains a residual (C, N) beside the columns `fitted` of the design."""
    beside = [design.where[fitted, c] for c in channels]
    beside = [np.unique(numbers[numbers >= 0]) for numbers in beside]
    sizes = [numbers.size + sum(one.count for one in cells) + 1 for numbers in beside]
    grams = [np.zeros((size, size)) for size in sizes]
    for whole in parts:
        for start in range(whole.start, whole.stop, CHUNKS.rows):
            part = slice(start, min(start + CHUNKS.rows, whole.stop))
            led = slice(max(0, part.start - noise.lead), part.stop)
            made = design.functions(led, residual)
            indicators = [one.functions(led) for one in cells]
            for k, c in enumerate(channels):
                rows = np.concatenate([made[c][beside[k]], *indicators, made[c][-1:]])
                white = noise.whiten(c, rows, part)
                grams[k] += white @ white.T
    outer = [_outside(gram, numbers.size) for gram, numbers in zip(grams, beside, strict=True)]
    found, at = [], 0
    for one in cells:
        own = slice(at, at + one.count)
        at += one.count
        # the channels of a cell stand beside one another
        gram = np.zeros((one.count, len(channels), one.count, len(channels)))
        moment, size = np.zeros((one.count, len(channels))), np.zeros((one.count, len(channels)))
        for k, (inner, before) in enumerate(outer):
            gram[:, k, :, k], moment[:, k], size[:, k] = inner[own, own], inner[own, -1], before[own]
        total = one.count * len(channels)
        found.append(support(one, gram.reshape(total, total), moment.reshape(-1), size.reshape(-1)))
    return found


def _outside(gram: Array, fitted: int) -> tuple[Array, Array]:
    """Inner products beyond the first `fitted` columns, and the squared lengths of the cells before that."""
    inner, cross, rest = gram[:fitted, :fitted], gram[:fitted, fitted:], gram[fitted:, fitted:]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.pinv(inner / scale[:, None] / scale[None, :], rcond=1e-9, hermitian=True)
    scaled = cross / scale[:, None]
    return rest - scaled.T @ inverse @ scaled, np.diag(rest)[:-1].copy()

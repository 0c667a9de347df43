"""What still readings determine of an effect's parameters where only the magnitude of gravity is known.

A magnitude shows some combinations of the parameters and cannot show others: in one attitude all that acts across
gravity, in any number of attitudes what only turns the reading. The value reported is the smallest explanation. The
interval is all that the readings leave open within what is plausible: the range of a parameter while the combinations
that show stay what they are, wider by their own uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.policy import INTERVALS, REGRESSION
from highside.diagnosis.core.probability import student_quantile
from highside.diagnosis.core.result import FittedParameter
from highside.diagnosis.magnitude.observed import Magnitudes
from highside.diagnosis.magnitude.policy import MAGNITUDE_FITS
from highside.physics.effect import Effect, Parameter
from highside.physics.forward import ForwardModel

Table = dict[str, FittedParameter]


def fitted_columns(
    observed: Magnitudes, model: ForwardModel, candidate: Candidate, table: Table
) -> tuple[Array, Array]:
    """Columns (k, 1, n) of an effect at its fitted shape, and (s, 1, n) what a change of that shape adds."""
    effect = candidate.effect
    assert effect is not None
    shape = {p.name: table[p.name].value for p in effect.parameters if p.shape}
    columns = observed.columns(model, effect, shape)
    amplitude = np.array([table[name].value for name in candidate.amplitudes])
    slopes = []
    for parameter in effect.parameters:
        if parameter.shape and table[parameter.name].std > 0:
            ends = [
                observed.columns(model, effect, {**shape, parameter.name: shape[parameter.name] * factor})
                for factor in (1 / MAGNITUDE_FITS.apart, MAGNITUDE_FITS.apart)
            ]
            slopes.append(np.tensordot(amplitude, ends[1] - ends[0], 1))
    return columns, np.array(slopes).reshape(len(slopes), *columns.shape[1:])


def least(table: Table, candidate: Candidate, columns: Array, shown: Array, freedom: float) -> Table:
    """The fitted parameters as their smallest explanation, with what the readings leave open.

    `columns` (k, N) are those of the amplitudes, whitened, outside of all else that was fitted; `shown` (k, r) are the
    directions in which the amplitudes, in units of their typical sizes, show at all.
    """
    assert candidate.effect is not None
    own = [p for p in candidate.effect.parameters if p.name in candidate.amplitudes]
    sizes = np.array([p.typical for p in own])
    rows = shown.T @ (sizes[:, None] * columns)
    values, vectors = np.linalg.eigh(rows @ rows.T)
    good = values > REGRESSION.visible**2 * values[-1]
    observed = shown @ vectors[:, good]
    estimate = observed @ (observed.T @ (np.array([table[p.name].value for p in own]) / sizes))
    std = sizes * np.sqrt(np.sum(observed**2 / values[good], axis=1))
    half = student_quantile(INTERVALS.upper, freedom) * std
    low, high = _open(own, sizes, observed, estimate)
    return {
        **table,
        **{
            p.name: FittedParameter(
                float(sizes[k] * estimate[k]), float(std[k]), float(low[k] - half[k]), float(high[k] + half[k]), p.unit
            )
            for k, p in enumerate(own)
        },
    }


def _open(own: Sequence[Parameter], sizes: Array, observed: Array, estimate: Array) -> tuple[Array, Array]:
    """Least and largest plausible value (k,) of each parameter, `estimate` kept in the directions `observed` (k, r)."""
    from scipy.optimize import linprog

    values = sizes * estimate
    if observed.shape[0] == observed.shape[1]:
        return values, values
    ends = np.array([values, values])
    bounds = [(p.gate[0] / size, p.gate[1] / size) for p, size in zip(own, sizes, strict=True)]
    for k in range(len(own)):
        for end, sign in enumerate((1.0, -1.0)):
            aim = np.zeros(len(own))
            aim[k] = sign
            found = linprog(aim, A_eq=observed.T, b_eq=observed.T @ estimate, bounds=bounds)
            if found.x is not None:
                ends[end, k] = sizes[k] * found.x[k]
    return ends[0], ends[1]


def from_the_start(table: Table, effect: Effect, delay_s: float) -> Table:
    """Parameters that refer to the first reading, as they are reported: from the recording's first row, `delay_s`
    earlier.

    A warm-up has then been larger; a step comes later after the start.
    """
    factors, later = effect.restarted(np.array([table[p.name].value for p in effect.parameters]), delay_s)
    estimate = dict(table)
    for parameter, factor, more in zip(effect.parameters, factors.tolist(), later.tolist(), strict=True):
        was = table[parameter.name]
        value, low, high = (factor * x + more if more else factor * x for x in (was.value, was.low, was.high))
        estimate[parameter.name] = replace(was, value=value, std=factor * was.std, low=low, high=high)
    return estimate

"""What a fit to a published table says of its instrument: what else it would have shown, and other tables of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import Detectable
from highside.diagnosis.table.chain import Linear, Procedure, Sessions, draw, predict_cells
from highside.diagnosis.table.fit import ErrorTable, Fitted, Option
from highside.diagnosis.table.policy import INSTRUMENT
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel


def detectable(table: ErrorTable, options: Sequence[Option], best: Fitted) -> dict[str, Detectable]:
    """Smallest size of each effect beside the best set, from the slopes at it."""
    mask = table.mask
    cov = best.covariance(table)[np.ix_(mask, mask)]
    result: dict[str, Detectable] = {}
    for option in options:
        effect = all_effects()[option.effect]
        if option.effect in best.effects:
            continue
        fields = [table.base, *(o.field for o in best.options), option.field]
        linear = Linear(table.sessions, table.start, np.concatenate(fields))
        values = np.concatenate([best.values, np.full(len(option.amplitudes), INSTRUMENT.probe)])
        slope = predict_cells(linear, values, best.noise_g, table.draws).slope.reshape(values.size + 1, -1)[:, mask]
        inner = slope @ np.linalg.solve(cov, slope.T) + np.diag(table.precision(len(slope)))
        inverse = np.linalg.inv(inner)
        own = slice(best.values.size, values.size)
        sizes = np.sqrt(INSTRUMENT.evidence_80 * np.diag(inverse)[own]) * option.typical
        parameter = next(p for p in effect.parameters if p.name == option.amplitudes[0])
        size = float(np.median(sizes))
        known = result.get(option.effect)
        if size < parameter.gate[1] and (known is None or size < known.value):
            result[option.effect] = Detectable(size, parameter.unit)
    return result


def instrument(
    model: ForwardModel, base_names: Sequence[str], base_units: Array, fitted: Fitted, terms: Iterable[int]
) -> ForwardModel:
    """The model at what was fitted, with some terms of the set: what predicts other tables of the instrument."""
    if base_names:
        values = fitted.values[: len(base_names)] * base_units
        model = model.set_free(model.get_free(base_names) + values, base_names)
    for k in terms:
        option = fitted.options[k]
        amounts = dict(zip(option.amplitudes, (fitted.values[fitted.own(k)] * option.typical).tolist(), strict=True))
        model = model.with_effects({option.effect: {**amounts, **dict(option.shape)}})
    return model


@dataclass(frozen=True)
class Predicted:
    """Cells (R, 4) in deg that a simulated instrument gives, with their standard deviation by chance."""

    cells: Array
    std: Array


def predict_table(
    inc_deg: Array,
    procedure: Procedure,
    instrument: ForwardModel,
    noise_g: float,
    *,
    noise_log_std: float = 0.0,
    seed: int = 1,
    count: int = INSTRUMENT.draws,
) -> Predicted:
    """What a table of this instrument would say; NaN where the correction has no meaning.

    `noise_log_std` is the standard deviation of the logarithm of the noise, where that is not well known.
    """
    sessions = Sessions.of(np.radians(inc_deg), procedure)
    draws = draw(sessions, instrument, count, seed, noise_g)
    linear = Linear.about(sessions, instrument, np.empty((0, 3, sessions.state.n)))
    predicted = predict_cells(linear, np.empty(0), noise_g, draws)
    mean, std = predicted.cells.mean(axis=0), predicted.cells.std(axis=0, ddof=1)
    mean[sessions.degenerate()] = np.nan
    return Predicted(mean, np.hypot(std, predicted.slope[-1] * noise_g * noise_log_std))

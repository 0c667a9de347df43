"""Which inclination station to measure next, so that two explanations of a published table part.

Each explanation predicts the cells of the new inclination station, with what the table leaves open of its own
parameters; the inclination station where they differ most, in units of that and of chance, is the one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import columns_of
from highside.diagnosis.table.chain import CELLS, Draws, Linear, Sessions, draw, errors_in_common, predict_cells
from highside.diagnosis.table.fit import PEAK, ErrorTable, Fitted
from highside.diagnosis.table.policy import STATION_ADVICE, TABLE_FITS
from highside.physics.effects import all_effects
from highside.physics.forward import ForwardModel


def next_station(
    model: ForwardModel,
    table: ErrorTable,
    base_names: Sequence[str],
    base_units: Array,
    best: Fitted,
    instead: Mapping[str, Fitted],
    seed: int,
) -> str:
    """Words; empty where there is no rival. `instead` are fitted sets by the effect that replaces the claim."""
    if not instead:
        return "none needed: no other effect explains the table as well"
    sessions = Sessions.of(np.radians(np.array(STATION_ADVICE.inclinations_deg)), table.sessions.procedure)
    draws = draw(
        sessions, model, STATION_ADVICE.draws, seed + 2, best.noise_g, own=table.base.shape[0] == len(base_names)
    )
    sin = np.sin(sessions.inc_rad)
    one = np.ones_like(sin)
    spread = np.degrees(np.stack([one, PEAK * one, one / sin, PEAK / sin], axis=1))
    ours, our_cov = _predicted(sessions, model, table, base_names, base_units, best, draws)
    parted = np.full((len(instead), len(STATION_ADVICE.inclinations_deg)), np.inf)
    column = np.zeros((len(instead), len(STATION_ADVICE.inclinations_deg)), dtype=int)
    for k, rival in enumerate(instead.values()):
        theirs, their_cov = _predicted(sessions, model, table, base_names, base_units, rival, draws)
        for r in range(len(STATION_ADVICE.inclinations_deg)):
            chance = np.cov(ours[:, r].T) + np.diag((best.tau_rad * spread[r]) ** 2)
            cov = chance + our_cov[r] + their_cov[r]
            difference = ours[:, r].mean(axis=0) - theirs[:, r].mean(axis=0)
            parted[k, r] = float(difference @ np.linalg.solve(cov, difference))
            column[k, r] = int(np.argmax(np.abs(difference) / np.sqrt(np.diag(cov))))
    parted[:, sessions.degenerate()] = 0.0
    worst = parted.min(axis=0)
    station = int(np.argmax(worst))
    k = int(np.argmin(parted[:, station]))
    if worst[station] < STATION_ADVICE.worth:
        return (
            f"no single inclination station of means and peak-to-peaks separates it from {list(instead)[k]} (best: "
            f"{STATION_ADVICE.inclinations_deg[station]:g} deg, expected chi-square {worst[station]:.1f}): "
            "record the errors by toolface"
        )
    return (
        f"a station at {STATION_ADVICE.inclinations_deg[station]:g} deg inclination: there {CELLS[column[k, station]]} "
        f"separates it from "
        f"{', '.join(instead)} (expected chi-square {worst[station]:.0f})"
    )


def _predicted(
    sessions: Sessions,
    model: ForwardModel,
    table: ErrorTable,
    base_names: Sequence[str],
    base_units: Array,
    fitted: Fitted,
    draws: Draws,
) -> tuple[Array, Array]:
    """Cells (M, R, 4) of the new inclination stations, and the covariance (R, 4, 4) of what is open of the
    parameters."""
    state = sessions.state
    columns = []
    if base_names:
        columns.append(np.asarray(model.jacobian(state, list(base_names)), dtype=float) * base_units[:, None, None])
    columns.append(errors_in_common(sessions, model, table.noise_g or TABLE_FITS.noise_g))
    for option in fitted.options:
        effect = all_effects()[option.effect]
        every = columns_of(model, state, effect, dict(option.shape))
        names = [effect.parameters[k].name for k in effect.amplitudes]
        which = [names.index(name) for name in option.amplitudes]
        columns.append(every[which] * option.typical[:, None, None])
    stacked = np.concatenate(columns) if columns else np.empty((0, 3, state.n))
    linear = Linear.about(sessions, model, stacked)
    predicted = predict_cells(linear, fitted.values, fitted.noise_g, draws)
    mask = table.mask
    cov = fitted.covariance(table)[np.ix_(mask, mask)]
    inner = fitted.jacobian[:-1, mask] @ np.linalg.solve(cov, fitted.jacobian[:-1, mask].T)
    open_values = np.linalg.inv(inner + np.diag(table.precision(len(inner))))
    slope = predicted.slope[:-1]
    return predicted.cells, np.einsum("prc,pq,qrd->rcd", slope, open_values, slope)

"""How large the innovations of a rotating recording are, row by row: with what their size goes along.

With the square of the vibration, of the rate across the gravity vector (sampling jitter), of either alone (errors of
the angles given, what grows with the rate), and slowly with the time. Rows that stand out as impulses count for
nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.rows.policy import ROW_NOISE
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.rows.weights import constant_weight
from highside.long_arrays import by_runs
from highside.physics.gravity import gravity_jacobians
from highside.physics.state import ChainState

SCATTERS = JITTER, SHAKEN, ANGLES, TURNING = range(4)
"""what the size of the innovations may follow: sampling jitter, vibration, errors of the angles given, the rate"""


def scatter_of(
    session: RotationSession, channel: int, parts: list[slice], left: list[Array], polynomial: Array, changes: bool
) -> tuple[tuple[Array, list[Array]], float, tuple[float, float, float], NDArray[np.intp]]:
    """How the size of the innovations goes along: 1 / size of all rows and of the windows' rows, evidence, impulses.

    The size is relative; jitter is given as the ratio of its time scatter to the level of the innovations.
    """
    if not changes:
        every = [np.ones_like(rows) for rows in left]
        return (constant_weight(session, 1.0), every), 0.0, (0.0, 0.0, 0.0), np.empty(0, dtype=np.intp)
    state = session.state
    across, square_rate = _across(state, channel), state.rotor_rate_radps**2
    whole = {
        SHAKEN: state.vibration_rms_g**2,
        JITTER: across * square_rate,
        ANGLES: across,
        TURNING: square_rate,
    }
    rows = np.concatenate(left)
    rows_used = np.concatenate([np.arange(p.start, p.stop) for p in parts])
    lead = polynomial.size - 1
    keep = np.ones(rows.size, dtype=bool)
    keep[:lead] = False
    scale = float(np.median(np.abs(rows[keep])) / INTERVALS.mad)
    wild = keep & (np.abs(rows) > ROW_NOISE.impulse * scale)
    modelled = {k: v[rows_used] for k, v in whole.items() if np.ptp(v) > 0}
    square = np.minimum(rows**2, (ROW_NOISE.impulse * scale) ** 2) / scale**2
    # heavy tails make differences of scatter look surer than they are
    kurtosis = float(np.mean(square[keep] ** 2) / np.mean(square[keep]) ** 2)
    surer = max(kurtosis - 1, 2.0) / 2
    level, chosen, evidence = _followed(square[keep], {k: v[keep] for k, v in modelled.items()}, surer)
    size = sum((w * whole[k] for k, w in chosen.items()), constant_weight(session, level))
    size = size / float(np.mean(size[rows_used]))
    if wild.mean() > ROW_NOISE.max_impulses:
        wild[:] = False
    if JITTER in chosen:
        # what comes and goes with time goes with the rate of a stretch as well: within the turn it must show
        slow = _slowly(session, rows_used, square, keep & ~wild)[rows_used]
        within = _gain_beside(square[keep], slow[keep], modelled[JITTER][keep]) / surer
        evidence[JITTER] = min(evidence[JITTER], max(within, 0.0))
    size = size * _slowly(session, rows_used, square / size[rows_used], keep & ~wild)
    root = 1 / np.sqrt(size)
    strays = rows_used[wild & (np.abs(rows) * root[rows_used] > ROW_NOISE.impulse * scale)]
    nothing = spread(strays, lead, session.n)
    jitter = (0.0, 0.0, 0.0)
    if chosen.get(JITTER, 0.0) > 0 and evidence[JITTER] > 0:
        time = float(np.sqrt(chosen[JITTER])) * scale
        # relative to the level of all innovations, which `scale` and the mean size make up
        mean = scale * float(np.sqrt(np.mean(square[keep])))
        jitter = (evidence[JITTER], time / mean, time / mean / np.sqrt(max(2 * evidence[JITTER], 1.0)))
    part_roots = np.split(root[rows_used] * keep, np.cumsum([p.stop - p.start for p in parts])[:-1])
    return (root, part_roots), evidence[SHAKEN], jitter, nothing


def _followed(square: Array, modelled: dict[int, Array], surer: float) -> tuple[float, dict[int, float], list[float]]:
    """What the squares (n,) of the innovations follow of regressors (n,), chosen one by one: their constant part, the
    weight of each that was chosen, and the evidence of every one; -2 log likelihood counts `surer` times less."""
    chosen: dict[int, float] = {}
    level, evidence = float(square.mean()), [0.0] * len(SCATTERS)
    cost = _deviance(square, np.full(square.size, level))
    for _ in range(len(modelled)):
        tries = {}
        for k in modelled:
            if k not in chosen:
                names = [*chosen, k]
                weights = _variance_fit(square, [modelled[j] for j in names])
                fitted = weights[0] + sum(w * modelled[j] for w, j in zip(weights[1:], names, strict=True))
                tries[k] = (cost - _deviance(square, fitted), names, weights)
        k = max(tries, key=lambda name: tries[name][0])
        gain, names, weights = tries[k]
        if gain / surer < ROW_NOISE.variance_gain:
            break
        evidence[k] = gain / surer
        level, chosen = float(weights[0]), dict(zip(names, weights[1:].tolist(), strict=True))
        cost -= gain
    return level, chosen, evidence


def spread(rows: NDArray[np.intp], lead: int, n: int) -> NDArray[np.intp]:
    """Rows, and those after them that the filter brings them into."""
    return np.unique(np.minimum((rows[:, None] + np.arange(lead + 1)).ravel(), n - 1))


def _across(state: ChainState, channel: int) -> Array:
    """(N,) square of the change of a reading with the toolface, (g/rad)^2."""

    def of(part: slice) -> Array:
        rows = state.rows(part)
        return np.asarray(gravity_jacobians(rows.inc_rad, rows.tf_rad)[1][channel] ** 2, dtype=float)

    if channel >= 3:
        return by_runs(state.t_s, (state.n,), lambda part: np.zeros(part.stop - part.start))
    return by_runs(state.t_s, (state.n,), of)


def _gain_beside(square: Array, slow: Array, regressor: Array) -> float:
    """-2 log likelihood that a regressor of the variance gains beside a size that changes slowly."""
    alone = _variance_fit(square, [slow])
    both = _variance_fit(square, [slow, regressor])
    before = _deviance(square, alone[0] + alone[1] * slow)
    return before - _deviance(square, both[0] + both[1] * slow + both[2] * regressor)


def _deviance(square: Array, variance: Array) -> float:
    return float(np.sum(np.log(variance) + square / variance))


def _variance_fit(square: Array, regressors: list[Array]) -> Array:
    """Weights >= 0 of a constant and regressors whose sum is the variance, by iterated weighted least squares."""
    from scipy.optimize import nnls

    columns = np.stack([np.ones(square.size), *regressors])
    unit = columns.max(axis=1)
    columns = columns / unit[:, None]
    fitted = np.full(square.size, float(square.mean()))
    weights = np.zeros(len(columns))
    for _ in range(ROW_NOISE.variance_turns):
        scaled = columns / fitted
        weights = nnls(scaled @ scaled.T, scaled @ (square / fitted))[0]
        fitted = np.maximum(weights @ columns, ROW_NOISE.least_variance * float(square.mean()))
    return np.asarray(np.maximum(weights / unit, [ROW_NOISE.least_level, *[0.0] * len(regressors)]))


def _slowly(session: RotationSession, rows_used: NDArray[np.intp], square: Array, keep: NDArray[np.bool_]) -> Array:
    """(N,) slow change of the variance, shrunk to 1 as far as chance explains it."""
    if rows_used.size < session.n:
        return constant_weight(session, 1.0)
    width = max(1, round(ROW_NOISE.scale_s / session.step_s))
    count = max(1, session.n // width)
    if count < ROW_NOISE.least_stretches:
        return constant_weight(session, 1.0)
    edges = np.linspace(0, session.n, count + 1).astype(int)
    used = np.add.reduceat(keep.astype(float), edges[:-1])
    means = np.add.reduceat(np.where(keep, square, 0.0), edges[:-1]) / np.maximum(used, 1.0)
    means /= means.mean()
    kurtosis = float(np.mean(square[keep] ** 2) / np.mean(square[keep]) ** 2)
    expected = (kurtosis - 1) / width
    share = max(0.0, 1 - expected / max(float(means.var()), 1e-12))
    if share < ROW_NOISE.slow_share:
        return constant_weight(session, 1.0)
    middle = (edges[1:] + edges[:-1]) / 2
    return np.asarray(np.interp(np.arange(session.n), middle, np.maximum(1 + share * (means - 1), ROW_NOISE.quietest)))

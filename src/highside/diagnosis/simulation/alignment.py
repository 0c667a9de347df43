"""Two programs' or instruments' views of one event brought onto one time base: the lag by cross-correlation.

Each side has its own times, which need not be evenly spaced, may start anywhere, and may have gaps (NaN). Where the
two clocks plainly are one (the spans overlap), a small lag is a finding, not an accident of recording, and is left in
the data. Otherwise the prediction is shifted to where it fits best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.simulation.policy import ALIGNMENT
from highside.errors import InputError


@dataclass(frozen=True, slots=True)
class Alignment:
    """`lag_s`: how much later the recording shows what the prediction shows; `shift_s`: what was added to the
    prediction's times; `correlation` at that lag; `same_clock` whether the times are of one clock."""

    lag_s: float
    shift_s: float
    correlation: float
    same_clock: bool


def align(t_s: Array, measured: Mapping[str, Array], t_sim_s: Array, predicted: Mapping[str, Array]) -> Alignment:
    """Find the lag between channels of the same names. Raises InputError where nothing fits anywhere."""
    span, span_sim = float(np.ptp(t_s)), float(np.ptp(t_sim_s))
    overlap = min(t_s[-1], t_sim_s[-1]) - max(t_s[0], t_sim_s[0])
    same = bool(overlap >= ALIGNMENT.same_clock * min(span, span_sim))
    rate = min(ALIGNMENT.coarse_hz, usual_rate(t_s), usual_rate(t_sim_s))
    names = list(measured)
    grid, grid_sim = (np.arange(t[0], t[-1], 1 / rate) for t in (t_s, t_sim_s))
    x = np.stack([_standard(filled(grid, t_s, measured[n])) for n in names])
    y = np.stack([_standard(filled(grid_sim, t_sim_s, predicted[n])) for n in names])
    lags, correlation = _correlations(x, y)
    start = float(t_s[0] - t_sim_s[0])
    best = int(np.argmax(correlation))
    fine = best + _vertex(correlation, best)
    lag = float(np.interp(fine, np.arange(lags.size), lags)) / rate + start
    value = float(correlation[best])
    if same and (abs(lag) <= ALIGNMENT.own_lag_s or value < ALIGNMENT.alike):
        return Alignment(lag if value >= ALIGNMENT.alike else 0.0, 0.0, value, True)
    if value < ALIGNMENT.alike:
        raise InputError(
            f"resembles the recording nowhere (best correlation {value:.2f})",
            remedy="give both files on one clock, or check names, units and signs of the columns",
        )
    return Alignment(lag, lag, value, False)


def usual_rate(t_s: Array) -> float:
    """Rows per second."""
    return float((t_s.size - 1) / max(float(t_s[-1] - t_s[0]), 1e-9))


def filled(grid: Array, t_s: Array, values: Array) -> Array:
    """Values (N,) at other times, gaps bridged by straight lines."""
    good = ~np.isnan(values)
    return np.asarray(np.interp(grid, t_s[good], values[good]))


def in_gap(grid: Array, t_s: Array, columns: Sequence[Array], longest_s: float) -> NDArray[np.bool_]:
    """Whether times lie where any of the columns (N,) has no value for longer than `longest_s`."""
    lost = np.zeros(grid.size, dtype=bool)
    for values in columns:
        good = t_s[~np.isnan(values)]
        after = np.searchsorted(good, grid)
        inside = (after > 0) & (after < good.size)
        apart = good[np.clip(after, 1, good.size - 1)] - good[np.clip(after, 1, good.size - 1) - 1]
        lost |= ~inside & (grid != good[0]) | (apart > longest_s)
    return lost


def _standard(values: Array) -> Array:
    spread = float(values.std())
    return np.asarray((values - values.mean()) / spread if spread > 0 else np.zeros_like(values))


def _correlations(x: Array, y: Array) -> tuple[Array, Array]:
    """Lags (rows of x minus rows of y) and the correlation of what overlaps there, all channels together."""
    from scipy.signal import correlate, correlation_lags

    n, m = x.shape[1], y.shape[1]
    cross = np.sum([correlate(a, b, mode="full", method="fft") for a, b in zip(x, y, strict=True)], axis=0)
    lags = correlation_lags(n, m, mode="full")
    first, last = np.maximum(lags, 0), np.minimum(n, m + lags)
    energy = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=0))])
    energy_sim = np.concatenate([[0.0], np.cumsum(np.sum(y**2, axis=0))])
    seen = energy[last] - energy[first]
    seen_sim = energy_sim[last - lags] - energy_sim[first - lags]
    enough = last - first >= ALIGNMENT.least_overlap * min(n, m)
    size = np.sqrt(np.maximum(seen * seen_sim, 1e-12))
    return np.asarray(lags, dtype=float), np.where(
        enough, cross / np.maximum(size, ALIGNMENT.nothing * max(float(size.max()), 1e-12)), -1.0
    )


def _vertex(values: Array, k: int) -> float:
    """Where between the rows the top of a parabola through three values lies."""
    if not 0 < k < values.size - 1:
        return 0.0
    before, here, after = values[k - 1 : k + 2]
    bend = before - 2 * here + after
    return float(0.5 * (before - after) / bend) if bend < 0 else 0.0

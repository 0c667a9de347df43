"""Two programs' or instruments' views of one event brought onto one time base: the lag, and the rate of the clock.

Each side has its own times, which need not be evenly spaced, may start anywhere, and may have gaps (NaN). Where the
spans coincide the clock is taken to be one and is kept: a lag is then a finding, not an accident of recording.
Otherwise the prediction is shifted to where it fits best. The recording may also show the same motion faster or slower,
by a clock or a constant of the simulation that is off: no single lag fits then, and the rate is measured first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.simulation.policy import ALIGNMENT
from highside.errors import InputError

Align = Literal["none", "offset", "auto"]
"""Whose clock: "none", both times are of one; "offset", each file has its own zero of time; "auto", by the spans"""


@dataclass(frozen=True, slots=True)
class Alignment:
    """`lag_s`: how much later the recording shows what the prediction shows, at the start where the rates differ;
    `shift_s`: what was added to the prediction's times; `correlation` so aligned; `same_clock` whether the times are of
    one clock; `rate` by how much the lag grows, s per s; `lags_s` that of each channel by itself."""

    lag_s: float
    shift_s: float
    correlation: float
    same_clock: bool
    rate: float = 0.0
    lags_s: tuple[tuple[str, float], ...] = ()

    def later_s(self, t_s: Array) -> Array:
        """(N,) how much later the recording shows what the prediction shows, at these of its times from the first."""
        return np.asarray(self.lag_s + self.rate * (t_s - t_s[:1]))

    def in_time(self, names: Sequence[str]) -> int:
        """Which of the channels tells the clock: that of the middle lag of all."""
        lags = np.array([dict(self.lags_s).get(name, self.lag_s) for name in names])
        return int(np.argsort(lags, kind="stable")[(lags.size - 1) // 2])


def align(
    t_s: Array, measured: Mapping[str, Array], t_sim_s: Array, predicted: Mapping[str, Array], how: Align = "auto"
) -> Alignment:
    """Find the lag between channels of the same names. Raises InputError where nothing fits anywhere."""
    span, span_sim = float(np.ptp(t_s)), float(np.ptp(t_sim_s))
    overlap = min(t_s[-1], t_sim_s[-1]) - max(t_s[0], t_sim_s[0])
    same = how == "none" or (how == "auto" and bool(overlap >= ALIGNMENT.same_clock * min(span, span_sim)))
    hz = min(ALIGNMENT.coarse_hz, usual_rate(t_s), usual_rate(t_sim_s))
    grid, grid_sim = (np.arange(t[0], t[-1], 1 / hz) for t in (t_s, t_sim_s))
    x = np.stack([_standard(filled(grid, t_s, values)) for values in measured.values()])
    y = np.stack([_standard(filled(grid_sim, t_sim_s, predicted[name])) for name in measured])
    start = float(t_s[0] - t_sim_s[0])
    if same:
        # a clock that is kept is off by little: whole periods of a motion that returns are no lag
        within = ALIGNMENT.own_lag * min(span, span_sim)
        lag, value = _nearest(x, y, hz, start, within)
        rate, lag_then, value_then = _rate(x, y, hz, start, within)
        if 1 - value_then < ALIGNMENT.halves * (1 - value):
            return Alignment(lag_then, 0.0, value_then, True, rate)
        if value >= ALIGNMENT.alike:
            lags = _each(x, y, hz, start, lag)
            return Alignment(lag, 0.0, value, True, lags_s=tuple(zip(measured, lags, strict=True)))
    lag, value = _nearest(x, y, hz, start, np.inf)
    if same and (how == "none" or value < ALIGNMENT.alike):
        return Alignment(0.0, 0.0, value, True)
    if value < ALIGNMENT.alike:
        raise InputError(
            f"resembles the recording nowhere (best correlation {value:.2f})",
            remedy='give both on one clock (align="none" keeps it), or check names, units and signs of the columns',
        )
    lags = _each(x, y, hz, start, lag)
    return Alignment(lag, lag, value, False, lags_s=tuple(zip(measured, lags, strict=True)))


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


def _nearest(
    x: Array, y: Array, hz: float, start: float, within_s: float, equal: float = ALIGNMENT.equal
) -> tuple[float, float]:
    """The lag (s) no larger than `within_s` at which x and y (C, N) are most alike, and how alike.

    Both have so many rows per second, and x begins `start` later. Of peaks of equal height the nearest to zero wins.
    """
    rows, correlation = _correlations(x, y)
    lags = rows / hz + start
    correlation = np.where(np.abs(lags) <= within_s, correlation, -1.0)
    best = int(np.argmax(correlation))
    inner = np.zeros(correlation.size, dtype=bool)
    inner[1:-1] = (correlation[1:-1] >= correlation[:-2]) & (correlation[1:-1] >= correlation[2:])
    inner[best] = True
    least = correlation[best] - equal * (1 - correlation[best]) - ALIGNMENT.equal_at_least
    peaks = np.flatnonzero(inner & (correlation >= least))
    chosen = int(peaks[np.argmin(np.abs(lags[peaks]))])
    lag = float(np.interp(chosen + _vertex(correlation, chosen), np.arange(lags.size), lags))
    return lag, float(correlation[chosen])


def _each(x: Array, y: Array, hz: float, start: float, lag_s: float) -> list[float]:
    """The lag (s) of each channel by itself near that of all: by the correlation of derivatives, which no offset and no
    drift moves."""
    found = []
    for a, b in zip(np.diff(x, axis=1), np.diff(y, axis=1), strict=True):
        if not (a.any() and b.any()):
            found.append(lag_s)
            continue
        rows, correlation = _correlations(a[None], b[None])
        near = int(np.argmin(np.abs(rows / hz + start - lag_s)))
        low = max(near - ALIGNMENT.beside, 0)
        top = low + int(np.argmax(correlation[low : near + ALIGNMENT.beside + 1]))
        found.append(float(np.interp(top + _vertex(correlation, top), np.arange(rows.size), rows)) / hz + start)
    return found


def _rate(x: Array, y: Array, hz: float, start: float, within_s: float) -> tuple[float, float, float]:
    """By how much the lag grows (s per s), the lag at the start of both (s), and the correlation so aligned; arguments
    as those of `_nearest`.

    A short stretch leaves the rate open and shows the lag; each stretch twice as long is searched about what the last
    one found, so that no period is lost on the way.
    """
    skipped = int(np.ceil(max(-start, 0.0) * hz))
    at = skipped / hz + start
    rows = int(min(x.shape[1] - skipped, y.shape[1] - at * hz)) - 1
    if rows < ALIGNMENT.least_rows:
        return 0.0, 0.0, -1.0
    x = x[:, skipped : skipped + rows]
    power = np.sum(np.abs(np.fft.rfft(y - y.mean(axis=1, keepdims=True), axis=1)) ** 2, axis=0)
    top = int(np.searchsorted(np.cumsum(power), ALIGNMENT.content * power.sum()))
    band = max(top * hz / y.shape[1], hz / y.shape[1])
    length = min(rows, max(ALIGNMENT.least_rows, round(ALIGNMENT.periods / band * hz)))
    rate, lag, value, finer = 0.0, 0.0, -1.0, ALIGNMENT.finer
    tried = np.arange(-ALIGNMENT.most_rate, ALIGNMENT.most_rate, ALIGNMENT.turn / (length / hz * band))
    while True:
        found = []
        for one in tried:
            # what the prediction shows at a time so much earlier, the longer the more; nothing beyond its end
            times = np.arange(length) / hz * (1 - one) + at
            times = times[times <= (y.shape[1] - 1) / hz]
            warped = np.stack([np.interp(times, np.arange(y.shape[1]) / hz, row) for row in y])
            both = _standard_rows(x[:, : times.size]), _standard_rows(warped)
            found.append((*_nearest(*both, hz, 0.0, within_s, ALIGNMENT.equal_turned), one))
        lag, value, rate = max(found, key=lambda f: f[1])
        if length == rows:
            finer -= 1
        if finer < 0:
            return float(rate), float(lag), float(value)
        length = min(rows, 2 * length)
        step = ALIGNMENT.turn / (length / hz * band) / ALIGNMENT.beside ** (ALIGNMENT.finer - finer)
        tried = rate + step * np.arange(-ALIGNMENT.beside, ALIGNMENT.beside + 1)


def _standard_rows(values: Array) -> Array:
    return np.stack([_standard(row) for row in values])


def _correlations(x: Array, y: Array) -> tuple[Array, Array]:
    """Lags (rows of x minus rows of y) and the correlation of what overlaps there, all channels together."""
    from scipy.signal import correlate, correlation_lags

    n, m = x.shape[1], y.shape[1]
    cross = np.sum([correlate(a, b, mode="full", method="fft") for a, b in zip(x, y, strict=True)], axis=0)
    lags = correlation_lags(n, m, mode="full")
    first, last = np.maximum(lags, 0), np.minimum(n, m + lags)
    energy = np.concatenate([[0.0], np.cumsum(np.sum(x**2, axis=0))])
    energy_sim = np.concatenate([[0.0], np.cumsum(np.sum(y**2, axis=0))])
    own = energy[last] - energy[first]
    own_sim = energy_sim[last - lags] - energy_sim[first - lags]
    enough = last - first >= ALIGNMENT.least_overlap * min(n, m)
    size = np.sqrt(np.maximum(own * own_sim, 1e-12))
    return np.asarray(lags, dtype=float), np.where(
        enough, cross / np.maximum(size, ALIGNMENT.nothing * max(float(size.max()), 1e-12)), -1.0
    )


def _vertex(values: Array, k: int) -> float:
    """Where between the rows the top of a parabola through three values lies."""
    if not 0 < k < values.size - 1:
        return 0.0
    before, here, after = values[k - 1 : k + 2]
    curvature = before - 2 * here + after
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0

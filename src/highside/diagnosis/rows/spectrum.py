"""The strongest line of fixed frequency in rows, by a Fourier transform of what their colour leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rows.policy import SPECTRUM


def strongest_line(rows: Array, places: Array) -> float | None:
    """Frequency, in cycles for a unit of `places` (n,), of the strongest line in rows (C, n) of unit size; None where
    no peak is higher than chance makes it."""
    from scipy.fft import next_fast_len, rfft

    n = int(places[-1]) + 1
    length = next_fast_len(SPECTRUM.padded * n, real=True)
    spectrum = np.abs(rfft(on_grid(flattened(rows), places), length, axis=1)) ** 2
    skip = np.zeros(spectrum.shape[1], dtype=bool)
    # what is slower than a few waves is drift
    skip[: SPECTRUM.slowest * length // n] = True
    peak = highest(spectrum, skip)
    if peak is None:
        return None
    # the frequency between the cells: the best of a fine grid on the row itself
    at, channel = peak
    tries = at / length + np.linspace(-SPECTRUM.about, SPECTRUM.about, SPECTRUM.finer) / n
    return best_frequency(tries, places, rows[channel])


def highest(power: Array, skip: NDArray[np.bool_]) -> tuple[int, int] | None:
    """Cell and strongest channel of the highest peak of spectra (C, cells) above their neighbourhood, if it is
    more than chance gives: each in units of its local level is exponential, so their sum has a gamma distribution."""
    from highside.special import gammainccinv

    ratio = heights(power)
    total = np.where(skip, 0.0, ratio.sum(axis=0))
    at = int(np.argmax(total))
    limit = float(gammainccinv(power.shape[0], SPECTRUM.chance / power.shape[1]))
    return (at, int(np.argmax(ratio[:, at]))) if total[at] > limit else None


def heights(power: Array) -> Array:
    """(C, cells) spectra in units of the mean of their neighbourhood."""
    stretches = np.array_split(power, max(1, power.shape[1] // (SPECTRUM.padded * SPECTRUM.smooth)), axis=1)
    level = np.concatenate(
        [np.broadcast_to(np.median(s, axis=1, keepdims=True), s.shape) for s in stretches], axis=1
    ) / np.log(2)
    return np.asarray(power / np.maximum(level, 1e-30))


def flattened(rows: Array) -> Array:
    """Rows (C, n) less what the row before says of each: the median of a neighbourhood is no level of a steep spectrum,
    and a filter of one term has no notch in which a line would hide."""
    before = np.sum(rows[:, 1:] * rows[:, :-1], axis=1) / np.sum(rows**2, axis=1)
    result = rows.copy()
    result[:, 1:] -= before[:, None] * rows[:, :-1]
    return result


def on_grid(rows: Array, places: Array) -> Array:
    """Rows (C, n) at whole places that rise, 0 at those that are missing."""
    if places[-1] - places[0] + 1 == places.size:
        return rows
    filled = np.zeros((len(rows), int(places[-1] - places[0]) + 1))
    filled[:, (places - places[0]).astype(np.intp)] = rows
    return filled


def best_frequency(tries: Array, places: Array, row: Array) -> float:
    """The frequency (cycles for a unit of `places`), of evenly spaced ones, of a wave in a row (n,)."""
    turned = row * np.exp(-2j * np.pi * tries[0] * places)
    onward = np.exp(-2j * np.pi * (tries[1] - tries[0]) * places)
    power = np.empty(tries.size)
    for k in range(tries.size):
        power[k] = np.abs(turned.sum())
        turned *= onward
    at = int(np.argmax(power))
    if not 0 < at < tries.size - 1:
        return float(tries[at])
    # between the tries, where a parabola through the three highest has its top
    before, here, after = power[at - 1 : at + 2]
    curvature = before - 2 * here + after
    return float(tries[at] + (0.5 * (before - after) / curvature if curvature < 0.0 else 0.0) * (tries[1] - tries[0]))

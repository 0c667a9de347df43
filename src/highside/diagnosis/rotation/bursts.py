"""Something that comes and goes in a rotating recording: a vibration of a while, which no function of the whole shows.

It is looked for in what is left of everything else, whitened: spectra of windows of several lengths, each cell in units
of the level of its neighbourhood in the same window. So neither noise that grows and shrinks nor an error in the colour
of the noise looks like a burst; what is left is exponential, as far as a neighbourhood tells its level, and the highest
of all cells is judged by their number.
Where it begins and ends is where a wave of its frequency fits best.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult, Location
from highside.diagnosis.rotation.policy import BURSTS
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.rows.spectrum import on_grid


@dataclass(frozen=True)
class Burst:
    """From place to place, its frequency in turns a step, the channels, and the probability of chance."""

    start: int
    stop: int
    frequency: float
    channels: tuple[int, ...]
    p: float


def found_burst(rest: Sequence[tuple[slice, Array]], places: Array) -> Burst | None:
    """The clearest burst in runs of rows, with what is left of them whitened (C, n); None where chance does it.

    `places` (N,) are the times of all rows in steps: rows that are missing leave gaps.
    """
    runs = [(int(places[part.start]), on_grid(rows, places[part])) for part, rows in rest]
    cells = 0
    best: tuple[float, int, int, int, float] | None = None
    for k, (_, rows) in enumerate(runs):
        for start, length in _windows(rows.shape[1]):
            power = np.abs(np.fft.rfft(rows[:, start : start + length], axis=1)[:, BURSTS.first_cell : -1]) ** 2
            cells += power.size
            heights = _heights(power)
            at = np.unravel_index(int(np.argmax(heights)), heights.shape)
            if best is None or heights[at] > best[0]:
                best = (float(heights[at]), k, start, length, float(at[1] + BURSTS.first_cell) / length)
    if best is None or best[0] < np.log(cells / BURSTS.chance):
        return None
    height, k, _, length, frequency = best
    first, rows = runs[k]
    start, stop, frequency, energy = _extent(rows, frequency, 1.0 / length)
    channels = np.flatnonzero(energy > max(BURSTS.channel_share * energy.max(), np.log(BURSTS.odds)))
    return Burst(
        first + start,
        first + stop,
        frequency,
        tuple(int(c) for c in channels),
        float(min(1.0, cells * np.exp(-height))),
    )


def _windows(n: int) -> Iterator[tuple[int, int]]:
    for share in BURSTS.shares:
        length = int(share * n)
        if length >= BURSTS.shortest:
            for start in range(0, n - length + 1, length // 2):
                yield start, length


def _heights(power: Array) -> Array:
    """(C, cells) minus the logarithm of the chance that a cell is as high above its neighbourhood.

    Of m cells the median tells the mean power with a variance of 1 / (m ln(2)^2) of its square, as a mean of k = m
    ln(2)^2 cells would: a cell in units of that is beyond h by (1 + h / k)^-k.
    """
    parts = np.array_split(power, max(1, power.shape[1] // BURSTS.neighbours), axis=1)
    found = []
    for part in parts:
        level = np.maximum(np.median(part, axis=1, keepdims=True) / np.log(2), 1e-30)
        known = part.shape[1] * np.log(2) ** 2
        found.append(known * np.log1p(part / level / known))
    return np.concatenate(found, axis=1)


def _extent(rows: Array, frequency: float, width: float) -> tuple[int, int, float, Array]:
    """First row, last row and frequency of the wave that fits best, and its energy on each channel."""
    n = rows.shape[1]
    edges = np.linspace(0, n, BURSTS.grid + 1).astype(int)
    best: tuple[float, int, int, float, Array] | None = None
    for f in frequency + np.linspace(-width, width, BURSTS.finer):
        turned = rows * np.exp(-2j * np.pi * f * np.arange(n))
        sums = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(turned, axis=1)], axis=1)[:, edges]
        span = np.maximum(edges[None, :] - edges[:, None], 1)
        energy = np.abs(sums[:, None, :] - sums[:, :, None]) ** 2 / span
        total = np.triu(energy.sum(axis=0), 1)
        a, b = np.unravel_index(int(np.argmax(total)), total.shape)
        if best is None or total[a, b] > best[0]:
            best = (float(total[a, b]), int(edges[a]), int(edges[b]), float(f), energy[:, a, b])
    assert best is not None
    return best[1], best[2], best[3], best[4]


def with_burst(
    diagnosis: DiagnosisResult, burst: Burst | None, session: RotationSession, channels: Sequence[str]
) -> DiagnosisResult:
    """The diagnosis with a burst reported, where nothing else was found: it has no name.

    Beside names or other remainders it is left to them: what they leave may come and go with the rate.
    """
    if burst is None or diagnosis.verdict != "nothing_left_out":
        return diagnosis
    names = tuple(channels[c] for c in burst.channels)
    t_s, places = session.state.t_s, session.places
    ends = (float(np.interp(burst.start, places, t_s)), float(np.interp(burst.stop - 1, places, t_s)))
    hz = burst.frequency * float(places[-1]) / float(t_s[-1] - t_s[0])
    place = Location(names, "t_s", (ends,), None, 1.0, burst.p)
    words = f"a vibration of {hz:.3g} Hz comes and goes on {', '.join(names)}"
    remainder = replace(diagnosis.remainder, location=(place,), hints=(words, *diagnosis.remainder.hints), p=burst.p)
    return replace(diagnosis, verdict="unknown", location=(place,), remainder=remainder)

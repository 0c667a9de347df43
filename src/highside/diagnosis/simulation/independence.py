"""Is what is left noise of sensors? Three tests that no misfit can raise the floor of.

Noise is learned from what is left, so a small misfit passes for some colour of it. But whatever its colour, noise of a
sensor has no less power at lower frequencies than at higher ones, and each channel has its own. Both are tested on what
a recording leaves beside a prediction, against the nearest noise that there could be:

- the spectrum against the nearest that falls (isotonic regression of the levels of octaves, which are gamma variates):
  the likelihood ratio is a mixture of chi-squares, with the probabilities of the simple order (Robertson, Wright and
  Dykstra, Order Restricted Statistical Inference, 1988, sections 2.3 and 2.4, there for equal weights, which octaves
  have not; their law is as stated, `BandPolicy.ordinates`);
- the spectra of all channels of a kind together: a run of octaves against one below it, by the signed root of the
  likelihood ratio of gamma variates, which is standard normal (Barndorff-Nielsen, Biometrika 73, 1986), averaged over
  the channels. What moves the instrument shows on most of them, and on each alone too little;
- the coherence of two channels against none: of m ordinates it exceeds x by chance with (1 - x)^(m - 1) (Goodman,
  Technometrics 3, 1961).

A motion that is missing in some octave shows where it is above the noise of the octaves below; what falls with
frequency as noise does, and is on one channel, no spectrum tells from noise. And what is small enough is not told
from noise by any test: how large it may be is given by `hidden_motions`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.location import intervals
from highside.diagnosis.core.policy import RIVALS
from highside.diagnosis.core.result import DiagnosisResult, Location
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.simulation.policy import BAND
from highside.diagnosis.simulation.session import unit_of
from highside.physics.channels import kind_of
from highside.special import chdtrc, ndtr, ndtri


@dataclass(frozen=True)
class NoNoise:
    """Channels of which what is left is no noise of theirs alone, the chance of that, and why, in words."""

    channels: tuple[int, ...]
    p: float
    words: str


TESTS = 3
"""that `no_noise` makes of several channels"""
HIDDEN = "hidden_motion"
"""of the noise in `diagnosis.json`: how large a motion may be that would not show"""


@dataclass(frozen=True)
class HiddenMotion:
    """What may move these channels and not show: of each octave its limits, Hz, and the rms in the channels' unit."""

    channels: tuple[str, ...]
    unit: str
    octaves: tuple[tuple[float, float, float], ...]


def no_noise(
    left: Array,
    white: Array | None,
    step_s: float,
    omitted: NDArray[np.bool_] | None,
    channels: Sequence[str],
) -> NoNoise | None:
    """What is left (C, n), and the same whitened (C, n), as that which no noise of sensors does, if it is certain.

    Without the latter it is not asked whether channels depart together.
    """
    kept = np.ones(left.shape[1], dtype=bool) if omitted is None else ~omitted
    rows = np.where(kept, left - left[:, kept].mean(axis=1, keepdims=True), 0.0)
    tests = [_rising(rows, step_s, channels), _moving(rows, step_s, channels)]
    if white is not None:
        whitened = np.where(kept, white - white[:, kept].mean(axis=1, keepdims=True), 0.0)
        tests.append(_shared(whitened, step_s, channels))
    found = [one for one in tests if one is not None]
    best = min(found, key=lambda one: one.p, default=None)
    return best if best is not None and len(found) * best.p < BAND.chance else None


def with_no_noise(
    diagnosis: DiagnosisResult, found: NoNoise | None, left: Array, t_s: Array, channels: Sequence[str]
) -> DiagnosisResult:
    """The diagnosis where what is left (C, n) at times (n,) is no noise: then something was left out."""
    if found is None or diagnosis.verdict != "nothing_left_out":
        return diagnosis
    energy = np.sum(left[list(found.channels)] ** 2, axis=0)
    place = Location(
        tuple(channels[c] for c in found.channels), "t_s", intervals("t_s", t_s, energy), None, 1.0, found.p
    )
    remainder = replace(diagnosis.remainder, location=(place,), p=found.p)
    return hinted(replace(diagnosis, verdict="unknown", location=(place,), remainder=remainder), found.words)


def with_hidden_motions(diagnosis: DiagnosisResult, found: Sequence[HiddenMotion]) -> DiagnosisResult:
    """The diagnosis with how large a motion may be that would not show, where nothing was found."""
    if diagnosis.verdict != "nothing_left_out" or not found:
        return diagnosis
    sizes = [
        {
            "channels": list(one.channels),
            "unit": one.unit,
            "octaves": [{"from_hz": low, "to_hz": high, "rms": rms} for low, high, rms in one.octaves],
        }
        for one in found
    ]
    return replace(diagnosis, noise={**diagnosis.noise, HIDDEN: sizes})


def octaves(rows: Array) -> tuple[NDArray[np.complex128], list[NDArray[np.intp]]] | None:
    """(C, m) the Fourier transform of rows (C, n), and the ordinates of each band, about an octave each; None where
    there are too few."""
    last = (rows.shape[1] - 1) // 2
    edges = [BAND.skipped, BAND.skipped + BAND.ordinates]
    while edges[-1] * 2 < last:
        edges.append(edges[-1] * 2)
    if last - edges[-1] < edges[-1] // 2:
        # half of an octave and less goes to the one below
        edges.pop()
    edges.append(last)
    parts = [np.arange(a, b) for a, b in pairwise(edges)]
    return None if len(parts) < BAND.least_bands else (np.fft.rfft(rows, axis=1), parts)


def _rising(rows: Array, step_s: float, channels: Sequence[str]) -> NoNoise | None:
    """The channel whose spectrum rises the most surely; where all do a little, those together."""
    from scipy.optimize import isotonic_regression

    known = octaves(rows)
    if known is None:
        return None
    waves, parts = known
    count = np.array([part.size for part in parts], dtype=float)
    deviance, words = np.zeros(len(rows)), [""] * len(rows)
    for c, level in enumerate(_levels(waves, parts)):
        if level.max() <= 0.0:
            continue
        falling = isotonic_regression(level, weights=count, increasing=False).x
        deviance[c] = float(2 * np.sum(count * np.log(falling / level))) / _spread(rows[c])
        highest = int(np.argmax(level / falling))
        low, high = (float(k / (rows.shape[1] * step_s)) for k in (parts[highest][0], parts[highest][-1]))
        words[c] = (
            f"{channels[c]} departs more from {low:.2g} to {high:.2g} Hz than at lower frequencies, as noise of a "
            "sensor does not: something moves that the prediction does not have"
        )
    order = _orders(len(parts))
    alone = [float(np.sum(order * _beyond(value, len(parts) - 1))) for value in deviance]
    mixed = order
    for _ in range(len(rows) - 1):
        mixed = np.convolve(mixed, order)
    together = float(np.sum(mixed * _beyond(float(deviance.sum()), len(rows) * (len(parts) - 1))))
    most = int(np.argmax(deviance))
    tests = len(rows) + 1
    if alone[most] <= together:
        return NoNoise((most,), min(1.0, tests * alone[most]), words[most])
    shown = tuple(int(c) for c in np.flatnonzero(deviance > deviance.max() / 2))
    return NoNoise(shown, min(1.0, tests * together), words[most])


def _levels(waves: NDArray[np.complex128], parts: Sequence[NDArray[np.intp]]) -> Array:
    """(C, K) mean power of each band; none is less than rounding."""
    level = np.stack([np.mean(np.abs(waves[:, part]) ** 2, axis=1) for part in parts], axis=1)
    return np.asarray(np.maximum(level, BAND.nothing * level.max(axis=1, keepdims=True)))


def _spread(row: Array) -> float:
    """By how much the power of bands scatters more than that of normal noise: rows (n,) of unequal size make ordinates
    depend on one another."""
    return max(1.0, float(np.mean(row**4) / (3 * np.mean(row**2) ** 2)))


def _kinds(channels: Sequence[str], rows: Array) -> list[list[int]]:
    """The channels (C,) of each kind of which there are several that are not constant."""
    kinds: dict[str, list[int]] = {}
    for c, name in enumerate(channels):
        if np.any(rows[c]):
            kinds.setdefault(kind_of(name, unit_of(name)), []).append(c)
    return [own for own in kinds.values() if len(own) > 1]


def _runs(bands: int) -> list[tuple[int, int, int]]:
    """Runs of bands [i, j) above those [h, i) below them."""
    return [(h, i, j) for h, i, j in combinations(range(bands + 1), 3)]


def _signed_root(ratio: Array, below: float, own: float) -> Array:
    """Signed root of the likelihood ratio of a level over that below it, against one level, of so many ordinates."""
    both = (below + own * ratio) / (below + own)
    deviance = 2 * ((below + own) * np.log(both) - own * np.log(ratio))
    return np.asarray(np.sign(ratio - 1.0) * np.sqrt(np.maximum(deviance, 0.0)))


def _moving(rows: Array, step_s: float, channels: Sequence[str]) -> NoNoise | None:
    """The channels of one kind that together show more in some octaves than below; None where no kind has several."""
    known, kinds = octaves(rows), _kinds(channels, rows)
    if known is None or not kinds:
        return None
    waves, parts = known
    count = np.array([part.size for part in parts], dtype=float)
    total = _levels(waves, parts) * count
    best: tuple[float, list[int], tuple[int, int]] = (-np.inf, kinds[0], (0, len(parts)))
    for own in kinds:
        spread = np.sqrt([_spread(rows[c]) for c in own])
        for h, i, j in _runs(len(parts)):
            below, above = count[h:i].sum(), count[i:j].sum()
            ratio = (total[own, i:j].sum(axis=1) / above) / (total[own, h:i].sum(axis=1) / below)
            z = float(np.sum(_signed_root(ratio, below, above) / spread) / np.sqrt(len(own)))
            best = max(best, (z, own, (i, j)), key=lambda one: one[0])
    z, own, (i, j) = best
    low, high = (float(k / (rows.shape[1] * step_s)) for k in (parts[i][0], parts[j - 1][-1]))
    words = (
        f"{', '.join(channels[c] for c in own)} together depart more from {low:.2g} to {high:.2g} Hz than at lower "
        "frequencies, as noise of sensors does not: something moves that the prediction does not have"
    )
    return NoNoise(tuple(own), min(1.0, len(kinds) * len(_runs(len(parts))) * float(ndtr(-z))), words)


def hidden_motions(
    left: Array, step_s: float, omitted: NDArray[np.bool_] | None, channels: Sequence[str]
) -> tuple[HiddenMotion, ...]:
    """Of each kind of which there are several channels, how large a motion may be that no test would tell from noise.

    In each octave it is the motion, on all channels of the kind, that `no_noise` tells with a probability of 80 % from
    what base and claims leave (C, n).
    """
    from scipy.optimize import isotonic_regression

    kept = np.ones(left.shape[1], dtype=bool) if omitted is None else ~omitted
    rows = np.where(kept, left - left[:, kept].mean(axis=1, keepdims=True), 0.0)
    known, kinds = octaves(rows), _kinds(channels, rows)
    if known is None:
        return ()
    waves, parts = known
    count = np.array([part.size for part in parts], dtype=float)
    level = np.stack([isotonic_regression(one, weights=count, increasing=False).x for one in _levels(waves, parts)])
    tests = TESTS * len(kinds) * len(_runs(len(parts)))
    needed = float(-ndtri(BAND.chance / tests)) + RIVALS.power_80
    found = []
    for own in kinds:
        root = needed * float(np.mean(np.sqrt([_spread(rows[c]) for c in own]))) / np.sqrt(len(own))
        shown = []
        for i, part in enumerate(parts[1:], start=1):
            power = min(_needed_power(level[own], count, h, i, root) for h in range(i))
            low, high = (float(k / (rows.shape[1] * step_s)) for k in (part[0], part[-1]))
            shown.append((low, high, float(np.sqrt(2 * power / (rows.shape[1] * kept.sum())))))
        found.append(HiddenMotion(tuple(channels[c] for c in own), unit_of(channels[own[0]]), tuple(shown)))
    return tuple(found)


def _needed_power(level: Array, count: Array, h: int, i: int, root: float) -> float:
    """Power, summed over the ordinates of band i, beside levels (C, K), whose signed root over bands [h, i) is `root`
    on average."""
    below = float(count[h:i].sum())
    reference = np.sum(level[:, h:i] * count[h:i], axis=1) / below
    least, most = 1.0, 2.0
    while _signed_root(np.array(most), below, count[i]) < root and most < 1 / BAND.nothing:
        most *= 2.0
    for _ in range(BAND.halvings):
        middle = (least + most) / 2
        least, most = (middle, most) if _signed_root(np.array(middle), below, count[i]) < root else (least, middle)
    return float(count[i] * np.mean(most * reference - level[:, i]))


def _shared(white: Array, step_s: float, channels: Sequence[str]) -> NoNoise | None:
    """The two channels that depart together the most surely; rows are whitened (C, n)."""
    known = octaves(white)
    if known is None or len(white) < 2:
        return None
    waves, parts = known
    best: NoNoise | None = None
    pairs = list(combinations(range(len(white)), 2))
    for a, b in pairs:
        power = [np.sum(np.abs(waves[c]) ** 2) for c in (a, b)]
        if min(power) <= 0.0:
            continue
        total, widest = 0.0, (0.0, parts[0])
        for part in parts:
            one, other = waves[a][part], waves[b][part]
            coherence = float(
                np.abs(np.vdot(one, other)) ** 2
                / max(float(np.vdot(one, one).real * np.vdot(other, other).real), 1e-300)
            )
            value = -2 * (part.size - 1) * float(np.log1p(-min(coherence, 1 - BAND.rounding)))
            total += value
            widest = max(widest, (value, part), key=lambda pair: pair[0])
        # where both are strong at the same times more of it is chance
        spread = max(
            1.0, float(np.mean(white[a] ** 2 * white[b] ** 2) / (np.mean(white[a] ** 2) * np.mean(white[b] ** 2)))
        )
        p = min(1.0, len(pairs) * float(chdtrc(2 * len(parts), total / spread)))
        if best is None or p < best.p:
            low, high = (float(k / (white.shape[1] * step_s)) for k in (widest[1][0], widest[1][-1]))
            words = (
                f"{channels[a]} and {channels[b]} depart together, most of all from {low:.2g} to {high:.2g} Hz, as "
                "noise of sensors of their own does not: both show something that the prediction does not have"
            )
            best = NoNoise((a, b), p, words)
    return best


def _beyond(value: float, most: int) -> Array:
    """(most + 1,) the chance of more than a value under chi-square of `most`, ..., 1 and no degrees of freedom."""
    freedom = np.arange(most, -1, -1)
    return np.asarray(np.where(freedom > 0, chdtrc(np.maximum(freedom, 1), value), float(value <= 0.0)))


def _orders(count: int) -> Array:
    """(count,) chance that so many equal levels, 1, 2, ..., are left of the isotonic regression of `count` equal ones:
    Stirling numbers of the first kind over the factorial (Robertson, Wright and Dykstra, 1988, corollary B to theorem
    2.4.2)."""
    found = np.array([1.0])
    for k in range(2, count + 1):
        # z (z + 1) ... (z + k - 1) / k!
        found = (np.append(found * (k - 1), 0.0) + np.insert(found, 0, 0.0)) / k
    return found

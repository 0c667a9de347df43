"""Power that no noise of a sensor has: a spectrum that rises towards higher frequencies within the band compared.

Noise is learned from what is left, so what is missing from the prediction would be taken for its colour. But the noise
of sensors, be it white, forgetful, 1 / f or a random walk, has no less power at lower frequencies than at higher ones.
So the floor of a channel is the least that its spectrum has had up to each frequency, and what stands above that, a
motion or a vibration that the prediction lacks, is a finding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.simulation.policy import BAND


@dataclass(frozen=True)
class Hump:
    """Of a channel what is left and its floor, standard deviations in its unit, and the band that stands out, Hz."""

    channel: str
    unit: str
    left: float
    floor: float
    band_hz: tuple[float, float]

    @property
    def words(self) -> str:
        """The size of it."""
        low, high = self.band_hz
        return (
            f"{self.channel} is left with {self.left:.2g} {self.unit} rms, where noise would leave "
            f"{self.floor:.2g}: something moves that the prediction does not have, from {low:.2g} to "
            f"{high:.2g} Hz"
        )


def humps(
    left: Array, step_s: float, omitted: NDArray[np.bool_] | None, channels: Sequence[str], units: Sequence[str]
) -> tuple[Hump, ...]:
    """The channels of what base and claims leave (C, n) that have such power, the largest ratio first."""
    from scipy.signal import welch

    kept = left if omitted is None else np.where(omitted, 0.0, left)
    length = min(left.shape[1] // BAND.segments, BAND.longest)
    if length < BAND.shortest:
        return ()
    hz, power = welch(kept, fs=1 / step_s, nperseg=length, axis=1)
    # what is removed with the mean of a segment, and its neighbour, is no spectrum
    hz, power = hz[2:], power[:, 2:]
    count = max(1, hz.size // BAND.bands)
    parts = np.array_split(np.arange(hz.size), hz.size // count)
    found = []
    for c, channel in enumerate(power):
        level = np.array([float(channel[part].mean()) for part in parts])
        least = np.minimum.accumulate(level)
        width = np.array([part.size for part in parts])
        whole, floor = float(level @ width), float(least @ width)
        if floor <= 0.0 or whole < BAND.ratio**2 * floor:
            continue
        above = np.flatnonzero(level >= min(BAND.ratio, float(np.max(level / least))) * least)
        size = float(np.std(kept[c]))
        band = (float(hz[parts[above[0]][0]]), float(hz[parts[above[-1]][-1]]))
        found.append((whole / floor, Hump(channels[c], units[c], size, size * float(np.sqrt(floor / whole)), band)))
    return tuple(hump for _, hump in sorted(found, key=lambda one: -one[0]))


def with_humps(diagnosis: DiagnosisResult, found: Sequence[Hump]) -> DiagnosisResult:
    """The diagnosis with what stands out of the noise's spectrum: something is left then, named or not."""
    if not found:
        return diagnosis
    others = ", ".join(hump.channel for hump in found[1:])
    with_hint = hinted(diagnosis, found[0].words + (f" (likewise {others})" if others else ""))
    if diagnosis.verdict == "nothing_left_out":
        return replace(with_hint, verdict="unknown")
    return replace(with_hint, verdict="named_plus") if diagnosis.verdict == "named" else with_hint

"""When, on which channels and how large: a motion that the recording has and the prediction has not.

That what is left is no noise of sensors is found elsewhere (`band`, `independence`, `missing_turn`). Here it is sized,
and the stretch of time is sought in which it is: two levels of power, one within and one outside, against one level,
by their likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.result import DiagnosisResult, Location, Verdict
from highside.diagnosis.core.unexplained import hinted
from highside.diagnosis.simulation.band import humps
from highside.diagnosis.simulation.independence import no_noise
from highside.diagnosis.simulation.policy import MOTION
from highside.diagnosis.simulation.session import SimulationSession


@dataclass(frozen=True)
class MissingMotion:
    """From when to when, seconds, None for throughout; of each channel that shows it what is left there, rms in its
    unit; the chance of it, and what was seen of it, in words."""

    session_s: tuple[float, float]
    stretch_s: tuple[float, float] | None
    rms: tuple[tuple[str, float, str], ...]
    p: float
    seen: tuple[str, ...]

    @property
    def words(self) -> str:
        """What is told of it."""
        sizes = ", ".join(f"{name} {size:.2g} {unit}" for name, size, unit in self.rms)
        if self.stretch_s is None:
            return f"a motion is missing from the prediction, throughout: {sizes} rms are left"
        start, stop = self.stretch_s
        return (
            f"a motion is missing from the prediction, most of it from {start:.4g} to {stop:.4g} s: {sizes} rms are "
            "left there"
        )

    @property
    def place(self) -> Location:
        """Where it is."""
        return Location(
            tuple(name for name, _, _ in self.rms), "t_s", (self.stretch_s or self.session_s,), None, 1.0, self.p
        )


def missing_motion(session: SimulationSession, left: Array, white: Array) -> MissingMotion | None:
    """What is left (C, n), and the same whitened (C, n), as a motion that is missing, if no noise of sensors does
    it."""
    found = humps(left, session.step_s, session.omitted, session.names, session.units)
    departs = no_noise(left, white, session.step_s, session.omitted, session.names)
    if not found and departs is None:
        return None
    own = {session.names.index(hump.channel) for hump in found} | set(departs.channels if departs else ())
    seen = tuple(one.words for one in (*found[:1], *((departs,) if departs else ())))
    return sized(session, left, sorted(own), departs.p if departs else 0.0, seen)


def sized(session: SimulationSession, left: Array, own: Sequence[int], p: float, seen: Sequence[str]) -> MissingMotion:
    """What is left (C, n) on some channels as a motion that is missing."""
    kept = np.ones(session.n, dtype=bool) if session.omitted is None else ~session.omitted
    rows = np.where(kept, left[list(own)], 0.0)
    energy = np.sum(rows**2 / np.maximum(np.mean(rows**2, axis=1, keepdims=True), 1e-300), axis=0)
    within = stretch(energy, kept, len(own))
    t_s, counted = session.state.t_s, kept
    if within is not None:
        counted = kept & (np.arange(session.n) >= within[0]) & (np.arange(session.n) < within[1])
    rms = tuple((session.names[c], float(np.sqrt(np.mean(left[c, counted] ** 2))), session.units[c]) for c in own)
    ends = None if within is None else (float(t_s[within[0]]), float(t_s[within[1] - 1]))
    return MissingMotion((float(t_s[0]), float(t_s[-1])), ends, rms, p, tuple(seen))


def stretch(energy: Array, kept: NDArray[np.bool_], channels: int) -> tuple[int, int] | None:
    """The rows [a, b) between which an energy (n,), the sum of squares of so many channels, is larger than outside;
    None where one level throughout is as good."""
    count = min(MOTION.blocks, energy.size // MOTION.least_rows)
    if count < MOTION.least_blocks:
        return None
    edges = np.arange(count + 1) * energy.size // count
    total = np.concatenate([[0.0], np.cumsum(np.add.reduceat(np.where(kept, energy, 0.0), edges[:-1]))])
    # a row that is low-passed tells half of what one does that is not
    number = np.concatenate([[0.0], np.cumsum(np.add.reduceat(kept.astype(float), edges[:-1]))]) * channels / 2
    start, stop = np.triu_indices(count + 1, 1)
    inside = total[stop] - total[start], number[stop] - number[start]
    outside = total[-1] - inside[0], number[-1] - inside[1]
    level_in, level_out = (np.maximum(e, 1e-300) / np.maximum(m, 1.0) for e, m in (inside, outside))
    level = max(total[-1], 1e-300) / max(float(number[-1]), 1.0)
    gain = 0.5 * (number[-1] * np.log(level) - inside[1] * np.log(level_in) - outside[1] * np.log(level_out))
    gain[(level_in <= level_out) | (outside[1] < 1.0) | (inside[1] < 1.0)] = -np.inf
    best = int(np.argmax(gain))
    return (int(edges[start[best]]), int(edges[stop[best]])) if gain[best] > MOTION.gain else None


def with_missing_motion(diagnosis: DiagnosisResult, found: MissingMotion | None) -> DiagnosisResult:
    """The diagnosis with a motion that is missing in the first place: names and laws stay beside it."""
    if found is None:
        return diagnosis
    for words in reversed((found.words, *found.seen)):
        diagnosis = hinted(diagnosis, words)
    remainder = replace(diagnosis.remainder, location=(found.place,), p=found.p)
    location = (*diagnosis.location, found.place) if diagnosis.claims else (found.place,)
    verdict: Verdict = "named_plus" if diagnosis.claims else "unknown"
    return replace(diagnosis, verdict=verdict, location=location, remainder=remainder)

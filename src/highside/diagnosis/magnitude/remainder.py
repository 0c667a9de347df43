"""What is left of the magnitudes beside how well they repeat: with every refusal its size, with "nothing" its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.candidates import Candidate
from highside.diagnosis.core.floor import Excess, NoiseFloor, excess
from highside.diagnosis.core.policy import REGRESSION
from highside.diagnosis.core.regression import outside, span
from highside.diagnosis.core.result import DiagnosisResult
from highside.diagnosis.core.unexplained import hinted, words_of
from highside.diagnosis.magnitude.policy import MAGNITUDE_NOISE
from highside.diagnosis.magnitude.session import MagnitudeSession
from highside.special import fdtrc

READINGS = "magnitudes of still readings"


def with_what_is_left(
    diagnosis: DiagnosisResult,
    left: Excess,
    session: MagnitudeSession,
    slow: Sequence[Candidate],
    base: Array,
    residual: Array,
) -> DiagnosisResult:
    """A random walk is no explanation of readings that disagree more than they repeat: how much is said.

    `left` is what the base (P, n) leaves of the residual (n,), and `slow` the effects that follow time.
    """
    words = words_of(left, READINGS)
    if diagnosis.verdict == "nothing_left_out":
        by_far = not session.rest and left.ratio > MAGNITUDE_NOISE.resembling
        if diagnosis.remainder.resembles and (left.above(1.0) or by_far):
            # what resembles something and is above the floor is not nothing, whatever its noise
            return hinted(replace(diagnosis, verdict="unknown"), words)
        if session.rest or session.floor is None:
            return diagnosis
        found = slow_beyond(slow, base, residual, session.floor)
        return _with_limit(diagnosis, left, slow) if found is None else _with_slow(diagnosis, words, *found)
    by_hand = not session.rest and diagnosis.verdict in ("wander", "partial", "unknown")
    if not by_hand and not (diagnosis.verdict in ("wander", "partial") and left.above(1.0)):
        return diagnosis
    return hinted(diagnosis, words)


def _with_slow(diagnosis: DiagnosisResult, words: str, near: str, p: float) -> DiagnosisResult:
    hint = f"{words}; {near} would explain more of it than chance makes (p = {p:.1g})"
    remainder = replace(diagnosis.remainder, p=p, resembles=(near,))
    return hinted(replace(diagnosis, verdict="unknown", remainder=remainder), hint)


def _with_limit(diagnosis: DiagnosisResult, left: Excess, slow: Sequence[Candidate]) -> DiagnosisResult:
    """Nothing, down to what would have shown."""
    sizes = {c.id: diagnosis.minimum_detectable[c.id] for c in slow if c.id in diagnosis.minimum_detectable}
    shown = [f"{name} {size.value:.2g} {size.unit}" for name, size in sizes.items()]
    if not shown:
        return diagnosis
    words = f"readings repeat to {left.floor:.2g} g: what follows time and is smaller than this does not show here"
    return hinted(diagnosis, f"{words}: {', '.join(shown)}")


def slow_beyond(slow: Sequence[Candidate], base: Array, residual: Array, floor: NoiseFloor) -> tuple[str, float] | None:
    """Of slow effects that which explains most of a residual (n,) beside a base (P, n), and the probability that
    readings which scatter as they repeat show as much of any; None where that is no small one.

    How large the scatter is need not be learned from few readings, and chance of a few columns is smaller by far than
    that of all readings together.
    """
    sigma = floor.sigma[0]
    space = span(base / sigma)
    left = outside(space, residual / sigma)
    freedom = residual.size - len(space)
    best: tuple[str, float] | None = None
    tries = sum(len(candidate.variants) for candidate in slow)
    for candidate in slow:
        for variant in candidate.variants:
            own = span(outside(space, variant.columns[:, 0] / sigma), tolerance=REGRESSION.visible)
            if not 0 < len(own) < freedom:
                continue
            square = float(np.sum((own @ left) ** 2)) / len(own)
            p = min(1.0, tries * float(fdtrc(len(own), floor.freedom, square)))
            if best is None or p < best[1]:
                best = (candidate.id, p)
    return best if best is not None and best[1] < MAGNITUDE_NOISE.slow_chance else None


def levels_differ(session: MagnitudeSession, free: Sequence[str], ratio: float) -> str:
    """Of a rest in a few attitudes, in words, what the free parameters have taken up between them; else nothing.

    A jump that also turns the reading a little is one attitude more, and offset and scale fit any level in it.
    """
    if session.floor is None or not free or not np.any(session.group):
        return ""
    size = np.linalg.norm(session.mean, axis=0)
    found = excess((size - size.mean())[None], np.ones((1, 1, session.n)), session.floor)
    if not found.above(ratio):
        return ""
    return (
        f"the magnitude differs by {1e3 * float(np.ptp(size)):.3g} mg between the {int(session.group.max()) + 1} "
        f"attitudes of this rest, and {', '.join(free)}, which may be refitted, take up any such difference"
    )

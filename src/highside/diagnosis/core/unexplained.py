"""Scatter above the noise floor is a finding: what a verdict says where neither floor nor identified noise explains it.

Noise that is serially correlated was identified by its spectrum (`serial_correlation`), errors of the set angles by
leaving the magnitude alone (`Problem.floor_excess`). What is beyond these and the floor may be an effect that nothing
here resembles: then the recording is not explained, however quiet the scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.floor import Excess
from highside.diagnosis.core.memory import Memory
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.result import DiagnosisResult, Fit

TAKEN_FOR_NOISE = "what is left is taken for noise"
"""how a hint begins that says what noise was learned from what is left"""


def unexplained(found: Excess | None, memories: Sequence[Memory]) -> Excess | None:
    """The excess over the floor that chance does not make, unless noise with a spectrum of its own was identified."""
    if found is None or not found.above(FLOOR.ratio):
        return None
    return None if any(m.gain > MEMORY.found for m in memories) else found


def with_lattice(diagnosis: DiagnosisResult, steps: Array, left: Array, channels: Sequence[str]) -> DiagnosisResult:
    """The diagnosis where all that is left (C,) is smaller than half a step (C,) of the converter: rounding is a
    function of the reading, which a scan cannot distinguish from a small effect."""
    coarse = left < FLOOR.dither * steps
    if diagnosis.verdict not in ("unknown", "partial", "wander") or not np.any(coarse):
        return diagnosis
    if not {name for place in diagnosis.location for name in place.channels} <= {
        name for name, small in zip(channels, coarse, strict=True) if small
    }:
        return diagnosis
    sizes = ", ".join(
        f"{name} {size:.2g} of {step:.2g}"
        for name, size, step, small in zip(channels, left, steps, coarse, strict=True)
        if small
    )
    words = f"what is left of a reading is below half a step of the converter ({sizes}): rounding explains it"
    remainder = replace(diagnosis.remainder, location=(), hints=(words,), resembles=())
    return replace(diagnosis, verdict="nothing_left_out", location=(), remainder=remainder)


def in_ug(size_g: float) -> str:
    """A misfit in g, in words: three digits, and no exponent below 1 g."""
    return f"{float(f'{1e6 * size_g:.3g}'):g} ug"


def unimproved(fit: Fit | None) -> Fit | None:
    """The figures of a fit whose names were withdrawn: nothing improves."""
    if fit is None:
        return None
    return replace(
        fit,
        rmse_after=fit.rmse_before,
        heldout_rmse_after=fit.heldout_rmse_before,
        heldout_gain_low=None,
        heldout_gain_high=None,
    )


def words_of(found: Excess, readings: str) -> str:
    """The size of an excess in words."""
    return (
        f"{readings} disagree {found.ratio:.1f} times more than they repeat "
        f"({in_ug(found.left)} against {in_ug(found.floor)})"
    )


def hinted(diagnosis: DiagnosisResult, words: str) -> DiagnosisResult:
    """The diagnosis with a hint that stands before the others."""
    hints = (words, *(hint for hint in diagnosis.remainder.hints if hint != words))
    return replace(diagnosis, remainder=replace(diagnosis.remainder, hints=hints))


def with_excess(diagnosis: DiagnosisResult, found: Excess | None, readings: str, ratio: float) -> DiagnosisResult:
    """The diagnosis with scatter above the floor reported; from a factor of `ratio` on something is left, named or
    not."""
    if found is None or diagnosis.verdict not in ("nothing_left_out", "named", "named_plus"):
        return diagnosis
    if not found.above(ratio):
        hints = (*diagnosis.remainder.hints, words_of(found, readings))
        return replace(diagnosis, remainder=replace(diagnosis.remainder, hints=hints))
    remainder = replace(diagnosis.remainder, hints=(words_of(found, readings), *diagnosis.remainder.hints), p=found.p)
    if diagnosis.verdict == "nothing_left_out":
        return replace(diagnosis, verdict="unknown", remainder=remainder)
    return replace(diagnosis, verdict="named_plus", remainder=remainder)

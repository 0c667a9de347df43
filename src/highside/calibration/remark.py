"""What the user of a calibration must know: remarks, each with its reason, and refusals."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from highside.errors import Refused


class Reason(StrEnum):
    """Why a calibration is refused, or what its user must know. The text is for the person at the bench."""

    NEAR_HORIZONTAL = "near_horizontal"
    """balance at 90 deg: the third row of W vanishes"""
    SINGULAR = "singular"
    """the poses do not determine the matrix"""
    TOO_FEW_POSES = "too_few_poses"
    NOT_FOUR_QUADRANTS = "not_four_quadrants"
    CLOSURE = "closure"
    """the four readings of an inclination contradict one another"""
    BAD_POSE = "bad_pose"
    """a reading that the others do not predict; rejected"""
    SWAPPED_POSES = "swapped_poses"
    UNOBSERVABLE = "unobservable"
    """quantities that the poses cannot separate"""
    OFFSET_NOT_OBSERVABLE = "offset_not_observable"
    TOO_MANY_BAD = "too_many_bad"
    NOT_NOMINAL = "not_nominal"
    """axes, signs or units confused"""
    TEMPERATURE_HYSTERESIS = "temperature_hysteresis"
    TEMPERATURE_SPAN = "temperature_span"
    NOISE_ASSUMED = "noise_assumed"
    BENCH_SCATTER = "bench_scatter"
    """the bench repeats worse than it was said to"""
    MISFIT = "misfit"
    """scatter that neither reading noise nor bench explains"""
    GAUGE = "gauge"
    """what a calibration without reference attitude leaves open"""


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing the user must know. `poses` names the poses it speaks of; `refused`: a part of the input was refused,
    so that a command that writes the result ends with exit status 1 all the same."""

    reason: Reason
    text: str
    poses: tuple[str, ...] = ()
    refused: bool = False


class CalibrationRefused(Refused):
    """The poses were read and understood, and no calibration follows from them. `remark` says why and what to do."""

    def __init__(self, reason: Reason, text: str, poses: tuple[str, ...] = ()) -> None:
        self.remark = Remark(reason, text, poses)
        super().__init__(text)
        self.code = f"calibration.{reason.value}"

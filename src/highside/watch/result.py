"""The answer of the watch, in the form of `watch.json` (schema `highside.watch/1`). Units stand beside each number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from highside.arrays import Array
from highside.watch.parameters import CALIBRATION

SCHEMA = "highside.watch/1"
Verdict = Literal["learning", "holds", "departs"]


@dataclass(frozen=True, slots=True)
class Deviation:
    """One parameter: how far it is from the calibration in force, and how well that is known."""

    value: float
    std: float
    unit: str
    stated_std: float
    """before the first measurement"""
    observable: bool
    """whether the hole has told most of what is known of it"""


@dataclass(frozen=True, slots=True)
class AttitudeError:
    """What something does to inclination and toolface at the present attitude, deg. `tf_sin_inc_deg`: of toolface times
    the sine of the inclination, which stays finite where the hole is vertical; `tf_deg` None there."""

    inc_deg: float
    tf_sin_inc_deg: float
    tf_deg: float | None


@dataclass(frozen=True, slots=True)
class Size:
    """A size with its standard deviation and 95 % interval."""

    value: float
    std: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True)
class WatchClaim:
    """A departure. The claim is the class: what the hole cannot tell apart; `parameter` is the likeliest of it."""

    effect: str
    """of the library of effects, of the likeliest"""
    parameter: str
    parameters: dict[str, Size]
    """of each of the class its size, if it is what happened; the likeliest first"""
    equivalence_class: tuple[str, ...]
    since_s: float
    since_low_s: float
    since_high_s: float
    """the onsets that explain it about as well"""
    alarm_s: float
    """when it was first said"""
    evidence: float | None
    """twice the log-likelihood ratio against no departure; None where the length of the readings says it alone"""
    error: AttitudeError | None
    """None where it cannot be said: an axis is dead, stuck or saturated"""


@dataclass(frozen=True, slots=True)
class TakenBack:
    """A departure that was said at `alarm_s`, and at `at_s` not any more: what came in between spoke against it."""

    alarm_s: float
    at_s: float


@dataclass(frozen=True, slots=True)
class NoiseChange:
    """An axis whose readings at rest scatter otherwise than before. Nothing of the calibration departs by it."""

    axis: Literal["x", "y", "z"]
    effect: str
    """of the library of effects"""
    of: str
    """what scatters: single readings, or means of two seconds"""
    factor: float
    """of the scatter to that of before; below one: less"""
    scatter_g: float
    """now, one standard deviation"""
    since_s: float
    """the first rest that shows it"""
    rests: int
    """that show it"""


@dataclass(frozen=True, slots=True)
class NotObservable:
    """What the hole has not shown so far, and what it would take."""

    parameter: str
    why: str


@dataclass(frozen=True, slots=True)
class Counts:
    """What was used, and what was not."""

    stills: int
    turns: int
    left_out: dict[str, int]
    """by reason"""


@dataclass(frozen=True)
class Trace:
    """For a picture, not in the JSON: after each measurement (K,) its time, (K, 12) deviations and their standard
    deviations, inclination in deg, the largest evidence."""

    t_s: Array
    value: Array
    std: Array
    inclination_deg: Array
    evidence: Array

    @classmethod
    def of(cls, rows: Sequence[tuple[float, Array, Array, float, float]]) -> Trace:
        """From its rows."""
        t, value, std, inclination, evidence = zip(*rows, strict=True) if rows else ((),) * 5
        shape = (len(t), CALIBRATION)
        return cls(
            np.array(t, dtype=float),
            np.array(value, dtype=float).reshape(shape),
            np.array(std, dtype=float).reshape(shape),
            np.array(inclination, dtype=float),
            np.array(evidence, dtype=float),
        )


@dataclass(frozen=True)
class WatchResult:
    """What is said now."""

    verdict: Verdict
    claims: tuple[WatchClaim, ...]
    parameters: dict[str, Deviation]
    not_observable: tuple[NotObservable, ...]
    advice: tuple[str, ...]
    cal_id: str
    inclination_deg: float | None
    toolface_deg: float | None
    measured_s: float | None
    """the last measurement that was used, to which all that is said belongs; None: there was none"""
    age_s: float
    """since then"""
    stale: bool
    """it is so old that nothing is said to hold by it"""
    still_unseen: AttitudeError | None
    """three standard deviations of what the hole alone says of the present attitude, but for `never_seen`"""
    never_seen: AttitudeError | None
    """three standard deviations of what no hole shows: of the antisymmetric part of S, as record and class state it"""
    stated: AttitudeError | None
    """one standard deviation of the record at the present attitude"""
    taken_back: TakenBack | None
    """the last departure that later measurements spoke against"""
    noise_grown: bool
    noise_ratio: float
    """of the innovations' standard deviation to the stated one"""
    undecided: int
    """the last measurements, where they scatter so much that the next ones must tell whether noise has grown or
    something departs; 0: none"""
    noise_changes: tuple[NoiseChange, ...]
    """by axis; empty where none has changed, or no rest of rows was seen"""
    threshold: float
    duration_s: float
    counts: Counts
    covariance: Array
    """(12, 12) of the calibration's parameters as they stand in `parameters`: g^2, g and none, row by row"""
    departure: Array
    """(12,) what the likeliest departure says of them now; zero where none is said. Not in the JSON"""
    trace: Trace

    def to_dict(self) -> dict[str, Any]:
        """What goes into `watch.json`."""
        inside = {"trace", "departure"}
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in inside}
        return {"schema": SCHEMA, **{name: _plain(value) for name, value in plain.items()}}


def _plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return {key: _plain(item) for key, item in asdict(value).items()}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value

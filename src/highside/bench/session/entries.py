"""What is written down while a session goes on: one class an event, in the order of a session's life.

`ledger` is their sum, `journal` their lines. Readings are raw: what the codec gave, no calibration applied; means are
exact sums (`math.fsum`), the same whether they have just been measured or were read from a file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from highside.bench.session.reasons import Rejection


@dataclass(frozen=True)
class HoldReadings:
    """The raw readings of one hold: `a` three lists of equal length in nominal g, device time of first and last."""

    a: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    t_start_s: float
    t_stop_s: float
    temp_c: float | None
    """mean over the hold"""
    std_error_g: tuple[float, float, float]
    """of the mean, coloured noise in it, as judged when it was taken"""

    @property
    def n(self) -> int:
        return len(self.a[0])

    def mean(self) -> tuple[float, float, float]:
        return self._mean

    def std(self) -> tuple[float, float, float]:
        """Standard deviation of one reading about the mean, each axis."""
        return self._std

    @cached_property
    def _mean(self) -> tuple[float, float, float]:
        x, y, z = (math.fsum(row) / len(row) for row in self.a)
        return x, y, z

    @cached_property
    def _std(self) -> tuple[float, float, float]:
        if self.n < 2:
            return 0.0, 0.0, 0.0
        out = [
            math.sqrt(math.fsum((v - m) * (v - m) for v in row) / (self.n - 1))
            for row, m in zip(self.a, self._mean, strict=True)
        ]
        return out[0], out[1], out[2]

    def independent(self) -> float:
        """How many independent readings would give this standard error (worst axis), at most `n`."""
        ratios = [(s / e) ** 2 for s, e in zip(self.std(), self.std_error_g, strict=True) if e > 0]
        return max(1.0, min([float(self.n), *ratios]))


@dataclass(frozen=True, slots=True)
class Began:
    """`holder`: what proves who holds the session from now on (`commands.holder_of`); None: the name alone."""

    operator: str
    holder: str | None = None


@dataclass(frozen=True, slots=True)
class TakenPose:
    """A pose was accepted. `inc_deg`, `tf_deg` are the plan's settings (None where poses are found by themselves)."""

    pose: str
    readings: HoldReadings
    sigmas: float | None
    inc_deg: float | None = None
    tf_deg: float | None = None
    stage: int = 0
    note: str = ""


@dataclass(frozen=True, slots=True)
class RefusedHold:
    """A pose was measured and not accepted. What contradicted others is kept with its readings."""

    pose: str | None
    reason: Rejection
    detail: str = ""
    readings: HoldReadings | None = None
    sigmas: float | None = None


@dataclass(frozen=True, slots=True)
class Skipped:
    pose: str
    operator: str


@dataclass(frozen=True, slots=True)
class Reopened:
    """A pose is to be measured again: by an operator, or because the solution calls for it."""

    pose: str
    reason: Rejection
    detail: str = ""
    operator: str | None = None


@dataclass(frozen=True, slots=True)
class Undone:
    operator: str


@dataclass(frozen=True, slots=True)
class StageReady:
    stage: int
    temp_c: float | None


@dataclass(frozen=True, slots=True)
class PlanClosed:
    """A plan of no fixed length is complete."""

    operator: str | None


@dataclass(frozen=True, slots=True)
class Paused:
    operator: str


@dataclass(frozen=True, slots=True)
class Resumed:
    """`operator` holds the session from now on. None: the process was started again, nobody has spoken yet.
    `holder` as in `Began`."""

    operator: str | None
    holder: str | None = None


@dataclass(frozen=True, slots=True)
class Noted:
    """Something for the reader of the journal that decides nothing: a fault, a clock step."""

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class Photographed:
    """A photograph was kept beside the journal, in a file named by its SHA-256 (64 hexadecimal digits); it decides
    nothing. `width`, `height` in points."""

    operator: str
    text: str
    sha256: str
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Ended:
    """`how`: accepted, rejected, aborted. `record` the id of the record that follows from this journal."""

    how: str
    operator: str
    t_wall_s: float
    record: str | None = None
    note: str = ""
    verdict: str | None = None
    """of a session that judges an existing calibration"""
    turntable: str | None = None
    """id of the fit of the bench's turntable"""


@dataclass(frozen=True, slots=True)
class PutInForce:
    """The store was changed, after the end: `record` is in force from then on. `how`: activate, rollback."""

    how: str
    record: str
    operator: str


Entry = (
    Began
    | TakenPose
    | RefusedHold
    | Skipped
    | Reopened
    | Undone
    | StageReady
    | PlanClosed
    | Paused
    | Resumed
    | Noted
    | Photographed
    | Ended
    | PutInForce
)

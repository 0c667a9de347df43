"""The answer of a diagnosis, in the form of `diagnosis.json` (schema `highside.diagnosis/1`).

Plain values: `Diagnosis.to_dict` gives what `json.dumps` takes. Units are the library's (g, rad, s, m, C) and stand
beside each parameter.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

SCHEMA = "highside.diagnosis/1"

Verdict = Literal[
    "nothing_left_out",
    "named",
    "named_plus",
    "partial",
    "unknown",
    "wander",
    "implausible_fit",
    "not_testable",
    "bad_data",
]


@dataclass(frozen=True, slots=True)
class Location:
    """Where the mismatch sits: channels, the covariate it follows, and where along that covariate it is large."""

    channels: tuple[str, ...]
    covariate: str
    intervals: tuple[tuple[float, float], ...]
    harmonic: int | None
    share_of_misfit: float
    p: float


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A parameter with its standard deviation and 95 % interval."""

    value: float
    std: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True, slots=True)
class Rival:
    """Another explanation that the data speak against."""

    effect: str
    delta_bic: float


@dataclass(frozen=True, slots=True)
class Claim:
    """An effect that was left out of the model, and what it cannot be told apart from in this recording."""

    effect: str
    story: str
    formula: str
    stage: str
    parameters: dict[str, FittedParameter]
    p_familywise: float
    equivalence_class: tuple[str, ...]
    rivals_ruled_out: tuple[Rival, ...]
    next_manoeuvre: str


@dataclass(frozen=True, slots=True)
class Fit:
    """How much the claims improve the fit; `heldout` figures are of blocks that the fit had not seen."""

    unit: str
    rmse_before: float
    rmse_after: float
    heldout_rmse_before: float | None
    heldout_rmse_after: float | None
    heldout_gain_low: float | None
    heldout_gain_high: float | None
    noise_floor: float
    how_held_out: str
    row_noise: float | None = None
    """of one row, as `rmse_before` and `rmse_after` are, where `noise_floor` is that of the held-out means"""


@dataclass(frozen=True, slots=True)
class Finding:
    """A fault of the data themselves."""

    check: str
    channels: tuple[str, ...]
    p: float
    remedy: str


@dataclass(frozen=True, slots=True)
class Remainder:
    """What no claim explains: where it sits, and what it looks like. `resembles` are names that were not believed."""

    location: tuple[Location, ...] = ()
    hints: tuple[str, ...] = ()
    p: float | None = None
    resembles: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NotTestable:
    """An effect that this recording cannot show, whatever its size within reason."""

    effect: str
    why: str
    needs: str


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of an effect that would have been seen with 80 % probability."""

    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole answer."""

    verdict: Verdict
    location: tuple[Location, ...] = ()
    claims: tuple[Claim, ...] = ()
    fit: Fit | None = None
    intake: tuple[Finding, ...] = ()
    remainder: Remainder = field(default_factory=Remainder)
    not_testable: tuple[NotTestable, ...] = ()
    minimum_detectable: dict[str, Detectable] = field(default_factory=dict)
    noise: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    version: str = ""

    def to_dict(self) -> dict[str, Any]:
        """What goes into `diagnosis.json`; numbers that are not finite become null."""
        plain = _plain(asdict(self))
        assert isinstance(plain, dict)
        return {"schema": SCHEMA, **plain}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

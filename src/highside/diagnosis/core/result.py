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
    "law",
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
class Curve:
    """A smooth law as it was found: its value with standard deviation on a grid (K,) of its first covariate.

    Of a law of two covariates the curve is a section: the second at its median over the recording.
    """

    grid: tuple[float, ...]
    value: tuple[float, ...]
    std: tuple[float, ...]
    """where a formula is told that of the curve in whose place it stands, with the distance of the two"""
    unit: str
    unread: tuple[tuple[float, float], ...] = ()
    """wide stretches of the covariate without a reading: what the law does there follows from its smoothness alone"""


@dataclass(frozen=True, slots=True)
class Claim:
    """An effect that the model omits, named or as a law, and what it is confounded with in this recording.

    The fields from `share` on are in `diagnosis.json` for every claim; those from `place` on say something of laws
    (`effect` is `law:<slug>` then), and are empty for a named effect.
    """

    effect: str
    story: str
    formula: str | None
    stage: str
    parameters: dict[str, FittedParameter]
    p_familywise: float
    equivalence_class: tuple[str, ...]
    rivals_ruled_out: tuple[Rival, ...]
    next_manoeuvre: str
    share: float | None = None
    """of the mean square that is explained, the part that is this claim's; 0 to 1"""
    channels: tuple[str, ...] = ()
    """on which it acts"""
    heldout_gain: float | None = None
    """log likelihood that it adds on blocks that were held out of its fit, beside the other claims; nats"""
    stable: bool | None = None
    """whether its size agrees over thirds of the session and halves of the inclinations or rates; None: not checked"""
    shape_within: float | None = None
    """how far another shape may depart from this one unseen, as a fraction of its size"""
    simulated: dict[str, float] = field(default_factory=dict)
    """values of its parameters in the simulation, which has the effect at another size; empty where it is left out"""
    place: str = ""
    """where the law acts (a key of the places of `physics.law`)"""
    depends_on: tuple[str, ...] = ()
    """what it is a function of"""
    curve: Curve | None = None
    range: tuple[tuple[float, float], ...] = ()
    """of each covariate, what this recording visited; beyond it the law says nothing"""
    resembles: tuple[str, ...] = ()
    """effects of the library that it is like, without being one"""
    readings: tuple[str, ...] = ()
    """physics that would read like this: suggestions"""
    confirm: str = ""
    """what another session must vary to confirm or refute it"""
    law: dict[str, Any] | None = None
    """the law itself in plain values (`physics.law`), as the model file has it; of one that set in midway since when"""
    rms: float | None = None
    """what the law adds to the readings of its channels, rms in their unit, less what bias, scale and all else that is
    free takes of it"""
    rms_std: float | None = None


@dataclass(frozen=True, slots=True)
class Fit:
    """How much the claims improve the fit; `heldout` figures are of blocks that were held out of the fit."""

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
    changing: tuple[str, ...] = ()
    """those of them whose size differs between parts of the recording: no constant has such a name"""


@dataclass(frozen=True, slots=True)
class NotTestable:
    """An effect that this recording cannot show, whatever its size within reason."""

    effect: str
    why: str
    needs: str


@dataclass(frozen=True, slots=True)
class Detectable:
    """The smallest size of an effect that would have been detected with 80 % probability."""

    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Coverage:
    """How much of the library and of the recording an answer rests on."""

    effects_tested: int
    effects_known: int
    intervals_used: int | None = None
    """still intervals (or poses) that were used, where the recording has such"""
    intervals_expected: int | None = None


@dataclass(frozen=True, slots=True)
class DiagnosisResult:
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
    coverage: Coverage | None = None

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

"""The surveys that a tool kept: `surveys.jsonl` of its state directory, one line of JSON each.

A survey keeps inclination, toolface and Gtotal of the corrected mean at rest, not its three components; together they
are that mean. A line that a loss of power tore stays in the file and is counted, not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from highside.arrays import Array
from highside.errors import InputError
from highside.reading import parse_message, read_bytes

__all__ = ["AT_REST", "KeptSurvey", "KeptSurveys", "elapsed_s", "read_surveys"]

AT_REST = frozenset({"g_total_low", "g_total_high", "uncertain"})
"""reasons of a refusal that leave a mean at rest with a correction in force: such a survey tells of the calibration"""
LONGEST_LINE = 64 * 1024
"""bytes; a survey has about one thousand"""
CLOCK_SET_S = 946_684_800.0, 4_102_444_800.0
"""2000 and 2100 (UTC epoch seconds): a clock that says another year is not set, as one without a battery at 1970"""

Angle = Annotated[float, Field(ge=0, le=360)]

Scatter = Annotated[float, Field(ge=0, le=1e6)]
ByAxis = Annotated[list[Scatter], Field(min_length=3, max_length=3)]


class KeptSurvey(BaseModel):
    """One line. Angles in deg, `t` in UTC epoch seconds; members that are not named here are left unread."""

    model_config = ConfigDict(strict=True, frozen=True, extra="ignore")

    t: Annotated[float, Field(ge=0, le=1e11)]
    seq: int | None = None
    inc_deg: Annotated[float, Field(ge=0, le=180)] | None
    inc_std_deg: Annotated[float, Field(ge=0)] | None = None
    tf_deg: Angle | None = None
    tf_std_deg: Annotated[float, Field(ge=0)] | None = None
    azi_deg: Angle | None = None
    azi_std_deg: Annotated[float, Field(ge=0)] | None = None
    g_total: Annotated[float, Field(ge=0, le=100)] | None
    g_error_mg: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None
    g_error_std_mg: Annotated[float, Field(ge=0, le=1e6)] | None = None
    g_std: Annotated[float, Field(ge=0, le=1e3)] | None = None
    g_noise_mg: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """standard deviation of Gtotal by the readings' own noise"""
    scatter_mg: Annotated[list[ByAxis | None], Field(min_length=2, max_length=2)] | None = None
    """standard deviation within the survey of x, y, z: of one reading, and of a mean of two seconds, where it was long
    enough; None in surveys of before it was kept"""
    n: Annotated[int, Field(ge=0)] | None = None
    temp_c: Annotated[float, Field(ge=-274, le=1000)] | None = None
    md_m: Annotated[float, Field(ge=0, le=20_000)] | None = None
    """measured depth, where whoever kept the survey knew it"""
    tvd_m: Annotated[float, Field(ge=-10_000, le=20_000)] | None = None
    cal_id: str
    accepted: bool
    reasons: list[str] = []

    @property
    def at_rest(self) -> bool:
        """Whether it is the mean of a tool at rest under a calibration, accepted or not."""
        return self.inc_deg is not None and self.g_total is not None and set(self.reasons) <= AT_REST

    def scatter_g(self) -> Array | None:
        """(2, 3) as `Still` has it, g; NaN what is not known, None where nothing is."""
        if self.scatter_mg is None:
            return None
        return 1e-3 * np.array([[np.nan] * 3 if of is None else of for of in self.scatter_mg])

    def mean_g(self) -> Array:
        """(3,) the corrected mean at rest, in units of the calibration. Where toolface is not defined (a vertical
        hole) what is across the axis is put on x."""
        assert self.inc_deg is not None and self.g_total is not None
        inc, tf = np.radians(self.inc_deg), np.radians(self.tf_deg or 0.0)
        s = np.sin(inc)
        return self.g_total * np.array([s * np.cos(tf), s * np.sin(tf), np.cos(inc)])


@dataclass(frozen=True, slots=True)
class KeptSurveys:
    """The surveys of a file in the order in which they were made. `damaged_lines`: lines that are no survey;
    `repeated`: lines of a survey that is there already (the same time and number)."""

    surveys: tuple[KeptSurvey, ...]
    source: str
    damaged_lines: int = 0
    repeated: int = 0

    @property
    def clock_steps(self) -> int:
        """How often the clock went back, or was or had not been set, from one survey to the next: the time between
        these two is not known."""
        return sum(not _is_known(a, b) for a, b in pairwise(self.surveys))


def elapsed_s(surveys: Sequence[KeptSurvey]) -> list[float]:
    """Seconds of each since the first. None are counted between two of which the clock does not tell how many."""
    out = [0.0]
    for a, b in pairwise(surveys):
        out.append(out[-1] + (b.t - a.t if _is_known(a, b) else 0.0))
    return out


def _is_known(one: KeptSurvey, following: KeptSurvey) -> bool:
    """Whether the clock tells the time from one survey to the next."""
    low, high = CLOCK_SET_S
    # two in a row of a clock that is not set are as far apart as it says
    return following.t >= one.t and (low <= one.t < high) == (low <= following.t < high)


def _in_order(kept: Sequence[KeptSurvey]) -> list[KeptSurvey]:
    """As they were made. The service appends: where the time goes back while the number goes up, the clock was set
    back and the file is in order; else it was put together from others, and time alone tells."""
    for a, b in pairwise(kept):
        if b.t < a.t and (a.seq is None or b.seq is None or b.seq <= a.seq):
            return sorted(kept, key=lambda one: one.t)
    return list(kept)


def read_surveys(path: Path) -> KeptSurveys:
    """Every survey of a file. Raises InputError for a file that holds none."""
    found: dict[tuple[float, int | None], KeptSurvey] = {}
    damaged = repeated = 0
    why: InputError | None = None
    for line in read_bytes(path).split(b"\n"):
        if not line.strip():
            continue
        try:
            survey = parse_message(KeptSurvey, line, max_bytes=LONGEST_LINE)
        except InputError as error:
            damaged += 1
            why = why or error
            continue
        key = (survey.t, survey.seq)
        repeated += key in found
        found.setdefault(key, survey)
    if not found:
        first = "it is empty" if why is None else f"first line: {why}"
        raise InputError(
            f"holds no survey ({first})", where=str(path), remedy="give surveys.jsonl of a tool's state directory"
        )
    return KeptSurveys(tuple(_in_order(list(found.values()))), str(path), damaged, repeated)

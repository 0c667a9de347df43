"""Surveys: what those that a tool kept say of its calibration (multi-station analysis)."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from highside.api.calibration import Calibration
from highside.calibration.record import CalibrationRecord
from highside.errors import InputError
from highside.recording.calibration_store import read_record
from highside.recording.files import write_folder
from highside.recording.frames import File
from highside.recording.kept_surveys import KeptSurvey, KeptSurveys, elapsed_s, read_surveys
from highside.report.surveys_page import SurveyPoint, page_of
from highside.report.watch_page import error_words, headline
from highside.shown.card import card
from highside.units import STANDARD_GRAVITY_MPS2
from highside.version import __version__
from highside.watch import STATED, Still, Watch, WatchResult, prior_of_record
from highside.watch.surveys import Detectable, detectable, iscwsa_prior

__all__ = ["MOST_SURVEYS", "AnalysedSurveys", "analyse_surveys"]

SCHEMA = "highside.surveys/1"
MOST_SURVEYS = 2000
"""that one analysis takes, the last ones: a month of one every twenty minutes; twenty seconds of one processor"""
LARGEST_GRAVITY_ERROR_G = 0.01
"""by which expected gravity may differ from that of the bench on which one unit was defined: pole to equator 0.005"""
GRAVITY_MPS2 = (9.6, 10.0)


@dataclass(frozen=True)
class AnalysedSurveys:
    """What the surveys of a tool say of the calibration that they were made under."""

    found: WatchResult
    detectable: tuple[Detectable, ...]
    """what these surveys could show, and what looks alike in them"""
    points: tuple[SurveyPoint, ...]
    """the surveys that were used"""
    start_t: float
    """UTC epoch seconds of the first: `since_s` and `alarm_s` of a claim count from here"""
    source: str
    prior: str
    """`record` or `iscwsa`: what was assumed before the first survey"""
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """`holds`, `learning` or `departs`."""
        return self.found.verdict

    def to_dict(self) -> dict[str, Any]:
        """What goes into `surveys.json`."""
        plain = {name: value for name, value in self.found.to_dict().items() if name != "schema"}
        return {
            "schema": SCHEMA,
            "surveys": self.source,
            "start": datetime.fromtimestamp(self.start_t, UTC).isoformat(timespec="seconds"),
            "prior": self.prior,
            **plain,
            "detectable": [
                {"name": one.name, "unit": one.unit, "std": one.std, "found_from": one.found_from}
                | {"alike": list(one.alike)}
                for one in self.detectable
            ],
            "notes": list(self.notes),
            "version": __version__,
        }

    def html(self) -> str:
        """The report: one page that needs nothing beside it."""
        return page_of(self.found, self.detectable, self.points, self.source, self.prior, self.notes)

    def save(self, folder: File) -> None:
        """Write `surveys.json` and `report.html`. Raises InputError for a folder that cannot be made."""
        text = json.dumps(self.to_dict(), indent=1, allow_nan=False) + "\n"
        write_folder(Path(folder), {"surveys.json": text, "report.html": self.html()})

    def _repr_html_(self) -> str:
        """What a notebook shows: the verdict, the departures, and what to do."""
        rows = [
            [", ".join(claim.equivalence_class), error_words(claim.error), f"{claim.since_s / 3600.0:.1f}"]
            for claim in self.found.claims
        ]
        return card(["departs", "error", "since, h"], rows, *self.found.advice, title=headline(self.found))


def analyse_surveys(
    surveys: File,
    calibration: Calibration | File | None = None,
    *,
    gravity_mps2: float | None = None,
    gravity_std_mps2: float = 5e-4,
) -> AnalysedSurveys:
    """Whether a calibration still holds, from the surveys that a tool kept under it (multi-station analysis).

    `surveys`: `surveys.jsonl` of the tool's state directory, of which `t`, `inc_deg`, `tf_deg`, `g_total`, `temp_c`,
    `g_error_mg`, `scatter_mg`, `cal_id` and `reasons` are used (`tvd_m` where it was added). `calibration`: the record
    they were made under; its covariance is what is known beforehand. Without it the surveys of the newest calibration
    in the file are taken, and a tool that keeps the accelerometer terms of the ISCWSA MWD model is assumed. Gravity is
    what the tool compared Gtotal with, unless `gravity_mps2` (m/s2, with its standard deviation `gravity_std_mps2`)
    says better; that needs `calibration`, whose bench defined the unit. Refused surveys are used where the tool was at
    rest under a calibration. Raises InputError for a file or record that is not in order, or without one survey that
    can be used.
    """
    kept = read_surveys(Path(surveys))
    record = calibration.record if isinstance(calibration, Calibration) else None
    if record is None and calibration is not None:
        record = read_record(Path(calibration))  # type: ignore[arg-type]
    cal_id = kept.surveys[-1].cal_id if record is None else record.id
    unit = _Unit.of(record, gravity_mps2, gravity_std_mps2)
    left: Counter[str] = Counter()
    used = [one for one in kept.surveys if _used(one, cal_id, unit, left)]
    if len(used) > MOST_SURVEYS:
        left["older than the last 2000"] = len(used) - MOST_SURVEYS
        used = used[-MOST_SURVEYS:]
    if not used:
        why = ", ".join(f"{count} x {reason}" for reason, count in left.items())
        raise InputError(
            f"no survey of calibration {cal_id[:12]} can be used ({why})",
            where=kept.source,
            remedy="give the record that these surveys were made under",
        )
    gravity_g = unit.std_g(used)
    noise = replace(STATED, gravity_g=gravity_g)
    prior = iscwsa_prior(noise) if record is None else prior_of_record(record, noise)
    stills = _stills(used, unit)
    watch = Watch(prior, cal_id)
    for reason, count in left.items():
        for _ in range(count):
            watch.leave_out(reason)
    for still in stills:
        watch.still(still)
    points = tuple(
        SurveyPoint(still.t_s, 1e3 * (math.dist(still.mean_g, (0, 0, 0)) - 1.0), one.inc_deg or 0.0, one.tf_deg)
        for still, one in zip(stills, used, strict=True)
    )
    return AnalysedSurveys(
        watch.result(),
        detectable(stills, prior),
        points,
        used[0].t,
        kept.source,
        "iscwsa" if record is None else "record",
        tuple(_notes(kept, used, record, gravity_g)),
    )


@dataclass(frozen=True, slots=True)
class _Unit:
    """What one unit of the corrected readings is, and what gravity should be in it."""

    unit_mg: float
    """mg of standard gravity in one unit"""
    expected: float | None
    """gravity in this unit; None: what the tool expected of each survey"""
    std: float
    """of `expected`, relative"""

    @classmethod
    def of(cls, record: CalibrationRecord | None, gravity_mps2: float | None, std_mps2: float) -> _Unit:
        environment = {} if record is None else record.content["environment"]
        bench = environment.get("gravity_mps2")
        unit_mg = 1e3 * (bench or STANDARD_GRAVITY_MPS2) / STANDARD_GRAVITY_MPS2
        if gravity_mps2 is None:
            return cls(unit_mg, None, 0.0)
        if not GRAVITY_MPS2[0] < gravity_mps2 < GRAVITY_MPS2[1] or not 0.0 <= std_mps2 < 0.1:
            raise InputError(
                f"{gravity_mps2:g} +- {std_mps2:g} m/s2 is no gravity of the earth",
                field="gravity_mps2",
                remedy="give m/s2, near 9.8",
            )
        if bench is None:
            raise InputError(
                "the gravity of the bench, which is one unit of these readings, is not known",
                field="gravity_mps2",
                remedy="give the record, if it states it, as calibration=, or leave gravity to what the tool expected",
            )
        std = math.hypot(std_mps2, environment.get("gravity_std_mps2") or 0.0)
        return cls(unit_mg, gravity_mps2 / bench, std / bench)

    def gravity(self, survey: KeptSurvey) -> float:
        """Expected Gtotal of a survey."""
        if self.expected is not None:
            return self.expected
        assert survey.g_total is not None and survey.g_error_mg is not None
        return survey.g_total - survey.g_error_mg / self.unit_mg

    def std_g(self, used: Sequence[KeptSurvey]) -> float:
        """Standard deviation of expected gravity, relative. The tool keeps only that of Gtotal less gravity, of which
        gravity's is a part: the smallest is a bound."""
        if self.expected is not None:
            return self.std
        bounds = [one.g_error_std_mg for one in used if one.g_error_std_mg is not None]
        return max(min(bounds, default=2.0) / self.unit_mg, 1e-6)


def _used(one: KeptSurvey, cal_id: str, unit: _Unit, left: Counter[str]) -> bool:
    """Whether a survey tells of this calibration; else why not is counted."""
    if one.cal_id != cal_id:
        left["made under another calibration"] += 1
    elif not one.at_rest:
        left["not at rest under a calibration"] += 1
    elif unit.expected is None and one.g_error_mg is None:
        left["kept without what Gtotal should be"] += 1
    elif abs(unit.gravity(one) - 1.0) > LARGEST_GRAVITY_ERROR_G:
        left["expects a gravity that is none of the earth in units of the bench"] += 1
    else:
        return True
    return False


def _stills(used: Sequence[KeptSurvey], unit: _Unit) -> list[Still]:
    """In units of expected gravity, seconds from the first. Depth counts where every survey has it."""
    depths = [one.tvd_m for one in used]
    known = all(depth is not None for depth in depths)
    out = []
    for one, since_s, depth in zip(used, elapsed_s(used), depths, strict=True):
        gravity = unit.gravity(one)
        noise = one.g_noise_mg
        if noise is None:
            noise = 1e3 * (one.g_std or 0.0) / math.sqrt(max(one.n or 1, 1))
        out.append(
            Still(
                since_s,
                one.mean_g() / gravity,
                1e-3 * noise,
                one.temp_c,
                depth / 1000.0 if known and depth is not None else None,
                one.scatter_g(),
            )
        )
    return out


def _notes(
    kept: KeptSurveys, used: Sequence[KeptSurvey], record: CalibrationRecord | None, gravity_g: float
) -> list[str]:
    notes = []
    if kept.damaged_lines:
        notes.append(f"{kept.damaged_lines} lines are no surveys: left out")
    if kept.repeated:
        notes.append(f"{kept.repeated} lines repeat a survey: left out")
    if kept.clock_steps:
        notes.append(
            f"clock set, set back or not set: the time from a survey to the next is not known ({kept.clock_steps} x)"
            " and taken as none"
        )
    if record is None:
        notes.append(
            "no calibration record was given: a tool that keeps the accelerometer terms of the ISCWSA MWD model is"
            " assumed (0.41 mg, 0.0005)"
        )
    if gravity_g > 5e-4:
        notes.append(
            f"gravity is known to {1e3 * gravity_g:.2f} mg only: b_z, S_zz and a common scale hide behind it; give"
            " gravity of site and bench"
        )
    if any(one.temp_c is None for one in used):
        notes.append("surveys without a temperature: an offset that follows it is read as a drift or a step")
    if any(one.tvd_m is None for one in used):
        notes.append("depths are not known: gravity's growth with depth is taken to follow time")
    return notes

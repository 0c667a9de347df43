"""Surveys: accepted or refused with reasons, every one kept, and what their Gtotal says about the calibration.

A survey is the average over a stop. It is accepted if the tool stood still long enough, if its Gtotal agrees with the
site's gravity, if temperature and shock are within limits and a calibration holds there. Gtotal is compared in mg of
standard gravity: a calibration made on a bench where gravity is g_b calls g_b one, so the site shows g_s / g_b. Both
gravities have an uncertainty, as has the survey; a departure counts against the survey only by what these cannot
explain (two standard deviations). A gravity that is not known is anywhere on earth: 9.780 to 9.833 m/s2.

The file of surveys is one line of JSON each, appended and synced; it is never rewritten while the daemon lives.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import threading
from collections import deque
from collections.abc import Iterable
from contextvars import copy_context
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from highside.config.rig import AcceptSettings, SiteSettings
from highside.errors import InputError
from highside.reading import parse_json
from highside.recording.files import flush_directory
from highside.service.outputs import AttitudeOutput, SurveyReason, SurveyVerdict
from highside.service.stillness import AxisScatter
from highside.units import STANDARD_GRAVITY_MPS2

log = logging.getLogger(__name__)

UNKNOWN_GRAVITY_STD_MPS2 = 0.0153
"""A gravity somewhere between equator and pole, taken as evenly spread."""
COVERAGE = 2.0
"""Standard deviations that a departure is allowed beyond its limit."""
TREND_LENGTH = 200
"""Surveys that the trend looks back."""
TREND_MIN = 8
TREND_SIGMAS = 4.0
"""A slope this far from zero is accepted: 1 of 16,000 by chance."""


REASON_TEXTS = {
    SurveyReason.MOVED: "the tool moved before the average was long enough",
    SurveyReason.G_TOTAL_LOW: "Gtotal is below the site's gravity",
    SurveyReason.G_TOTAL_HIGH: "Gtotal is above the site's gravity",
    SurveyReason.TOO_COLD: "colder than surveys are accepted at",
    SurveyReason.TOO_HOT: "hotter than surveys are accepted at",
    SurveyReason.TEMPERATURE_UNKNOWN: "the calibration needs a temperature and the frame has none",
    SurveyReason.SHOCK: "a shock during the average",
    SurveyReason.UNCERTAIN: "the inclination is less certain than requested",
    SurveyReason.NO_CORRECTION: "no calibration holds at this attitude, or it was refused",
    SurveyReason.SENSOR_STUCK: "an axis repeats one value",
}


@dataclass(frozen=True, slots=True)
class Gravity:
    """What Gtotal should be: `expected` in units of the corrected reading, `std_mg` its standard deviation."""

    expected: float
    std_mg: float
    unit_mg: float
    """mg of standard gravity in one unit of the corrected reading"""


def expected_gravity(site: SiteSettings, bench_mps2: float | None, bench_std_mps2: float | None) -> Gravity:
    """From the site's gravity and that of the bench on which one unit was defined."""
    local = site.local_gravity()
    if local is None or bench_mps2 is None:
        # the ratio of the two is all that counts, and one of them may be anywhere
        return Gravity(1.0, 1e3 * UNKNOWN_GRAVITY_STD_MPS2 / STANDARD_GRAVITY_MPS2, 1e3)
    gravity, gravity_std = local
    std = math.hypot(gravity_std, bench_std_mps2 or 0.0)
    return Gravity(gravity / bench_mps2, 1e3 * std / STANDARD_GRAVITY_MPS2, 1e3 * bench_mps2 / STANDARD_GRAVITY_MPS2)


def judge(
    attitude: AttitudeOutput, gravity: Gravity, limits: AcceptSettings, shock_g: float, *, complete: bool
) -> SurveyVerdict:
    """Decide. `shock_g` is the greatest peak until the survey ended, `complete` whether it was long enough.

    What ended an average too soon is a shock, if there was one, else motion.
    """
    reasons: list[SurveyReason] = []
    if not complete and shock_g <= limits.shock_g:
        reasons.append(SurveyReason.MOVED)
    error = (attitude.g_total - gravity.expected) * gravity.unit_mg
    std = math.hypot(attitude.g_total_std * gravity.unit_mg, gravity.std_mg)
    refused = "calibration_refused" in attitude.flags and "calibration_kept" not in attitude.flags
    if not math.isfinite(attitude.inc_deg) or refused or "no_calibration" in attitude.flags:
        reasons.append(SurveyReason.NO_CORRECTION)
    if math.isfinite(error) and abs(error) > limits.g_total_mg + COVERAGE * std:
        reasons.append(SurveyReason.G_TOTAL_LOW if error < 0 else SurveyReason.G_TOTAL_HIGH)
    if "temperature_unknown" in attitude.flags:
        reasons.append(SurveyReason.TEMPERATURE_UNKNOWN)
    if attitude.temp_c is not None:
        if attitude.temp_c < limits.min_temp_c:
            reasons.append(SurveyReason.TOO_COLD)
        elif attitude.temp_c > limits.max_temp_c:
            reasons.append(SurveyReason.TOO_HOT)
    if shock_g > limits.shock_g:
        reasons.append(SurveyReason.SHOCK)
    if limits.max_inc_std_deg is not None and not attitude.inc_std_deg <= limits.max_inc_std_deg:
        reasons.append(SurveyReason.UNCERTAIN)
    if any(flag == "frozen" or flag.startswith("stuck_") for flag in attitude.flags):
        reasons.append(SurveyReason.SENSOR_STUCK)
    return SurveyVerdict(not reasons, tuple(reasons), error, std, shock_g)


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One survey as the trend sees it."""

    t: float
    temp_c: float | None
    error_mg: float
    noise_mg: float
    """scatter between surveys that is to be expected: the readings' own"""


class GravityTrend:
    """Departure of Gtotal from survey to survey: its mean, and its slope with temperature and with time."""

    def __init__(self) -> None:
        self._points: deque[TrendPoint] = deque(maxlen=TREND_LENGTH)

    def add(self, point: TrendPoint) -> None:
        """Take a survey whose Gtotal means something (it stood still, a correction held, no shock)."""
        if math.isfinite(point.error_mg):
            self._points.append(point)

    def as_dict(self) -> dict[str, Any]:
        """What the health message says; `advice` is null while nothing is wrong."""
        points = list(self._points)
        found: dict[str, Any] = {"surveys": len(points), "mean_mg": None, "last_mg": None, "advice": None}
        if not points:
            return found
        error = np.array([p.error_mg for p in points])
        found |= {"mean_mg": round(float(error.mean()), 4), "last_mg": round(points[-1].error_mg, 4)}
        if len(points) < TREND_MIN:
            return found
        temps = np.array([math.nan if p.temp_c is None else p.temp_c for p in points])
        days = np.array([p.t for p in points]) / 86_400.0
        noise = max(float(np.median([p.noise_mg for p in points])), 1e-4)
        advice = None
        for name, covariate, least, text in (
            ("per_degc", temps, 2.0, "the residual of |g| has grown with temperature: run `diagnose`"),
            ("per_day", days, 1.0 / 24.0, "the residual of |g| drifts with time: run `diagnose`"),
        ):
            good = np.isfinite(covariate)
            if good.sum() < TREND_MIN or float(np.ptp(covariate[good])) < least:
                continue
            slope, std = _slope(covariate[good], error[good], noise)
            found |= {f"slope_mg_{name}": round(slope, 6), f"slope_std_mg_{name}": round(std, 6)}
            if advice is None and abs(slope) > TREND_SIGMAS * std:
                advice = text
        found["advice"] = advice
        return found


def _slope(x: NDArray[np.float64], y: NDArray[np.float64], noise: float) -> tuple[float, float]:
    """Slope of a straight line and its standard deviation, from the scatter about it or `noise` if that is larger."""
    centred = x - x.mean()
    xx = float(centred @ centred)
    slope = float(centred @ y) / xx
    rest = y - y.mean() - slope * centred
    scatter = math.sqrt(float(rest @ rest) / max(x.size - 2, 1))
    return slope, max(scatter, noise) / math.sqrt(xx)


RETRY_S = 2.0
"""Seconds between two tries of a disk that refuses."""
WAITING_MAX = 1_000
"""Surveys that wait in memory for the disk, about a megabyte; a survey takes a minute of standing still."""


class SurveyLog:
    """Keeps every survey: `surveys.jsonl` in the state directory, written by a thread, a line synced each.

    The file is cut off by renaming it to `surveys.1.jsonl` at the start of the daemon once it holds `max_bytes`. What a
    full disk refuses is tried again every `RETRY_S`, so that nothing is lost and the alarm ends with its cause.
    """

    def __init__(self, path: Path, *, max_bytes: int = 64 * 1024 * 1024) -> None:
        self.path = path
        self.kept = 0
        self.error = ""
        self.damaged_lines = 0
        self._waiting: deque[bytes] = deque()
        self._lost = 0
        self._max_bytes = max_bytes
        self._queue: SimpleQueue[bytes | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    @property
    def failed(self) -> int:
        """Surveys that are not on the disk: those that still wait for it, and those that were given up."""
        return len(self._waiting) + self._lost

    def start(self) -> None:
        """Begin to write."""
        with contextlib.suppress(OSError):
            if self.path.stat().st_size > self._max_bytes:
                self.path.replace(self.path.with_name("surveys.1.jsonl"))
        self._thread = threading.Thread(target=copy_context().run, args=(self._write_all,), name="surveys", daemon=True)
        self._thread.start()

    def keep(self, survey: dict[str, Any]) -> None:
        """Hand over one survey; never waits."""
        self._queue.put(json.dumps(survey, separators=(",", ":")).encode() + b"\n")

    def stop(self, timeout_s: float) -> None:
        """Write what is left and end."""
        self._queue.put(None)
        if self._thread is not None:
            self._thread.join(timeout_s)

    def recent(self, count: int = TREND_LENGTH) -> list[dict[str, Any]]:
        """The last surveys of the file. A line that is none is omitted and counted in `damaged_lines`: one that a loss
        of power tore stays where it is."""
        try:
            with self.path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                file.seek(max(size - count * 1024, 0))
                lines = file.read(count * 1024).split(b"\n")[:-1]
        except OSError:
            return []
        found = [survey for line in lines[-count:] if (survey := _survey(line)) is not None]
        self.damaged_lines = len(lines[-count:]) - len(found)
        if self.damaged_lines:
            log.warning("%s: %d of the last lines are no surveys; omitted", self.path, self.damaged_lines)
        return found

    def _write_all(self) -> None:
        ended = False
        while not ended:
            with contextlib.suppress(Empty):
                line = self._queue.get(timeout=RETRY_S if self._waiting else None)
                while True:
                    if line is None:
                        ended = True
                    else:
                        self._waiting.append(line)
                    line = self._queue.get_nowait()
            while len(self._waiting) > WAITING_MAX:
                self._waiting.popleft()
                self._lost += 1
            if self._waiting:
                self._append()

    def _append(self) -> None:
        """Write what waits; what the disk does not take goes on waiting."""
        lines = list(self._waiting)
        try:
            # a power cut in the middle of a line must not spoil the next one
            left = memoryview((b"\n" if _ends_torn(self.path) else b"") + b"".join(lines))
            with self.path.open("ab", buffering=0) as file:
                whole = file.seek(0, os.SEEK_END)
                try:
                    while left:
                        left = left[file.write(left) :]
                    os.fsync(file.fileno())
                    if whole == 0:
                        flush_directory(self.path.parent)
                except OSError:
                    # else the lines that a full disk took would stand there twice
                    os.ftruncate(file.fileno(), whole)
                    raise
            self._waiting.clear()
            if self.error:
                log.warning("surveys are kept again in %s", self.path)
            self.error = ""
            self.kept += len(lines)
        except OSError as error:
            if not self.error:
                log.error("surveys cannot be kept in %s: %s", self.path, error.strerror)
            self.error = error.strerror or str(error)


def _survey(line: bytes) -> dict[str, Any] | None:
    """A survey as it was kept; None for a line that is none."""
    try:
        survey = parse_json(line)
    except InputError:
        return None
    if not isinstance(survey, dict):
        return None
    reasons = survey.get("reasons", [])
    numbers = [survey.get(name) for name in ("t", "temp_c", "g_error_mg", "g_noise_mg")]
    if not isinstance(reasons, list) or not all(isinstance(reason, str) for reason in reasons):
        return None
    return survey if all(number is None or type(number) in (int, float) for number in numbers) else None


def scatter_dict(scatter: AxisScatter | None) -> dict[str, Any]:
    """Member `scatter_mg` of a kept survey, in which noise that has grown shows: of x, y, z the standard deviation of
    one reading, and of a mean of two seconds (null: too short). Empty where it is not known."""
    if scatter is None:
        return {}
    return {"scatter_mg": [None if of is None else [round(1e3 * value, 6) for value in of] for of in scatter]}


def _ends_torn(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) == 0:
                return False
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"\n"
    except FileNotFoundError:
        return False


def trend_of(surveys: Iterable[dict[str, Any]], cal_id: str) -> GravityTrend:
    """The trend of kept surveys made with the calibration in force."""
    trend = GravityTrend()
    for survey in surveys:
        if survey.get("cal_id") == cal_id and trusted(survey.get("reasons", [])):
            error, noise = survey.get("g_error_mg"), survey.get("g_noise_mg")
            if isinstance(error, float) and isinstance(noise, float):
                trend.add(TrendPoint(float(survey.get("t") or 0.0), survey.get("temp_c"), error, noise))
    return trend


def trusted(reasons: Iterable[str]) -> bool:
    """Whether a survey with these reasons still tells something about the calibration."""
    return set(reasons) <= {
        SurveyReason.G_TOTAL_LOW.value,
        SurveyReason.G_TOTAL_HIGH.value,
        SurveyReason.UNCERTAIN.value,
    }

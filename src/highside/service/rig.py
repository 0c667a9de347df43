"""What the daemon has around I and T for the rig: surveys kept, toolface offset, WITS, metrics, announcement.

Everything here lives beside the pipeline: it takes what the pipeline has made, and nothing in it can hold that up.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from highside.calibration.record import CalibrationRecord
from highside.config.settings import Settings
from highside.errors import HighsideError
from highside.recording.calibration_store import CalibrationStore, read_record
from highside.service.messages import HealthMessage, survey_dict
from highside.service.metrics import Figures, MetricsServer
from highside.service.pipeline import Attitude, Pipeline, Survey
from highside.service.surveys import (
    Gravity,
    GravityTrend,
    SurveyLog,
    TrendPoint,
    expected_gravity,
    trend_of,
    trusted,
)
from highside.service.toolface import ToolfaceLog, ToolfaceOffset
from highside.service.wits import Latest, WitsOutput

log = logging.getLogger("highside")

OFFSET_CHECK_S = 1.0
"""How soon a new toolface offset is in force."""


class Rig:
    """Made with the service; `start` and `stop` with its loop, `apply` after a reload."""

    def __init__(self, settings: Settings, state_dir: Path, health: Callable[[], HealthMessage]) -> None:
        self._settings = settings
        self._health = health
        self.surveys = SurveyLog(state_dir / "surveys.jsonl")
        self.accepted = 0
        self.refused: Counter[str] = Counter()
        self.refused_surveys = 0
        self._toolface_log = ToolfaceLog(state_dir)
        self.offset: ToolfaceOffset | None = None
        self.offset_error: str | None = None
        self.latest = Latest()
        self.outputs: list[WitsOutput] = []
        self.metrics: MetricsServer | None = None
        self._trend = GravityTrend()
        self._trend_of = "none"
        self._tasks: list[asyncio.Task[None]] = []

    # --- readings ----------------------------------------------------------------------------------------------

    def on_attitude(self, attitude: Attitude, t_wall: float) -> None:
        """The newest attitude, for WITS and metrics."""
        latest = self.latest
        latest.attitude = _values(attitude)
        latest.attitude_s, latest.attitude_t = time.monotonic(), t_wall

    def on_survey(self, survey: Survey, seq: int, t_wall: float) -> None:
        """Count, keep and learn from a survey."""
        verdict, attitude = survey.verdict, survey.attitude
        if verdict.accepted:
            self.accepted += 1
            self.latest.survey, self.latest.survey_t = _values(attitude), t_wall
        else:
            self.refused_surveys += 1
            self.refused.update(reason.value for reason in verdict.reasons)
        noise_mg = 1e3 * survey.g_std / math.sqrt(max(attitude.n, 1))
        self.surveys.keep(survey_dict(seq, t_wall, survey) | {"g_noise_mg": round(noise_mg, 6)})
        if attitude.cal_id != self._trend_of:
            self._trend, self._trend_of = GravityTrend(), attitude.cal_id
        if trusted(verdict.reasons):
            self._trend.add(TrendPoint(t_wall, attitude.temp_c, verdict.g_error_mg, noise_mg))

    def gravity(self, cal_id: str) -> Gravity:
        """What Gtotal should be with the calibration in force."""
        record = _record_in_force(self._settings) if cal_id != "none" else None
        environment = record.content.get("environment", {}) if record is not None else {}
        return expected_gravity(
            self._settings.site, environment.get("gravity_mps2"), environment.get("gravity_std_mps2")
        )

    # --- health ------------------------------------------------------------------------------------------------

    def survey_health(self) -> dict[str, Any]:
        """Member `surveys` of the health message."""
        return {
            "accepted": self.accepted,
            "refused": self.refused_surveys,
            "reasons": dict(self.refused),
            "kept": self.surveys.kept,
            "not_kept": self.surveys.failed,
            "storage_error": self.surveys.error,
            "trend": self._trend.as_dict(),
        }

    def toolface_health(self) -> dict[str, Any]:
        """Member `toolface` of the health message."""
        offset = self.offset
        found = {"offset_deg": 0.0, "author": None, "t": None} if offset is None else offset.as_dict()
        return found | {"error": self.offset_error}

    def wits_health(self) -> list[dict[str, Any]]:
        """Member `wits` of the health message."""
        return [{"name": output.name} | output.stats.as_dict() for output in self.outputs]

    def alarms(self) -> list[str]:
        """Alarms of what is here."""
        found = []
        if self.surveys.error:
            found.append("survey_storage")
        if self.offset_error:
            found.append("toolface_offset")
        if self._trend.as_dict()["advice"]:
            found.append("g_total_trend")
        found.extend("wits_away" for output in self.outputs if output.stats.last_error and not output.stats.peers)
        return list(dict.fromkeys(found))

    # --- running -----------------------------------------------------------------------------------------------

    def read_offset(self, pipeline: Pipeline) -> bool:
        """Take a changed toolface offset into force; returns whether it did. A spoilt file changes nothing."""
        if not self._toolface_log.changed():
            return False
        try:
            offset = self._toolface_log.current()
            self.offset_error = None
        except HighsideError as error:
            self.offset_error = str(error)
            log.error("toolface offset stays as it is: %s", error)
            return True
        if offset is None or offset == self.offset:
            return False
        before = self.offset
        self.offset = offset
        pipeline.toolface_offset_deg = offset.offset_deg
        if before is not None:
            log.warning(
                "toolface offset %.3f deg -> %.3f deg, set by %s", before.offset_deg, offset.offset_deg, offset.author
            )
        else:
            log.info("toolface offset %.3f deg, set by %s", offset.offset_deg, offset.author)
        return True

    def start(self, pipeline: Callable[[], Pipeline], changed: Callable[[], None]) -> None:
        """Begin. Raises InputError if the metrics cannot be served."""
        self._start_metrics()
        self.surveys.start()
        cal_id = pipeline().correction.cal_id
        self._trend, self._trend_of = trend_of(self.surveys.recent(), cal_id), cal_id
        self._start_outputs()
        self.read_offset(pipeline())

        async def watch_offset() -> None:
            while True:
                await asyncio.sleep(OFFSET_CHECK_S)
                if self.read_offset(pipeline()):
                    changed()

        self._watch = asyncio.create_task(watch_offset(), name="toolface-offset")

    def apply(self, settings: Settings) -> None:
        """Take new settings. Raises InputError, with the old ones still at work, if the metrics cannot be served."""
        old, self._settings = self._settings, settings
        if settings.metrics != old.metrics:
            serving = self.metrics
            try:
                self._start_metrics()
            except HighsideError:
                self._settings = old
                raise
            if serving is not None:
                asyncio.get_running_loop().run_in_executor(None, serving.close)
                if settings.metrics is None:
                    self.metrics = None
        if settings.wits != old.wits:
            for task in self._tasks:
                task.cancel()
            self._start_outputs()

    def _start_metrics(self) -> None:
        if self._settings.metrics is not None:
            self.metrics = MetricsServer(self._settings.metrics, self._figures, asyncio.get_running_loop())

    def _start_outputs(self) -> None:
        self.outputs = [WitsOutput(table, self.latest) for table in self._settings.wits]
        self._tasks = [asyncio.create_task(output.run(), name=output.name) for output in self.outputs]

    def _figures(self) -> Figures:
        return Figures(self._settings.tool.id, self._health(), self.latest.attitude)

    async def stop(self, timeout_s: float) -> None:
        """End; every survey handed over is on the disk afterwards, if the disk takes it."""
        tasks = [*self._tasks, *([self._watch] if hasattr(self, "_watch") else [])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self.metrics is not None:
            await asyncio.to_thread(self.metrics.close)
        await asyncio.to_thread(self.surveys.stop, timeout_s)


def _values(attitude: Attitude) -> dict[str, float | None]:
    return {
        "inc_deg": attitude.inc_deg,
        "inc_std_deg": attitude.inc_std_deg,
        "tf_deg": attitude.tf_deg,
        "tf_std_deg": attitude.tf_std_deg,
        "toolface_deg": attitude.toolface_deg,
        "azi_deg": None if attitude.azimuth is None else attitude.azimuth.azi_deg,
        "azi_std_deg": None if attitude.azimuth is None else attitude.azimuth.azi_std_deg,
        "g_total": attitude.g_total,
        "temp_c": attitude.temp_c,
    }


def _record_in_force(settings: Settings) -> CalibrationRecord | None:
    calibration = settings.calibration
    try:
        if calibration.record is not None:
            return read_record(calibration.record)
        if calibration.store is not None:
            return CalibrationStore(calibration.store).active(settings.tool.id)
    except HighsideError:
        pass  # the service has said so already
    return None

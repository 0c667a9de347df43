"""What the daemon has around I and T for the rig: surveys kept, toolface offset, WITS, metrics, announcement.

Everything here lives beside the pipeline: it takes what the pipeline has made, and nothing in it can hold that up.
"""

from __future__ import annotations

import asyncio
import logging
import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.config.rig import MetricsSettings
from highside.config.settings import Settings
from highside.service.damage import DamageLog
from highside.service.in_force import error_text
from highside.service.messages import HealthMessage, latest_payload, survey_dict
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.pipeline import Pipeline
from highside.service.rig.metrics import MetricsServer, Scrape
from highside.service.rig.surveys import GravityTrend, SurveyLog, TrendPoint, scatter_dict, trend_of, trusted
from highside.service.rig.toolface import ToolfaceLog, ToolfaceOffset
from highside.service.rig.wits import Latest, WitsOutput

log = logging.getLogger("highside")

OFFSET_CHECK_S = 1.0
"""How soon a new toolface offset is in force."""
LATEST_INTERVAL_S = 1.0
"""Seconds between two messages of `latest`: what a person looks at, and what a recorder of states can keep."""


@dataclass(frozen=True, slots=True)
class RigParts:
    """What the configuration decides here; replaced as a whole by a reload."""

    settings: Settings
    outputs: tuple[WitsOutput, ...]
    metrics: MetricsServer | None = None


class Rig:
    """Made with the service, `start` and `stop` with its loop. `in_force()` tells which parts are at work."""

    def __init__(
        self,
        state_dir: Path,
        health: Callable[[], HealthMessage],
        in_force: Callable[[], RigParts],
        damage: DamageLog,
    ) -> None:
        self._health, self._in_force, self._damage = health, in_force, damage
        self.surveys = SurveyLog(state_dir / "surveys.jsonl")
        self.accepted = 0
        self.refused: Counter[str] = Counter()
        self.refused_surveys = 0
        self._toolface_log = ToolfaceLog(state_dir)
        self.offset: ToolfaceOffset | None = None
        self.offset_error: str | None = None
        self.latest = Latest()
        self._trend = GravityTrend()
        self._trend_of = "none"
        self._watches: list[asyncio.Task[None]] = []

    @property
    def outputs(self) -> tuple[WitsOutput, ...]:
        """The WITS outputs at work."""
        return self._in_force().outputs

    # --- parts -------------------------------------------------------------------------------------------------

    def build(self, settings: Settings, running: RigParts | None = None) -> RigParts:
        """Parts for `settings`; the WITS outputs of the running ones go on where their tables are the same."""
        if running is not None and running.settings.wits == settings.wits:
            return RigParts(settings, running.outputs)
        return RigParts(settings, tuple(WitsOutput(table, self.latest) for table in settings.wits))

    def open_metrics(self, settings: MetricsSettings) -> MetricsServer:
        """A server of figures. Raises InputError if it cannot be served."""
        return MetricsServer(settings, self._figures, asyncio.get_running_loop())

    # --- readings ----------------------------------------------------------------------------------------------

    def on_attitude(self, attitude: AttitudeOutput, t_wall: float) -> None:
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
        kept = survey_dict(seq, t_wall, survey) | {"g_noise_mg": round(noise_mg, 6)}
        self.surveys.keep(kept | scatter_dict(survey.scatter))
        if attitude.cal_id != self._trend_of:
            self._trend, self._trend_of = GravityTrend(), attitude.cal_id
        if trusted(verdict.reasons):
            self._trend.add(TrendPoint(t_wall, attitude.temp_c, verdict.g_error_mg, noise_mg))

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

    def read_offset(self, pipeline: Pipeline, *, at_start: bool = False) -> bool:
        """Take a changed toolface offset into force; returns whether it did. A spoilt file changes nothing; at the
        start it is set aside, later somebody may be at work on it."""
        if not self._toolface_log.changed():
            return False
        try:
            offset = self._toolface_log.current()
            self.offset_error = None
        except Exception as error:
            self.offset_error = error_text(error)
            path = self._toolface_log.path
            if at_start and os.path.lexists(path):
                self._damage.note(path, error, "no offset is in force; set it anew: highside toolface set")
                self._toolface_log.changed()
            else:
                log.error("toolface offset stays as it is: %s", self.offset_error)
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

    def start(
        self, pipeline: Callable[[], Pipeline], changed: Callable[[], None], latest: Callable[[bytes], None]
    ) -> None:
        """Begin; outputs and metrics are the service's to start. `changed` is called after a new toolface offset,
        `latest` with the payload of each `LatestMessage`.
        """
        self._damage.require_file(self.surveys.path, "surveys are kept in a new file")
        self._trend_of = pipeline().correction.cal_id
        try:
            self._trend = trend_of(self.surveys.recent(), self._trend_of)
        except Exception as error:
            self._damage.note(self.surveys.path, error, "the trend of Gtotal begins anew")
        self.surveys.start()
        self.read_offset(pipeline(), at_start=True)

        async def watch_offset() -> None:
            while True:
                await asyncio.sleep(OFFSET_CHECK_S)
                if self.read_offset(pipeline()):
                    changed()

        self._watches = [
            asyncio.create_task(watch_offset(), name="toolface-offset"),
            asyncio.create_task(self._publish_latest(latest), name="latest"),
        ]

    async def _publish_latest(self, publish_latest: Callable[[bytes], None]) -> None:
        published_s = 0.0
        while True:
            await asyncio.sleep(LATEST_INTERVAL_S)
            newest = self.latest
            if self._in_force().settings.home_assistant is not None and newest.attitude_s > published_s:
                published_s = newest.attitude_s
                publish_latest(latest_payload(newest.attitude_t, newest.attitude))

    def _figures(self) -> Scrape:
        return Scrape(self._in_force().settings.tool.id, self._health(), self.latest.attitude)

    async def stop(self, timeout_s: float) -> None:
        """End; every survey handed over is on the disk afterwards, if the disk takes it."""
        for watch in self._watches:
            watch.cancel()
        await asyncio.gather(*self._watches, return_exceptions=True)
        await asyncio.to_thread(self.surveys.stop, timeout_s)


def _values(attitude: AttitudeOutput) -> dict[str, float | None]:
    return {
        "inc_deg": attitude.inc_deg,
        "inc_std_deg": attitude.inc_std_deg,
        "tf_deg": attitude.tf_deg,
        "tf_std_deg": attitude.tf_std_deg,
        "motor_toolface_deg": attitude.motor_toolface_deg,
        "azi_deg": None if attitude.azimuth is None else attitude.azimuth.azi_deg,
        "azi_std_deg": None if attitude.azimuth is None else attitude.azimuth.azi_std_deg,
        "g_total": attitude.g_total,
        "temp_c": attitude.temp_c,
    }


async def run_outputs(outputs: Iterable[WitsOutput]) -> None:
    """Keep outputs at work until cancelled. What ends although it should not is named; the others go on."""
    tasks = [asyncio.create_task(output.run(), name=output.name) for output in outputs]

    def ended(task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("wits: %s has ended: %s: %s", task.get_name(), type(error).__name__, error)

    for task in tasks:
        task.add_done_callback(ended)
    try:
        await asyncio.Event().wait()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

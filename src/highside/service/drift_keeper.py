"""Around the drift stage: its state on disk, the commands that come over MQTT, its retained message."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.config.settings import Settings
from highside.errors import HighsideError
from highside.service import saved_drift
from highside.service.clock import clock_synced
from highside.service.commands import Commands
from highside.service.damage import DamageLog
from highside.service.drift_stage import DriftStage
from highside.service.messages import DriftCommand, DriftReply

log = logging.getLogger("highside")

FILE = "drift.json"
ALIGN_STD_DEG = 0.5


@dataclass(frozen=True, slots=True)
class DriftParts:
    """What the configuration decides here; replaced as a whole by a reload."""

    settings: Settings
    stage: DriftStage | None
    error: str | None = None
    """why the state of before the restart could not be used"""


class DriftKeeper:
    """Made with the service, `start` and `stop` with its loop. `in_force()` tells which parts are at work.

    `reply(payload, done)` and `tell(payload)` publish on `drift/reply` and (retained) on `drift`.
    """

    def __init__(
        self,
        state_dir: Path,
        reply: Callable[[bytes, bool], None],
        publish_state: Callable[[bytes], None],
        in_force: Callable[[], DriftParts],
        damage: DamageLog,
    ) -> None:
        self._path = state_dir / FILE
        self._publish_state, self._in_force = publish_state, in_force
        self._damage = damage
        self._task: asyncio.Task[None] | None = None
        self._commands = Commands("drift", DriftCommand, DriftReply, self._do, reply, self.publish)
        self._save_error: str | None = None
        self.saves = 0

    @property
    def stage(self) -> DriftStage | None:
        """The stage at work; None: switched off."""
        return self._in_force().stage

    @property
    def error(self) -> str | None:
        """Why the state cannot be kept, or was not taken up and nothing has been kept since."""
        return self._save_error or (None if self.saves else self._in_force().error)

    def build(self, settings: Settings, running: DriftParts | None = None) -> DriftParts:
        """Parts for `settings`: what the running stage knows at this moment goes on under them."""
        if not settings.drift.enabled:
            return DriftParts(settings, None)
        if running is None or running.stage is None:
            return self._load(settings)
        before = running.settings
        if (before.drift, before.site.latitude_deg) == (settings.drift, settings.site.latitude_deg):
            return DriftParts(settings, running.stage)
        saved = running.stage.saved()
        carried = None if saved is None else saved.model_copy(update={"age_s": 0.0})
        return DriftParts(settings, _stage(settings, carried, first_start=not self._path.exists()))

    def _load(self, settings: Settings) -> DriftParts:
        known = os.path.lexists(self._path)
        try:
            now = saved_drift.Stamp.now(synced=clock_synced())
            saved = saved_drift.read(self._path, settings.tool.id, now)
            return DriftParts(settings, _stage(settings, saved, first_start=not known))
        except Exception as error:
            # whatever is wrong with it, the readings are worth more
            damaged = self._damage.note(self._path, error, "the azimuth of before is lost")
            return DriftParts(settings, _stage(settings, None, first_start=not known), damaged)

    def start(self) -> None:
        """In the event loop."""
        self._task = asyncio.create_task(self._run(), name="drift")

    async def stop(self) -> None:
        """Keep the last state."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        await self._save()

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(self._in_force().settings.drift.save_interval_s)
            await self._save()

    async def _save(self) -> None:
        state = None if self.stage is None else self.stage.saved()
        if state is None:
            return
        stamp = saved_drift.Stamp.now(synced=clock_synced())
        try:
            await asyncio.to_thread(saved_drift.write, self._path, self._in_force().settings.tool.id, stamp, state)
        except HighsideError as error:
            if self._save_error != str(error):
                log.error("the azimuth cannot be kept for a restart: %s", error)
            self._save_error = str(error)
        else:
            self.saves += 1
            self._save_error = None

    # --- messages ----------------------------------------------------------------------------------------------

    def publish(self) -> None:
        """The retained message, for tools that have shown gyros."""
        if self.stage is not None and self.stage.has_gyro_data:
            self._publish_state(self.stage.message(time.time()).model_dump_json().encode())

    def health(self) -> dict[str, Any] | None:
        """Member `drift` of the health message."""
        stage = self.stage
        if stage is None:
            return None
        return {
            "aligned": stage.alignment is not None,
            "basis": list(stage.basis),
            "restored": stage.restored,
            "saves": self.saves,
            "commands": self.commands,
            "error": self.error,
        }

    @property
    def commands(self) -> int:
        """Messages on `drift/command` so far."""
        return self._commands.count

    def on_command(self, payload: bytes, retained: bool) -> None:
        """A message on `drift/command`. Never raises; every command is answered."""
        self._commands.on_command(payload, retained=retained)

    def _do(self, command: DriftCommand) -> str | None:
        stage = self.stage
        if stage is None:
            return "the drift stage is switched off: set drift.enabled = true"
        if command.command == "align":
            assert command.azimuth_deg is not None
            std = ALIGN_STD_DEG if command.std_deg is None else command.std_deg
            return stage.align(command.azimuth_deg, std, time.time())
        if command.command == "reset_heading":
            return stage.reset_heading()
        if command.command == "connection":
            assert command.seconds is not None
            return stage.connection(command.seconds)
        return stage.restart()


def _stage(settings: Settings, saved: saved_drift.SavedDrift | None, *, first_start: bool) -> DriftStage:
    return DriftStage(
        settings.drift, settings.site.latitude_deg, saved, loaded_mono=time.monotonic(), first_start=first_start
    )

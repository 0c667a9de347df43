"""Around the watch: its sums in a thread, its state on disk, its commands, its retained message.

The prior is the calibration record in force. Another record, or another gravity of the site, begins the watch anew and
says so, and the history of the last day goes on with a mark; other limits go on with what was seen.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from highside.config.settings import Settings
from highside.errors import InputError
from highside.service import saved_watch
from highside.service.clock import clock_synced
from highside.service.commands import Commands
from highside.service.damage import DamageLog
from highside.service.in_force import CalibrationInForce, error_text
from highside.service.saved_drift import Stamp
from highside.service.saved_watch import SavedWatch
from highside.service.watch_history import history
from highside.service.watch_messages import WatchCommand, WatchHistory, WatchMessage, WatchReply
from highside.service.watch_said import message
from highside.service.watch_stage import DEPARTS, Carried, Watched, WatchStage

log = logging.getLogger("highside")

FILE = "watch.json"
SWITCHED_OFF = "it is switched off in the configuration"


@dataclass(frozen=True, slots=True)
class WatchParts:
    """What the configuration and the calibration decide here; replaced as a whole by a reload."""

    settings: Settings
    stage: WatchStage | None
    error: str | None = None
    """why the state of before could not be used"""
    why_not: str | None = None
    """why there is no stage although it is switched on"""


class WatchKeeper:
    """Made with the service, `start` and `stop` with its loop. `in_force()` tells which parts are at work.

    `reply(payload, done)` publishes on `watch/reply`; `retained(topic)` gives what publishes on `watch` and
    `watch/history`.
    """

    def __init__(
        self,
        state_dir: Path,
        reply: Callable[[bytes, bool], None],
        retained: Callable[[str], Callable[[bytes], None]],
        in_force: Callable[[], WatchParts],
        damage: DamageLog,
    ) -> None:
        self._path = state_dir / FILE
        self._publish_state, self._publish_history = retained("watch"), retained("watch/history")
        self._in_force, self._damage = in_force, damage
        self._commands = Commands("watch", WatchCommand, WatchReply, self._do, reply, self._changed)
        self._task: asyncio.Task[None] | None = None
        self._wake = asyncio.Event()
        self._dirty = False
        """something is known that is not on the disk"""
        self._commanded = False
        """a command was obeyed that is not on the disk: what a person said is kept at once"""
        self._news = True
        self._stands = False
        """something was said that is to be taken back once nothing is watched"""
        self._leaving: WatchStage | None = None
        """switched off: what it collected is used and kept before it goes"""
        self.figures: dict[str, float | None] = {}
        """for WITS: the newest, the same dict always"""
        self._published_s = self._saved_s = 0.0
        self._verdict = ""
        self._save_error: str | None = None
        self._fault: str | None = None
        self.saves = 0

    @property
    def stage(self) -> WatchStage | None:
        """The stage at work; None: switched off, or there is nothing to watch."""
        return self._in_force().stage

    @property
    def error(self) -> str | None:
        """Why the state cannot be kept, was not taken up and nothing has been kept since, or what failed."""
        return self._fault or self._save_error or (None if self.saves else self._in_force().error)

    # --- parts -------------------------------------------------------------------------------------------------

    def build(
        self, settings: Settings, calibration: CalibrationInForce, running: WatchParts | None = None
    ) -> WatchParts:
        """Parts for `settings` and the calibration in force; what the running stage knows of the same record goes on.
        Never raises: a watch that cannot be made costs the watch alone."""
        if not settings.watch.enabled or calibration.record is None:
            return WatchParts(
                settings, None, why_not=None if calibration.record else "no calibration record is in force"
            )
        gravity = calibration.gravity(settings)
        of = Watched(calibration.record, gravity.expected, gravity.std_mg / gravity.unit_mg)
        before = None if running is None else running.stage or self._leaving
        if before is not None and running is not None:
            if (before.of, running.settings.watch) == (of, settings.watch):
                return WatchParts(settings, before, running.error)
            if before.of == of:
                state, carried = before.carried()
                return self._made(settings, of, state, "went on under other limits", continues=carried)
            changed = "the calibration" if before.cal_id != of.record.id else "the site's gravity"
            why = f"began anew: {changed} is another one ({of.record.id[:12]})"
            return self._made(settings, of, None, why, before.saved().model_copy(update={"age_s": 0.0}))
        return self._load(settings, of)

    def _load(self, settings: Settings, of: Watched) -> WatchParts:
        try:
            saved = saved_watch.read(self._path, settings.tool.id, Stamp.now(synced=clock_synced()))
        except Exception as error:
            # whatever is wrong with it, the readings are worth more
            return self._damaged(settings, of, error)
        if saved is None:
            return self._made(settings, of, None, "began from the record")
        if saved.cal_id != of.record.id:
            why = f"began anew: the calibration is another one ({of.record.id[:12]}, before {saved.cal_id[:12]})"
            return self._made(settings, of, None, why, saved)
        if saved.gravity != of.gravity:
            return self._made(settings, of, None, "began anew: the site's gravity is another one", saved)
        age = "of unknown age" if saved.age_s is None else f"{saved.age_s:.1f} s old"
        try:
            return WatchParts(settings, self._stage(settings, of, saved, f"taken up again, {age}"))
        except InputError as error:
            return WatchParts(settings, None, why_not=error_text(error))
        except Exception as error:
            return self._damaged(settings, of, error)

    def _damaged(self, settings: Settings, of: Watched, error: Exception) -> WatchParts:
        text = self._damage.note(self._path, error, "the watch begins anew from the calibration record")
        parts = self._made(settings, of, None, "began anew: what was kept is damaged")
        return WatchParts(settings, parts.stage, text, parts.why_not)

    def _made(
        self,
        settings: Settings,
        of: Watched,
        saved: SavedWatch | None,
        began: str,
        follows: SavedWatch | None = None,
        continues: Carried | None = None,
    ) -> WatchParts:
        try:
            return WatchParts(settings, self._stage(settings, of, saved, began, follows, continues))
        except InputError as error:
            return WatchParts(settings, None, why_not=error_text(error))

    def _stage(
        self,
        settings: Settings,
        of: Watched,
        saved: SavedWatch | None,
        began: str,
        follows: SavedWatch | None = None,
        continues: Carried | None = None,
    ) -> WatchStage:
        return WatchStage(
            settings.watch,
            of,
            saved,
            follows=follows,
            continues=continues,
            loaded_mono=time.monotonic(),
            began=began,
            on_stretch=self._wake.set,
        )

    # --- running -----------------------------------------------------------------------------------------------

    def start(self) -> None:
        """In the event loop."""
        # of a run before this one the broker may hold what nobody watches over now
        self._stands = self._path.exists()
        self._say_what_began()
        self._look_at_age()
        self.publish()
        self._task = asyncio.create_task(self._run(), name="watch")

    def took_over(self, before: WatchStage | None) -> None:
        """Other parts are in force, in the place of `before`."""
        before, stage, self._leaving = before or self._leaving, self.stage, None
        if stage is None:
            # a rig would be told for ever what nobody watches any more
            self.figures.clear()
            if before is not None:
                before.finish()
                self._leaving = before
        elif before is not None and before.of != stage.of and (lost := before.replaced_by(stage)):
            log.warning("watch: %d stretches before the reload were not used: they are of another record", lost)
        self._say_what_began()
        self._changed()

    def _say_what_began(self) -> None:
        parts = self._in_force()
        if parts.stage is not None:
            log.info("watch: %s", parts.stage.began)
        elif parts.why_not is not None and parts.settings.watch.enabled:
            log.info("watch: none, %s", parts.why_not)

    async def stop(self) -> None:
        """Use what was collected, and keep the last state."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        await self._let_go()
        if (stage := self.stage) is not None:
            stage.finish()
            await self._work(stage)
            await self._save(stage)
        self._news = True
        self.publish()

    def _changed(self) -> None:
        self._dirty = self._news = True
        self._wake.set()

    async def _run(self) -> None:
        while True:
            settings = self._in_force().settings.watch
            # `interval_s` also bounds how late a change is published that came soon after another
            with_timeout = min(settings.interval_s, settings.save_interval_s)
            try:
                async with asyncio.timeout(with_timeout):
                    await self._wake.wait()
            except TimeoutError:
                pass
            self._wake.clear()
            await self._let_go()
            if (stage := self.stage) is not None:
                await self._work(stage)
            self._look_at_age()
            now = time.monotonic()
            if self._news and now - self._published_s >= settings.interval_s:
                self.publish()
            stage = self.stage
            if (
                stage is not None
                and self._dirty
                and (self._commanded or now - self._saved_s >= settings.save_interval_s)
            ):
                await self._save(stage)

    def _look_at_age(self) -> None:
        """What nothing was measured for since is said to be old."""
        stage = self.stage
        if stage is not None and stage.grown_old(time.monotonic()):
            self._dirty = self._news = True
            self._verdict = stage.said.verdict
            log.warning("watch: %s; %s", stage.said.verdict, stage.said.advice[0])

    async def _let_go(self) -> None:
        """Of a watch that was switched off the last stretches are used, and what it knows is kept."""
        if (leaving := self._leaving) is not None:
            await self._work(leaving)
            if leaving is self._leaving:
                await self._save(leaving)
            if leaving is self._leaving:
                self._leaving = None

    async def _work(self, stage: WatchStage) -> None:
        """The sums of the stretches that wait, one after another."""
        while stage.waiting and stage in (self.stage, self._leaving):
            stretch, core = stage.waiting.popleft(), stage.core
            stage.working = stretch
            try:
                said = await asyncio.to_thread(core.take, stretch)
            except Exception as error:  # a defect here must not cost the readings
                self._failed("a stretch could not be used", error)
                continue
            finally:
                stage.working = None
            if stage.core is not core:  # it was told to begin again meanwhile
                continue
            stage.take_result(said)
            self._dirty = self._news = True
            if said.verdict != self._verdict and stage is self.stage:
                self._verdict = said.verdict
                level = logging.WARNING if said.verdict == "departs" else logging.INFO
                log.log(level, "watch: %s; %s", said.verdict, said.advice[0])
                self.publish()

    def _failed(self, what: str, error: Exception) -> None:
        if self._fault is None:
            log.error("watch: %s", what, exc_info=error)
        self._fault = error_text(error)

    async def _save(self, stage: WatchStage) -> None:
        tool = self._in_force().settings.tool.id
        self._saved_s = time.monotonic()
        self._dirty = self._commanded = False
        stamp = Stamp.now(synced=clock_synced())

        def keep() -> None:
            saved_watch.write(self._path, tool, stamp, stage.said.to_dict(), stage.saved())

        try:
            await asyncio.to_thread(keep)
        except Exception as error:  # whatever it is: the service must not end by it
            if self._save_error != (text := error_text(error)):
                log.error("the watch cannot be kept for a restart: %s", text)
            self._save_error = text
            self._dirty = True
        else:
            self.saves += 1
            self._save_error = None

    # --- messages ----------------------------------------------------------------------------------------------

    def publish(self) -> None:
        """The retained messages, if there is something to say."""
        stage = self.stage
        if self._news and (stage is not None or self._stands):
            self._news, self._stands = False, stage is not None
            self._published_s, now_s = time.monotonic(), time.time()
            try:
                if stage is None:
                    self._verdict, why = "", f"nothing is watched: {self._in_force().why_not or SWITCHED_OFF}"
                    threshold = self._in_force().settings.watch.policy().threshold
                    said, seen = WatchMessage.off(now_s, why), WatchHistory.off(now_s, why, threshold)
                else:
                    self.figures.update(stage.figures())
                    said, seen = message(stage, now_s, time.monotonic()), history(stage, now_s, time.monotonic())
                self._publish_state(said.model_dump_json().encode())
                self._publish_history(seen.model_dump_json().encode())
            except Exception as error:  # a defect here must not cost the readings
                self._failed("what it says cannot be written", error)

    def health(self) -> dict[str, Any] | None:
        """Member `watch` of the health message."""
        parts = self._in_force()
        if parts.stage is None:
            return None if parts.why_not is None else {"verdict": None, "why_not": parts.why_not}
        return parts.stage.health() | {
            "saves": self.saves,
            "commands": self._commands.count,
            "error": self.error,
            "why_not": None,
        }

    def alarms(self) -> list[str]:
        """Alarms of what is here."""
        found = [DEPARTS] if self.stage is not None and self.stage.departs else []
        return [*found, "watch_state"] if self.error else found

    def on_command(self, payload: bytes, retained: bool) -> None:
        """A message on `watch/command`. Never raises; every command is answered."""
        self._commands.on_command(payload, retained=retained)

    def _do(self, command: WatchCommand) -> str | None:
        parts = self._in_force()
        stage = parts.stage
        if stage is None:
            return f"nothing is watched: {parts.why_not or 'set watch.enabled = true'}"
        if command.command == "acknowledge":
            why_not = stage.acknowledge()
            self._commanded = self._commanded or why_not is None
            return why_not
        stage.begin_again()
        self._fault = None
        self._commanded = True
        return None

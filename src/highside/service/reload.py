"""Reload: everything new is built, then the whole is put in force by one assignment. What fails on the way is undone.

1. *Read*, in a thread: the configuration and every file that it names. Nothing of the service is touched.
2. *Build*: all parts from what was read, beside those that run. Done once to find out what cannot be made.
3. *Open* what has a place in the world: the listener of the metrics, the right to speak as the tool, the link. A link
   that would have to wait for its device is not waited for: what could not be opened refuses the reload, unless
   `wait_at_start` says that it may come later. What stands where the running part stands (the same serial port with
   another baud rate, the same listening port) can only be opened when that is closed: that is done last of all, and
   should the new one fail, the old one is opened again as it was. Only then is anything interrupted, and by the time
   that closing and opening take: what the tool sends meanwhile is lost, and counted as a gap. A link whose limits of
   silence or pauses alone change stays open.
4. *Build* again, since the running parts went on in the meantime, and *swap* them in.

Whatever is raised before the swap, and by whatever, leaves the service as it was: what was opened is closed, what was
closed is opened again. `service.settings` is still the old one, so that a corrected file is applied by the next SIGHUP.
A refused calibration or compensation does not refuse the reload: the one in force stays (`in_force`).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, replace
from typing import Any, Protocol

from highside.codec.frame import ByteCodec, CanCodec
from highside.config.settings import Settings
from highside.errors import HighsideError, InputError
from highside.link.base import LinkError, LinkSupervisor
from highside.link.opened import OpenedTransport
from highside.service.broker_client import check_secrets
from highside.service.clock_watch import ClockWatch
from highside.service.drift_keeper import DriftKeeper, DriftParts
from highside.service.in_force import CalibrationInForce, CompensationInForce, calibration_for, error_text, rotation_for
from highside.service.leaving import Leaving
from highside.service.notify import Notifier
from highside.service.parts import ServiceParts, Tap, make_supervisor
from highside.service.pipeline import Pipeline
from highside.service.places import ToolLock
from highside.service.publisher import Publisher
from highside.service.quiet_log import QuietLog
from highside.service.rig.metrics import MetricsServer
from highside.service.rig.rig import Rig, run_outputs
from highside.service.watch_keeper import WatchKeeper, WatchParts

log = logging.getLogger("highside")

ONLY_BY_RESTART = ("service.state_dir", "tool.id", "mqtt.outbox", "mqtt.historical_after_s")
"""Fields that decide where messages are kept and under which name: they hold for the life of the process."""


class Reloadable(Protocol):
    """What a reload needs of the service: the parts in force, what makes others, and what puts them in force."""

    parts: ServiceParts
    clock: ClockWatch
    leaving: Leaving
    notifier: Notifier
    rig: Rig
    drift: DriftKeeper
    watch: WatchKeeper

    @property
    def settings(self) -> Settings: ...

    def make_pipeline(
        self,
        settings: Settings,
        codec: ByteCodec | CanCodec,
        calibration: CalibrationInForce,
        rotation: CompensationInForce,
        drift: DriftParts,
        watch: WatchParts,
    ) -> Pipeline: ...

    def make_publisher(self, settings: Settings) -> Publisher: ...

    def make_tap(self) -> Tap: ...

    def take(self, parts: ServiceParts) -> None: ...

    def run_link(self, supervisor: LinkSupervisor) -> None: ...

    def announce(self) -> None: ...

    def publish_health(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Read:
    """What stands in the files."""

    settings: Settings
    codec: ByteCodec | CanCodec | None
    """None: it has not changed"""
    calibration: CalibrationInForce
    rotation: CompensationInForce


@dataclass(frozen=True, slots=True)
class Opened:
    """What was opened for the new parts; None: nothing new is needed, the running one stays (or there is none)."""

    metrics: MetricsServer | None = None
    tool_lock: ToolLock | None = None
    link: OpenedTransport | None = None


NOTHING_OPENED = Opened()


async def open_link(settings: Settings, undo: AsyncExitStack) -> OpenedTransport | None:
    """The configured link, open; None: it is opened by its supervisor, now or when it can be.

    Raises InputError if it cannot be opened and is not to be waited for. `undo` closes it.
    """
    if not _opened_first(settings):
        return None
    opened = OpenedTransport(settings.link.transport())
    undo.push_async_callback(opened.close)
    try:
        await opened.open_ahead()
    except LinkError as error:
        raise InputError(
            error.message,
            field="the [link] table",
            remedy="fix it, or set link.wait_at_start = true to wait for it",
        ) from error
    return opened


def _opened_first(settings: Settings) -> bool:
    return settings.link.opens_ahead and not settings.link.wait_at_start


class Reload:
    """One attempt. `run` puts the new configuration in force, or raises with everything as it was."""

    def __init__(self, service: Reloadable, load: Callable[[], Settings]) -> None:
        self._service, self._load = service, load
        self._old = service.parts
        self._present = service.clock.present()
        self.doing = "reading the configuration"
        """for whoever has to say where it failed"""

    @property
    def done(self) -> bool:
        """Whether the new configuration is in force."""
        return self._service.settings is not self._old.settings

    async def run(self) -> None:
        """Raises whatever went wrong."""
        read = await asyncio.to_thread(self._read)
        self.doing = "building the parts"
        self._build(read, NOTHING_OPENED)
        await self._service.leaving.all_gone()
        async with AsyncExitStack() as undo:
            opened = await self._open(read.settings, undo)
            self.doing = "putting the new parts in force"
            self._swap(self._build(read, opened), undo)

    def _read(self) -> Read:
        """In a thread: the codec may have to parse a file, a certificate or a disk may be slow."""
        new, old = self._load(), self._old.settings
        for field in ONLY_BY_RESTART:
            table, name = field.split(".")
            if getattr(getattr(new, table), name) != getattr(getattr(old, table), name):
                raise InputError("cannot change while running", field=field, remedy="restart the service instead")
        self.doing = "reading the codec's files"
        codec = new.codec.build() if new.codec != old.codec else None
        self.doing = "reading password and certificates"
        if new.mqtt != old.mqtt:
            check_secrets(new.mqtt)
        self.doing = "reading calibration and compensation"
        calibration = calibration_for(new, self._present, self._old.calibration)
        return Read(new, codec, calibration, rotation_for(new, self._old.rotation))

    def _build(self, read: Read, opened: Opened) -> ServiceParts:
        """All parts; neither the running ones nor the world outside are touched."""
        service, old, new = self._service, self._old, read.settings
        before = old.settings
        drift = service.drift.build(new, old.drift)
        watch = service.watch.build(new, read.calibration, old.watch)
        rig = service.rig.build(new, old.rig)
        parts = replace(
            old,
            settings=new,
            calibration=read.calibration,
            rotation=read.rotation,
            drift=drift,
            watch=watch,
            rig=replace(rig, metrics=old.rig.metrics if new.metrics == before.metrics else opened.metrics),
            tool_lock=opened.tool_lock or old.tool_lock,
        )
        if read.codec is not None:
            pipeline = service.make_pipeline(new, read.codec, read.calibration, read.rotation, drift, watch)
        else:
            pipeline = old.pipeline.successor(
                before,
                new,
                correction=read.calibration.correction,
                rotation=read.rotation.live,
                drift=drift.stage,
                watch=watch.stage,
            )
            pipeline.extra_flags = parts.flags
            pipeline.gravity = read.calibration.gravity(new)
        parts = replace(parts, pipeline=pipeline)
        if new.mqtt != before.mqtt:
            parts = replace(parts, publisher=service.make_publisher(new))
        if not new.link.same_line(before.link):
            tap = service.make_tap()
            parts = replace(parts, tap=tap, supervisor=make_supervisor(new.link, tap, opened.link))
        return parts

    # --- what has a place in the world -----------------------------------------------------------------------------

    async def _open(self, new: Settings, undo: AsyncExitStack) -> Opened:
        old = self._old.settings
        found = NOTHING_OPENED
        if ToolLock.name_of(new.tool.id, new.mqtt) != ToolLock.name_of(old.tool.id, old.mqtt):
            self.doing = "asking for the tool's name at the broker"
            lock = ToolLock(new.tool.id, new.mqtt)
            undo.callback(lock.release)
            found = replace(found, tool_lock=lock)
        link_stays = new.link.same_line(old.link)
        link_first = not link_stays and not self._link_in_the_way(new)
        if link_first:
            found = replace(found, link=await self._open_link(new, undo))
        if new.metrics != old.metrics:
            found = replace(found, metrics=await self._open_metrics(new, undo))
        if not link_stays and not link_first:
            await self._close_link(undo)
            found = replace(found, link=await self._open_link(new, undo))
        return found

    def _link_in_the_way(self, new: Settings) -> bool:
        """Whether the running link holds what the new one needs in order to be opened."""
        place = new.link.place
        return _opened_first(new) and place is not None and place == self._old.settings.link.place

    async def _open_link(self, new: Settings, undo: AsyncExitStack) -> OpenedTransport | None:
        self.doing = "opening the link"
        return await open_link(new, undo)

    async def _close_link(self, undo: AsyncExitStack) -> None:
        """Make room for the new link."""
        self.doing = "closing the running link"
        task = self._old.link_task
        undo.push_async_callback(self._link_again)
        if task is not None:
            task.cancel()
            await asyncio.wait({task})

    async def _link_again(self) -> None:
        """The old link is opened again by its own supervisor."""
        task = self._old.link_task
        if task is not None:
            if not task.done() and not task.cancelling():
                return  # it was not closed yet
            await asyncio.wait({task})
        self._service.run_link(self._old.supervisor)

    async def _open_metrics(self, new: Settings, undo: AsyncExitStack) -> MetricsServer | None:
        self.doing = "opening the [metrics] listener"
        rig, running, old = self._service.rig, self._old.rig.metrics, self._old.settings
        if new.metrics is None:
            return None
        if running is not None and old.metrics is not None and new.metrics.port == old.metrics.port:
            # the same port at another address: only one of the two can listen
            undo.push_async_callback(self._metrics_again, running)
            await asyncio.to_thread(running.close)
        undo.push_async_callback(asyncio.to_thread, (server := rig.open_metrics(new.metrics)).close)
        return server

    async def _metrics_again(self, running: MetricsServer) -> None:
        """The old figures are served again."""
        if not running.closed:
            return
        service, server = self._service, None
        try:
            if self._old.settings.metrics is not None:
                server = service.rig.open_metrics(self._old.settings.metrics)
        except Exception as error:
            log.error("the figures are no longer served: %s", error_text(error))
        service.take(replace(service.parts, rig=replace(service.parts.rig, metrics=server)))

    # --- in force --------------------------------------------------------------------------------------------------

    def _swap(self, parts: ServiceParts, undo: AsyncExitStack) -> None:
        """The tasks of the new parts are made, then all is put in force at once. Nothing here waits, so no frame comes
        in between; a task made here has not begun when it is cancelled again."""
        service, old = self._service, self._old
        made: dict[str, Any] = {}
        try:
            if parts.supervisor is not old.supervisor:
                made["link_task"] = service.leaving.successor("link", old.link_task, parts.supervisor.run)
            if parts.publisher is not old.publisher:
                made["publisher_task"] = service.leaving.successor("publisher", old.publisher_task, parts.publisher.run)
            if parts.rig.outputs is not old.rig.outputs:
                outputs = parts.rig.outputs
                made["wits_task"] = service.leaving.successor("wits", old.wits_task, lambda: run_outputs(outputs))
            if parts.supervisor is old.supervisor:
                parts.supervisor.apply(parts.settings.link.supervisor())
            service.take(replace(parts, **made))
            undo.pop_all()
        except BaseException:
            for task in made.values():
                task.cancel()
            old.supervisor.apply(old.settings.link.supervisor())
            service.take(old)
            raise

    def retire(self) -> None:
        """Close what the new parts have replaced and no task of theirs closes."""
        old, new = self._old, self._service.parts
        if old.tool_lock is not None and new.tool_lock is not old.tool_lock:
            old.tool_lock.release()
        if old.rig.metrics is not None and new.rig.metrics is not old.rig.metrics:
            self._service.leaving.let(asyncio.create_task(asyncio.to_thread(old.rig.metrics.close), name="metrics"))
        announced = [(settings.home_assistant, settings.service) for settings in (new.settings, old.settings)]
        if new.publisher is not old.publisher or announced[0] != announced[1]:
            self._service.announce()


class Reloader:
    """Answers SIGHUP: one reload at a time; what is requested meanwhile is done afterwards, once."""

    def __init__(self, service: Reloadable, load: Callable[[], Settings] | None) -> None:
        self._service, self._load = service, load
        self._requested = asyncio.Event()
        self._quiet, self._quiet_changes, self._said = QuietLog(log), QuietLog(log), ""
        self.count = 0
        self.refused: dict[str, Any] | None = None
        """of the last attempt: what, and as far as it is known where and which field"""

    def ask(self) -> None:
        """From the signal handler."""
        self._service.notifier.reloading("reloading")
        self._requested.set()

    async def run(self) -> None:
        """Reload whenever asked, until cancelled."""
        while True:
            await self._requested.wait()
            self._requested.clear()
            await self._reload()
            if not self._requested.is_set():
                self._service.notifier.ready(self._outcome())
            self._service.publish_health()

    async def _reload(self) -> None:
        if self._load is None:
            return
        reload: Reload | None = None
        try:
            reload = Reload(self._service, self._load)
            await reload.run()
            reload.retire()
        except Exception as error:
            if reload is None or not reload.done:
                self.refused = _refusal(error, "beginning" if reload is None else reload.doing)
                self._say(
                    logging.ERROR, "reload refused, the old configuration stays in force: %s", self.refused["refused"]
                )
                log.debug("reload refused", exc_info=error)
                return
            self._say(logging.ERROR, "reloaded, but something of before was not closed: %s", error_text(error))
        self.refused = None
        self.count += 1
        self._say(logging.INFO, self._outcome())

    def _say(self, level: int, text: str, *args: object) -> None:
        """One line of an outcome a minute, and one of each change from one outcome to another."""
        outcome = text % args if args else text
        if not self._quiet.say(level, outcome, "%s", outcome) and outcome != self._said:
            self._quiet_changes.say(level, f"{self._said} -> {outcome}", "%s", outcome)
        self._said = outcome

    def _outcome(self) -> str:
        if self.refused is not None:
            return f"reload refused: {self.refused['refused']}"
        kept = [flag for flag in self._service.parts.flags if flag.endswith("_kept")]
        return f"reloaded, but {' and '.join(kept)}" if kept else "reloaded"

    def note(self) -> str:
        """For the status line that systemd shows, as long as the last reload stands refused."""
        return "" if self.refused is None else f"; {self._outcome()}"

    def as_dict(self) -> dict[str, Any]:
        """Member `reload` of the health message."""
        return {"count": self.count, "refused": None} | (self.refused or {})


def _refusal(error: Exception, doing: str) -> dict[str, Any]:
    """What the health message says of a refused reload."""
    text = error_text(error) if isinstance(error, HighsideError) else f"{error_text(error)} (while {doing})"
    where, field = getattr(error, "where", None), getattr(error, "field", None)
    return {"refused": text, "where": where, "field": field, "while": doing, "t": round(time.time(), 3)}

"""The daemon: puts link, pipeline, outbox, publisher, recorder and health together and keeps them running.

One event loop; acquisition is a callback of it and never waits: what is slow (SQLite, fsync, the network) has threads
and tasks of its own behind bounded hand-overs that count what they drop. What follows from the configuration is one
value, `ServiceParts`, which a reload (SIGHUP) makes anew and puts in force as a whole, or not at all (`reload`).
SIGTERM leaves within ten seconds: acquisition stops, the last window is committed to the outbox, `offline` is
published, what is not acknowledged stays on disk.

At the start the state directory comes first, then the right to speak as this tool, then the link; only then is the
broker spoken to. A daemon that finds one of them taken ends without a word to anybody.

The watchdog is fed by the progress of the pipeline: the loop turns and the outbox commits. A dead broker or a dead
link is not a wedged pipeline and is never answered by a restart.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from highside.config.places import left_behind
from highside.config.settings import Settings
from highside.errors import InputError
from highside.link.base import Batch, LinkReason, LinkState, LinkSupervisor
from highside.service import messages
from highside.service.broker_client import check_secrets
from highside.service.clock import LoopLag
from highside.service.clock_watch import ClockWatch
from highside.service.damage import DamageLog
from highside.service.drift_keeper import DriftKeeper
from highside.service.health import Health
from highside.service.in_force import calibration_for, error_text, rotation_for
from highside.service.leaving import Leaving
from highside.service.notify import Notifier
from highside.service.outbox import Outbox
from highside.service.outputs import AttitudeOutput, Survey
from highside.service.parts import ServiceParts, Tap, make_pipeline, make_supervisor
from highside.service.pipeline import Pipeline
from highside.service.places import StateLock, ToolLock, state_dir
from highside.service.progress import feed_watchdog
from highside.service.publisher import Publisher
from highside.service.quiet_log import QuietLog
from highside.service.reconnect import new_instance
from highside.service.recorder import Recorder
from highside.service.reload import Reloader, open_link
from highside.service.rig.home_assistant import discovery
from highside.service.rig.rig import Rig, run_outputs
from highside.service.starts import StartLog
from highside.service.tasks import cancelled, first_to_end
from highside.service.watch_keeper import WatchKeeper

log = logging.getLogger("highside")

STOP_BUDGET_S = 8.0
"""How long an orderly end may take; systemd would kill after 10 s."""
LINK_LINES = 3
"""Lines a minute for each state and reason of the link: a plug that is seated anew is logged in full, a loose contact
in a few lines; `health` counts every one."""


class Service:
    """One tool's daemon. `reload` re-reads the configuration (it may raise InputError)."""

    def __init__(
        self, settings: Settings, reload: Callable[[], Settings] | None = None, notifier: Notifier | None = None
    ) -> None:
        self.state_dir = state_dir(settings)
        self.notifier = notifier or Notifier()
        self._lock = StateLock(self.state_dir)
        self._places = contextlib.AsyncExitStack()
        """gives back what the start has opened and nobody has taken over"""
        self._lag, self.clock = LoopLag(), ClockWatch(self.state_dir)
        self._stopping, self._changed = asyncio.Event(), asyncio.Event()
        """other tasks are to be watched"""
        self._refused_link: str | None = None
        self._quiet_link = QuietLog(log, burst=LINK_LINES)
        self._instance = new_instance()
        """names this run at the broker"""
        self.leaving = Leaving()
        keep = settings.mqtt.outbox
        self.outbox = Outbox(
            self.state_dir / "outbox.sqlite",
            max_rows=keep.max_rows,
            max_age_s=keep.max_age_s,
            max_bytes=keep.max_bytes,
            commit_interval_s=keep.commit_interval_s,
            historical_after_s=settings.mqtt.historical_after_s,
        )
        self.recorder = Recorder(
            settings.recorder,
            self.state_dir / "recordings",
            settings.tool.id,
            meta={"codec": settings.codec.name, "link": settings.link.kind},
            channel=str(getattr(settings.link, "interface", None) or "can0"),
        )
        self.damage = DamageLog()
        self._starts = StartLog(self.state_dir)
        self.rig = Rig(self.state_dir, self.health, lambda: self.parts.rig, self.damage)
        self.drift = DriftKeeper(
            self.state_dir, self._replies("drift"), self._states("drift"), lambda: self.parts.drift, self.damage
        )
        self.watch = WatchKeeper(
            self.state_dir, self._replies("watch"), self._states, lambda: self.parts.watch, self.damage
        )
        self.make_pipeline = partial(make_pipeline, emit=self._on_output, rig=self.rig)
        self.parts = self._make_parts(settings)
        self.reloader = Reloader(self, reload)
        self._health = Health(
            lambda: self.parts,
            self.reloader.as_dict,
            outbox=self.outbox,
            recorder=self.recorder,
            rig=self.rig,
            drift=self.drift,
            watch=self.watch,
            damage=self.damage,
            starts=self._starts,
            steps=self.clock.steps,
            lag=self._lag,
            state_lock=self._lock,
        )
        self.on_output: Callable[[AttitudeOutput | Survey, int], None] | None = None
        """called with every output and its sequence number, for faces inside the process"""

    # --- parts -------------------------------------------------------------------------------------------------

    @property
    def settings(self) -> Settings:
        """The configuration in force."""
        return self.parts.settings

    @property
    def pipeline(self) -> Pipeline:
        """The pipeline in force."""
        return self.parts.pipeline

    @property
    def publisher(self) -> Publisher:
        """The publisher in force."""
        return self.parts.publisher

    @property
    def supervisor(self) -> LinkSupervisor:
        """Of the link in force."""
        return self.parts.supervisor

    def _make_parts(self, settings: Settings) -> ServiceParts:
        """All parts for the start."""
        calibration = calibration_for(settings, self.clock.present())
        rotation, drift = rotation_for(settings), self.drift.build(settings)
        watch = self.watch.build(settings, calibration)
        tap = self.make_tap()
        return ServiceParts(
            settings=settings,
            calibration=calibration,
            rotation=rotation,
            pipeline=self.make_pipeline(settings, settings.codec.build(), calibration, rotation, drift, watch),
            publisher=self.make_publisher(settings),
            tap=tap,
            supervisor=make_supervisor(settings.link, tap, None),
            drift=drift,
            watch=watch,
            rig=self.rig.build(settings),
        )

    def make_publisher(self, settings: Settings) -> Publisher:
        """A publisher that has not connected."""
        topic = partial(settings.mqtt.topic, settings.tool.id)
        commands = {topic("drift/command"): self.drift.on_command, topic("watch/command"): self.watch.on_command}
        return Publisher(
            settings.mqtt, self.outbox, tool_id=settings.tool.id, commands=commands, instance=self._instance
        )

    def make_tap(self) -> Tap:
        """For a link that is not in force yet."""
        return Tap(self, lambda: self.parts.tap)

    def take(self, parts: ServiceParts) -> None:
        """Put other parts in force."""
        before, self.parts = self.parts.watch.stage, parts
        if parts.watch.stage is not before:
            self.watch.took_over(before)
        self.recorder.apply(parts.settings.recorder)
        self._changed.set()

    def _judge_age(self) -> None:
        """The calibration in force may have expired meanwhile."""
        calibration = self.parts.calibration.aged(self.clock.present())
        if calibration is not self.parts.calibration:
            self.parts = replace(self.parts, calibration=calibration)
            self.pipeline.extra_flags = self.parts.flags
            self.publish_health()

    def _topic(self, name: str) -> str:
        return self.settings.mqtt.topic(self.settings.tool.id, name)

    def _replies(self, name: str) -> Callable[[bytes, bool], None]:
        return lambda payload, done: self.publisher.reply(self._topic(f"{name}/reply"), payload, done=done)

    def _states(self, name: str) -> Callable[[bytes], None]:
        return lambda payload: self.publisher.retained(self._topic(name), payload)

    def _publish_latest(self, payload: bytes) -> None:
        self.publisher.passing(self._topic("latest"), payload)

    # --- the sink of the link ----------------------------------------------------------------------------------

    def on_batch(self, batch: Batch) -> None:
        self.recorder.on_batch(batch)
        self.pipeline.on_batch(batch)

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        level = logging.WARNING if state in (LinkState.DOWN, LinkState.STALE) else logging.INFO
        reason_text = "" if reason is None else reason.value
        self._quiet_link.say(level, f"{state.value} {reason_text}", "link %s: %s", state.value, message)
        if state in (LinkState.DOWN, LinkState.CONNECTING):
            self.pipeline.on_link_reopened()  # what a link began, the next one does not complete
        if state is LinkState.DOWN:
            if not self.supervisor.stats.opens and not self.settings.link.wait_at_start and not self.reloader.count:
                self._refused_link = message
                self.stop()
        elif state is LinkState.ENDED:
            self.pipeline.finish()
        self.publish_health()

    # --- outputs -----------------------------------------------------------------------------------------------

    def _on_output(self, output: AttitudeOutput | Survey) -> None:
        now_wall, now_mono = time.time(), time.monotonic()
        attitude = output.attitude if isinstance(output, Survey) else output
        t_wall = now_wall - (now_mono - attitude.t_mono) if attitude.t_mono else now_wall
        if isinstance(output, Survey):
            topic = self._topic("survey")
            seq = self.outbox.next_seq(topic)
            payload = messages.survey_payload(seq, t_wall, attitude.t_mono, self.clock.synced, output)
            self.rig.on_survey(output, seq, t_wall)
        else:
            topic = self._topic("attitude")
            seq = self.outbox.next_seq(topic)
            payload = messages.attitude_payload(seq, t_wall, attitude.t_mono, self.clock.synced, output)
            self.rig.on_attitude(output, t_wall)
        self.outbox.put(topic, payload, synced=self.clock.synced)
        if self.on_output is not None:
            self.on_output(output, seq)

    def health(self) -> messages.HealthMessage:
        """What the retained `health` message says; every counter balances at any time (`balance`)."""
        return self._health.message(clock_synced=self.clock.synced)

    def announce(self) -> None:
        settings = self.settings
        if settings.home_assistant is not None:
            tool = settings.tool
            interval_s = settings.service.health_interval_s
            found = discovery(
                tool.id, tool.serial, settings.mqtt, settings.home_assistant, health_interval_s=interval_s
            )
            self.publisher.retained(*found)

    def publish_health(self) -> None:
        self.publisher.retained(self._topic("health"), messages.health_payload(self.health()))
        self.drift.publish()

    # --- running -----------------------------------------------------------------------------------------------

    async def run(self, *, signals: bool = True) -> None:
        """Run until SIGTERM or SIGINT (`signals`), or `stop`, or until a replayed recording has ended and is delivered.

        Raises InputError if the state directory cannot be used or another daemon uses it, if another daemon speaks as
        this tool, if a file with a password or a certificate cannot be used, or if the link cannot be opened at the
        start and is not to be waited for.
        """
        await asyncio.to_thread(check_secrets, self.settings.mqtt)
        loop = asyncio.get_running_loop()
        handlers = ((signal.SIGTERM, self.stop), (signal.SIGINT, self.stop), (signal.SIGHUP, self.reloader.ask))
        for number, handler in handlers if signals else ():
            loop.add_signal_handler(number, handler)
        others: list[asyncio.Task[None]] = []
        how: str | None = None
        try:
            if await self._take_places():
                others = self._start()
                await self._until_stopped(others)
            how = self._refused_link
        except BaseException as error:
            how = error_text(error)
            raise
        finally:
            self.notifier.stopping("leaving")
            await self._shut_down(others, how)
            self.notifier.close()
            # only now: an impatient second signal must not end the process before the outbox is committed
            for number, _ in handlers if signals else ():
                loop.remove_signal_handler(number)
        if self._refused_link is not None:
            raise InputError(
                self._refused_link,
                field="the [link] table",
                remedy="fix it, or set link.wait_at_start = true to wait for it",
            )

    async def _take_places(self) -> bool:
        """What no two daemons can have: state directory, tool, listener, link. False: asked to stop meanwhile.

        Raises InputError; nobody has been notified then, and what was taken is given back by `_shut_down`.
        """
        settings = self.settings
        self._lock.take()
        await asyncio.to_thread(self._starts.begin)
        # where earlier versions kept it by default: not lost without a word
        if settings.service.state_dir is None:
            left = left_behind(Path("state"), self.state_dir, "service.state_dir")
            if left is not None:
                log.warning("%s", left)
        self.parts = replace(self.parts, tool_lock=ToolLock(settings.tool.id, settings.mqtt))
        if settings.metrics is not None:
            metrics = self.rig.open_metrics(settings.metrics)
            self.parts = replace(self.parts, rig=replace(self.parts.rig, metrics=metrics))
        opening = asyncio.create_task(open_link(settings, self._places), name="opening the link")
        stopping = asyncio.create_task(self._stopping.wait(), name="stopping")
        await asyncio.wait({opening, stopping}, return_when=asyncio.FIRST_COMPLETED)
        stopping.cancel()
        if not opening.done():
            await cancelled(opening)
            return False
        opened = opening.result()
        self._places.pop_all()  # from here on the link is its supervisor's to close
        self.parts = replace(self.parts, supervisor=make_supervisor(settings.link, self.parts.tap, opened))
        return True

    def _start(self) -> list[asyncio.Task[None]]:
        """Everything at work; returns the tasks that live as long as the service."""
        self.run_link(self.supervisor)
        self.rig.latest.watch = self.watch.figures
        self.rig.start(lambda: self.pipeline, self.publish_health, self._publish_latest)
        self.drift.start()
        self.watch.start()
        self.damage.require_file(self.state_dir / "outbox.sqlite", "messages are kept in a new file")
        self.outbox.start(wait=False)
        self.damage.require_directory(self.state_dir / "recordings", "the recordings in it, if it held any")
        self.recorder.start()
        self.announce()
        outputs = self.rig.outputs
        self.parts = replace(
            self.parts,
            publisher_task=asyncio.create_task(self.publisher.run(), name="publisher"),
            wits_task=asyncio.create_task(run_outputs(outputs), name="wits"),
        )
        others = [
            asyncio.create_task(self._lag.run(), name="loop-lag"),
            asyncio.create_task(self._health_task(), name="health"),
            asyncio.create_task(self._lock.run(), name="state-lock"),
            asyncio.create_task(self.clock.run(self._judge_age, self.publish_health), name="clock"),
            asyncio.create_task(feed_watchdog(self.notifier, self.outbox), name="watchdog"),
            asyncio.create_task(self.reloader.run(), name="reload"),
        ]
        self.notifier.ready(f"tool {self.settings.tool.id}")
        log.info("tool %s: running, state in %s", self.settings.tool.id, self.state_dir)
        return others

    def run_link(self, supervisor: LinkSupervisor) -> None:
        """Set a supervisor of the link in force to work."""
        self.parts = replace(self.parts, link_task=asyncio.create_task(supervisor.run(), name="link"))
        self._changed.set()

    def stop(self) -> None:
        """Ask for an orderly end."""
        self._stopping.set()

    async def _until_stopped(self, others: list[asyncio.Task[None]]) -> None:
        """Wait for the end; a part that dies is fatal and says so (systemd restarts us), never silence."""

        def watched() -> set[asyncio.Task[None]]:
            parts = (self.parts.link_task, self.parts.publisher_task)
            return {task for task in (*parts, *others) if task is not None}

        while (over := await first_to_end(watched, self._changed, self._stopping)) is not None:
            if over is self.parts.link_task:
                await self._deliver_rest()
                return

    async def _deliver_rest(self) -> None:
        """A replay has ended: give the broker time to take what was made of it."""
        log.info("the recording has ended")
        while self.outbox.stats.queued and not self._stopping.is_set():
            publishing = self.parts.publisher_task
            if publishing is not None and publishing.done() and not publishing.cancelled():
                publishing.result()  # it died: raises why
                return
            await asyncio.sleep(0.05)

    async def _shut_down(self, others: list[asyncio.Task[None]], how: str | None) -> None:
        """Give everything back; `how` says what ended the run, None: it was asked to end."""
        deadline = time.monotonic() + STOP_BUDGET_S
        for task in others:
            if task.get_name() == "reload":
                await cancelled(task)  # a reload under way takes back what it has begun
        if not others:
            # it never came to work: nobody was spoken to
            await self._give_places_back(how)
            return
        parts = (self.parts.link_task, self.parts.wits_task)
        for task in (*[task for task in parts if task is not None], *others, *self.leaving.tasks):
            await cancelled(task)
        # close what the disk must not lose before the network is given the rest of the time
        await self.rig.stop(1.0)
        await self.drift.stop()
        await self.watch.stop()
        await asyncio.to_thread(self.recorder.stop, max(deadline - time.monotonic() - 4.0, 1.0))
        self.publish_health()
        await self.publisher.stop(max(min(deadline - time.monotonic() - 2.0, 4.0), 0.5))
        if self.parts.publisher_task is not None:
            await cancelled(self.parts.publisher_task)
        await asyncio.to_thread(self.outbox.stop, max(deadline - time.monotonic(), 1.0))
        await self._give_places_back(how)

    async def _give_places_back(self, how: str | None) -> None:
        await self._places.aclose()
        if self.parts.link_task is not None:
            await cancelled(self.parts.link_task)
        if self.parts.rig.metrics is not None:
            await asyncio.to_thread(self.parts.rig.metrics.close)
        if self.parts.tool_lock is not None:
            self.parts.tool_lock.release()
        if self._lock.held:
            await asyncio.to_thread(self.clock.keep)
            await asyncio.to_thread(self._starts.end, how)
            self._lock.release()

    async def _health_task(self) -> None:
        while True:
            self.publish_health()
            link = self.supervisor.stats
            self.notifier.status(
                f"link {link.state.value}, {self.pipeline.attitudes} attitudes,"
                f" {'connected to' if self.publisher.connected else 'without'} broker,"
                f" {self.outbox.stats.queued} queued{self.reloader.note()}"
            )
            await asyncio.sleep(self.settings.service.health_interval_s)

"""The daemon: puts link, pipeline, outbox, publisher, recorder and health together and keeps them running.

One event loop; acquisition is a callback of it and never waits: what is slow (SQLite, fsync, the network) has threads
and tasks of its own behind bounded hand-overs that count what they drop. What follows from the configuration is one
value, `Parts`, which a reload (SIGHUP) makes anew and puts in force as a whole, or not at all (`reload`). SIGTERM
leaves within ten seconds: acquisition stops, the last window is committed to the outbox, `offline` is published, what
is not acknowledged stays on disk.

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
from collections.abc import Callable, Coroutine
from dataclasses import asdict, replace
from pathlib import Path
from typing import IO, Any

from highside import __version__
from highside.codec.frame import ByteCodec, CanCodec
from highside.config.places import left_behind
from highside.config.settings import Settings
from highside.errors import InputError
from highside.link.base import Batch, LinkReason, LinkState, LinkSupervisor
from highside.service import clock, messages
from highside.service.alarms import UNANSWERED_STANDS_S, Dropping, Growing
from highside.service.broker_client import check_secrets
from highside.service.clock import LoopLag, StepWatch, clock_synced
from highside.service.damage import DamageLog
from highside.service.drift_keeper import DriftKeeper, DriftParts
from highside.service.in_force import Calibration, Rotation, calibration_for, rotation_for, said
from highside.service.known_time import KnownTime, Present
from highside.service.notify import Notifier
from highside.service.outbox import Outbox
from highside.service.outputs import Attitude, Survey
from highside.service.parts import Parts, Tap, make_supervisor
from highside.service.pipeline import Pipeline
from highside.service.places import ToolLock, state_dir, take_state_dir
from highside.service.progress import Progress
from highside.service.publisher import Publisher, new_instance
from highside.service.quiet_log import QuietLog
from highside.service.recorder import Recorder, RecorderState
from highside.service.reload import Reloader, open_link
from highside.service.rig.home_assistant import discovery
from highside.service.rig.rig import Rig, run_outputs
from highside.service.starts import StartLog

log = logging.getLogger("highside")

WEDGED_AFTER_S = 15.0
"""The outbox has not committed what it was given for so long: the pipeline counts as wedged."""
STOP_BUDGET_S = 8.0
"""How long an orderly end may take; systemd would kill after 10 s."""
CLOCK_CHECK_S = 10.0
STEP_CHECK_S = 1.0
LINK_LINES = 3
"""Lines a minute for each state and reason of the link: a plug that is seated anew is told whole, a loose contact in a
few lines; `health` counts every one."""
LEAVING_S = 10.0
"""How long a reload waits for links and connections that an earlier one replaced; closing takes 2 s at most."""


class Service:
    """One tool's daemon. `reload` re-reads the configuration (it may raise InputError)."""

    def __init__(self, settings: Settings, reload: Callable[[], Settings] | None = None) -> None:
        self.state_dir = state_dir(settings)
        self.notifier = Notifier()
        self._lock: IO[str] | None = None
        self._places = contextlib.AsyncExitStack()
        """gives back what the start has opened and nobody has taken over"""
        self._lag = LoopLag()
        self._started_mono = time.monotonic()
        self._clock_synced = clock_synced()
        self._steps = StepWatch()
        self._known_time = KnownTime(self.state_dir)
        self._stopping = asyncio.Event()
        self._changed = asyncio.Event()
        """other tasks are to be watched"""
        self._refused_link: str | None = None
        self._dropping = Dropping()
        self._quiet_link = QuietLog(log, burst=LINK_LINES)
        self._unanswered = Growing(UNANSWERED_STANDS_S)
        self._instance = new_instance()
        """names this run at the broker"""
        self._leaving: set[asyncio.Task[None]] = set()
        """tasks that a reload has replaced and that still give back what they hold"""
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
            self.state_dir, self._reply_drift, self._tell_drift, lambda: self.parts.drift, self.damage
        )
        self.parts = self._make_parts(settings)
        self.reloader = Reloader(self, reload)
        self.on_output: Callable[[Attitude | Survey, int], None] | None = None
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

    def _make_parts(self, settings: Settings) -> Parts:
        """All parts for the start."""
        calibration = calibration_for(settings, self.present())
        rotation, drift = rotation_for(settings), self.drift.build(settings)
        tap = self.make_tap()
        return Parts(
            settings=settings,
            calibration=calibration,
            rotation=rotation,
            pipeline=self.make_pipeline(settings, settings.codec.build(), calibration, rotation, drift),
            publisher=self.make_publisher(settings),
            tap=tap,
            supervisor=make_supervisor(settings.link, tap, None),
            drift=drift,
            rig=self.rig.build(settings),
        )

    def make_pipeline(
        self,
        settings: Settings,
        codec: ByteCodec | CanCodec,
        calibration: Calibration,
        rotation: Rotation,
        drift: DriftParts,
    ) -> Pipeline:
        """A pipeline whose counts begin anew."""
        pipeline = Pipeline(
            codec=codec,
            tool=settings.tool,
            pipeline=settings.pipeline,
            monitor=settings.monitor,
            survey=settings.survey,
            correction=calibration.correction,
            rebalance=settings.rebalance,
            emit=self._on_output,
            vibration=settings.vibration,
            toolface=settings.toolface,
            drift=drift.stage,
            rotation=rotation.live,
        )
        pipeline.extra_flags = calibration.flags + rotation.flags
        pipeline.gravity = calibration.gravity(settings)
        if self.rig.offset is not None:
            pipeline.toolface_offset_deg = self.rig.offset.offset_deg
        return pipeline

    def make_publisher(self, settings: Settings) -> Publisher:
        """A publisher that has not connected."""
        commands = {settings.mqtt.topic(settings.tool.id, "drift/command"): self._on_drift_command}
        return Publisher(
            settings.mqtt, self.outbox, tool_id=settings.tool.id, commands=commands, instance=self._instance
        )

    def make_tap(self) -> Tap:
        """For a link that is not in force yet."""
        return Tap(self, lambda: self.parts.tap)

    def take(self, parts: Parts) -> None:
        """Put other parts in force."""
        self.parts = parts
        self.recorder.apply(parts.settings.recorder)
        self._changed.set()

    def present(self) -> Present:
        """The time that is known, by which a calibration is judged."""
        now = clock.now(synced=self._clock_synced)
        self._known_time.look(now)
        return self._known_time.present(now)

    def _judge_age(self) -> None:
        """The calibration in force may have expired meanwhile."""
        calibration = self.parts.calibration.aged(self.present())
        if calibration is not self.parts.calibration:
            self.parts = replace(self.parts, calibration=calibration)
            self.pipeline.extra_flags = self.parts.flags
            self.publish_health()

    def _topic(self, name: str) -> str:
        return self.settings.mqtt.topic(self.settings.tool.id, name)

    def _on_drift_command(self, payload: bytes, retained: bool) -> None:
        self.drift.on_command(payload, retained=retained)

    def _reply_drift(self, payload: bytes, done: bool) -> None:
        self.publisher.reply(self._topic("drift/reply"), payload, done=done)

    def _tell_latest(self, payload: bytes) -> None:
        self.publisher.passing(self._topic("latest"), payload)

    def _tell_drift(self, payload: bytes) -> None:
        self.publisher.retained(self._topic("drift"), payload)

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

    def _on_output(self, output: Attitude | Survey) -> None:
        now_wall, now_mono = time.time(), time.monotonic()
        attitude = output.attitude if isinstance(output, Survey) else output
        t_wall = now_wall - (now_mono - attitude.t_mono) if attitude.t_mono else now_wall
        if isinstance(output, Survey):
            topic = self._topic("survey")
            seq = self.outbox.next_seq(topic)
            payload = messages.survey_payload(seq, t_wall, attitude.t_mono, self._clock_synced, output)
            self.rig.on_survey(output, seq, t_wall)
        else:
            topic = self._topic("attitude")
            seq = self.outbox.next_seq(topic)
            payload = messages.attitude_payload(seq, t_wall, attitude.t_mono, self._clock_synced, output)
            self.rig.on_attitude(output, t_wall)
        self.outbox.put(topic, payload, synced=self._clock_synced)
        if self.on_output is not None:
            self.on_output(output, seq)

    def health(self) -> messages.HealthMessage:
        """What the retained `health` message says; every counter balances at any time (`balance`)."""
        pipeline = self.pipeline
        pipeline.process_held()
        codec, monitor = pipeline.codec.counts, pipeline.monitor.counts
        outbox, link, broker, recorder = (
            self.outbox.stats,
            self.supervisor.stats,
            self.publisher.stats,
            self.recorder.stats,
        )
        age = None if link.last_data_mono is None else round(time.monotonic() - link.last_data_mono, 3)
        balance = {
            "bytes": codec.balanced(),
            "frames": monitor.balanced() and codec.frames_good == monitor.received + codec.frames_held,
            "messages": outbox.balanced(),
        }
        alarms = [f"balance_{name}" for name, good in balance.items() if not good]
        if link.state in (LinkState.DOWN, LinkState.STALE):
            alarms.append(f"link_{link.state.value}")
        if not broker.connected:
            alarms.append("broker_away")
        if broker.taken:
            alarms.append("client_id_taken")
        if self._unanswered.look(broker.replies_dropped):
            alarms.append("commands_unanswered")
        if not outbox.storage_ok:
            alarms.append("outbox_storage")
        if self._dropping.look(outbox.dropped):
            alarms.append("outbox_dropping")
        if self.settings.recorder.enabled and recorder.state is RecorderState.FAILING:
            alarms.append("recorder_storage")
        if self._steps.alarm:
            alarms.append("clock_stepped")
        alarms.extend(self.parts.flags)
        if self.reloader.refused:
            alarms.append("reload_refused")
        alarms.extend(f"stuck_{axis}" for axis in pipeline.monitor.stuck_axes)
        if pipeline.monitor.frozen:
            alarms.append("frozen")
        alarms.extend(self.rig.alarms())
        if self.drift.error:
            alarms.append("drift_state")
        if damaged := self.damage.as_list():
            alarms.append("damaged_file")
        if self._starts.alarm:
            alarms.append("restarting")
        return messages.HealthMessage(
            t=round(time.time(), 6),
            clock_synced=self._clock_synced,
            version=__version__,
            uptime_s=round(time.monotonic() - self._started_mono, 3),
            clock=self._steps.as_dict(),
            link=link.as_dict() | {"data_age_s": age},
            codec=codec.as_dict(),
            monitor=monitor.as_dict(),
            outbox=messages.OutboxHealth(**asdict(outbox)),
            broker=messages.BrokerHealth(
                connected=broker.connected,
                connects=broker.connects,
                failures=broker.failures,
                last_error=broker.last_error,
                instance=broker.instance,
                short_connections=broker.short_connections,
                taken=broker.taken,
                replies=broker.replies,
                replies_dropped=broker.replies_dropped,
                commands_failed=broker.commands_failed,
            ),
            recorder=recorder.as_dict() if self.settings.recorder.enabled else None,
            loop=self._lag.as_dict(),
            pipeline={"attitudes": pipeline.attitudes, "surveys": pipeline.surveys},
            surveys=self.rig.survey_health(),
            vibration=pipeline.shock.as_dict(),
            toolface=self.rig.toolface_health(),
            wits=self.rig.wits_health(),
            calibration=self.parts.calibration.as_dict(),
            rotation=self._rotation_health(),
            rebalance=self._rebalance_health(),
            drift=self.drift.health(),
            reload=self.reloader.as_dict(),
            starts=self._starts.as_dict(),
            damaged=damaged,
            balance=balance,
            alarms=alarms,
        )

    def _rotation_health(self) -> dict[str, Any] | None:
        if self.settings.rotation.compensation is None:
            return None
        rotation = self.parts.rotation
        live = rotation.live
        return {
            "comp_id": None if live is None else live.id,
            "channels": [] if live is None else list(live.channels),
            "unused": [] if live is None else list(live.unused),
            "refused": rotation.refused,
            "kept": rotation.kept,
        }

    def _rebalance_health(self) -> dict[str, Any]:
        rebalancer = self.pipeline.rebalancer
        offset = rebalancer.offset
        return {
            "state": rebalancer.state.value,
            "reason": rebalancer.reason.value,
            "turns": rebalancer.turns_collected,
            "bx_ug": None if offset is None else round(offset.bx_g * 1e6, 2),
            "by_ug": None if offset is None else round(offset.by_g * 1e6, 2),
            "std_ug": None if offset is None else round(max(offset.std_g) * 1e6, 2),
            "applied": self.settings.rebalance.apply and offset is not None,
        }

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

    async def run(self) -> None:
        """Run until SIGTERM or SIGINT, or until a replayed recording has ended and is delivered.

        Raises InputError if the state directory cannot be used or another daemon uses it, if another daemon speaks as
        this tool, if a file with a password or a certificate cannot be used, or if the link cannot be opened at the
        start and is not to be waited for.
        """
        await asyncio.to_thread(check_secrets, self.settings.mqtt)
        loop = asyncio.get_running_loop()
        handlers = ((signal.SIGTERM, self.stop), (signal.SIGINT, self.stop), (signal.SIGHUP, self.reloader.ask))
        for number, handler in handlers:
            loop.add_signal_handler(number, handler)
        others: list[asyncio.Task[None]] = []
        how: str | None = None
        try:
            if await self._take_places():
                others = self._start()
                await self._until_stopped(others)
            how = self._refused_link
        except BaseException as error:
            how = said(error)
            raise
        finally:
            self.notifier.stopping("leaving")
            await self._shut_down(others, how)
            self.notifier.close()
            # only now: an impatient second signal must not end the process before the outbox is committed
            for number, _ in handlers:
                loop.remove_signal_handler(number)
        if self._refused_link is not None:
            raise InputError(
                self._refused_link,
                field="the [link] table",
                remedy="mend it, or set link.wait_at_start = true to wait for it",
            )

    async def _take_places(self) -> bool:
        """What no two daemons can have: state directory, tool, listener, link. False: told to stop meanwhile.

        Raises InputError; nothing has been said to anybody then, and what was taken is given back by `_shut_down`.
        """
        settings = self.settings
        self._lock = take_state_dir(self.state_dir)
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
            await _cancel(opening)
            return False
        opened = opening.result()
        self._places.pop_all()  # from here on the link is its supervisor's to close
        self.parts = replace(self.parts, supervisor=make_supervisor(settings.link, self.parts.tap, opened))
        return True

    def _start(self) -> list[asyncio.Task[None]]:
        """Everything at work; returns the tasks that live as long as the service."""
        self.run_link(self.supervisor)
        self.rig.start(lambda: self.pipeline, self.publish_health, self._tell_latest)
        self.drift.start()
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
            asyncio.create_task(self._tell_health(), name="health"),
            asyncio.create_task(self._watch_clock(), name="clock"),
            asyncio.create_task(self._feed_watchdog(), name="watchdog"),
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
        stopping = asyncio.create_task(self._stopping.wait(), name="stopping")
        changed = asyncio.create_task(self._changed.wait(), name="changed")
        try:
            while True:
                link = self.parts.link_task
                parts = {task for task in (link, self.parts.publisher_task) if task is not None}
                # one that is cancelled is being replaced by a reload
                watched = {task for task in (*parts, *others) if not task.cancelled()}
                done, _ = await asyncio.wait({stopping, changed, *watched}, return_when=asyncio.FIRST_COMPLETED)
                if stopping in done:
                    return
                if changed in done:
                    self._changed.clear()
                    changed = asyncio.create_task(self._changed.wait(), name="changed")
                for task in done & watched:
                    if task.cancelled():
                        continue
                    if (error := task.exception()) is not None:
                        raise error
                    if task is link:
                        await self._deliver_rest()
                        return
        finally:
            stopping.cancel()
            changed.cancel()

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
                await _cancel(task)  # a reload under way takes back what it has begun
        if not others:
            # it never came to work: nobody was spoken to
            await self._give_places_back(how)
            return
        parts = (self.parts.link_task, self.parts.wits_task)
        for task in (*[task for task in parts if task is not None], *others, *self._leaving):
            await _cancel(task)
        # close what the disk must not lose before the network is given the rest of the time
        await self.rig.stop(1.0)
        await self.drift.stop()
        await asyncio.to_thread(self.recorder.stop, max(deadline - time.monotonic() - 4.0, 1.0))
        self.publish_health()
        await self.publisher.stop(max(min(deadline - time.monotonic() - 2.0, 4.0), 0.5))
        if self.parts.publisher_task is not None:
            await _cancel(self.parts.publisher_task)
        await asyncio.to_thread(self.outbox.stop, max(deadline - time.monotonic(), 1.0))
        await self._give_places_back(how)

    async def _give_places_back(self, how: str | None) -> None:
        await self._places.aclose()
        if self.parts.link_task is not None:
            await _cancel(self.parts.link_task)
        if self.parts.rig.metrics is not None:
            await asyncio.to_thread(self.parts.rig.metrics.close)
        if self.parts.tool_lock is not None:
            self.parts.tool_lock.release()
        if self._lock is not None:
            await asyncio.to_thread(self._known_time.keep)
            await asyncio.to_thread(self._starts.end, how)
            self._lock.close()
            self._lock = None

    async def _tell_health(self) -> None:
        while True:
            self.publish_health()
            link = self.supervisor.stats
            self.notifier.status(
                f"link {link.state.value}, {self.pipeline.attitudes} attitudes,"
                f" {'connected to' if self.publisher.connected else 'without'} broker,"
                f" {self.outbox.stats.queued} queued{self.reloader.note()}"
            )
            await asyncio.sleep(self.settings.service.health_interval_s)

    async def _watch_clock(self) -> None:
        last_check = 0.0
        while True:
            stepped, now = self._steps.look(), time.monotonic()
            if stepped is not None or now - last_check >= CLOCK_CHECK_S:
                self._clock_synced, last_check = clock_synced(), now
                self._judge_age()
                if self._known_time.to_be_kept:
                    await asyncio.to_thread(self._known_time.keep)
            if stepped is not None:
                log.warning("the wall clock was set %s by %.1f s", "forward" if stepped > 0.0 else "back", abs(stepped))
                self.publish_health()
            await asyncio.sleep(STEP_CHECK_S)

    async def _feed_watchdog(self) -> None:
        interval = self.notifier.watchdog_interval_s
        if interval is None:
            await asyncio.Event().wait()
            return
        progress = Progress(self.outbox)
        while True:
            if progress.wedged_s() < max(WEDGED_AFTER_S, interval / 2.0):
                self.notifier.watchdog()
            else:
                log.error("the outbox has committed nothing of what it was given for %.0f s", progress.wedged_s())
            await asyncio.sleep(interval / 4.0)

    # --- replaced by a reload ----------------------------------------------------------------------------------

    def successor(
        self, name: str, old: asyncio.Task[None] | None, run: Callable[[], Coroutine[Any, Any, None]]
    ) -> asyncio.Task[None]:
        """A task that ends `old`, waits until it and those before it have given everything back, and then runs."""

        async def after() -> None:
            if old is not None:
                self.let_leave(old)
            before = {task for task in self._leaving if task.get_name() == name}
            for task in before:
                task.cancel()
            if before:
                await asyncio.wait(before)
            await run()

        return asyncio.create_task(after(), name=name)

    def let_leave(self, task: asyncio.Task[None]) -> None:
        """A task that gives back what was replaced: the next reload, and the end, wait for it."""
        self._leaving.add(task)
        task.add_done_callback(self._leaving.discard)

    async def all_have_left(self) -> None:
        """Wait for the tasks that earlier reloads have replaced. Raises TimeoutError."""
        if self._leaving:
            _, late = await asyncio.wait(self._leaving, timeout=LEAVING_S)
            if late:
                raise TimeoutError(f"{', '.join(task.get_name() for task in late)} still closing after {LEAVING_S} s")


async def _cancel(task: asyncio.Task[Any]) -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError, Exception):
        await task

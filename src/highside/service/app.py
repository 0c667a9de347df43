"""The daemon: puts link, pipeline, outbox, publisher, recorder and health together and keeps them running.

One event loop; acquisition is a callback of it and never waits: what is slow (SQLite, fsync, the network) has threads
and tasks of its own behind bounded hand-overs that count what they drop. Reload (SIGHUP) reads and validates the whole
configuration first and swaps only then; a bad file changes nothing. SIGTERM leaves within ten seconds: acquisition
stops, the last window is committed to the outbox, `offline` is published, what is not acknowledged stays on disk.

The watchdog is fed by the progress of the pipeline: the loop turns and the outbox commits. A dead broker or a dead
link is not a wedged pipeline and is never answered by a restart.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import logging
import os
import signal
import time
from collections.abc import Callable, Coroutine
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from highside import __version__
from highside.calibration.correction import Correction, IdentityCorrection
from highside.codec.frame import ByteCodec, CanCodec
from highside.config.settings import Settings
from highside.errors import HighsideError, InputError
from highside.link.base import Batch, LinkReason, LinkState, LinkSupervisor
from highside.reading import read_bytes
from highside.recording.calibration_store import load_active, load_record_file
from highside.recording.keys import read_trusted_keys
from highside.rotation.compensation import Compensation
from highside.rotation.live import LiveCompensation
from highside.service import messages
from highside.service.alarms import UNANSWERED_STANDS_S, Dropping, Growing
from highside.service.broker_client import check_secrets
from highside.service.clock import LoopLag, clock_synced
from highside.service.drift_keeper import DriftKeeper
from highside.service.home_assistant import discovery
from highside.service.notify import Notifier
from highside.service.outbox import Outbox
from highside.service.pipeline import Attitude, Pipeline, Survey
from highside.service.publisher import Publisher, new_instance
from highside.service.recorder import Recorder, RecorderState
from highside.service.rig import Rig

log = logging.getLogger("highside")

WEDGED_AFTER_S = 15.0
"""The outbox has not committed what it was given for so long: the pipeline counts as wedged."""
STOP_BUDGET_S = 8.0
"""How long an orderly end may take; systemd would kill after 10 s."""
CLOCK_CHECK_S = 10.0


class Service:
    """One tool's daemon. `reload` re-reads the configuration (it may raise InputError)."""

    def __init__(self, settings: Settings, reload: Callable[[], Settings] | None = None) -> None:
        self.settings = settings
        self._reload_settings = reload
        self.state_dir = state_dir(settings)
        self._lock: IO[str] | None = None
        self._notifier = Notifier()
        self._lag = LoopLag()
        self._started_mono = time.monotonic()
        self._clock_synced = clock_synced()
        self._reload_error: str | None = None
        self._calibration_error: str | None = None
        self._rotation_error: str | None = None
        self._reloads = 0
        self._stopping = asyncio.Event()
        self._refused_link: str | None = None
        self._link_task: asyncio.Task[None] | None = None
        self._publisher_task: asyncio.Task[None] | None = None
        self._dropping = Dropping()
        self._unanswered = Growing(UNANSWERED_STANDS_S)
        self._instance = new_instance()
        """names this run at the broker"""
        self._leaving: set[asyncio.Task[None]] = set()
        """tasks that a reload has replaced and that still give back what they hold"""
        self._name_topics()
        keep = settings.mqtt.outbox
        self.outbox = Outbox(
            self.state_dir / "outbox.sqlite",
            max_rows=keep.max_rows,
            max_age_s=keep.max_age_s,
            max_bytes=keep.max_bytes,
            commit_interval_s=keep.commit_interval_s,
            historical_after_s=settings.mqtt.historical_after_s,
        )
        self.publisher = self._make_publisher()
        self.recorder = Recorder(
            settings.recorder,
            self.state_dir / "recordings",
            settings.tool.id,
            meta={"codec": settings.codec.name, "link": settings.link.kind},
            channel=str(getattr(settings.link, "interface", None) or "can0"),
        )
        self.rig = Rig(settings, self.state_dir, self.health)
        self.drift = DriftKeeper(settings, self.state_dir, self._reply_drift, self._tell_drift)
        self.pipeline = self._make_pipeline(self._correction(settings))
        self.supervisor = self._make_supervisor()
        self.on_output: Callable[[Attitude | Survey, int], None] | None = None
        """called with every output and its sequence number, for faces inside the process"""

    # --- parts -------------------------------------------------------------------------------------------------

    def _name_topics(self) -> None:
        tool, mqtt = self.settings.tool.id, self.settings.mqtt
        self._topic_attitude = mqtt.topic(tool, "attitude")
        self._topic_survey = mqtt.topic(tool, "survey")
        self._topic_health = mqtt.topic(tool, "health")

    def _make_publisher(self) -> Publisher:
        settings = self.settings
        commands = {settings.mqtt.topic(settings.tool.id, "drift/command"): self._on_drift_command}
        return Publisher(
            settings.mqtt, self.outbox, tool_id=settings.tool.id, commands=commands, instance=self._instance
        )

    def _on_drift_command(self, payload: bytes, retained: bool) -> None:
        self.drift.on_command(payload, retained=retained)

    def _reply_drift(self, payload: bytes, done: bool) -> None:
        self.publisher.reply(self.settings.mqtt.topic(self.settings.tool.id, "drift/reply"), payload, done=done)

    def _tell_drift(self, payload: bytes) -> None:
        self.publisher.retained(self.settings.mqtt.topic(self.settings.tool.id, "drift"), payload)

    def _make_pipeline(self, correction: Correction, codec: ByteCodec | CanCodec | None = None) -> Pipeline:
        settings = self.settings
        pipeline = Pipeline(
            codec=codec or settings.codec.build(),
            tool=settings.tool,
            pipeline=settings.pipeline,
            monitor=settings.monitor,
            survey=settings.survey,
            correction=correction,
            rebalance=settings.rebalance,
            emit=self._on_output,
            vibration=settings.vibration,
            toolface=settings.toolface,
            drift=self.drift.stage,
            rotation=self._rotation(settings),
        )
        pipeline.extra_flags = self._extra_flags()
        pipeline.gravity = self.rig.gravity(correction.cal_id)
        if self.rig.offset is not None:
            pipeline.toolface_offset_deg = self.rig.offset.offset_deg
        return pipeline

    def _make_supervisor(self) -> LinkSupervisor:
        link = self.settings.link
        self._tap = _Tap(self)
        return LinkSupervisor(link.transport, self._tap, link.supervisor())

    def _extra_flags(self) -> tuple[str, ...]:
        refused = {"calibration_refused": self._calibration_error, "rotation_refused": self._rotation_error}
        return tuple(flag for flag, error in refused.items() if error)

    def _correction(self, settings: Settings) -> Correction:
        """The calibration in force. A refused record is named and answered by no correction at all, never by a stop."""
        self._calibration_error = None
        try:
            return correction_of(settings)
        except HighsideError as error:
            self._calibration_error = str(error)
            log.error("calibration refused, readings pass uncorrected: %s", error)
        return _uncalibrated(settings)

    def _rotation(self, settings: Settings) -> LiveCompensation | None:
        """The rotor-angle compensation in force; a refused file is named and answered by none."""
        self._rotation_error = None
        try:
            return compensation_of(settings)
        except HighsideError as error:
            self._rotation_error = str(error)
            log.error("rotor-angle compensation refused, nothing is taken off: %s", error)
        return None

    # --- the sink of the link ----------------------------------------------------------------------------------

    def on_batch(self, batch: Batch) -> None:
        self.recorder.on_batch(batch)
        self.pipeline.on_batch(batch)

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        level = logging.WARNING if state in (LinkState.DOWN, LinkState.STALE) else logging.INFO
        log.log(level, "link %s: %s", state.value, message)
        if state is LinkState.DOWN:
            self.pipeline.on_link_reopened()
            if not self.supervisor.stats.opens and not self.settings.link.wait_at_start and not self._reloads:
                self._refused_link = message
                self.stop()
        elif state is LinkState.ENDED:
            self.pipeline.finish()
        self._publish_health()

    # --- outputs -----------------------------------------------------------------------------------------------

    def _on_output(self, output: Attitude | Survey) -> None:
        now_wall, now_mono = time.time(), time.monotonic()
        attitude = output.attitude if isinstance(output, Survey) else output
        t_wall = now_wall - (now_mono - attitude.t_mono) if attitude.t_mono else now_wall
        if isinstance(output, Survey):
            topic = self._topic_survey
            seq = self.outbox.next_seq(topic)
            payload = messages.survey_payload(seq, t_wall, attitude.t_mono, self._clock_synced, output)
            self.rig.on_survey(output, seq, t_wall)
        else:
            topic = self._topic_attitude
            seq = self.outbox.next_seq(topic)
            payload = messages.attitude_payload(seq, t_wall, attitude.t_mono, self._clock_synced, output)
            self.rig.on_attitude(output, t_wall)
        self.outbox.put(topic, payload, synced=self._clock_synced)
        if self.on_output is not None:
            self.on_output(output, seq)

    def health(self) -> messages.HealthMessage:
        """What the retained `health` message says; every counter balances at any time (`balance`)."""
        pipeline = self.pipeline
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
        if self._calibration_error:
            alarms.append("calibration_refused")
        if self._rotation_error:
            alarms.append("rotation_refused")
        if self._reload_error:
            alarms.append("reload_refused")
        alarms.extend(f"stuck_{axis}" for axis in pipeline.monitor.stuck_axes)
        if pipeline.monitor.frozen:
            alarms.append("frozen")
        alarms.extend(self.rig.alarms())
        return messages.HealthMessage(
            t=round(time.time(), 6),
            clock_synced=self._clock_synced,
            version=__version__,
            uptime_s=round(time.monotonic() - self._started_mono, 3),
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
            loop={
                "lag_p999_ms": round(self._lag.quantile_ms(0.999), 3),
                "lag_max_ms": round(self._lag.max_s * 1e3, 3),
            },
            pipeline={"attitudes": pipeline.attitudes, "surveys": pipeline.surveys},
            surveys=self.rig.survey_health(),
            vibration=pipeline.shock.as_dict(),
            toolface=self.rig.toolface_health(),
            wits=self.rig.wits_health(),
            calibration={"cal_id": pipeline.correction.cal_id, "refused": self._calibration_error},
            rotation=self._rotation_health(),
            rebalance=self._rebalance_health(),
            drift=self.drift.health(),
            reload={"count": self._reloads, "refused": self._reload_error},
            balance=balance,
            alarms=alarms,
        )

    def _rotation_health(self) -> dict[str, Any] | None:
        if self.settings.rotation.compensation is None:
            return None
        live = self.pipeline.rotation
        return {
            "comp_id": None if live is None else live.id,
            "channels": [] if live is None else list(live.channels),
            "unused": [] if live is None else list(live.unused),
            "refused": self._rotation_error,
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

    def _announce(self) -> None:
        settings = self.settings
        if settings.home_assistant is not None:
            tool = settings.tool
            self.publisher.retained(*discovery(tool.id, tool.serial, settings.mqtt, settings.home_assistant))

    def _publish_health(self) -> None:
        self.publisher.retained(self._topic_health, messages.health_payload(self.health()))
        self.drift.publish()

    # --- running -----------------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Run until SIGTERM or SIGINT, or until a replayed recording has ended and is delivered.

        Raises InputError if the state directory cannot be used or another daemon uses it, if a file with a password
        or a certificate cannot be used, or if the link cannot be opened at the start and is not to be waited for.
        """
        await asyncio.to_thread(check_secrets, self.settings.mqtt)
        self._take_state_dir()
        loop = asyncio.get_running_loop()
        for number, handler in (
            (signal.SIGTERM, self.stop),
            (signal.SIGINT, self.stop),
            (signal.SIGHUP, self.request_reload),
        ):
            loop.add_signal_handler(number, handler)
        self.rig.start(lambda: self.pipeline, self._publish_health)
        self.drift.start()
        self.outbox.start(wait=False)
        self.recorder.start()
        self._announce()
        self._publisher_task = asyncio.create_task(self.publisher.run(), name="publisher")
        self._link_task = asyncio.create_task(self.supervisor.run(), name="link")
        others = [
            asyncio.create_task(self._lag.run(), name="loop-lag"),
            asyncio.create_task(self._tell_health(), name="health"),
            asyncio.create_task(self._feed_watchdog(), name="watchdog"),
        ]
        self._notifier.ready(f"tool {self.settings.tool.id}")
        log.info("tool %s: running, state in %s", self.settings.tool.id, self.state_dir)
        try:
            await self._until_stopped(others)
        finally:
            self._notifier.stopping("leaving")
            await self._shut_down(others)
            self._notifier.close()
            # only now: an impatient second signal must not end the process before the outbox is committed
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
                loop.remove_signal_handler(number)
        if self._refused_link is not None:
            raise InputError(
                self._refused_link,
                field="the [link] table",
                remedy="mend it, or set link.wait_at_start = true to wait for it",
            )

    def stop(self) -> None:
        """Ask for an orderly end."""
        self._stopping.set()

    async def _until_stopped(self, others: list[asyncio.Task[None]]) -> None:
        """Wait for the end; a part that dies is fatal and says so (systemd restarts us), never silence."""
        stopping = asyncio.create_task(self._stopping.wait(), name="stopping")
        try:
            while True:
                assert self._link_task is not None and self._publisher_task is not None
                watched: set[asyncio.Task[Any]] = {stopping, self._link_task, self._publisher_task, *others}
                done, _ = await asyncio.wait(watched, return_when=asyncio.FIRST_COMPLETED)
                if stopping in done:
                    return
                for task in done:
                    if task.cancelled():
                        continue  # replaced by a reload
                    if (error := task.exception()) is not None:
                        raise error
                    if task is self._link_task:
                        await self._deliver_rest()
                        return
        finally:
            stopping.cancel()

    async def _deliver_rest(self) -> None:
        """A replay has ended: give the broker time to take what was made of it."""
        log.info("the recording has ended")
        while self.outbox.stats.queued and not self._stopping.is_set():
            assert self._publisher_task is not None
            if self._publisher_task.done():
                self._publisher_task.result()  # it died: raises why
                return
            await asyncio.sleep(0.05)

    async def _shut_down(self, others: list[asyncio.Task[None]]) -> None:
        deadline = time.monotonic() + STOP_BUDGET_S
        if self._link_task is not None:
            await _cancel(self._link_task)
        for task in (*others, *self._leaving):
            await _cancel(task)
        # close what the disk must not lose before the network is given the rest of the time
        await self.rig.stop(1.0)
        await self.drift.stop()
        await asyncio.to_thread(self.recorder.stop, max(deadline - time.monotonic() - 4.0, 1.0))
        self._publish_health()
        await self.publisher.stop(max(min(deadline - time.monotonic() - 2.0, 4.0), 0.5))
        if self._publisher_task is not None:
            await _cancel(self._publisher_task)
        await asyncio.to_thread(self.outbox.stop, max(deadline - time.monotonic(), 1.0))
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    async def _tell_health(self) -> None:
        last_clock_check = 0.0
        while True:
            now = time.monotonic()
            if now - last_clock_check >= CLOCK_CHECK_S:
                self._clock_synced, last_clock_check = clock_synced(), now
            self._publish_health()
            link = self.supervisor.stats
            self._notifier.status(
                f"link {link.state.value}, {self.pipeline.attitudes} attitudes,"
                f" {'connected to' if self.publisher.connected else 'without'} broker,"
                f" {self.outbox.stats.queued} queued"
            )
            await asyncio.sleep(self.settings.service.health_interval_s)

    async def _feed_watchdog(self) -> None:
        interval = self._notifier.watchdog_interval_s
        if interval is None:
            await asyncio.Event().wait()
            return
        progress = Progress(self.outbox)
        while True:
            if progress.wedged_s() < max(WEDGED_AFTER_S, interval / 2.0):
                self._notifier.watchdog()
            else:
                log.error("the outbox has committed nothing of what it was given for %.0f s", progress.wedged_s())
            await asyncio.sleep(interval / 4.0)

    # --- reload ------------------------------------------------------------------------------------------------

    def request_reload(self) -> None:
        """SIGHUP: read the configuration again, and the active calibration."""
        if self._stopping.is_set():
            return
        self._notifier.reloading("reloading")
        try:
            self._reload()
            self._reload_error = None
            self._reloads += 1
            log.info("reloaded")
        except HighsideError as error:
            self._reload_error = str(error)
            log.error("reload refused, the old configuration stays in force: %s", error)
        self._notifier.ready()
        self._publish_health()

    def _reload(self) -> None:
        if self._reload_settings is None:
            return
        new = self._reload_settings()
        old = self.settings
        for table, why in (("service", "state_dir"), ("tool", "id")):
            if getattr(getattr(new, table), why) != getattr(getattr(old, table), why):
                raise InputError(
                    "cannot change while running", field=f"{table}.{why}", remedy="restart the service instead"
                )
        for field in ("outbox", "historical_after_s"):
            if getattr(new.mqtt, field) != getattr(old.mqtt, field):
                raise InputError(
                    "cannot change while running", field=f"mqtt.{field}", remedy="restart the service instead"
                )
        # everything that can fail is made before anything is swapped
        codec = new.codec.build() if new.codec != old.codec else None
        if new.mqtt != old.mqtt:
            check_secrets(new.mqtt)
        self.rig.apply(new)
        self.drift.apply(new)
        self.pipeline.drift = self.drift.stage
        self.settings = new
        correction = self._correction(new)
        if codec is not None:
            self.pipeline = self._make_pipeline(correction, codec)
        else:
            self.pipeline.correction = correction
            self.pipeline.rotation = self._rotation(new)
            self.pipeline.gravity = self.rig.gravity(correction.cal_id)
            if (new.vibration, new.toolface) != (old.vibration, old.toolface):
                self.pipeline.apply_rig(new.vibration, new.toolface)
            self.pipeline.extra_flags = self._extra_flags()
            if (new.tool, new.pipeline, new.survey) != (old.tool, old.pipeline, old.survey):
                self.pipeline.apply(new.tool, new.pipeline, new.survey)
            if (new.monitor, new.rebalance) != (old.monitor, old.rebalance):
                # the codec and its counters go on: not a byte is lost for a new limit
                self.pipeline.apply_limits(new.monitor, new.rebalance)
        if new.link != old.link and self._link_task is not None:
            self._tap.close()
            if codec is None:
                self.pipeline.on_link_reopened()  # what the old link began, the new one does not complete
            self.supervisor = self._make_supervisor()
            self._link_task = self._replace(self._link_task, self.supervisor.run, "link")
        if new.mqtt != old.mqtt and self._publisher_task is not None:
            self._name_topics()
            self.publisher = self._make_publisher()
            self._publisher_task = self._replace(self._publisher_task, self.publisher.run, "publisher")
        if new.home_assistant != old.home_assistant or new.mqtt != old.mqtt:
            self._announce()
        if new.recorder != old.recorder:
            self.recorder.apply(new.recorder)

    def _replace(
        self, old: asyncio.Task[None], run: Callable[[], Coroutine[Any, Any, None]], name: str
    ) -> asyncio.Task[None]:
        """Cancel a task and start its successor when it, and those replaced before it, have given everything back."""
        old.cancel()
        self._leaving.add(old)
        old.add_done_callback(self._leaving.discard)
        before = {task for task in self._leaving if task.get_name() == name}

        async def after() -> None:
            await asyncio.wait(before)
            await run()

        return asyncio.create_task(after(), name=name)

    # --- the state directory -----------------------------------------------------------------------------------

    def _take_state_dir(self) -> None:
        """Make the directory and hold a lock on it, so that no two daemons share an outbox."""
        where = str(self.state_dir)
        try:
            self.state_dir.mkdir(parents=True, exist_ok=True)
            lock = (self.state_dir / "lock").open("w")
        except OSError as error:
            raise InputError(
                f"the state directory cannot be written: {error.strerror}",
                where=where,
                field="service.state_dir",
                remedy="give one that this user may write",
            ) from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            raise InputError(
                "another highside uses this state directory",
                where=where,
                field="service.state_dir",
                remedy="stop it, or give this one its own",
            ) from None
        self._lock = lock


class _Tap:
    """What a link's supervisor speaks to; closed when another link takes over, whose data may be of another kind."""

    def __init__(self, service: Service) -> None:
        self._service: Service | None = service

    def close(self) -> None:
        self._service = None

    def on_batch(self, batch: Batch) -> None:
        if self._service is not None:
            self._service.on_batch(batch)

    def on_state(self, state: LinkState, reason: LinkReason | None, message: str) -> None:
        if self._service is not None:
            self._service.on_state(state, reason, message)


class Progress:
    """Whether the outbox takes what the pipeline makes. A disk that refuses is reported, it is not a wedged thread."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox

    def wedged_s(self) -> float:
        """Seconds for which messages have waited for a commit that did not come."""
        return self._outbox.overdue_s if self._outbox.stats.storage_ok else 0.0


def correction_of(settings: Settings) -> Correction:
    """The correction that a configuration asks for.

    Raises Refused (exit status 1) if the record is tampered with, expired or of another tool, InputError if it cannot
    be read.
    """
    calibration, tool = settings.calibration, settings.tool
    trusted = None if calibration.trusted_keys is None else read_trusted_keys(calibration.trusted_keys)
    now_s = time.time()
    if calibration.record is not None:
        return load_record_file(calibration.record, tool_id=tool.id, serial=tool.serial, now_s=now_s, trusted=trusted)
    if calibration.store is not None:
        return load_active(calibration.store, tool_id=tool.id, serial=tool.serial, now_s=now_s, trusted=trusted)
    return _uncalibrated(settings)


def compensation_of(settings: Settings) -> LiveCompensation | None:
    """The rotor-angle compensation that a configuration asks for.

    Raises Refused if the file was changed or says nothing of I, T and azimuth, InputError if it cannot be read.
    """
    path = settings.rotation.compensation
    if path is None:
        return None
    return LiveCompensation(Compensation.from_json(read_bytes(path), where=str(path)))


def _uncalibrated(settings: Settings) -> IdentityCorrection:
    return IdentityCorrection(settings.calibration.bias_std_g, settings.calibration.scale_std)


def state_dir(settings: Settings) -> Path:
    """Where the service keeps its state: configured, given by systemd, or `./state`."""
    if settings.service.state_dir is not None:
        return settings.service.state_dir
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(given) if given else Path("state")


async def _cancel(task: asyncio.Task[Any]) -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError, Exception):
        await task

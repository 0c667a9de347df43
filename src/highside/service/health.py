"""The retained `health` message: the counters of every part, whether they balance, and which alarms stand."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from highside.link.base import LinkState
from highside.service import messages
from highside.service.alarms import DECODER_STANDS_S, REPLACED_STANDS_S, UNANSWERED_STANDS_S, Dropping, Growing
from highside.service.clock import LoopLag, StepWatch
from highside.service.damage import DamageLog
from highside.service.drift_keeper import DriftKeeper
from highside.service.outbox import Outbox
from highside.service.parts import ServiceParts
from highside.service.places import StateLock
from highside.service.recorder import Recorder
from highside.service.recorder_stats import RecorderState
from highside.service.rig.rig import Rig
from highside.service.starts import StartLog
from highside.service.watch_keeper import WatchKeeper
from highside.version import __version__


class Health:
    """Asks the parts in force and those that live as long as the service; remembers what alarms outlast."""

    def __init__(
        self,
        parts: Callable[[], ServiceParts],
        reloaded: Callable[[], dict[str, Any]],
        *,
        outbox: Outbox,
        recorder: Recorder,
        rig: Rig,
        drift: DriftKeeper,
        watch: WatchKeeper,
        damage: DamageLog,
        starts: StartLog,
        steps: StepWatch,
        lag: LoopLag,
        state_lock: StateLock,
    ) -> None:
        self._parts, self._reloaded = parts, reloaded
        self._outbox, self._recorder, self._rig, self._drift, self._watch = outbox, recorder, rig, drift, watch
        self._damage, self._starts, self._steps, self._lag = damage, starts, steps, lag
        self._state_lock = state_lock
        self._started_mono = time.monotonic()
        self._dropping, self._unanswered = Dropping(), Growing(UNANSWERED_STANDS_S)
        self._decoder, self._replaced = Growing(DECODER_STANDS_S), Growing(REPLACED_STANDS_S)

    def message(self, *, clock_synced: bool) -> messages.HealthMessage:
        """What the retained `health` message says; every counter balances at any time (`balance`)."""
        parts = self._parts()
        settings, pipeline = parts.settings, parts.pipeline
        pipeline.process_held()
        codec, monitor = pipeline.codec.counts, pipeline.monitor.counts
        outbox, link, broker, recorder = (
            self._outbox.stats,
            parts.supervisor.stats,
            parts.publisher.stats,
            self._recorder.stats,
        )
        age = None if link.last_data_mono is None else round(time.monotonic() - link.last_data_mono, 3)
        balance = {
            "bytes": codec.balanced(),
            "frames": monitor.balanced() and codec.frames_good == monitor.received + codec.frames_held,
            "messages": outbox.balanced(),
        }
        damaged, reloaded = self._damage.as_list(), self._reloaded()
        return messages.HealthMessage(
            t=round(time.time(), 6),
            clock_synced=clock_synced,
            version=__version__,
            uptime_s=round(time.monotonic() - self._started_mono, 3),
            clock=self._steps.as_dict(),
            link=link.as_dict() | {"data_age_s": age},
            codec=codec.as_dict() | {"faults": pipeline.decoder_faults},
            monitor=monitor.as_dict(),
            outbox=outbox,
            broker=broker,
            recorder=recorder.as_dict() if settings.recorder.enabled else None,
            loop=self._lag.as_dict(),
            pipeline={"attitudes": pipeline.attitudes, "surveys": pipeline.surveys},
            surveys=self._rig.survey_health(),
            vibration=pipeline.shock.as_dict(),
            toolface=self._rig.toolface_health(),
            wits=self._rig.wits_health(),
            calibration=parts.calibration.as_dict(),
            rotation=_rotation(parts),
            rolling_bias=_rolling_bias(parts),
            drift=self._drift.health(),
            watch=self._watch.health(),
            reload=reloaded,
            starts=self._starts.as_dict(),
            damaged=damaged,
            balance=balance,
            alarms=self._alarms(parts, balance, reloaded),
        )

    def _alarms(self, parts: ServiceParts, balance: dict[str, bool], reloaded: dict[str, Any]) -> list[str]:
        """Names of the alarms that stand."""
        settings, pipeline = parts.settings, parts.pipeline
        link, broker = parts.supervisor.stats, parts.publisher.stats
        outbox, recorder = self._outbox.stats, self._recorder.stats
        stands = {
            **{f"balance_{name}": not good for name, good in balance.items()},
            f"link_{link.state.value}": link.state in (LinkState.DOWN, LinkState.STALE),
            "decoder_failed": self._decoder.look(pipeline.decoder_faults),
            "broker_away": not broker.connected,
            "client_id_taken": broker.taken,
            "commands_unanswered": self._unanswered.look(broker.replies_dropped),
            "outbox_storage": not outbox.storage_ok,
            "outbox_replaced": self._replaced.look(outbox.replaced),
            "state_dir_taken": self._state_lock.taken,
            "outbox_dropping": self._dropping.look(outbox.dropped),
            "recorder_storage": settings.recorder.enabled and recorder.state is RecorderState.FAILING,
            "clock_stepped": self._steps.alarm,
            **dict.fromkeys(parts.flags, True),
            "reload_refused": bool(reloaded["refused"]),
            **{f"stuck_{axis}": True for axis in pipeline.monitor.stuck_axes},
            "frozen": pipeline.monitor.frozen,
            **dict.fromkeys(self._rig.alarms(), True),
            "drift_state": bool(self._drift.error),
            **dict.fromkeys(self._watch.alarms(), True),
            "damaged_file": bool(self._damage.as_list()),
            "restarting": self._starts.alarm,
        }
        return [name for name, standing in stands.items() if standing]


def _rotation(parts: ServiceParts) -> dict[str, Any] | None:
    if parts.settings.rotation.compensation is None:
        return None
    rotation = parts.rotation
    live = rotation.live
    return {
        "comp_id": None if live is None else live.id,
        "channels": [] if live is None else list(live.channels),
        "unused": [] if live is None else list(live.unused),
        "refused": rotation.refused,
        "kept": rotation.kept,
    }


def _rolling_bias(parts: ServiceParts) -> dict[str, Any]:
    rolling_bias = parts.pipeline.rolling_bias
    offset = rolling_bias.offset
    return {
        "state": rolling_bias.state.value,
        "reason": rolling_bias.reason.value,
        "turns": rolling_bias.turns_collected,
        "bx_ug": None if offset is None else round(offset.bx_g * 1e6, 2),
        "by_ug": None if offset is None else round(offset.by_g * 1e6, 2),
        "std_ug": None if offset is None else round(max(offset.std_g) * 1e6, 2),
        "applied": parts.settings.rolling_bias.apply and offset is not None,
    }

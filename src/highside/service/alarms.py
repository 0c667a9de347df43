"""The alarms of the health message: what each says and what to do, and those that outlast what raised them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping

from highside.service.quiet_log import QuietLog

log = logging.getLogger("highside")

ALARMS: dict[str, str] = {
    "balance_bytes": "The counts of bytes do not add up: a fault of the program; keep the log.",
    "balance_frames": "The counts of frames do not add up: a fault of the program; keep the log.",
    "balance_messages": "The counts of messages do not add up: a fault of the program; keep the log.",
    "link_down": "The link is gone: cable, adapter, permission; the log names it.",
    "decoder_failed": "The codec's decoder failed within the last hour on what it was given, `codec.faults` times; what"
    " it was given then is lost. The log says why: tell the maker of the codec.",
    "link_stale": "The link is open and silent: power and wiring of the tool.",
    "broker_away": "No connection to the broker; messages wait on disk.",
    "client_id_taken": "Another client uses this tool's MQTT client id, or the broker sheds us: `broker.taken` says"
    " which. Stop one of the two, or give it its own `tool.id`.",
    "commands_unanswered": "More commands came in the last minute than can be answered: find who sends them.",
    "outbox_storage": "The outbox cannot write to the disk; messages wait in memory.",
    "outbox_replaced": "The outbox's files were deleted or replaced within the last hour, while in use, and begun anew:"
    " keep others out of the state directory; the log says what was set aside.",
    "state_dir_taken": "Another highside uses the same state directory, which was deleted or replaced while in use:"
    " stop one of the two.",
    "outbox_dropping": "Messages were dropped within the last hour, `outbox.dropped` says why: more room"
    " (`[mqtt.outbox]`), or the broker back.",
    "clock_stepped": "The wall clock was set within the last hour, `clock.last_step_s` says by how much: the `t` of"
    " messages before and after it are not of one clock.",
    "recorder_storage": "The recorder cannot write to the disk.",
    "survey_storage": "Surveys cannot be written to the disk; they are tried again.",
    "no_calibration": "No calibration was ever put in force in the configured store; readings pass uncorrected.",
    "calibration_refused": "The configured calibration was refused, `calibration.refused` says why.",
    "calibration_kept": "The calibration of before stays in force in memory: fix the configured one before a restart.",
    "calibration_age_unknown": "The calibration in force expires one day, and whether that has come cannot be"
    " determined: the clock is not synchronised, or was set. It is used; fix the host's time (NTP, PTP, GPS).",
    "rotation_refused": "The rotor-angle compensation was refused, `rotation.refused` says why.",
    "rotation_kept": "The compensation of before stays in force in memory: fix the configured one before a restart.",
    "reload_refused": "The last reload was refused, `reload.refused` says why; the configuration before is in force.",
    "stuck_ax": "This accelerometer gives one and the same value.",
    "stuck_ay": "This accelerometer gives one and the same value.",
    "stuck_az": "This accelerometer gives one and the same value.",
    "frozen": "Every reading is the same: a dead converter.",
    "toolface_offset": "The log of toolface offsets cannot be read, or was lost; the offset before is in force, after a"
    " start none: `highside toolface set`.",
    "calibration_departs": "The calibration in force does not hold any more, `watch` says what, how much and what to"
    " do; the command `acknowledge` ends the alarm.",
    "watch_state": "What the watch knew was not taken up, or cannot be kept, or it has failed; `watch.error` says why.",
    "drift_state": "What is known of the azimuth was not taken up, or cannot be kept; `drift.error` says why.",
    "damaged_file": "A file of the state directory was damaged and set aside; `damaged` names it.",
    "restarting": "The service has ended at least three times within ten minutes; `starts.last` says by what.",
    "g_total_trend": "Gtotal of the surveys drifts: run `diagnose`.",
    "wits_away": "A WITS output has an error and nobody is connected to it.",
}
"""By name; `highside schema` prints them with the health message."""

DROPPING_STANDS_S = 3600.0
"""Seconds for which `outbox_dropping` outlasts the last drop: an operator looks at a rig at least once in an hour."""
DECODER_STANDS_S = 3600.0
"""Seconds for which `decoder_failed` outlasts the last fault: as `DROPPING_STANDS_S`."""
REPLACED_STANDS_S = 3600.0
"""Seconds for which `outbox_replaced` outlasts the last time: as `DROPPING_STANDS_S`."""
UNANSWERED_STANDS_S = 60.0
"""Seconds for which `commands_unanswered` outlasts the last answer that was dropped."""


class Growing:
    """Whether a count has grown within the last `stands_s`; looked at with each health message."""

    def __init__(self, stands_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._stands_s, self._clock = stands_s, clock
        self._count = 0
        self._last: float | None = None

    def look(self, count: int) -> bool:
        """Take the present count; begins at 0, and may begin anew."""
        now = self._clock()
        if count > self._count:
            self._last = now
        self._count = count
        return self._last is not None and now - self._last < self._stands_s


class Dropping:
    """`outbox_dropping`: stands for an hour after the last drop; each reason has its line in the log, once a minute."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._growing = Growing(DROPPING_STANDS_S, clock)
        self._quiet = QuietLog(log, clock=clock)
        self._dropped_before: dict[str, int] = {}

    def look(self, dropped: Mapping[str, int]) -> bool:
        """Take the present counts by reason."""
        for reason, count in dropped.items():
            if count > self._dropped_before.get(reason, 0):
                text = "outbox: messages are dropped (%s), %d of them since the start"
                self._quiet.say(logging.ERROR, reason, text, reason, count)
        self._dropped_before = dict(dropped)
        return self._growing.look(sum(dropped.values()))

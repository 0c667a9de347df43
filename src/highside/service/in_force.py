"""Which calibration and which rotor-angle compensation are in force, and why others were refused.

A file that cannot be used never ends the service and never takes away what is good. At the start there is nothing else,
so readings pass as they are; at a reload the one in force stays in memory, and flags and alarms say both. It is given
up only where it is not this tool's any more (another serial number, a key that is not trusted) or where the store says
that it was taken back.

Whether a calibration has expired is judged by the time that is known (`known_time`), never by a wall clock alone: where
that cannot tell, the calibration is used and flagged. One that expires while it is in force is kept, and flagged.
"""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass, replace

from highside.calibration.correction import Correction, IdentityCorrection
from highside.calibration.record import CalibrationRecord, RecordError, RecordReason, correction_from_record, verify
from highside.calibration.signature import TrustedKeys
from highside.config.settings import Settings
from highside.errors import HighsideError
from highside.reading import read_document
from highside.recording.calibration_store import CalibrationStore, read_record
from highside.recording.keys import read_trusted_keys
from highside.rotation.compensation import Compensation
from highside.rotation.live import LiveCompensation
from highside.service.known_time import Present
from highside.service.quiet_log import QuietLog
from highside.service.rig.surveys import Gravity, expected_gravity

log = logging.getLogger("highside")


@dataclass(frozen=True, slots=True)
class CalibrationInForce:
    """The correction in force."""

    correction: Correction
    record: CalibrationRecord | None = None
    """what it comes from; None: readings pass as they are"""
    refused: str | None = None
    """why the configured record is not in force"""
    reason: RecordReason | None = None
    kept: bool = False
    """although refused: the one that was in force before stays"""
    age_unknown: bool = False
    """it expires one day, and no clock can tell whether that has come"""

    @property
    def flags(self) -> tuple[str, ...]:
        """Of every output, and alarms."""
        age = ("calibration_age_unknown",) if self.age_unknown else ()
        if self.refused is None:
            return age
        if self.reason is RecordReason.NONE_ACTIVE and not self.kept:
            return ("no_calibration",)
        return ("calibration_refused", "calibration_kept", *age) if self.kept else ("calibration_refused",)

    def gravity(self, settings: Settings) -> Gravity:
        """What Gtotal should be at the site with this calibration."""
        bench = {} if self.record is None else self.record.content.get("environment", {})
        return expected_gravity(settings.site, bench.get("gravity_mps2"), bench.get("gravity_std_mps2"))

    def as_dict(self) -> dict[str, str | bool | None]:
        """Member `calibration` of the health message."""
        reason = None if self.reason is None else self.reason.value
        return {"cal_id": self.correction.cal_id, "refused": self.refused, "reason": reason, "kept": self.kept}

    def aged(self, present: Present) -> CalibrationInForce:
        """The same at another time: it may have expired, and stays in force; its age may have become known."""
        if self.record is None:
            return self
        age_unknown = self.record.expires_s is not None and not present.known
        now = self if age_unknown == self.age_unknown else replace(self, age_unknown=age_unknown)
        if self.refused is not None:
            return now
        try:
            verify(self.record, tool_id=None, now_s=present.surely_s)
        except RecordError as error:
            log.error("%s; it stays in force", error)
            return replace(now, refused=str(error), reason=error.reason, kept=True)
        return now


@dataclass(frozen=True, slots=True)
class CompensationInForce:
    """The rotor-angle compensation in force; `live` None: none."""

    live: LiveCompensation | None = None
    refused: str | None = None
    kept: bool = False

    @property
    def flags(self) -> tuple[str, ...]:
        """Of every output, and alarms."""
        if self.refused is None:
            return ()
        return ("rotation_refused", "rotation_kept") if self.kept else ("rotation_refused",)


_quiet = QuietLog(log)
"""A file that stays bad is refused with each reload."""


def _say(settings: Settings, text: str, *values: object, level: int = logging.ERROR) -> None:
    told = text % values
    _quiet.say(level, f"{settings.tool.id} {told}", "%s", told)


def calibration_for(
    settings: Settings, present: Present, running: CalibrationInForce | None = None
) -> CalibrationInForce:
    """The calibration that a configuration puts in force; `running` is the one in force now. Never raises."""
    try:
        return _calibration(settings, present, running)
    except Exception as error:
        # whatever is wrong with a file, the tool is not stopped for it
        refused, reason = error_text(error), error.reason if isinstance(error, RecordError) else None
    if running is not None and _may_stay(running, settings):
        _say(settings, "the calibration in force (%s) is kept: %s", running.correction.cal_id[:12], refused)
        return replace(running, refused=refused, reason=reason, kept=True)
    # a store in which nothing was put in force refuses nothing
    level = logging.WARNING if reason is RecordReason.NONE_ACTIVE else logging.ERROR
    _say(settings, "%s; readings pass uncorrected", refused, level=level)
    return CalibrationInForce(_uncalibrated(settings), refused=refused, reason=reason)


def rotation_for(settings: Settings, running: CompensationInForce | None = None) -> CompensationInForce:
    """The compensation that a configuration puts in force; `running` is the one in force now. Never raises."""
    try:
        return CompensationInForce(compensation_of(settings))
    except Exception as error:
        refused = error_text(error)
    if running is not None and running.live is not None:
        _say(settings, "the rotor-angle compensation in force (%s) is kept: %s", running.live.id[:12], refused)
        return CompensationInForce(running.live, refused, kept=True)
    _say(settings, "rotor-angle compensation refused, nothing is taken off: %s", refused)
    return CompensationInForce(refused=refused)


def configured_calibration(settings: Settings, present: Present) -> CalibrationInForce:
    """The calibration that a configuration requests.

    Raises Refused (exit status 1) if the record is damaged, expired or of another tool, InputError if it cannot be
    read.
    """
    return _calibration(settings, present)


def compensation_of(settings: Settings) -> LiveCompensation | None:
    """The rotor-angle compensation that a configuration requests.

    Raises Refused if the file was changed or says nothing of I, T and azimuth, InputError if it cannot be read.
    """
    path = settings.rotation.compensation
    if path is None:
        return None
    return LiveCompensation(Compensation.from_json(read_document(path), where=str(path)))


def error_text(error: BaseException) -> str:
    """An error in one line: as it was made for the user's eyes, else with its kind."""
    if isinstance(error, RecordError) and error.reason is RecordReason.NONE_ACTIVE:
        return error.text
    if isinstance(error, HighsideError):
        return str(error)
    return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"


def _calibration(settings: Settings, present: Present, running: CalibrationInForce | None = None) -> CalibrationInForce:
    record = _record_of(settings)
    if record is None:
        return CalibrationInForce(_uncalibrated(settings))
    tool, trusted = settings.tool, _trusted_keys(settings)
    # one that may have expired is better than none, but does not replace another
    replaces = running is not None and running.record is not None and running.record.id != record.id
    now_s = present.wall_s if replaces else present.surely_s
    verify(record, tool_id=tool.id, serial=tool.serial, now_s=now_s, trusted=trusted)
    age_unknown = record.expires_s is not None and not present.known
    if age_unknown:
        text = "whether calibration %s has expired cannot be determined: the clock is not synchronised"
        _say(settings, text, record.id[:12], level=logging.WARNING)
    return CalibrationInForce(correction_from_record(record), record, age_unknown=age_unknown)


def _record_of(settings: Settings) -> CalibrationRecord | None:
    calibration = settings.calibration
    if calibration.record is not None:
        return read_record(calibration.record)
    if calibration.store is not None:
        return CalibrationStore(calibration.store).active(settings.tool.id)
    return None


def _trusted_keys(settings: Settings) -> TrustedKeys | None:
    path = settings.calibration.trusted_keys
    return None if path is None else read_trusted_keys(path)


def _may_stay(running: CalibrationInForce, settings: Settings) -> bool:
    """Whether the calibration in force goes on although the configured one is refused.

    It may have expired meanwhile: it is still better than none. What cannot be read has taken nothing back.
    """
    if running.record is None:
        return False
    trusted = None
    with contextlib.suppress(Exception):
        trusted = _trusted_keys(settings)
    try:
        verify(running.record, tool_id=settings.tool.id, serial=settings.tool.serial, trusted=trusted)
    except RecordError:
        return False
    if settings.calibration.store is not None:
        with contextlib.suppress(Exception):
            store = CalibrationStore(settings.calibration.store)
            return not store.was_taken_back(settings.tool.id, running.record.id)
    return True


def _uncalibrated(settings: Settings) -> IdentityCorrection:
    return IdentityCorrection(settings.calibration.bias_std_g, settings.calibration.scale_std)

"""The calibration record: everything needed to use a calibration, to trust it, and to make it again.

A record is JSON. Its id is the SHA-256 of its content written in one canonical way (keys sorted, no spaces, the
shortest decimal that reads back to the same double), so that a changed digit is a different record: `verify` recomputes
it. The pose table and the request that was solved are part of the content; `recompute` solves them again.

A record does not know whether it is in force: that is the store's business. A laboratory may sign it (`signature`):
the hash finds what was damaged, the signature also what was changed on purpose. It stands beside the content, not in
it, so that a record keeps its id when it is signed.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from highside.calibration.correction import OUTSIDE_ZONE, Correction, TemperatureTrust
from highside.calibration.in_hole import moved_again, solved_again
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.method import Solution, SolveRequest
from highside.calibration.methods import all_methods, get
from highside.calibration.poses import PoseSet
from highside.calibration.result import CalibrationResult
from highside.calibration.schedule import ScheduledCorrection
from highside.calibration.sensor_laws import LawCorrection, SensorLaws, laws_of_content, without_laws
from highside.calibration.signature import RECORD, Signature, SignatureError, SigningKey, TrustedKeys, UnknownKeyError
from highside.calibration.zone import SHARED_NAMES
from highside.errors import InputError, Refused
from highside.physics.law import Law
from highside.reading import MALFORMED, parse_json
from highside.version import __version__

SCHEMA = "highside.calibration/1"
SCHEMA_WITH_LAWS = "highside.calibration/2"
"""of a record with `laws`: who does not take them off the readings must not use it"""
UNITS = {
    "reading": "g",
    "offset": "g",
    "angle": "rad",
    "pose_table_angle": "deg",
    "temperature": "degC",
    "gravity": "m/s2",
}

TEXT_COLUMNS = ("pose",)
"""Columns of a pose table that are names, not numbers."""

SINGLE_TEMPERATURE_HALF_WIDTH_C = 5.0
"""A calibration at one temperature is taken to hold within this much of it."""

_ID = re.compile(r"[0-9a-f]{64}")


class RecordReason(StrEnum):
    """Why a record is refused."""

    TAMPERED = "tampered"
    """its content does not give its id, or is not what was signed: somebody or something changed it"""
    UNSIGNED = "unsigned"
    """only signed records are accepted here"""
    UNTRUSTED = "untrusted"
    """signed, but not with one of the keys that are trusted here"""
    EXPIRED = "expired"
    WRONG_TOOL = "wrong_tool"
    """made for another tool or another serial number"""
    UNIT_MISMATCH = "unit_mismatch"
    """written in other units than this software reads"""
    UNKNOWN_SCHEMA = "unknown_schema"
    """written by another version of the format"""
    MALFORMED = "malformed"
    """the id is right, but parts are missing or contradict one another"""
    NOT_FOUND = "not_found"
    NONE_ACTIVE = "none_active"
    """the store holds no calibration in force for this tool"""
    NOTHING_BEFORE = "nothing_before"
    """there is no earlier calibration to go back to"""


class RecordError(Refused):
    """A calibration record is refused. `reason` names why; the line starts with it, `text` is the rest."""

    def __init__(self, reason: RecordReason, text: str) -> None:
        self.reason = reason
        self.text = " ".join(text.split())
        super().__init__(" ".join(f"calibration refused ({reason.value}): {text}".split()))
        self.code = f"record.{reason.value}"


@dataclass(frozen=True, slots=True)
class Environment:
    """Where and by whom the poses were measured. Local gravity of the bench with its standard deviation in m/s2."""

    bench: str | None = None
    operator: str | None = None
    temp_c: float | None = None
    gravity_mps2: float | None = None
    gravity_std_mps2: float | None = None
    turntable: str | None = None
    """id of the compensation of the bench's encoder and axis that the poses were corrected by"""

    def to_dict(self) -> dict[str, Any]:
        found: dict[str, Any] = {
            "bench": self.bench,
            "operator": self.operator,
            "temp_c": self.temp_c,
            "gravity_mps2": self.gravity_mps2,
            "gravity_std_mps2": self.gravity_std_mps2,
        }
        # absent where there is none, so that records made without keep their ids
        return found if self.turntable is None else found | {"turntable": self.turntable}


PoseColumns = Mapping[str, Sequence[float] | Sequence[str]]


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """One record: `content` (plain JSON values, never changed after building) and the typed views of it."""

    id: str
    content: Mapping[str, Any]
    result: CalibrationResult
    fallback: CalibrationResult | None
    """global correction beside the zones of a balance calibration"""
    guide: CalibrationResult | None
    """rough global correction by which zones are chosen where there is no fallback"""
    signature: Signature | None = None
    """who vouches for it; only `check_signature` says whether that holds"""
    laws: tuple[Law, ...] = ()
    """of the sensor, taken off a reading before it is corrected"""

    @property
    def tool_id(self) -> str:
        return str(self.content["tool"]["id"])

    @property
    def serial(self) -> str | None:
        value = self.content["tool"]["serial"]
        return None if value is None else str(value)

    @property
    def created_s(self) -> float:
        return from_utc(self.content["created"])

    @property
    def valid_from_s(self) -> float:
        return from_utc(self.content["valid_from"])

    @property
    def expires_s(self) -> float | None:
        """End of validity in UTC epoch seconds; None: never."""
        value = self.content["expires"]
        return None if value is None else from_utc(value)

    @property
    def request(self) -> SolveRequest:
        return SolveRequest(**self.content["request"])

    @property
    def pose_count(self) -> int:
        return len(self.content["pose_table"]["ax"])

    @property
    def pose_columns(self) -> PoseColumns:
        """As they were solved: without what the laws of the record say. As measured: `content["pose_table"]`."""
        return without_laws(self.content["pose_table"], self.laws)

    def to_json(self) -> str:
        """The file: readable, one line at the end; numbers as in the content."""
        beside: dict[str, Any] = {"id": self.id}
        if self.signature is not None:
            beside["signature"] = self.signature.to_dict()
        return json.dumps({**beside, **self.content}, indent=1, sort_keys=True, allow_nan=False) + "\n"

    def signed(self, key: SigningKey, *, now_s: float) -> CalibrationRecord:
        """The same record with a signature of this key in place of any other. `now_s`: UTC epoch seconds."""
        return replace(self, signature=key.sign(RECORD, self.id, to_utc(now_s)))

    def check_signature(self, trusted: TrustedKeys) -> str:
        """The trusted name of who signed it. Raises RecordError (unsigned, untrusted, tampered)."""
        short = self.id[:12]
        if self.signature is None:
            raise RecordError(
                RecordReason.UNSIGNED,
                f"record {short} bears no signature, and only signed ones are accepted; see `highside keys sign`",
            )
        try:
            return trusted.check(self.signature, RECORD, self.id)
        except UnknownKeyError as error:
            raise RecordError(RecordReason.UNTRUSTED, f"record {short} is {error}") from error
        except SignatureError as error:
            raise RecordError(RecordReason.TAMPERED, f"record {short}: {error}; use the original file") from error


def canonical(content: Mapping[str, Any]) -> bytes:
    """The one way to write a content for hashing. Raises InputError for a number that is not finite."""
    try:
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    except ValueError as error:
        raise InputError(f"a calibration record cannot hold a number that is not finite ({error})") from error
    return text.encode("ascii")


def content_id(content: Mapping[str, Any]) -> str:
    """SHA-256 of the canonical content, 64 hexadecimal digits."""
    return hashlib.sha256(canonical(content)).hexdigest()


def to_utc(epoch_s: float) -> str:
    """UTC epoch seconds as `2026-11-21T02:40:00Z` (whole seconds)."""
    return datetime.fromtimestamp(math.floor(epoch_s), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def from_utc(text: str) -> float:
    """Epoch seconds of `to_utc`'s form. Raises ValueError for another form."""
    return datetime.strptime(text, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC).timestamp()


def build_record(
    *,
    tool_id: str,
    serial: str | None,
    request: SolveRequest,
    result: CalibrationResult,
    pose_columns: PoseColumns,
    raw_sha256: str,
    raw_name: str,
    environment: Environment,
    now_s: float,
    expires_s: float | None = None,
    fallback: CalibrationResult | None = None,
    guide: CalibrationResult | None = None,
    laws: Sequence[Law] = (),
) -> CalibrationRecord:
    """Put a record together. `pose_columns`: the pose table as it was read (degrees, g), `raw_sha256`: of its file;
    `laws` of the sensor: taken off these readings before they were solved."""
    if not tool_id.strip():
        raise InputError("the tool has no name", remedy="give tool=")
    if expires_s is not None and expires_s <= now_s:
        raise InputError("the record would expire before it is made", remedy="give a positive number of days")
    content: dict[str, Any] = {
        "schema": SCHEMA_WITH_LAWS if laws else SCHEMA,
        "units": dict(UNITS),
        "tool": {"id": tool_id, "serial": serial},
        "created": to_utc(now_s),
        "valid_from": to_utc(now_s),
        "expires": None if expires_s is None else to_utc(expires_s),
        "software": {"name": "highside", "version": __version__},
        "request": request.to_dict(),
        "environment": environment.to_dict(),
        "raw": {"name": raw_name, "sha256": raw_sha256},
        "pose_table": {name: list(values) for name, values in pose_columns.items()},
        "result": result.to_dict(),
        "fallback": None if fallback is None else fallback.to_dict(),
        "guide": None if guide is None else guide.to_dict(),
    }
    content |= {"laws": [law.to_dict() for law in laws]} if laws else {}
    # through JSON and back, so that what is used now is exactly what will be read later
    content = parse_json(canonical(content))
    return _typed(content_id(content), content)


def parse_record(text: str | bytes, *, where: str | None = None) -> CalibrationRecord:
    """Read and check a record's own integrity: schema, hash, units, structure.

    Raises InputError for what is no record at all, RecordError for one that is refused.
    """
    remedy = "give a file made by calibrate solve"
    data = parse_json(text, where=where, kind="calibration record", remedy=remedy)
    if not isinstance(data, dict) or "schema" not in data or "id" not in data:
        raise InputError("is no calibration record", where=where, remedy=remedy)
    at = f"{where}: " if where else ""
    stated, beside = data.pop("id"), data.pop("signature", None)
    if data["schema"] not in (SCHEMA, SCHEMA_WITH_LAWS):
        raise RecordError(
            RecordReason.UNKNOWN_SCHEMA,
            f"{at}schema {data['schema']!r}, this software reads {SCHEMA!r} and {SCHEMA_WITH_LAWS!r}",
        )
    found = content_id(data)
    if not isinstance(stated, str) or stated != found:
        raise RecordError(
            RecordReason.TAMPERED,
            f"{at}its content has the hash {found[:12]}, not {str(stated)[:12]}; use the original file",
        )
    if data.get("units") != UNITS:
        found_units = data["units"] if isinstance(data.get("units"), dict) else {}
        wrong = [
            f"{name} in {found_units.get(name)!r} where {unit!r} is read"
            for name, unit in UNITS.items()
            if found_units.get(name) != unit
        ]
        raise RecordError(RecordReason.UNIT_MISMATCH, f"{at}{', '.join(wrong) or 'unknown quantities'}")
    try:
        signature = None if beside is None else Signature.from_dict(beside)
    except ValueError as error:
        raise RecordError(RecordReason.TAMPERED, f"{at}the signature {error}; use the original file") from error
    return replace(_typed(found, data, at), signature=signature)


def _typed(record_id: str, content: Mapping[str, Any], at: str = "") -> CalibrationRecord:
    try:
        record = CalibrationRecord(
            id=record_id,
            content=content,
            result=CalibrationResult.from_dict(content["result"]),
            fallback=None if content["fallback"] is None else CalibrationResult.from_dict(content["fallback"]),
            guide=None if content["guide"] is None else CalibrationResult.from_dict(content["guide"]),
            laws=laws_of_content(content, content["schema"] == SCHEMA_WITH_LAWS),
        )
        # the views that are made on demand must work too
        _ = (record.tool_id, record.serial, record.created_s, record.valid_from_s, record.expires_s, record.request)
        moved_again(content, record.result)
        trial = correction_from_record(record).correct((0.1, 0.2, 0.97))
        if OUTSIDE_ZONE not in trial.flags and not all(map(math.isfinite, (*trial[:3], *trial.cov))):
            raise ValueError("a corrected reading is no number")
    except (*MALFORMED, InputError) as error:
        detail = f"{type(error).__name__}: {error}"
        raise RecordError(
            RecordReason.MALFORMED, f"{at}parts are missing or contradict one another ({detail})"
        ) from error
    return record


def verify(
    record: CalibrationRecord,
    *,
    tool_id: str | None,
    serial: str | None = None,
    now_s: float | None = None,
    trusted: TrustedKeys | None = None,
) -> None:
    """Whether a record, already read, may be used for this tool now. Raises RecordError.

    `tool_id`, `serial`: None where the caller does not know. `valid_from` is not held against the clock: a tool that
    boots with a clock of 1970 must not lose its calibration for it. `trusted`: only records signed with one of these
    keys; None: signed or not.
    """
    short = record.id[:12]
    if trusted is not None:
        record.check_signature(trusted)
    if tool_id is not None and record.tool_id != tool_id:
        raise RecordError(RecordReason.WRONG_TOOL, f"record {short} is of tool {record.tool_id!r}, not of {tool_id!r}")
    if serial is not None and record.serial is not None and record.serial != serial:
        raise RecordError(
            RecordReason.WRONG_TOOL, f"record {short} is of serial number {record.serial!r}, not of {serial!r}"
        )
    expires = record.expires_s
    if expires is not None and now_s is not None and now_s >= expires:
        raise RecordError(
            RecordReason.EXPIRED, f"record {short} expired on {record.content['expires']}; calibrate again"
        )


def correction_from_record(record: CalibrationRecord) -> Correction:
    """The record's calibration ready for use: a single correction, or a schedule of zones; behind its laws, if any."""
    bare = _without_its_laws(record)
    return LawCorrection(bare, SensorLaws(record.laws)) if record.laws else bare


def _without_its_laws(record: CalibrationRecord) -> LinearCorrection | ScheduledCorrection:
    trust = temperature_trust(record)
    result = record.result
    local = [zone for zone in result.zones if zone.is_local]
    outer = record.fallback.main if record.fallback is not None else None
    if outer is None:
        outer = next((zone for zone in result.zones if not zone.is_local), None)
    if not local:
        if outer is None:
            raise InputError("the calibration has no zone")
        return LinearCorrection(outer, record.id, trust)
    if len(local) == 1 and outer is None:
        return LinearCorrection(local[0], record.id, trust)
    guide = record.guide.main if record.guide is not None else None
    return ScheduledCorrection(
        zones=tuple(LinearCorrection(zone, record.id, trust, guarded=False) for zone in local),
        fallback=None if outer is None else LinearCorrection(outer, record.id, trust),
        cal_id=record.id,
        guide=None if guide is None else LinearCorrection(guide, record.id, trust),
    )


def temperature_trust(record: CalibrationRecord) -> TemperatureTrust | None:
    """The temperatures at which the poses were measured, from the table or the stated one; None where not known."""
    ranges = [zone.temperature for zone in record.result.zones if zone.temperature is not None]
    if ranges:
        low, high = min(t.min_c for t in ranges), max(t.max_c for t in ranges)
    else:
        table = record.content["pose_table"].get("temp_c")
        stated = record.content["environment"]["temp_c"]
        if table:
            low, high = min(table), max(table)
        elif stated is not None:
            low = high = float(stated)
        else:
            return None
    half = SINGLE_TEMPERATURE_HALF_WIDTH_C
    if high - low < 2.0 * half:
        middle = 0.5 * (low + high)
        low, high = middle - half, middle + half
    return TemperatureTrust(low, high)


def pose_set(columns: PoseColumns, request: SolveRequest, *, where: str | None = None) -> PoseSet:
    """The poses of a table as the solver takes them; InputError for a bad table, or a row copied."""
    poses = PoseSet.from_columns(columns, where=where, reference=request.reference)  # type: ignore[arg-type]
    poses.require_distinct(where)
    return poses


def solve_poses(columns: PoseColumns, request: SolveRequest, *, where: str | None = None) -> Solution:
    """Solve a pose table as requested. Raises InputError (bad table) or CalibrationRefused (no calibration follows)."""
    method = get(request.method)
    poses = pose_set(columns, request, where=where)
    if request.reference == "magnitude":
        if method.by_magnitude is None:
            others = " or ".join(other.name for other in all_methods().values() if other.by_magnitude is not None)
            raise InputError(
                f"method {request.method} needs the attitude of every pose",
                field="reference",
                remedy=f"use the method {others}",
            )
        return method.by_magnitude(poses)
    return method.solve(poses, request, BenchAccuracy(pose_rad=math.radians(request.pose_sigma_deg)))


def recompute(record: CalibrationRecord) -> Solution:
    """Solve the record's own pose table again, as it was requested; one made in the hole is moved as it says."""
    where = f"pose table of record {record.id[:12]}"
    return solved_again(record.content, solve_poses(record.pose_columns, record.request, where=where))


def largest_difference(record: CalibrationRecord, solution: Solution) -> float:
    """Largest difference between the parameters of a record and a solution; infinite if they are not of one kind."""
    if len(record.result.zones) != len(solution.result.zones):
        return math.inf
    worst = 0.0
    for mine, other in zip(record.result.zones, solution.result.zones, strict=True):
        names = [tuple(n for n in zone.parameters.names if n not in SHARED_NAMES) for zone in (mine, other)]
        if names[0] != names[1]:
            return math.inf
        worst = max(worst, float(abs(mine.parameters.block(names[0]) - other.parameters.block(names[0])).max()))
    return worst

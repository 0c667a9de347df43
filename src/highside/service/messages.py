"""What is published: a model of every MQTT payload, and the quick way to write the frequent ones.

The models are the contract (`highside schema` prints their JSON Schemas); the hot path writes the same JSON with an
f-string, several times quicker, and a test holds the two equal. JSON knows no NaN: what is not known is `null`.

`historical` is always the last member of a stored payload, so that a message that could not be sent in time is marked
by exchanging its last bytes.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

if TYPE_CHECKING:
    from highside.service.pipeline import Attitude, Survey

ONLINE = b"online"
OFFLINE = b"offline"

_FRESH_END = b'"historical":false}'
_HISTORICAL_END = b'"historical":true}'

Count = Annotated[int, Field(ge=0)]


class _Payload(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Reading(_Payload):
    seq: Count = Field(description="Counts the messages of this topic; goes on after a restart; a gap is a loss.")
    t: float = Field(description="UTC, seconds since 1970, by the clock of the host.")
    t_mono: float = Field(description="Seconds of the host's monotonic clock; not comparable across restarts.")
    clock_synced: bool = Field(description="Whether the host's clock was synchronised when `t` was taken.")
    t_device_s: float = Field(description="The tool's own time of the last reading used, seconds.")
    window_s: float = Field(ge=0, description="Time averaged; the attitude is that of the middle of it.")
    inc_deg: float | None = Field(
        ge=0, le=180, description="Inclination of the hole from vertical; null where no correction holds."
    )
    inc_std_deg: float | None = Field(ge=0, description="Standard deviation of `inc_deg`.")
    tf_deg: float | None = Field(ge=0, le=360, description="Gravity toolface; null where it is not defined.")
    tf_std_deg: float | None = Field(ge=0, description="Standard deviation of `tf_deg`; null: unknown.")
    toolface_deg: float | None = Field(ge=0, le=360, description="Toolface of the bend: `tf_deg` plus the offset.")
    toolface_offset_deg: float = Field(ge=0, le=360, description="From the sensor's scribe line to the bend.")
    azi_deg: float | None = Field(default=None, ge=0, le=360, description="Azimuth of the hole; absent without gyros.")
    azi_std_deg: float | None = Field(default=None, ge=0)
    g_total: float | None = Field(description="Magnitude of the corrected acceleration in local g; 1 at rest.")
    cal_id: str = Field(description="The calibration that made these values.")
    zone: str = Field(description="Zone of that calibration.")
    flags: list[str] = Field(description="What is doubtful about this message; empty if nothing.")


class AttitudeMessage(_Reading):
    """`<prefix>/<tool>/attitude`: inclination and toolface, each with its uncertainty."""

    historical: bool = Field(description="Sent late, after an outage.")


class SurveyMessage(_Reading):
    """`<prefix>/<tool>/survey`: the average over a time in which the tool stood still, with its quality."""

    duration_s: float = Field(ge=0, description="Seconds of stillness averaged.")
    n: Count = Field(description="Readings averaged.")
    g_std: float = Field(ge=0, description="Standard deviation of one reading, g, root mean square over the axes.")
    temp_c: float | None
    accepted: bool = Field(description="Whether the survey may be used.")
    reasons: list[str] = Field(description="Why it may not; empty if it may.")
    g_error_mg: float | None = Field(description="Gtotal minus the site's gravity, mg of standard gravity.")
    g_error_std_mg: float | None = Field(ge=0, description="Its standard deviation: survey, calibration, gravities.")
    shock_g: float = Field(ge=0, description="Greatest peak of shaking during the survey.")
    historical: bool = Field(description="Sent late, after an outage.")


class OutboxHealth(_Payload):
    """`produced == acknowledged + queued + sum(dropped)`."""

    produced: Count
    carried: Count
    committed: Count
    acknowledged: Count
    queued: Count
    queued_bytes: int
    dropped: dict[str, Count]
    storage_ok: bool
    storage_errors: Count
    storage_error: str
    corrupt_files: Count


class BrokerHealth(_Payload):
    """The connection to the broker."""

    connected: bool
    connects: Count
    failures: dict[str, Count]
    last_error: str


class HealthMessage(_Payload):
    """`<prefix>/<tool>/health` (retained): counters that balance, and alarms."""

    t: float
    clock_synced: bool
    version: str
    uptime_s: float = Field(ge=0)
    link: dict[str, Any] = Field(description="State of the link and how often it was opened and lost.")
    codec: dict[str, Count] = Field(description="Where the bytes went: bytes_in = framed + bad + text + junk.")
    monitor: dict[str, Any] = Field(description="Gaps, duplicates, range, stuck axes.")
    outbox: OutboxHealth
    broker: BrokerHealth
    recorder: dict[str, Any] | None = Field(default=None, description="Bytes written and dropped; null: not recording.")
    loop: dict[str, float] = Field(default_factory=dict, description="Stalls of the event loop.")
    pipeline: dict[str, Count] = Field(description="Attitudes and surveys made.")
    surveys: dict[str, Any] = Field(description="Accepted, refused by reason, kept on disk, and the trend of Gtotal.")
    vibration: dict[str, Any] = Field(description="Rms and peak of each axis, seconds and shocks by level.")
    toolface: dict[str, Any] = Field(description="The offset in force, who set it and when.")
    wits: list[dict[str, Any]] = Field(description="Each WITS output: peers, records made, sent and dropped.")
    calibration: dict[str, Any] = Field(description="`cal_id` in force, and why a configured record was refused.")
    rebalance: dict[str, Any] = Field(description="Cross-axis offset of this power-up, and whether it is taken off.")
    reload: dict[str, Any] = Field(description="Reloads taken, and why the last one was refused (null: it was not).")
    balance: dict[str, bool] = Field(description="Whether the counters of bytes, frames and messages add up.")
    alarms: list[str] = Field(description="What needs attention; empty if nothing.")


PAYLOADS: dict[str, type[BaseModel]] = {
    "attitude": AttitudeMessage,
    "survey": SurveyMessage,
    "health": HealthMessage,
}
"""Model by last part of the topic; `status` is a bare word."""


def schemas() -> dict[str, Any]:
    """JSON Schema of every topic."""
    found: dict[str, Any] = {name: model.model_json_schema() for name, model in PAYLOADS.items()}
    status = TypeAdapter(Literal["online", "offline"]).json_schema()
    status["description"] = "Retained plain text, not JSON: birth `online`, last will and farewell `offline`."
    found["status"] = status
    return found


def attitude_payload(
    seq: int,
    t: float,
    t_mono: float,
    clock_synced: bool,
    attitude: Attitude,
    *,
    azi_deg: float | None = None,
    azi_std_deg: float | None = None,
) -> bytes:
    """An `AttitudeMessage` as JSON. `t` UTC epoch seconds, `t_mono` monotonic seconds."""
    return b"{" + _reading(seq, t, t_mono, clock_synced, attitude, azi_deg, azi_std_deg) + _FRESH_END


def survey_payload(
    seq: int,
    t: float,
    t_mono: float,
    clock_synced: bool,
    survey: Survey,
    *,
    azi_deg: float | None = None,
    azi_std_deg: float | None = None,
) -> bytes:
    """A `SurveyMessage` as JSON. `t` UTC epoch seconds, `t_mono` monotonic seconds."""
    attitude = survey.attitude
    quality = (
        f'"duration_s":{_number(survey.duration_s, 3)},"n":{attitude.n},"g_std":{_number(survey.g_std, 9)},'
        f'"temp_c":{_number(attitude.temp_c, 3)},'
    )
    verdict = survey.verdict
    reasons = ",".join(map(_string, verdict.reasons))
    quality += (
        f'"accepted":{"true" if verdict.accepted else "false"},"reasons":[{reasons}],'
        f'"g_error_mg":{_number(verdict.g_error_mg, 4)},"g_error_std_mg":{_number(verdict.g_std_mg, 4)},'
        f'"shock_g":{_number(verdict.shock_g, 4)},'
    )
    reading = _reading(seq, t, t_mono, clock_synced, attitude, azi_deg, azi_std_deg)
    return b"{" + reading + quality.encode() + _FRESH_END


def survey_dict(seq: int, t: float, survey: Survey) -> dict[str, Any]:
    """A survey as it is kept on disk: what is published, without what belongs to the publishing."""
    found: dict[str, Any] = json.loads(survey_payload(seq, t, survey.attitude.t_mono, False, survey))
    for name in ("t_mono", "clock_synced", "historical"):
        del found[name]
    return found


def health_payload(health: HealthMessage) -> bytes:
    """A `HealthMessage` as JSON."""
    return health.model_dump_json().encode()


def mark_historical(payload: bytes) -> bytes:
    """The payload with `historical` set. One that does not end in that member (not ours) is returned as it is."""
    if payload.endswith(_FRESH_END):
        return payload[: -len(_FRESH_END)] + _HISTORICAL_END
    return payload


def _reading(
    seq: int,
    t: float,
    t_mono: float,
    clock_synced: bool,
    attitude: Attitude,
    azi_deg: float | None,
    azi_std_deg: float | None,
) -> bytes:
    azimuth = "" if azi_deg is None else f'"azi_deg":{_angle(azi_deg)},"azi_std_deg":{_number(azi_std_deg, 6)},'
    flags = ",".join(map(_string, attitude.flags))
    return (
        f'"seq":{seq},"t":{t:.6f},"t_mono":{t_mono:.6f},"clock_synced":{"true" if clock_synced else "false"},'
        f'"t_device_s":{attitude.t_device_s:.6f},"window_s":{attitude.window_s:.6f},'
        f'"inc_deg":{_number(attitude.inc_deg, 6)},"inc_std_deg":{_number(attitude.inc_std_deg, 6)},'
        f'"tf_deg":{_angle(attitude.tf_deg)},"tf_std_deg":{_number(attitude.tf_std_deg, 6)},'
        f'"toolface_deg":{_angle(attitude.toolface_deg)},'
        f'"toolface_offset_deg":{_angle(attitude.toolface_offset_deg)},{azimuth}'
        f'"g_total":{_number(attitude.g_total, 8)},"cal_id":{_string(attitude.cal_id)},'
        f'"zone":{_string(attitude.zone)},"flags":[{flags}],'
    ).encode()


def _number(value: float | None, digits: int) -> str:
    # a value that is not finite differs from itself when subtracted
    if value is None or value - value != 0.0:
        return "null"
    return f"{value:.{digits}f}"


def _angle(value: float | None) -> str:
    """An angle in [0, 360): rounding must not make 360 of 359.9999999."""
    text = _number(value, 6)
    return "0.000000" if text in ("360.000000", "-0.000000") else text


_KNOWN_STRINGS: dict[str, str] = {}


def _string(text: str) -> str:
    """`text` as a JSON string. Flags, zones and calibration ids are few: each is quoted once."""
    quoted = _KNOWN_STRINGS.get(text)
    if quoted is None:
        if len(_KNOWN_STRINGS) >= 1000:
            _KNOWN_STRINGS.clear()
        quoted = _KNOWN_STRINGS[text] = json.dumps(text)
    return quoted

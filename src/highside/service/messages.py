"""What is published: a model of every MQTT payload, and the quick way to write the frequent ones.

The models are the contract (`highside schema` prints their JSON Schemas); what writes the frequent ones is made from
their fields (`payload.py`). JSON knows no NaN: what is not known is `null`. A field that says nothing else is written
from the attribute of its name of the pipeline's `AttitudeOutput`.

`historical` is always the last member of a stored payload, so that a message that could not be sent in time is marked
by exchanging its last bytes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BaseModel, Field, TypeAdapter, model_validator

from highside.reading import parse_json
from highside.service.alarms import ALARMS
from highside.service.message_base import CommandMessage, CommandReply, Payload
from highside.service.outbox_memory import Count, OutboxStats
from highside.service.payload import Written, writer
from highside.service.saved_drift import HeadingAlignment
from highside.service.watch_messages import WatchCommand, WatchHistory, WatchMessage, WatchReply

if TYPE_CHECKING:
    from highside.service.outputs import AttitudeOutput, Survey

ONLINE = b"online"
OFFLINE = b"offline"

_FRESH_END = b'"historical":false}'
_HISTORICAL_END = b'"historical":true}'

ANGLE, TIME = Written(angle=True), Written(finite=True)
AzimuthSource = Literal[
    "constraint", "zero_rate", "rotation", "nothing", "unaligned", "vertical", "no_gyros", "gyro_units"
]


class _Reading(Payload):
    seq: Count = Field(description="Counts the messages of this topic; goes on after a restart; a gap is a loss.")
    t: Annotated[float, TIME] = Field(description="UTC, seconds since 1970, by the clock of the host.")
    t_mono: Annotated[float, TIME] = Field(
        description="Seconds of the host's monotonic clock; not comparable across restarts."
    )
    clock_synced: bool = Field(description="Whether the host's clock was synchronised when `t` was taken.")
    t_device_s: Annotated[float, TIME] = Field(description="The tool's own time of the last reading used, seconds.")
    window_s: Annotated[float, TIME] = Field(
        ge=0, description="Time averaged; the attitude is that of the middle of it."
    )
    inc_deg: float | None = Field(
        ge=0, le=180, description="Inclination of the hole from vertical; null where no correction holds."
    )
    inc_std_deg: float | None = Field(ge=0, description="Standard deviation of `inc_deg`.")
    tf_deg: Annotated[float | None, ANGLE] = Field(
        ge=0, le=360, description="Gravity toolface; null where it is not defined."
    )
    tf_std_deg: float | None = Field(ge=0, description="Standard deviation of `tf_deg`; null: unknown.")
    motor_toolface_deg: Annotated[float | None, ANGLE] = Field(
        ge=0, le=360, description="Toolface of the motor's bend: `tf_deg` plus the offset."
    )
    toolface_offset_deg: Annotated[float, ANGLE] = Field(
        ge=0, le=360, description="From the sensor's scribe line to the motor's bend."
    )
    azi_deg: Annotated[float | None, Written(of="azimuth", angle=True)] = Field(
        default=None,
        ge=0,
        le=360,
        description="Azimuth of the hole, clockwise from true north, at the last reading, freed of what `comp_id` says"
        " of the heading; absent without gyros, null where it is not known.",
    )
    azi_std_deg: Annotated[float | None, Written(of="azimuth")] = Field(
        default=None, ge=0, description="Its standard deviation; null: none is stated."
    )
    azi_basis: Annotated[list[AzimuthSource] | None, Written(of="azimuth", as_="basis")] = Field(
        default=None,
        description="What the azimuth rests on: zero_rate (gyros measured while the tool stood), rotation (the turning"
        " tool showed their biases), constraint (asserted not to change), nothing (gyros integrated as they are); or"
        " why there is none: unaligned (no azimuth was given, or it was lost), vertical, no_gyros (they fell silent),"
        " gyro_units (they are not in deg/s).",
    )
    g_total: Annotated[float | None, Written(8)] = Field(
        description="Magnitude of the corrected acceleration in local g; 1 at rest."
    )
    cal_id: str = Field(description="The calibration that made these values.")
    comp_id: Annotated[str | None, Written(or_absent=True)] = Field(
        default=None,
        description="The rotor-angle compensation in force, of inclination, toolface and azimuth as far as it has their"
        " channels; absent where none is. Its variance is part of theirs. Flags: `rotor_unknown`, `rotation_outside`"
        " (fitted at another inclination): nothing was taken off; `rotation_gap`: it is a guess at this angle;"
        " `rotation_refused`: the file was refused (`rotation_kept`: the one before goes on).",
    )
    zone: str = Field(description="Zone of that calibration.")
    flags: list[str] = Field(description="What is doubtful about this message; empty if nothing.")


class AttitudeMessage(_Reading):
    """`<prefix>/<tool>/attitude`: inclination and toolface, each with its uncertainty."""

    historical: bool = Field(description="Sent late, after an outage.")


class SurveyMessage(_Reading):
    """`<prefix>/<tool>/survey`: the average over a time in which the tool stood still, with its quality."""

    duration_s: Annotated[float, Written(3, of="survey")] = Field(ge=0, description="Seconds of stillness averaged.")
    n: Count = Field(description="Readings averaged.")
    g_std: Annotated[float, Written(9, of="survey")] = Field(
        ge=0, description="Standard deviation of one reading, g, root mean square over the axes."
    )
    temp_c: Annotated[float | None, Written(3)]
    accepted: Annotated[bool, Written(of="verdict")] = Field(description="Whether the survey may be used.")
    reasons: Annotated[list[str], Written(of="verdict")] = Field(description="Why it may not; empty if it may.")
    g_error_mg: Annotated[float | None, Written(4, of="verdict")] = Field(
        description="Gtotal minus the site's gravity, mg of standard gravity."
    )
    g_error_std_mg: Annotated[float | None, Written(4, of="verdict", as_="g_std_mg")] = Field(
        ge=0, description="Its standard deviation: survey, calibration, gravities."
    )
    shock_g: Annotated[float, Written(4, of="verdict")] = Field(
        ge=0, description="Greatest peak of shaking during the survey."
    )
    historical: bool = Field(description="Sent late, after an outage.")


class LatestMessage(Payload):
    """`<prefix>/<tool>/latest` (with `[home_assistant]`): the newest attitude, once a second while there is one.

    For who shows values and keeps none: not retained, not stored, late never. The stream is `attitude`.
    """

    t: float = Field(description="UTC, seconds since 1970, by the clock of the host.")
    inc_deg: float | None
    inc_std_deg: float | None
    tf_deg: float | None
    tf_std_deg: float | None
    motor_toolface_deg: float | None
    azi_deg: float | None
    azi_std_deg: float | None
    g_total: float | None
    temp_c: float | None


class BrokerHealth(Payload):
    """The connection to the broker."""

    connected: bool
    connects: Count
    failures: dict[str, Count]
    last_error: str
    instance: str = Field(default="", description="Names this run of the service, as in `instance`.")
    short_connections: Count = Field(default=0, description="Connections that ended within 5 s.")
    taken: str | None = Field(default=None, description="Why our client id seems to be used elsewhere; null: not.")
    replies: Count = Field(default=0, description="Answers to commands that the broker has.")
    replies_dropped: Count = Field(default=0, description="Answers beyond 5 a second (20 at once), of each kind.")
    commands_failed: Count = Field(default=0, description="Messages to us that ended in a fault of the program.")


class HealthMessage(Payload):
    """`<prefix>/<tool>/health` (retained): counters that balance, and alarms."""

    t: float
    clock_synced: bool
    version: str
    uptime_s: float = Field(ge=0)
    clock: dict[str, float | None] = Field(
        default_factory=dict,
        description="How often the wall clock was set since the start, by how much (s, positive: forward) and how long"
        " ago the last time.",
    )
    link: dict[str, Any] = Field(description="State of the link and how often it was opened and lost.")
    codec: dict[str, Count] = Field(description="Where the bytes went: bytes_in = framed + bad + text + junk.")
    monitor: dict[str, Any] = Field(description="Gaps, duplicates, range, stuck axes.")
    outbox: OutboxStats
    broker: BrokerHealth
    recorder: dict[str, Any] | None = Field(default=None, description="Bytes written and dropped; null: not recording.")
    loop: dict[str, float] = Field(default_factory=dict, description="Stalls of the event loop.")
    pipeline: dict[str, Count] = Field(description="Attitudes and surveys made.")
    surveys: dict[str, Any] = Field(description="Accepted, refused by reason, kept on disk, and the trend of Gtotal.")
    vibration: dict[str, Any] = Field(description="Rms and peak of each axis, seconds and shocks by level.")
    toolface: dict[str, Any] = Field(description="The offset in force, who set it and when.")
    wits: list[dict[str, Any]] = Field(description="Each WITS output: peers, records made, sent and dropped.")
    calibration: dict[str, Any] = Field(
        description="`cal_id` in force; why a configured record was `refused`, with the `reason` (none_active: nothing"
        " was ever put in force), and whether the one before is `kept`."
    )
    rolling_bias: dict[str, Any] = Field(description="Cross-axis offset of this power-up, and whether it is taken off.")
    drift: dict[str, Any] | None = Field(default=None, description="How the azimuth's state is kept; null: no stage.")
    watch: dict[str, Any] | None = Field(
        default=None, description="The watch of the calibration in short, and how its state is kept; null: no watch."
    )
    rotation: dict[str, Any] | None = Field(
        default=None,
        description="Rotor-angle compensation: `comp_id`, its channels, those `unused` (roll and pitch of a vehicle),"
        " why a file was refused, and whether the one before is `kept`; null: none.",
    )
    reload: dict[str, Any] = Field(
        description="Reloads taken, and why the last one was refused (null: it was not); then also the file (`where`)"
        " and `field` as far as they are known, `while` doing what, and when (`t`)."
    )
    starts: dict[str, Any] = Field(
        default_factory=dict,
        description="How often the service ended within the last minutes without a request, and the `last` cause.",
    )
    damaged: list[dict[str, str | None]] = Field(
        default_factory=list,
        description="Files of the state directory found damaged since the start: `what` was wrong, and under which name"
        " each is kept (`aside`).",
    )
    balance: dict[str, bool] = Field(description="Whether the counters of bytes, frames and messages add up.")
    alarms: list[str] = Field(
        description="What needs attention; empty if nothing. "
        + " ".join(f"`{name}`: {text}" for name, text in ALARMS.items())
    )


class LiteralAzimuth(Payload):
    """The literal algorithm of the gravity-quaternion paper on the same readings, for comparison."""

    policy: Literal["gyro", "prev", "hold"]
    azi_deg: float | None
    bias_dph: list[float] = Field(description="Its drift estimate, tool frame, deg/h.")


class RecursiveAzimuth(Payload):
    """The light filter with one gain for all directions, on the same readings, for comparison."""

    azi_deg: float | None
    azi_std_deg: float | None
    bias_dph: list[float] = Field(description="Its gyro biases, tool frame, deg/h.")


class DriftMessage(Payload):
    """`<prefix>/<tool>/drift` (retained, tools with gyros): what the azimuth is and rests on, and the gyros' biases."""

    t: float
    method: Literal["kinematic", "literal", "literal_block", "recursive"]
    motion: Literal["none", "vibrating", "turning", "quiet", "still"]
    azi_deg: float | None = Field(
        description="Of the sensors' package: what a rotor-angle compensation takes off the attitude's is still in it."
    )
    azi_std_deg: float | None
    azi_basis: list[AzimuthSource]
    alignment: HeadingAlignment | None = Field(description="When and how the azimuth was given; null: it was not.")
    connection: bool = Field(description="Whether the tool is declared to stand.")
    bias_dph: list[float] | None = Field(description="Gyro biases, tool frame, deg/h.")
    bias_std_dph: list[float] | None
    scale_ppm: float | None = Field(description="Scale error of the gyro along the tool axis.")
    refused: dict[str, Count] = Field(description="Seconds in which a measurement was rejected, by kind.")
    literal: LiteralAzimuth | None
    recursive: RecursiveAzimuth | None = Field(default=None, description="With the method recursive.")
    restored: str | None = Field(description="What was taken up from before the last restart or gap; null: nothing.")
    notes: list[str]


class DriftCommand(CommandMessage):
    """`<prefix>/<tool>/drift/command` (to the service, not retained): heading alignment and reset."""

    command: Literal["align", "reset_heading", "connection", "restart"] = Field(
        description="align: the azimuth is this. reset_heading: it is that of the alignment again (asserts a straight"
        " hole). connection: the tool stands for `seconds` (0: no more). restart: forget all, biases too."
    )
    azimuth_deg: float | None = Field(
        default=None, ge=0, le=360, strict=True, description="align: clockwise from true north."
    )
    std_deg: float | None = Field(
        default=None, ge=0, le=90, strict=True, description="align: its standard deviation; 0.5 if absent."
    )
    seconds: float | None = Field(
        default=None, ge=0, le=1800, strict=True, description="connection: for how long at most."
    )

    @model_validator(mode="after")
    def _complete(self) -> Self:
        needs = {"align": "azimuth_deg", "connection": "seconds"}.get(self.command)
        if needs is not None and getattr(self, needs) is None:
            raise ValueError(f"{self.command} needs {needs}")
        for name, of in (("azimuth_deg", "align"), ("std_deg", "align"), ("seconds", "connection")):
            if getattr(self, name) is not None and self.command != of:
                raise ValueError(f"{name} belongs to {of}, not to {self.command}")
        return self


class DriftReply(CommandReply):
    """`<prefix>/<tool>/drift/reply`: whether a command was done."""


PAYLOADS: dict[str, type[BaseModel]] = {
    "attitude": AttitudeMessage,
    "survey": SurveyMessage,
    "latest": LatestMessage,
    "health": HealthMessage,
    "drift": DriftMessage,
    "drift/command": DriftCommand,
    "drift/reply": DriftReply,
    "watch": WatchMessage,
    "watch/history": WatchHistory,
    "watch/command": WatchCommand,
    "watch/reply": WatchReply,
}
"""Model by last part of the topic; `status` is a word, `instance` two."""


WORDS: tuple[tuple[str, str, str], ...] = (
    ("status", "^(online|offline)$", "birth `online`, last will and farewell `offline`."),
    (
        "instance",
        "^(online|offline) [0-9a-f]{8}$",
        "which run of the service was the last to begin or to take leave (health's `broker.instance`): `online"
        " 5f0c2a91`. Two services of one tool notice each other by it.",
    ),
)
"""Topics of plain text, retained: name, pattern, meaning."""


def schemas() -> dict[str, Any]:
    """JSON Schema of every topic."""
    found: dict[str, Any] = {name: model.model_json_schema() for name, model in PAYLOADS.items()}
    for name, pattern, says in WORDS:
        found[name] = TypeAdapter(Annotated[str, Field(pattern=pattern)]).json_schema()
        found[name]["description"] = f"Retained plain text, not JSON: {says}"
    return found


_COMMON = ("seq", "t", "t_mono", "clock_synced")

attitude_payload: Callable[[int, float, float, bool, AttitudeOutput], bytes] = writer(
    AttitudeMessage, (*_COMMON, "attitude"), "attitude", {"azimuth": "attitude.azimuth"}
)
"""An `AttitudeMessage` as JSON, of `seq`, `t` (UTC epoch seconds), `t_mono` (monotonic seconds), `clock_synced`."""

survey_payload: Callable[[int, float, float, bool, Survey], bytes] = writer(
    SurveyMessage,
    (*_COMMON, "survey"),
    "attitude",
    {"attitude": "survey.attitude", "azimuth": "attitude.azimuth", "verdict": "survey.verdict"},
)
"""A `SurveyMessage` as JSON, of the same and a survey."""


def survey_dict(seq: int, t: float, survey: Survey) -> dict[str, Any]:
    """A survey as it is kept on disk: what is published, without what belongs to the publishing."""
    found: dict[str, Any] = parse_json(survey_payload(seq, t, survey.attitude.t_mono, False, survey))
    for name in ("t_mono", "clock_synced", "historical"):
        del found[name]
    return found


def latest_payload(t: float, values: dict[str, float | None]) -> bytes:
    """A `LatestMessage` as JSON; what is not finite is null."""
    known = {name: None if value is None or value - value != 0.0 else value for name, value in values.items()}
    return LatestMessage(t=round(t, 6), **known).model_dump_json().encode()


def health_payload(health: HealthMessage) -> bytes:
    """A `HealthMessage` as JSON."""
    return health.model_dump_json().encode()


def mark_historical(payload: bytes) -> bytes:
    """The payload with `historical` set. One that does not end in that member (not ours) is returned as it is."""
    if payload.endswith(_FRESH_END):
        return payload[: -len(_FRESH_END)] + _HISTORICAL_END
    return payload

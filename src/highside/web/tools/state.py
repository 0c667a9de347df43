"""What the tools at a broker have published, as far as a page shows it. Pure: messages and times in, state out.

Every figure carries the time of its arrival by the monotonic clock of this process, and is stale by that clock: the
sender's clock may be wrong. A message that the broker had kept (retained) is of unknown age and never counts as fresh.
Messages of other versions are read leniently: a member that is missing or of another type is unknown, members that are
not known here are passed over; what is no JSON object is counted.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

from highside.errors import InputError
from highside.printable import printable
from highside.reading import parse_json

TOPICS = ("attitude", "survey", "status", "health", "drift", "watch", "watch/history")
"""Last parts of the topics that are subscribed to."""
TOOLS_MAX = 1000
"""Tools that are kept; further ones are counted. A thousand with full histories take some 300 MB."""
PAYLOAD_MAX = 65_536
"""Bytes of a message; `watch/history`, the longest, has some 40,000."""
STALE_S = 3.0
"""Seconds without an attitude after which the last one is stale: thrice the slowest usual interval, 1 s."""
STALE_INTERVALS = 3.0
"""Usual intervals between attitudes after which the last one is stale, where these are longer than `STALE_S` allows."""
TREND_EVERY_S = 1.0
TREND_LENGTH = 600
"""Points of the trend: ten minutes at one a second."""
ORDINARY_FLAGS = frozenset({"moving", "low_inclination", "toolface_undefined"})
SURVEYS_KEPT = 20
EVENTS_KEPT = 200
INTERVALS_KEPT = 15
HISTORY_MAX = 1000
"""Points of a watch's history that are taken; a service sends 144."""
CHANGES_MAX = 24
"""Changes of the record in it that are taken; a service sends twelve."""
PARAMETERS_MAX = 30
"""Its parameters; a calibration has twelve."""
TEXT_MAX = 300
"""Characters of a text from outside that a page shows."""

Condition = Literal["live", "silent", "offline", "unknown"]


@dataclass(frozen=True, slots=True)
class Reading:
    """One attitude, in deg and local g; None: not known."""

    t: float | None
    inc_deg: float | None
    inc_std_deg: float | None
    tf_deg: float | None
    tf_std_deg: float | None
    motor_toolface_deg: float | None
    azi_deg: float | None
    azi_std_deg: float | None
    g_total: float | None
    cal_id: str
    zone: str
    flags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SurveyRow:
    """One survey: its reading, whether it may be used, and why not."""

    reading: Reading
    duration_s: float | None
    temp_c: float | None
    g_error_mg: float | None
    accepted: bool
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Point:
    """One point of the trend; `mono` in seconds of this process's monotonic clock."""

    mono: float
    reading: Reading


@dataclass(frozen=True, slots=True)
class Event:
    """Something that changed; `utc` in seconds since 1970 by this machine's clock."""

    utc: float
    text: str


@dataclass(frozen=True, slots=True)
class Trace:
    """One parameter of the calibration over time; None: not known."""

    value: tuple[float | None, ...]
    std: tuple[float | None, ...]


@dataclass(frozen=True, slots=True)
class History:
    """How far a tool was from its calibration, by the tool's watch."""

    hours: tuple[float, ...]
    """before the message, by the sender's clock: negative"""
    parameters: dict[str, Trace]
    inclination_deg: tuple[float | None, ...]
    evidence: tuple[float | None, ...]
    threshold: float | None
    changes: tuple[tuple[float, str], ...] = ()
    """hours at which another record, or another gravity, came into force, and the record from then on"""


@dataclass(slots=True)
class ToolState:
    """Everything known of one tool."""

    tool: str
    status: str | None = None
    reading: Reading | None = None
    reading_mono: float | None = None
    health: dict[str, Any] = field(default_factory=dict)
    health_mono: float | None = None
    """None: it was retained, its age is not known"""
    drift: dict[str, Any] = field(default_factory=dict)
    watch: dict[str, Any] = field(default_factory=dict)
    history: History | None = None
    """of the watch, over the last day"""
    surveys: deque[SurveyRow] = field(default_factory=lambda: deque(maxlen=SURVEYS_KEPT))
    trend: deque[Point] = field(default_factory=lambda: deque(maxlen=TREND_LENGTH))
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=EVENTS_KEPT))
    attitudes: int = 0
    late: int = 0
    """attitudes that came late, after an outage (`historical`); they are not shown as the present"""
    unreadable: int = 0
    version: int = 0
    """grows with every message"""
    _intervals: deque[float] = field(default_factory=lambda: deque(maxlen=INTERVALS_KEPT))

    @property
    def alarms(self) -> tuple[str, ...]:
        """Names of the alarms that stand, as the tool's last `health` says."""
        return texts(self.health.get("alarms"))

    def age_s(self, now: float) -> float | None:
        """Seconds since the last attitude; None before the first."""
        return None if self.reading_mono is None else max(0.0, now - self.reading_mono)

    def stale_after_s(self) -> float:
        """Seconds without an attitude after which the last one is stale."""
        usual = statistics.median(self._intervals) if self._intervals else 0.0
        return max(STALE_S, STALE_INTERVALS * usual)

    def condition(self, now: float) -> Condition:
        """`live`: attitudes arrive; `silent`: online, but none arrives; `offline`; `unknown`: it has never said."""
        age = self.age_s(now)
        fresh = age is not None and age <= self.stale_after_s()
        if self.status == "offline":
            return "offline"
        if fresh:
            return "live"
        return "silent" if self.status == "online" or age is not None else "unknown"

    # --- taking -------------------------------------------------------------------------------------------------

    def take(self, name: str, payload: bytes, *, retained: bool, mono: float, utc: float) -> None:
        """A message of the topic `name`; one that cannot be read is counted."""
        self.version += 1
        if name == "status":
            self._status(payload, utc)
            return
        try:
            said = parse_json(payload, max_bytes=PAYLOAD_MAX)
        except InputError:
            said = None
        if not isinstance(said, dict):
            self.unreadable += 1
        elif name == "attitude":
            self._attitude(said, retained=retained, mono=mono, utc=utc)
        elif name == "survey":
            self._survey(said, utc)
        elif name == "health":
            self._health(said, None if retained else mono, utc)
        elif name == "drift":
            self.drift = said
        elif name == "watch":
            self._watch(said, utc)
        elif name == "watch/history":
            self.history = history_of(said)

    def _status(self, payload: bytes, utc: float) -> None:
        word = payload[:32].decode("utf-8", "replace").strip()
        if word not in ("online", "offline"):
            self.unreadable += 1
        elif word != self.status:
            self._note(utc, f"is {word}")
            self.status = word

    def _attitude(self, said: dict[str, Any], *, retained: bool, mono: float, utc: float) -> None:
        self.attitudes += 1
        if retained or said.get("historical") is True:
            self.late += 1
            return
        made = reading_of(said)
        before = self.reading
        if self.reading_mono is not None:
            self._intervals.append(mono - self.reading_mono)
        self.reading, self.reading_mono = made, mono
        if before is not None:
            if made.cal_id != before.cal_id:
                now_in_force, earlier = (cal_id[:12] or "unknown" for cal_id in (made.cal_id, before.cal_id))
                self._note(utc, f"calibration {now_in_force} in force, before it {earlier}")
            self._changes(utc, "flag", _lasting(before.flags), _lasting(made.flags))
        if not self.trend or mono - self.trend[-1].mono >= TREND_EVERY_S:
            self.trend.append(Point(mono, made))

    def _survey(self, said: dict[str, Any], utc: float) -> None:
        row = SurveyRow(
            reading_of(said),
            number(said.get("duration_s")),
            number(said.get("temp_c")),
            number(said.get("g_error_mg")),
            said.get("accepted") is True,
            texts(said.get("reasons")),
        )
        self.surveys.append(row)
        why = f": {', '.join(row.reasons)}" if row.reasons else ""
        self._note(utc, f"survey {'accepted' if row.accepted else 'refused'}{why}")

    def _health(self, said: dict[str, Any], mono: float | None, utc: float) -> None:
        before = self.alarms
        self.health, self.health_mono = said, mono
        self._changes(utc, "alarm", before, self.alarms)

    def _watch(self, said: dict[str, Any], utc: float) -> None:
        before, self.watch = text(self.watch.get("verdict")), said
        if (verdict := text(said.get("verdict"))) != before:
            self._note(utc, f"watch: {verdict or 'no verdict'}")

    def _changes(self, utc: float, what: str, before: tuple[str, ...], now: tuple[str, ...]) -> None:
        for name in now:
            if name not in before:
                self._note(utc, f"{what} {name}")
        for name in before:
            if name not in now:
                self._note(utc, f"{what} {name} is over")

    def _note(self, utc: float, what: str) -> None:
        self.events.append(Event(utc, what))


class Tools:
    """All tools that were heard of."""

    def __init__(self, prefix: str) -> None:
        self._prefix = f"{prefix}/"
        self.tools: dict[str, ToolState] = {}
        self.refused = 0
        """messages of tools beyond `TOOLS_MAX`, or of a topic that is none of a tool's"""

    def take(self, topic: str, payload: bytes, *, retained: bool, mono: float, utc: float) -> None:
        """A message as it came; never raises."""
        tool, _, name = topic.removeprefix(self._prefix).partition("/")
        known = self.tools.get(tool)
        if known is None:
            bad = not topic.startswith(self._prefix) or name not in TOPICS or not tool or printable(tool) != tool
            if bad or len(tool) > TEXT_MAX or len(self.tools) >= TOOLS_MAX:
                self.refused += 1
                return
            if not payload:
                # how a retained message is taken back: nothing is known of such a tool
                return
            known = self.tools[tool] = ToolState(tool)
        if name in TOPICS and payload:
            known.take(name, payload, retained=retained, mono=mono, utc=utc)

    def in_order(self, now: float) -> list[ToolState]:
        """Those that need attention first, then by name."""
        return sorted(self.tools.values(), key=lambda tool: (not needs_attention(tool, now), tool.tool))


def _lasting(flags: tuple[str, ...]) -> tuple[str, ...]:
    """Without those that come and go in ordinary work, and would fill the log."""
    return tuple(flag for flag in flags if flag not in ORDINARY_FLAGS)


def needs_attention(tool: ToolState, now: float) -> bool:
    """Whether somebody should look at it: it is silent, an alarm stands, or its calibration departs."""
    return tool.condition(now) in ("silent", "unknown") or bool(tool.alarms) or departs(tool)


def departs(tool: ToolState) -> bool:
    """Whether the watch over its calibration says that it no longer holds."""
    return tool.watch.get("verdict") == "departs"


def reading_of(said: dict[str, Any]) -> Reading:
    """The attitude in a message of `attitude` or `survey`; members of another type than expected are unknown."""
    return Reading(
        t=number(said.get("t")),
        inc_deg=number(said.get("inc_deg")),
        inc_std_deg=number(said.get("inc_std_deg")),
        tf_deg=number(said.get("tf_deg")),
        tf_std_deg=number(said.get("tf_std_deg")),
        # formerly `toolface_deg`: a fleet may have tools of both
        motor_toolface_deg=number(said.get("motor_toolface_deg", said.get("toolface_deg"))),
        azi_deg=number(said.get("azi_deg")),
        azi_std_deg=number(said.get("azi_std_deg")),
        g_total=number(said.get("g_total")),
        cal_id=text(said.get("cal_id")),
        zone=text(said.get("zone")),
        flags=texts(said.get("flags")),
    )


def history_of(said: dict[str, Any]) -> History | None:
    """The history in a message of `watch/history`; None where its times are none. Lists of another length than the
    times have are unknown from there on."""
    now, listed = number(said.get("t")), said.get("times")
    if now is None or not isinstance(listed, list) or len(listed) > HISTORY_MAX:
        return None
    times = [number(one) for one in listed]
    known = [one for one in times if one is not None]
    if len(known) < len(times) or known != sorted(known):
        return None
    count = len(known)
    parameters = said.get("parameters")
    traces = {
        text(name): Trace(_numbers(one.get("value"), count), _numbers(one.get("std"), count))
        for name, one in (list(parameters.items())[:PARAMETERS_MAX] if isinstance(parameters, dict) else ())
        if isinstance(one, dict)
    }
    return History(
        tuple(round((one - now) / 3600.0, 4) for one in known),
        traces,
        _numbers(said.get("inclination_deg"), count),
        _numbers(said.get("evidence"), count),
        number(said.get("threshold")),
        _changes(said.get("changes"), now),
    )


def _changes(listed: object, now: float) -> tuple[tuple[float, str], ...]:
    found = [one for one in listed[:CHANGES_MAX] if isinstance(one, dict)] if isinstance(listed, list) else []
    times = [(number(one.get("t")), text(one.get("cal_id"))[:12]) for one in found]
    return tuple(sorted((round((t - now) / 3600.0, 4), cal_id) for t, cal_id in times if t is not None))


def _numbers(value: object, count: int) -> tuple[float | None, ...]:
    found = [number(one) for one in value[:count]] if isinstance(value, list) else []
    return (*found, *[None] * (count - len(found)))


def number(value: object) -> float | None:
    """A finite number, else None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        made = float(value)
    except OverflowError:
        return None
    return made if made - made == 0.0 else None


def text(value: object) -> str:
    """A text of bounded length without control characters; anything else is empty."""
    return printable(value)[:TEXT_MAX] if isinstance(value, str) else ""


def texts(value: object) -> tuple[str, ...]:
    """The texts of a list; anything else is empty."""
    return tuple(text(item) for item in value[:50] if isinstance(item, str)) if isinstance(value, list) else ()

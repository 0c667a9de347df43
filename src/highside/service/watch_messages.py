"""What the watch says over MQTT, and what it obeys."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from highside.service.message_base import CommandMessage, CommandReply, Payload
from highside.service.outbox_memory import Count


class WatchError(Payload):
    """Of the present attitude, deg."""

    inc_deg: float = Field(description="Of inclination.")
    tf_sin_inc_deg: float = Field(description="Of toolface times the sine of the inclination.")
    tf_deg: float | None = Field(description="Of toolface; null in a vertical hole.")


class WatchSize(Payload):
    """Of one of a class, if it is what happened."""

    value: float
    std: float = Field(ge=0, description="Standard deviation.")
    low: float = Field(description="95 % interval.")
    high: float
    unit: str


class WatchTakenBack(Payload):
    """A departure that was said once, and not any more: what came in between spoke against it."""

    alarm_t: float = Field(description="When it was said, UTC, by the tool's own time back from now.")
    t: float = Field(description="When it was taken back.")


class WatchDeparture(Payload):
    """A departure from the calibration in force. The claim is its class: what the hole cannot tell apart."""

    effect: str = Field(description="Of the library of effects, of the likeliest; `unexplained`: no small error.")
    parameter: str = Field(description="The likeliest of the class: b_x is the offset of x, S_xz how x feels z.")
    equivalence_class: list[str]
    size: float
    std: float = Field(ge=0, description="Standard deviation of the size.")
    low: float = Field(description="95 % interval of the size.")
    high: float
    unit: str
    sizes: dict[str, WatchSize] = Field(
        default_factory=dict, description="Of each of the class, if it is what happened; the likeliest first."
    )
    since_t: float = Field(description="Likeliest onset, UTC, by the tool's own time back from now.")
    since_low_t: float
    since_high_t: float
    alarm_t: float = Field(description="When it was first said.")
    evidence: float | None = Field(description="Twice the log-likelihood ratio against no departure.")
    error: WatchError | None = Field(description="What it does; null where no reading is to be used.")
    acknowledged: bool = Field(description="Whether somebody has taken note: the alarm has ended.")


class WatchNoise(Payload):
    """An axis whose readings at rest scatter otherwise than before. Nothing of the calibration departs by it."""

    axis: Literal["x", "y", "z"]
    effect: str = Field(description="Of the library of effects: reading_noise or coloured_noise.")
    of: str = Field(description="What scatters: single readings, or means of two seconds.")
    factor: float = Field(ge=0, description="Of the scatter to that of before; below one: less.")
    scatter_g: float = Field(ge=0, description="Now, one standard deviation.")
    since_t: float = Field(description="UTC, by the tool's own time back from now: the first rest that shows it.")
    rests: Count = Field(description="Rests that show it.")


class WatchParameter(Payload):
    """How far a parameter is from the calibration in force."""

    value: float
    std: float = Field(ge=0)
    unit: str
    stated_std: float = Field(ge=0, description="Before the first measurement.")
    observable: bool = Field(description="Whether the hole has told most of what is known of it.")


class WatchMessage(Payload):
    """`<prefix>/<tool>/watch` (retained): whether the calibration in force still holds, by what the hole shows."""

    t: float = Field(description="UTC, seconds since 1970, of what was said.")
    verdict: Literal["learning", "holds", "departs", "off"] = Field(
        description="off: nothing is watched any more, `began` says why; nothing else is known then."
    )
    cal_id: str = Field(description="The calibration that is watched; empty: none.")
    claims: list[WatchDeparture]
    parameters: dict[str, WatchParameter]
    not_observable: dict[str, str] = Field(description="Parameter, and what it would take to see it.")
    advice: list[str] = Field(description="What to do, the first first.")
    inclination_deg: float | None = Field(description="The present attitude: that of the last rest or turn used.")
    toolface_deg: float | None = Field(description="null: it turned.")
    measured_t: float | None = Field(
        default=None,
        description="UTC of the last rest or turn used, of which all is that is said; null: none was.",
    )
    age_s: float = Field(default=0.0, ge=0, description="Seconds from then to `t`.")
    stale: bool = Field(default=False, description="So old that nothing is said to hold by it.")
    still_unseen: WatchError | None = Field(
        description="Three standard deviations of what the hole alone says of the present attitude."
    )
    never_seen: WatchError | None = Field(
        default=None,
        description="Three standard deviations of what no hole shows (toolface zero, an antisymmetric misalignment), as"
        " the record and the tool's class state it.",
    )
    stated: WatchError | None = Field(description="One standard deviation of the record at the present attitude.")
    taken_back: WatchTakenBack | None = Field(
        default=None, description="The last departure that later measurements spoke against."
    )
    noise_grown: bool
    noise_ratio: float = Field(description="Of the innovations' standard deviation to the stated one.")
    undecided: Count = Field(
        default=0, description="Measurements that noise which has grown or a departure has made: the next ones tell."
    )
    noise_changes: list[WatchNoise] = Field(
        default_factory=list, description="Axes whose own noise has changed, by what their readings scatter at rest."
    )
    watched_s: float = Field(ge=0, description="Seconds since the watch began.")
    stills: Count = Field(description="Rests used.")
    turns: Count = Field(description="Windows of rotation used.")
    left_out: dict[str, Count] = Field(description="What was not used, by reason.")
    began: str = Field(description="From what this watch goes on, or why it began anew.")

    @classmethod
    def off(cls, t: float, why: str) -> WatchMessage:
        """In the place of a verdict that nobody watches over any more."""
        return cls(
            t=t,
            verdict="off",
            cal_id="",
            claims=[],
            parameters={},
            not_observable={},
            advice=[],
            inclination_deg=None,
            toolface_deg=None,
            still_unseen=None,
            stated=None,
            noise_grown=False,
            noise_ratio=1.0,
            watched_s=0.0,
            stills=0,
            turns=0,
            left_out={},
            began=why,
        )


class WatchTrace(Payload):
    """One parameter at the times of `WatchHistory`."""

    unit: str
    value: list[float]
    std: list[float] = Field(description="Standard deviation of each; bands of 95 % are two of them.")


class WatchChange(Payload):
    """Where the watch began anew within `WatchHistory`: deviations before and after are from different records."""

    t: float = Field(description="UTC, by the tool's own time back from now: the last reading before.")
    before: str = Field(description="The calibration record in force before.")
    cal_id: str = Field(description="The one in force from then on.")
    why: str


class WatchHistory(Payload):
    """`<prefix>/<tool>/watch/history` (retained): how far the tool was from its calibration over the last day."""

    t: float = Field(description="UTC, seconds since 1970, of what was said.")
    cal_id: str
    began: str = Field(description="From what this watch goes on, or why it began anew.")
    threshold: float = Field(description="Evidence from which something departs.")
    times: list[float] = Field(description="UTC, by the tool's own time back from now; 144 at most, over 24 hours.")
    inclination_deg: list[float]
    evidence: list[float] = Field(description="Twice the log-likelihood ratio of the likeliest departure against none.")
    parameters: dict[str, WatchTrace] = Field(
        description="Deviations from the calibration then in force, by the names of `watch`."
    )
    changes: list[WatchChange] = Field(
        default_factory=list, description="Where another record, or another gravity of the site, came into force."
    )

    @classmethod
    def off(cls, t: float, why: str, threshold: float) -> WatchHistory:
        """No picture: nothing is watched any more."""
        return cls(
            t=t,
            cal_id="",
            began=why,
            threshold=threshold,
            times=[],
            inclination_deg=[],
            evidence=[],
            parameters={},
        )


class WatchCommand(CommandMessage):
    """`<prefix>/<tool>/watch/command` (to the service, not retained): take note of a departure, or begin anew."""

    command: Literal["acknowledge", "restart"] = Field(
        description="acknowledge: the departures that stand are known; the alarm ends, the flag stays. restart: forget"
        " what was seen, and begin from the calibration in force."
    )


class WatchReply(CommandReply):
    """`<prefix>/<tool>/watch/reply`: whether a command was done."""

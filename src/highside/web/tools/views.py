"""What the pages say of the tools, as HTML made once for all who look: pure, from the state and the time.

Everything that comes from outside is escaped by the templates (Jinja2 with autoescape).
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from jinja2 import Environment
from markupsafe import Markup

from highside.service.alarms import ALARMS
from highside.web.tools.drawings import dial
from highside.web.tools.signs import FLAGS, LINK, MOTION, REASONS, RECORDER, all_meant, event_words, meant
from highside.web.tools.state import (
    PARAMETERS_MAX,
    Condition,
    Reading,
    Tools,
    ToolState,
    departs,
    needs_attention,
    number,
    text,
    texts,
)
from highside.web.tools.watch_words import advice, duration, unseen, watch_words
from highside.web.words import _, said_later, several, told
from highside.words.marked import in_words
from highside.words.worded import worded

WORDS: dict[Condition, str] = {
    "live": said_later("live"),
    "silent": said_later("silent"),
    "offline": said_later("offline"),
    "unknown": said_later("never heard"),
}
"""What the sign of a tool says."""

CLAIMS_MAX = 4
"""that a page lists: a watch says one, or two where an axis is broken"""
UNKNOWN_ALARM = said_later("This page does not know the alarm: the tool's version is another; see its documentation.")


@dataclass(frozen=True, slots=True)
class Alarm:
    """An alarm with its cause and remedy."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Row:
    """A name, a value and what is to be noted of it."""

    name: str
    value: str
    note: Markup | str = ""
    bad: bool = False


@dataclass(frozen=True, slots=True)
class Figure:
    """A large number with its 95 % band."""

    name: str
    value: str
    band: str


@dataclass(frozen=True, slots=True)
class Broker:
    """How this page stands with the broker."""

    where: str
    connected: bool
    reason: str
    since_s: float


@dataclass(frozen=True, slots=True)
class ToolPage:
    """One string for each place of a tool's page."""

    head: str
    figures: str
    dial: str
    state: str
    parts: str
    surveys: str
    events: str
    watch: str


def list_page(tools: Tools, broker: Broker, now: float) -> str:
    """The start page: every tool in a row, those that need attention first."""
    rows = [_list_row(tool, now) for tool in tools.in_order(now)]
    count = sum(row["attention"] for row in rows)
    if not rows:
        said = _("No tool has been heard at this broker yet.") if broker.connected else _("No broker, no tools.")
    elif count == 0:
        said = _("%(tools)s, nothing needs attention.") % {"tools": _tools(len(rows))}
    else:
        said = several("%(count)s of %(tools)s needs attention.", "%(count)s of %(tools)s need attention.", count)
        said = said % {"count": count, "tools": _tools(len(rows))}
    return _render("list.html", rows=rows, said=said, broker=broker, refused=tools.refused)


def tool_page(tool: ToolState, broker: Broker, now: float) -> ToolPage:
    """Everything of one tool."""
    condition = tool.condition(now)
    fresh = condition == "live" and broker.connected
    reading = tool.reading
    toolface, std = (None, None) if reading is None else (reading.motor_toolface_deg, reading.tf_std_deg)
    past = [p.reading.motor_toolface_deg for p in tool.trend if p.reading.motor_toolface_deg is not None]
    return ToolPage(
        head=_render(
            "head.html",
            tool=tool.tool,
            sign=_(WORDS[condition]),
            condition=condition,
            broker=broker,
            said=_sentence(tool, now),
            alarms=_alarms(tool),
            advice=advice(tool) if departs(tool) else (),
        ),
        figures=_render("figures.html", figures=_figures(reading), fresh=fresh),
        dial=_render("dial.html", dial=dial(toolface, std, past[:-1]), fresh=fresh, ticks=_TICKS),
        state=_render("rows.html", rows=_state_rows(tool), fresh=fresh),
        parts=_render("rows.html", rows=_part_rows(tool, now), fresh=True),
        surveys=_render("surveys.html", surveys=[_survey(row) for row in reversed(tool.surveys)]),
        events=_render("events.html", events=_log(tool)),
        watch=_render(
            "watch.html",
            said=watch_words(tool),
            claims=_departures(tool),
            # where it departs it stands at the top of the page
            advice=() if departs(tool) else advice(tool),
            rows=_parameters(tool),
            unseen=unseen(tool),
        ),
    )


# --- the words ---------------------------------------------------------------------------------------------------


def _tools(count: int) -> str:
    return several("%(count)s tool", "%(count)s tools", count) % {"count": count}


def _sentence(tool: ToolState, now: float) -> str:
    """What is going on, in one sentence."""
    condition, age = tool.condition(now), tool.age_s(now)
    if condition == "live":
        flags = tool.reading.flags if tool.reading is not None else ()
        if not flags:
            return _("Attitudes arrive.")
        return _("Attitudes arrive, with doubts: %(flags)s.") % {"flags": all_meant(flags, FLAGS)}
    last = _("No attitude has come yet.")
    if age is not None:
        last = _("The last attitude is %(age)s old.") % {"age": duration(age)}
    if condition == "offline":
        return _("The service of this tool has gone off line.") + f" {last}"
    if condition == "silent":
        return _("Its service is on line.") + f" {last}" if tool.status == "online" else last
    return _("Only kept messages are known of this tool; it has said nothing since.")


def _list_row(tool: ToolState, now: float) -> dict[str, Any]:
    condition = tool.condition(now)
    figures = _figures(tool.reading)
    return {
        "tool": tool.tool,
        "sign": _(WORDS[condition]),
        "condition": condition,
        "fresh": condition == "live",
        "figures": figures[:2],
        "said": _sentence(tool, now),
        "alarms": _alarms(tool),
        "attention": needs_attention(tool, now),
        "departs": departs(tool),
    }


def _alarms(tool: ToolState) -> list[Alarm]:
    return [Alarm(name, ALARMS.get(name, UNKNOWN_ALARM)) for name in tool.alarms]


def _figures(reading: Reading | None) -> list[Figure]:
    if reading is None:
        return [Figure("I", "–", ""), Figure("T", "–", "")]
    return [
        Figure("I", _degrees(reading.inc_deg, reading.inc_std_deg), _band(reading.inc_std_deg)),
        Figure("T", _degrees(reading.motor_toolface_deg, reading.tf_std_deg), _band(reading.tf_std_deg)),
    ]


def _degrees(value: float | None, std: float | None) -> str:
    return "–" if value is None else f"{value:.{_digits(std)}f}°"


def _digits(std: float | None) -> int:
    """Digits after the point that the uncertainty leaves."""
    if std is None or std <= 0.0:
        return 2
    return min(4, max(0, 1 - math.floor(math.log10(std))))


def _band(std: float | None) -> str:
    return _("uncertainty unknown") if std is None else f"± {2 * std:.2g}° (95 %)"


def _state_rows(tool: ToolState) -> list[Row]:
    """What the tool measures beside I and T."""
    reading = tool.reading
    rows: list[Row] = []
    if reading is not None:
        offset = "" if reading.tf_deg is None else _("of the sensor: %(angle)s°") % {"angle": f"{reading.tf_deg:.2f}"}
        rows.append(Row(_("toolface"), _degrees(reading.motor_toolface_deg, reading.tf_std_deg), offset))
        if reading.azi_deg is not None:
            rows.append(Row(_("azimuth"), _degrees(reading.azi_deg, reading.azi_std_deg), _band(reading.azi_std_deg)))
        rows.append(Row("|g|", "–" if reading.g_total is None else f"{reading.g_total:.6f} g", _("1 at rest")))
    temp = next((row.temp_c for row in reversed(tool.surveys) if row.temp_c is not None), None)
    if temp is not None:
        rows.append(Row(_("temperature"), f"{temp:.1f} °C", _("of the last survey")))
    vibration = tool.health.get("vibration")
    rms = vibration.get("rms_g") if isinstance(vibration, dict) else None
    if isinstance(rms, list) and (known := [value for item in rms if (value := number(item)) is not None]):
        rows.append(Row(_("vibration, rms"), _accelerations(known), "x · y · z"))
    return rows


def _accelerations(values_g: list[float]) -> str:
    """Of several axes in one unit: mg, in which a tool at rest is not zero, below a tenth of g."""
    unit, scale, digits = ("g", 1.0, 3) if max(abs(value) for value in values_g) >= 0.1 else ("mg", 1e3, 2)
    return " · ".join(f"{scale * value:.{digits}f}" for value in values_g) + f" {unit}"


def _part_rows(tool: ToolState, now: float) -> list[Row]:
    """How its parts are, from its `health`; nothing where it never published one."""
    health = tool.health
    if not health:
        return []
    age = _("its age is not known: the broker had kept it")
    if tool.health_mono is not None:
        age = _("%(age)s ago") % {"age": duration(now - tool.health_mono)}
    link, outbox = _table(health, "link"), _table(health, "outbox")
    recorder, calibration = _table(health, "recorder"), _table(health, "calibration")
    dropped = sum(int(value) for value in _table(outbox, "dropped").values() if number(value) is not None)
    lost = number(recorder.get("bytes_dropped")) or 0
    state = text(link.get("state"))
    rows = [
        Row(_("reported"), age, _("version %(name)s") % {"name": text(health.get("version"))}),
        Row(_("link"), meant(state, LINK) or "–", _age(link), bad=state not in ("up", "")),
        Row(
            _("outbox"),
            _("%(count)s waiting") % {"count": _count(outbox, "queued")},
            _("%(count)s dropped") % {"count": dropped},
            bad=dropped > 0,
        ),
    ]
    if recorder:
        state = text(recorder.get("state"))
        note = text(recorder.get("message")) or _("%(written)s bytes written, %(lost)s dropped") % {
            "written": _count(recorder, "bytes_written"),
            "lost": f"{lost:.0f}",
        }
        rows.append(Row(_("recorder"), meant(state, RECORDER) or "–", note, bad=state == "failing" or lost > 0))
    refused = text(calibration.get("refused"))
    cal = text(calibration.get("cal_id"))
    rows.append(Row(_("calibration"), cal[:12] or "–", in_words(refused, of="refusals"), bad=bool(refused)))
    if tool.watch:
        rows.append(
            Row(
                _("watch over it"),
                told(text(tool.watch.get("verdict")), "watch") or "–",
                _claims(tool),
                bad=departs(tool),
            )
        )
    if tool.drift:
        std = number(tool.drift.get("azi_std_deg"))
        rows.append(Row(_("azimuth state"), meant(text(tool.drift.get("motion")), MOTION) or "–", _band(std)))
    surveys = _table(health, "surveys")
    if surveys:
        accepted = _("%(count)s accepted") % {"count": _count(surveys, "accepted")}
        rows.append(Row(_("surveys"), accepted, _("%(count)s refused") % {"count": _count(surveys, "refused")}))
    heard = _("%(count)s heard") % {"count": f"{tool.attitudes:,}"}
    spoilt = _("%(late)s late, %(bad)s messages unreadable") % {"late": tool.late, "bad": tool.unreadable}
    rows.append(Row(_("attitudes"), heard, spoilt))
    return rows


def _parameters(tool: ToolState) -> list[dict[str, str]]:
    """The newest deviation of each parameter, in thousandths of its unit."""
    found = tool.watch.get("parameters")
    rows = []
    for name, one in list(found.items())[:PARAMETERS_MAX] if isinstance(found, dict) else ():
        value, std = (number(one.get(key)) if isinstance(one, dict) else None for key in ("value", "std"))
        if value is None or std is None:
            continue
        unit, seen = text(one.get("unit")), one.get("observable") is True
        rows.append(
            {
                "name": text(name),
                "value": _thousandths(value, std),
                "unit": _thousandth(unit),
                "seen": _("seen") if seen else _("not seen yet"),
            }
        )
    return rows


def _thousandths(value: float, std: float) -> str:
    """With its band of 95 %, in thousandths, on one line; no digits beyond the band's."""
    digits = _digits(2e3 * std)
    band = f"{2e3 * std:.{digits}f}" if 2e3 * std >= 1e-3 else f"{2e3 * std:.1e}"
    return f"{1e3 * value:+.{digits}f} ±\u00a0{band}".replace("-", "\u2212")


def _thousandth(unit: str) -> str:
    return f"m{unit}" if unit in ("m", "rad") or unit.startswith("g") else f"10⁻³ {unit}"


def _departures(tool: ToolState) -> list[str]:
    """What departs, in a line each: the class, the size of its likeliest, and what it does now."""
    claims, lines = tool.watch.get("claims"), []
    for claim in (claims if isinstance(claims, list) else [])[:CLAIMS_MAX]:
        if not isinstance(claim, dict):
            continue
        names = _class_of(claim)
        size, std = number(claim.get("size")), number(claim.get("std"))
        line = [names]
        if size is not None and std is not None:
            line.append(
                f"{text(claim.get('parameter'))} {_thousandths(size, std)} {_thousandth(text(claim.get('unit')))}"
            )
        error = _table(claim, "error")
        inc, across = number(error.get("inc_deg")), number(error.get("tf_sin_inc_deg"))
        if inc is not None and across is not None:
            line.append(f"ΔI {inc:+.3f}°, ΔT·sin I {across:+.3f}°".replace("-", "\u2212"))
        lines.append(": ".join([line[0], "; ".join(line[1:])]) if line[1:] else line[0])
    return lines


def _claims(tool: ToolState) -> str:
    claims = tool.watch.get("claims")
    found = [claim for claim in claims if isinstance(claim, dict)] if isinstance(claims, list) else []
    return ", ".join(_class_of(claim) for claim in found)


def _class_of(claim: dict[str, Any]) -> str:
    """The parameters that cannot be told apart, by their symbols: the same in every language."""
    return " / ".join(texts(claim.get("equivalence_class"))) or text(claim.get("parameter"))


def _age(link: dict[str, Any]) -> str:
    age = number(link.get("data_age_s"))
    return "" if age is None else _("last data %(age)s before") % {"age": duration(age)}


def _table(said: dict[str, Any], name: str) -> dict[str, Any]:
    found = said.get(name)
    return found if isinstance(found, dict) else {}


def _count(said: dict[str, Any], name: str) -> str:
    found = number(said.get(name))
    return "–" if found is None else f"{found:,.0f}"


def _survey(row: Any) -> dict[str, Any]:
    reading: Reading = row.reading
    return {
        "at": _utc(reading.t),
        "inc": _degrees(reading.inc_deg, reading.inc_std_deg),
        "tf": _degrees(reading.motor_toolface_deg, reading.tf_std_deg),
        "azi": _degrees(reading.azi_deg, reading.azi_std_deg),
        "g": "–" if row.g_error_mg is None else f"{row.g_error_mg:+z.2f}",
        "accepted": row.accepted,
        "reasons": all_meant(row.reasons, REASONS),
    }


def _utc(seconds: float | None) -> str:
    """Date and time, or a dash for what is no date."""
    try:
        return "–" if seconds is None else f"{dt.datetime.fromtimestamp(seconds, dt.UTC):%Y-%m-%d %H:%M:%S}"
    except (ValueError, OverflowError, OSError):
        return "–"


def _log(tool: ToolState) -> list[tuple[str, str]]:
    """When and what, the newest first."""
    return [(_utc(event.utc), event_words(event.text)) for event in reversed(tool.events)]


_TICKS = tuple(range(0, 360, 15))


@cache
def _templates() -> Environment:
    made = worded("highside.web.tools")
    made.filters["path"] = _path
    return made


def _path(tool: str) -> str:
    """A tool's name as a part of an address."""
    from urllib.parse import quote

    return quote(tool, safe="")


def _render(name: str, **values: object) -> str:
    return _templates().get_template(name).render(**values)

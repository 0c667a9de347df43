"""Pages of what is kept, as HTML: pure, from what `shelf` has read. Everything is escaped by the templates (Jinja2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from highside.bench.journal_file import FoundJournal
from highside.bench.session.entries import Noted
from highside.bench.session.journal import Journal
from highside.calibration.change import CoefficientChange, ReadingChange, RecordChange
from highside.calibration.record import CalibrationRecord, to_utc
from highside.calibration.summary import summary
from highside.calibration.zone import SHARED_NAMES, Zone
from highside.recording.calibration_store import Activation
from highside.shown.card import templates
from highside.web.navigation import Link
from highside.web.records.shelf import Listed, RecordLine

NOTED_SHOWN = 100
"""Notes of a session, the last ones."""
DEPARTS_SIGMAS = 3.0
"""A change of a coefficient that is marked, in its standard deviations: one of 370 is beyond it by chance."""


@dataclass(frozen=True, slots=True)
class Pages:
    """Where a list is in the whole: `first` of `total`, `count` at a time."""

    path: str
    first: int
    count: int
    total: int

    @property
    def newer(self) -> str | None:
        return None if self.first == 0 else f"{self.path}?first={max(0, self.first - self.count)}"

    @property
    def older(self) -> str | None:
        after = self.first + self.count
        return f"{self.path}?first={after}" if after < self.total else None

    @property
    def said(self) -> str:
        return f"{self.first + 1} to {min(self.first + self.count, self.total)} of {self.total}"


class Views:
    """The pages, each with the navigation and a mark for where one is."""

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = tuple(links)
        self._templates = templates("highside.web")

    def calibrations(
        self, listed: Listed, pages: Pages, in_force: dict[str, str], now_s: float, trouble: str | None = None
    ) -> str:
        """The records of a store; `trouble`: why it is not known what is in force."""
        rows = [_record_row(line, in_force, now_s) for line in listed.lines]
        said = "No calibration is kept here." if not listed.total else f"{_count(listed.total, 'calibration')} kept."
        return self._page("calibrations.html", "/calibrations", rows=rows, pages=pages, said=said, trouble=trouble)

    def calibration(
        self, record: CalibrationRecord, history: Sequence[Activation], now_s: float, trouble: str | None = None
    ) -> str:
        """One record; `history` is that of its tool."""
        known = summary(record)
        active = standing(history)
        before = next((entry.record_id for entry in reversed(history) if entry.record_id != record.id), None)
        other = active if active not in (None, record.id) else before
        return self._page(
            "calibration.html",
            "/calibrations",
            id=record.id,
            tool=known["tool"],
            sign=_sign(record.id, record.expires_s, active, now_s),
            facts=_facts(known),
            zones=[_zone_rows(zone) for zone in record.result.zones],
            uncertainty=[_uncertainty_row(row) for row in known["uncertainty"]],
            closures=known["closures"],
            remarks=known["remarks"],
            poses=_pose_rows(record),
            history=[_history_row(entry, active, history) for entry in reversed(history)],
            other=other,
            other_in_force=other is not None and other == active,
            trouble=trouble,
        )

    def comparison(self, before: CalibrationRecord, after: CalibrationRecord, found: RecordChange) -> str:
        """From one record to another."""
        doubts = []
        if before.tool_id != after.tool_id or before.serial != after.serial:
            doubts.append("These are calibrations of two tools: the differences are those of the tools.")
        if before.result.method != after.result.method:
            text = "Their methods differ: coefficients of one name need not mean the same. Judge by the readings."
            doubts.append(text)
        zones = [*(f"{name} (only in the first)" for name in found.only_before)]
        zones += [f"{name} (only in the second)" for name in found.only_after]
        return self._page(
            "comparison.html",
            "/calibrations",
            before=_side(before),
            after=_side(after),
            doubts=doubts,
            zones=zones,
            coefficients=[_change_row(row) for row in found.coefficients],
            readings=[_reading_row(row) for row in found.readings],
            temp="the reference temperature of each" if found.temp_c is None else f"{found.temp_c:.1f} °C",
            sigmas=f"{DEPARTS_SIGMAS:g}",
        )

    def sessions(self, found: Sequence[FoundJournal], pages: Pages) -> str:
        """The sessions, those written last first."""
        said = "No bench session is kept here." if not pages.total else f"{_count(pages.total, 'bench session')} kept."
        rows = [_session_row(one) for one in found]
        return self._page("sessions.html", "/sessions", rows=rows, pages=pages, said=said)

    def session(self, found: FoundJournal, journal: Journal | None) -> str:
        """One session."""
        if journal is None:
            return self.trouble("This journal is damaged.", "`highside calibrate bench --resume` says where.")
        ledger, header = journal.ledger(), journal.header
        ended = ledger.ended
        return self._page(
            "session.html",
            "/sessions",
            name=found.name,
            state=found.state,
            facts=_session_facts(journal, found),
            poses=[_pose_line(line) for line in ledger.lines.values()],
            refused=[(reason.value, count) for reason, count in ledger.refused.items()],
            record=None if ended is None else ended.record,
            report=bool(ledger.done) and found.state != "in use",
            measuring=found.state == "in use",
            notes=[
                (_when(at), entry.text)
                for entry, at in zip(journal.entries, journal.times_s, strict=True)
                if isinstance(entry, Noted)
            ][-NOTED_SHOWN:],
            judged=None if header.judged is None else header.judged.id,
        )

    def trouble(self, said: str, text: str) -> str:
        """A page for what cannot be shown."""
        return self._page("trouble.html", "", said=said, text=text)

    def _page(self, template: str, here: str, **values: object) -> str:
        return self._templates.get_template(f"plain/{template}").render(links=self._links, here=here, **values)


def standing(history: Sequence[Activation]) -> str | None:
    """The record in force after a tool's history: a roll back takes the last one away."""
    return history[-1].record_id if history else None


def with_band(value: float, std: float, scale: float = 1.0) -> str:
    """A value with its 95 % band, with two digits of the band."""
    band = 2.0 * std * scale
    if not (band > 0.0 and math.isfinite(band)):
        return f"{value * scale:+.8g} (not estimated)"
    digits = min(9, max(0, 1 - math.floor(math.log10(band))))
    return f"{value * scale:+.{digits}f} ± {band:.{digits}f}"


# --- rows ----------------------------------------------------------------------------------------------------------


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _sign(name: str, expires_s: float | None, active: str | None, now_s: float) -> dict[str, str]:
    """What stands beside a record, and its look."""
    expired = expires_s is not None and expires_s <= now_s
    if name == active:
        return {"text": "in force, expired" if expired else "in force", "look": "departs" if expired else "live"}
    return {"text": "expired", "look": "offline"} if expired else {"text": "", "look": ""}


def _record_row(line: RecordLine, in_force: dict[str, str], now_s: float) -> dict[str, Any]:
    return {
        "line": line,
        "short": line.id[:12],
        "created": _spaced(line.created),
        "expires": "never" if line.expires is None else _spaced(line.expires),
        "sign": _sign(line.id, line.expires_s, in_force.get(line.tool), now_s),
    }


def _facts(known: dict[str, Any]) -> list[tuple[str, str]]:
    environment = known["environment"]
    options = ", ".join(f"{key} {value}" for key, value in known["options"].items())
    rms = known["rms_residual_g"]
    worst = known["worst_pose"]
    rows = [
        ("tool", known["tool"] + (f", serial {known['serial']}" if known["serial"] else "")),
        ("made", _spaced(known["created"]) + f", by {known['software']['name']} {known['software']['version']}"),
        ("expires", "never" if known["expires"] is None else _spaced(known["expires"])),
        ("method", known["method"] + (f" ({options})" if options else "")),
        ("angles referred to", known["frame"]),
        ("bench", environment["bench"] or "not named"),
        ("operator", environment["operator"] or "not named"),
        ("temperature", "not known" if environment["temp_c"] is None else f"{environment['temp_c']:.1f} °C"),
        ("poses used", f"{known['poses_used']} of {known['poses']}"),
        ("residual, rms", "not known" if rms is None else f"{1e6 * rms:.1f} µg"),
        ("noise of a reading", f"{1e6 * known['reading_noise_g']:.1f} µg"),
    ]
    if worst is not None and worst["sigmas"] > 0.0:
        rows.append(("worst pose", f"{worst['pose']}, {worst['sigmas']:.1f} σ"))
    if any(known["tilt_deg"]):
        along, across = known["tilt_deg"]
        rows.append(("tilt of the bench", f"{along:+.4f}° in the plane of inclination, {across:+.4f}° across"))
    rows += [(f"law {law['slug']}", f"{law['place']} {', '.join(law['channels'])}") for law in known["laws"]]
    if known["fallback"]:
        rows.append(("beyond the zones", known["fallback"]))
    if known["parent"]:
        rows.append(("made in the hole of", known["parent"][:12]))
    signature = known["signature"]
    signed = (
        "no" if signature is None else f"{_spaced(signature['time'])}, names {signature['signer']}; not checked here"
    )
    rows.append(("signed", signed))
    rows.append(("raw data", f"{known['raw']['name']}, SHA-256 {known['raw']['sha256'][:16]}…"))
    return rows


def _unit(unit: str) -> tuple[float, str]:
    """The factor and the unit in which a coefficient is read."""
    if unit == "g":
        return 1e3, "mg"
    return (180.0 / math.pi, "°") if unit == "rad" else (1.0, "" if unit == "1" else unit)


def _zone_rows(zone: Zone) -> dict[str, Any]:
    parameters = zone.parameters
    rows = []
    for name, value in zip(parameters.names, parameters.values, strict=True):
        if name in SHARED_NAMES:
            continue
        scale, unit = _unit(parameters.unit(name))
        rows.append((name, with_band(float(value), parameters.std(name), scale), unit))
    held = np.rad2deg((zone.inc_min_rad, zone.inc_max_rad))
    temperature = zone.temperature
    over = "" if temperature is None else f", {temperature.min_c:.1f} to {temperature.max_c:.1f} °C"
    return {"name": zone.name, "holds": f"I {held[0]:.2f}° to {held[1]:.2f}°{over}", "rows": rows}


def _uncertainty_row(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return (
        f"{row['inc_deg']:.1f}°",
        f"± {2 * row['inc_std_deg']:.4f}°",
        f"± {2 * row['tf_std_deg']:.4f}°",
        str(row["zone"]),
    )


def _pose_rows(record: CalibrationRecord) -> list[dict[str, Any]]:
    fit = record.result.poses
    rows = []
    for k, name in enumerate(fit.ids):
        sigmas = float(abs(fit.studentised[k]))
        used = bool(fit.used[k])
        residual = [f"{1e6 * value:+.1f}" for value in fit.residual_g[:, k]]
        rows.append({"name": name, "residual": residual, "sigmas": f"{sigmas:.1f}", "used": used})
    return rows


def _history_row(entry: Activation, active: str | None, history: Sequence[Activation]) -> dict[str, Any]:
    return {
        "number": entry.number,
        "at": _spaced(to_utc(entry.at_s)),
        "action": "put in force" if entry.action == "activate" else "rolled back to",
        "id": entry.record_id,
        "short": entry.record_id[:12],
        "now": entry is history[-1] and entry.record_id == active,
    }


def _side(record: CalibrationRecord) -> dict[str, str]:
    return {
        "id": record.id,
        "short": record.id[:12],
        "tool": record.tool_id + (f", serial {record.serial}" if record.serial else ""),
        "made": _spaced(str(record.content["created"])),
        "method": record.result.method,
    }


def _change_row(row: CoefficientChange) -> dict[str, Any]:
    scale, unit = _unit(row.unit)
    sigmas = row.sigmas
    return {
        "zone": row.zone,
        "name": row.name,
        "before": with_band(row.before, row.before_std, scale),
        "after": with_band(row.after, row.after_std, scale),
        "difference": with_band(row.difference, row.std, scale),
        "unit": unit,
        "sigmas": "–" if sigmas is None else f"{sigmas:.1f}",
        "departs": sigmas is not None and sigmas > DEPARTS_SIGMAS,
    }


def _reading_row(row: ReadingChange) -> dict[str, Any]:
    def said(change: float | None, std: float | None) -> tuple[str, bool]:
        if change is None:
            return "one of them does not hold here", False
        band = "" if std is None else f" (band of the difference ± {2 * std:.4f}°)"
        return f"{change:.4f}°{band}", std is not None and change > DEPARTS_SIGMAS * std

    inc, inc_departs = said(row.inc_change_deg, row.inc_std_deg)
    tf, tf_departs = said(row.tf_change_deg, row.tf_std_deg)
    return {"at": f"{row.inc_deg:.1f}°", "inc": inc, "tf": tf, "departs": inc_departs or tf_departs}


def _session_row(one: FoundJournal) -> dict[str, Any]:
    return {
        "name": one.name,
        "begun": _when(one.t_wall_s),
        "progress": one.progress,
        "state": one.state,
        "plan": one.plan,
        "look": "live" if one.state in ("accepted", "in use") else "departs" if one.state == "damaged" else "offline",
    }


def _session_facts(journal: Journal, found: FoundJournal) -> list[tuple[str, str]]:
    header, ledger = journal.header, journal.ledger()
    environment = header.environment
    return [
        ("tool", header.tool_id + (f", serial {header.serial}" if header.serial else "")),
        ("plan", header.plan.title),
        ("begun", _when(header.t_wall_s)),
        ("last entry", _when(journal.times_s[-1]) if journal.times_s else "–"),
        ("progress", found.progress),
        ("taken again", str(ledger.retaken)),
        ("omitted", str(ledger.skipped)),
        ("bench", environment.bench or "not named"),
        ("operator", ledger.operator or environment.operator or "not named"),
        ("software", header.software),
    ]


def _pose_line(line: Any) -> dict[str, Any]:
    readings = line.readings
    return {
        "name": line.id,
        "inc": "–" if line.inc_deg is None else f"{line.inc_deg:g}°",
        "tf": "–" if line.tf_deg is None else f"{line.tf_deg:g}°",
        "state": line.state.value,
        "readings": "–" if readings is None else str(readings.n),
        "sigmas": "–" if line.sigmas is None else f"{line.sigmas:.1f}",
        "attempts": line.attempts,
        "reason": "" if line.reason is None else f"{line.reason.value}{f': {line.detail}' if line.detail else ''}",
    }


def _spaced(utc: str) -> str:
    """`2026-11-21T02:40:00Z` as people read it."""
    return utc.replace("T", " ").replace("Z", " UTC")


def _when(seconds: float | None) -> str:
    """UTC date and time, or a dash for what is no date."""
    try:
        return "–" if seconds is None else f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return "–"

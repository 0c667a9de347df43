"""Pages of what is kept, as HTML: pure, from what `shelf` has read. Everything is escaped by the templates (Jinja2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from highside.bench.journal_file import FoundJournal
from highside.bench.photographs import Found
from highside.bench.session.entries import Noted
from highside.bench.session.journal import Journal
from highside.calibration.change import CoefficientChange, ReadingChange, RecordChange
from highside.calibration.record import CalibrationRecord, to_utc
from highside.calibration.summary import summary
from highside.calibration.zone import SHARED_NAMES, Zone
from highside.recording.calibration_store import Activation
from highside.web.navigation import Link
from highside.web.plain import render
from highside.web.records.shelf import Listed, RecordLine, to_compare
from highside.web.words import _, several, told
from highside.words import from_to

if TYPE_CHECKING:
    from highside.web.records.wanted import Wanted

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
        last = min(self.first + self.count, self.total)
        return _("%(first)s to %(last)s of %(total)s") % {"first": self.first + 1, "last": last, "total": self.total}


class Views:
    """The pages, each with the navigation and a mark for where one is."""

    def __init__(self, links: Sequence[Link]) -> None:
        self._links = tuple(links)

    def calibrations(
        self, listed: Listed, pages: Pages, in_force: dict[str, str], now_s: float, trouble: str | None = None
    ) -> str:
        """The records of a store; `trouble`: why it is not known what is in force."""
        rows = [_record_row(line, in_force, now_s) for line in listed.lines]
        kept = several("%(count)s calibration kept.", "%(count)s calibrations kept.", listed.total)
        said = kept % {"count": listed.total} if listed.total else _("No calibration is kept here.")
        before, after = to_compare(listed.lines, in_force, now_s)
        chosen = {"rows": rows, "before": before, "after": after}
        return self._page("calibrations.html", "/calibrations", **chosen, pages=pages, said=said, trouble=trouble)

    def calibration(
        self, record: CalibrationRecord, history: Sequence[Activation], now_s: float, trouble: str | None = None
    ) -> str:
        """One record; `history` is that of its tool."""
        known = summary(record)
        active = standing(history)
        others = (entry.record_id for entry in reversed(history) if entry.record_id not in ("", record.id))
        before = next(others, None)
        other = active if active not in (None, "", record.id) else before
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
            is_active=active == record.id,
            back=active == record.id,
            trouble=trouble,
        )

    def comparison(self, before: CalibrationRecord, after: CalibrationRecord, found: RecordChange) -> str:
        """From one record to another."""
        doubts = []
        if before.tool_id != after.tool_id or before.serial != after.serial:
            doubts.append(_("These are calibrations of two tools: the differences are those of the tools."))
        if before.result.method != after.result.method:
            text = _("Their methods differ: coefficients of one name need not mean the same. Judge by the readings.")
            doubts.append(text)
        zones = [_("%(zone)s (only in the first)") % {"zone": name} for name in found.only_before]
        zones += [_("%(zone)s (only in the second)") % {"zone": name} for name in found.only_after]
        return self._page(
            "comparison.html",
            "/calibrations",
            before=_side(before),
            after=_side(after),
            doubts=doubts,
            zones=zones,
            coefficients=[_change_row(row) for row in found.coefficients],
            readings=[_reading_row(row) for row in found.readings],
            temp=_temperature(found),
            sigmas=f"{DEPARTS_SIGMAS:g}",
        )

    def force(self, wanted: Wanted, found: RecordChange | None) -> str:
        """What would change, and the button that does it."""
        now = wanted.now
        doubts = []
        if now is not None and now.serial != wanted.then.serial:
            numbers = {"before": now.serial or _("none"), "after": wanted.then.serial or _("none")}
            doubts.append(_("The serial number changes from %(before)s to %(after)s.") % numbers)
        doubts += (
            [] if wanted.then.signature is not None or wanted.to_nothing else [_("This calibration is not signed.")]
        )
        return self._page(
            "force.html",
            "/calibrations",
            heading="Take the calibration in force back?" if wanted.back else "Put this calibration in force?",
            button="Take it back" if wanted.back else "Put it in force",
            then=_side(wanted.then),
            now=None if now is None else _side(now),
            now_id=wanted.now_id,
            to_nothing=wanted.to_nothing,
            doubt=None if wanted.doubt is None else told(wanted.doubt),
            doubts=doubts,
            readings=[] if found is None else [_reading_row(row) for row in found.readings],
            temp=_temperature(found),
        )

    def certificate(
        self, record: CalibrationRecord, rows: list[tuple[str, str, str]], trouble: str | None, **more: Any
    ) -> str:
        """The form for a certificate: name, words and present value of each field; `more`: the chosen language, how
        many photographs there are, and whether they are wanted."""
        tool = _tool(record.tool_id, record.serial)
        values = {"id": record.id, "short": record.id[:12], "tool": tool, "rows": rows, "trouble": trouble, **more}
        return self._page("certificate.html", "/calibrations", **values)

    def sessions(self, found: Sequence[FoundJournal], pages: Pages) -> str:
        """The sessions, those written last first."""
        kept = several("%(count)s bench session kept.", "%(count)s bench sessions kept.", pages.total)
        said = kept % {"count": pages.total} if pages.total else _("No bench session is kept here.")
        rows = [_session_row(one) for one in found]
        return self._page("sessions.html", "/sessions", rows=rows, pages=pages, said=said)

    def session(self, found: FoundJournal, journal: Journal | None, photographs: Sequence[Found] = ()) -> str:
        """One session."""
        if journal is None:
            return self.trouble(
                _("This journal is damaged."),
                _("%(command)s says where.") % {"command": "highside calibrate bench --resume"},
            )
        ledger, header = journal.ledger(), journal.header
        ended = ledger.ended
        return self._page(
            "session.html",
            "/sessions",
            name=found.name,
            state=found.state,
            facts=_session_facts(journal, found),
            poses=[_pose_line(line) for line in ledger.lines.values()],
            refused=[(reason.text, count) for reason, count in ledger.refused.items()],
            record=None if ended is None else ended.record,
            report=bool(ledger.done) and found.state != "in use",
            measuring=found.state == "in use",
            notes=[
                (_when(at), told(entry.text))
                for entry, at in zip(journal.entries, journal.times_s, strict=True)
                if isinstance(entry, Noted)
            ][-NOTED_SHOWN:],
            photographs=[(_when(one.at_s), one.entry, told(one.trouble)) for one in photographs],
            judged=None if header.judged is None else header.judged.id,
        )

    def trouble(self, said: str, text: str) -> str:
        """A page for what cannot be shown."""
        return self._page("trouble.html", "", said=said, text=text)

    def _page(self, template: str, here: str, **values: object) -> str:
        return render(f"plain/{template}", self._links, here, **values)


def standing(history: Sequence[Activation]) -> str | None:
    """The record in force after a tool's history: a roll back takes the last one away."""
    return history[-1].record_id if history else None


def with_band(value: float, std: float, scale: float = 1.0) -> str:
    """A value with its 95 % band, with two digits of the band."""
    band = 2.0 * std * scale
    if not (band > 0.0 and math.isfinite(band)):
        return _("%(value)s (not estimated)") % {"value": f"{value * scale:+.8g}"}
    digits = min(9, max(0, 1 - math.floor(math.log10(band))))
    return f"{value * scale:+.{digits}f} ± {band:.{digits}f}"


# --- rows ----------------------------------------------------------------------------------------------------------


def _tool(name: str, serial: str | None) -> str:
    return name + (", " + _("serial number %(serial)s") % {"serial": serial} if serial else "")


def _sign(name: str, expires_s: float | None, active: str | None, now_s: float) -> dict[str, str]:
    """What stands beside a record, and its look."""
    expired = expires_s is not None and expires_s <= now_s
    if name == active:
        return {"text": _("in force, expired") if expired else _("in force"), "look": "departs" if expired else "live"}
    return {"text": _("expired"), "look": "offline"} if expired else {"text": "", "look": ""}


def _record_row(line: RecordLine, in_force: dict[str, str], now_s: float) -> dict[str, Any]:
    return {
        "line": line,
        "short": line.id[:12],
        "created": _spaced(line.created),
        "expires": _("never") if line.expires is None else _spaced(line.expires),
        "sign": _sign(line.id, line.expires_s, in_force.get(line.tool), now_s),
    }


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _facts(known: dict[str, Any]) -> list[tuple[str, str]]:
    environment = known["environment"]
    options = ", ".join(f"{key} {_short(value)}" for key, value in known["options"].items())
    rms = known["rms_residual_g"]
    worst = known["worst_pose"]
    rows = [
        (_("tool"), _tool(known["tool"], known["serial"])),
        (_("made"), f"{_spaced(known['created'])}, {known['software']['name']} {known['software']['version']}"),
        (_("expires"), _("never") if known["expires"] is None else _spaced(known["expires"])),
        (_("method"), known["method"] + (f" ({options})" if options else "")),
        (_("angles referred to"), told(known["frame"])),
        (_("bench"), environment["bench"] or _("not named")),
        (_("operator"), environment["operator"] or _("not named")),
        (_("temperature"), _("not known") if environment["temp_c"] is None else f"{environment['temp_c']:.1f} °C"),
        (_("poses used"), _("%(used)s of %(poses)s") % {"used": known["poses_used"], "poses": known["poses"]}),
        (_("residual, rms"), _("not known") if rms is None else f"{1e6 * rms:.1f} µg"),
        (_("noise of a reading"), f"{1e6 * known['reading_noise_g']:.1f} µg"),
    ]
    if worst is not None and worst["sigmas"] > 0.0:
        rows.append((_("worst pose"), f"{worst['pose']}, {worst['sigmas']:.1f} σ"))
    if any(known["tilt_deg"]):
        along, across = known["tilt_deg"]
        tilts = {"along": f"{along:+.4f}°", "across": f"{across:+.4f}°"}
        rows.append((_("tilt of the bench"), _("%(along)s in the plane of inclination, %(across)s across") % tilts))
    rows += [
        (_("law %(name)s") % {"name": law["slug"]}, f"{law['place']} {', '.join(law['channels'])}")
        for law in known["laws"]
    ]
    if known["fallback"]:
        rows.append((_("beyond the zones"), known["fallback"]))
    if known["parent"]:
        rows.append((_("made in the hole of"), known["parent"][:12]))
    signature = known["signature"]
    signed = _("no")
    if signature is not None:
        signer = {"at": _spaced(signature["time"]), "signer": signature["signer"]}
        signed = _("%(at)s, names %(signer)s; not checked here") % signer
    rows.append((_("signed"), signed))
    rows.append((_("raw data"), f"{known['raw']['name']}, SHA-256 {known['raw']['sha256'][:16]}…"))
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
    over = "" if temperature is None else f", {from_to(f'{temperature.min_c:.1f}', f'{temperature.max_c:.1f}')} °C"
    return {"name": zone.name, "holds": f"I {from_to(f'{held[0]:.2f}°', f'{held[1]:.2f}°')}{over}", "rows": rows}


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
        "action": _("put in force") if entry.action == "activate" else _("rolled back to"),
        "id": entry.record_id,
        "short": entry.record_id[:12] or _("nothing"),
        "now": entry is history[-1] and entry.record_id == active,
    }


def _side(record: CalibrationRecord) -> dict[str, str]:
    return {
        "id": record.id,
        "short": record.id[:12],
        "tool": _tool(record.tool_id, record.serial),
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


def _temperature(found: RecordChange | None) -> str:
    known = None if found is None else found.temp_c
    return _("the reference temperature of each") if known is None else f"{known:.1f} °C"


def _reading_row(row: ReadingChange) -> dict[str, Any]:
    def said(change: float | None, std: float | None) -> tuple[str, bool]:
        if change is None:
            return _("one of them does not hold here"), False
        band = "" if std is None else f" ± {2 * std:.4f}°"
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
        (_("tool"), _tool(header.tool_id, header.serial)),
        (_("plan"), told(header.plan.title)),
        (_("begun"), _when(header.t_wall_s)),
        (_("last entry"), _when(journal.times_s[-1]) if journal.times_s else "–"),
        (_("progress"), told(found.progress)),
        (_("taken again"), str(ledger.retaken)),
        (_("omitted"), str(ledger.skipped)),
        (_("bench"), environment.bench or _("not named")),
        (_("operator"), ledger.operator or environment.operator or _("not named")),
        (_("software"), header.software),
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
        "reason": ""
        if line.reason is None
        else told(line.reason.text) + (f" ({told(line.detail)})" if line.detail else ""),
    }


def _why(line: Any) -> str:
    if line.reason is None:
        return ""
    return told(line.reason.text) + (f" ({told(line.detail)})" if line.detail else "")


def _spaced(utc: str) -> str:
    """`2026-11-21T02:40:00Z` as people read it."""
    return utc.replace("T", " ").replace("Z", " UTC")


def _when(seconds: float | None) -> str:
    """UTC date and time, or a dash for what is no date."""
    try:
        return "–" if seconds is None else f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return "–"

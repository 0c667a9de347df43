"""The page's parts as HTML, made once for each snapshot and shared by all who look at it.

What stands where is said by the template `session.html`, which escapes whatever it is given (names, reasons, remarks);
here is what it is given. The page puts the strings in as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from highside.bench.session.reasons import Fault
from highside.bench.session.snapshot import PoseRow, PoseState, SessionState, Snapshot, VerdictState, table_reads
from highside.bench.session.time_to_go import in_words
from highside.calibration.methods import solves_by_inclination
from highside.web.bench_scene import seen
from highside.web.drawings import pictures
from highside.web.words import _, said_later, told
from highside.words.worded import worded

STATES = {
    SessionState.IDLE: said_later("ready"),
    SessionState.SOAKING: said_later("temperature"),
    SessionState.GUIDING: said_later("set the pose"),
    SessionState.SETTLING: said_later("let it rest"),
    SessionState.CAPTURING: said_later("hands off"),
    SessionState.CHECKING: said_later("checking"),
    SessionState.SOLVING: said_later("computing"),
    SessionState.REVIEW: said_later("review"),
    SessionState.PAUSED: said_later("paused"),
    SessionState.NO_DATA: said_later("no data"),
    SessionState.ACCEPTED: said_later("accepted"),
    SessionState.REJECTED: said_later("rejected"),
    SessionState.ABORTED: said_later("aborted"),
}
"""What the sign at the top says, in a word or two."""

_MARKS = {
    PoseState.OPEN: ("○", said_later("open")),
    PoseState.DONE: ("✓", said_later("done")),
    PoseState.SKIPPED: ("–", said_later("skipped")),
    PoseState.AGAIN: ("↺", said_later("again")),
}


@dataclass(frozen=True, slots=True)
class PageParts:
    """One string for each place of the page. `spoken`: for a screen reader, changes only with state and pose."""

    sign: str
    prompt: str
    spoken: str
    alarms: str
    numbers: str
    guidance: str
    bullseye: str
    dial: str
    still: str
    hold: str
    poses: str
    calibration: str
    result: str
    foot: str


def markup(macro: str, *values: object) -> str:
    """What a macro of the template makes of the values, every one of them escaped."""
    return str(getattr(worded().get_template("session.html").module, macro)(*values)).strip()


def parts_of(snapshot: Snapshot) -> PageParts:
    """The whole page."""
    drawn = pictures(snapshot)
    return PageParts(
        sign=markup("sign", snapshot, _(STATES[snapshot.state]), _to_go(snapshot)),
        prompt=markup("words", snapshot.prompt),
        spoken=markup("plain", _spoken(snapshot)),
        alarms=markup("alarms", list(_faults(snapshot)), _warning(snapshot)),
        numbers=markup("numbers", snapshot, *_reads(snapshot)),
        guidance=markup("guidance", seen(snapshot).said),
        bullseye=markup("drawn", drawn["bullseye"], _("off the pose"), _angle(snapshot)),
        dial=markup("drawn", drawn["dial"], _("toolface"), _toolface(snapshot)),
        still=markup("drawn", drawn["trace"], _("stillness"), _stillness(snapshot)),
        hold=markup("hold", 0.0 if snapshot.capture is None else snapshot.capture.progress, _measured(snapshot)),
        poses=markup("poses", snapshot, [_pose(row, snapshot) for row in snapshot.poses]),
        calibration=_calibration(snapshot, drawn["curve"]),
        result=_result(snapshot),
        foot=markup("plain", _foot(snapshot)),
    )


def _spoken(snapshot: Snapshot) -> str:
    target = snapshot.target
    state, done = _(STATES[snapshot.state]), _("%(done)s poses done") % {"done": snapshot.plan.done}
    if target is None:
        return f"{state}; {done}"
    where = _("pose %(pose)s, inclination %(inc)s, toolface %(tf)s") % {
        "pose": target.pose,
        "inc": f"{target.inc_deg:g}",
        "tf": f"{target.tf_deg:g}",
    }
    return f"{state}, {where}; {done}"


DATA_FAULTS = frozenset({Fault.NO_DATA.value, Fault.LINK_DOWN.value})


def _warning(snapshot: Snapshot) -> str:
    """Why the last pose was not taken; while no data come that is what is said already."""
    if any(fault.code in DATA_FAULTS for fault in snapshot.faults):
        return ""
    return snapshot.last_rejection or ""


def _faults(snapshot: Snapshot) -> Iterator[str]:
    """What is wrong, each sentence once: what the headline says already is given by its detail alone."""
    for fault in snapshot.faults:
        said = ("" if fault.text == snapshot.prompt else fault.text, fault.detail)
        text = " ".join(told(part) for part in said if part)
        if text:
            yield text


def _reads(snapshot: Snapshot) -> tuple[str, str]:
    """Inclination and toolface as the table reads them."""
    reads = None if snapshot.attitude is None else table_reads(snapshot.attitude, snapshot.target)
    inc, tf = reads or (None, None)
    return _hundredths(inc), _hundredths(tf)


def _hundredths(angle_deg: float | None) -> str:
    return "–" if angle_deg is None else f"{angle_deg:.2f}°"


def _to_go(snapshot: Snapshot) -> str:
    """How far the session is, and how long the rest will take where that can be known."""
    plan = snapshot.plan
    if snapshot.to_go_s is None or plan.poses is None:
        return ""
    far = _("%(done)s of %(poses)s") % {"done": plan.done, "poses": plan.poses}
    beside = "" if plan.stages == 1 or plan.stage_temp_c is None else ", " + _("warming up not counted")
    return f"{far}, {told(in_words(snapshot.to_go_s))}{beside}"


def _angle(snapshot: Snapshot) -> str:
    return _hundredths(None if snapshot.deviation is None else snapshot.deviation.angle_deg)


def _toolface(snapshot: Snapshot) -> str:
    tf = None if snapshot.attitude is None else table_reads(snapshot.attitude, snapshot.target)[1]
    return "–" if tf is None else f"{tf:.1f}°"


def _stillness(snapshot: Snapshot) -> str:
    still = snapshot.stillness
    return _("no readings") if still is None else _("still") if still.still else _("moving")


def _measured(snapshot: Snapshot) -> str:
    capture = snapshot.capture
    if capture is None:
        return _("not measuring")
    error = "" if capture.std_error_g is None else f" ± {1e6 * capture.std_error_g:.1f} µg"
    goal = ""
    if capture.target_std_error_g is not None:
        goal = " " + _("(wanted %(error)s)") % {"error": f"{1e6 * capture.target_std_error_g:.0f}"}
    count = _("%(count)s readings") % {"count": capture.readings}
    return f"{capture.elapsed_s:.0f} s, {count}{error}{goal}"


def _pose(row: PoseRow, snapshot: Snapshot) -> dict[str, Any]:
    """A row of the table of poses; `why`: a second one below it."""
    here = snapshot.target is not None and snapshot.target.pose == row.pose
    mark, word = ("▶", said_later("requested now")) if here else _MARKS[row.state]
    cells = (
        "" if row.inc_deg is None else f"{row.inc_deg:.2f}°",
        "" if row.tf_deg is None else f"{row.tf_deg:.1f}°",
        "" if row.std_error_g is None else f"{1e6 * row.std_error_g:.1f}",
        "" if row.sigmas is None else f"{row.sigmas:.1f}",
    )
    warning = _warning(snapshot)
    repeated = bool(warning) and (row.text or "").startswith(warning)
    why = row.text if row.state in (PoseState.AGAIN, PoseState.OPEN) and not repeated else ""
    return {"pose": row, "here": here, "mark": mark, "word": _(word), "cells": cells, "why": why}


def _calibration(snapshot: Snapshot, drawn: Markup) -> str:
    u = snapshot.uncertainty
    none = _("after the first poses") if snapshot.plan.judges is None else _("none: this session judges one")
    text = none if u is None else f"I ± {u.rms_inc_std_deg:.4f}°, T ± {u.rms_tf_std_deg:.4f}°"
    over = snapshot.result is not None or snapshot.state.ended
    waits = solves_by_inclination(snapshot.plan.method) and not over
    later = _("after the first four poses of an inclination") if waits else ""
    return markup("calibration", snapshot, drawn, _("calibration") if over else _("calibration so far"), text, later)


def _result(snapshot: Snapshot) -> str:
    result = snapshot.result
    if result is None:
        return ""
    if result.verdict is not None:
        return markup("verdict", snapshot, *_comparisons(result.verdict))
    return markup("result", snapshot, _ranges(snapshot), _in_force(snapshot))


def _ranges(snapshot: Snapshot) -> str:
    """Over inclination: T is less certain the nearer to vertical, which one figure for all attitudes hides."""
    u = snapshot.uncertainty
    if u is None or not u.inc_deg:
        return ""
    rows = []
    for name, stds in (("I", u.inc_std_deg), ("T", u.tf_std_deg)):
        worst = max(range(len(stds)), key=stds.__getitem__)
        least, most = f"{name} ± {min(stds):.4f}°", f"{stds[worst]:.4f}°"
        values = {"least": least, "most": most, "inc": f"{u.inc_deg[worst]:.0f}"}
        rows.append(_("%(least)s to %(most)s (at I = %(inc)s°)") % values)
    return ", ".join(rows)


def _in_force(snapshot: Snapshot) -> bool:
    """Whether the record of the session corrects; what is left to do is then said too."""
    force, result = snapshot.in_force, snapshot.result
    return force is not None and result is not None and bool(result.record_id) and force.present == result.record_id


def _comparisons(verdict: VerdictState) -> tuple[str, dict[str, list[str]]]:
    """The limits of a verification or roll test, and its errors beside them: a column each."""
    limits = [f"I {verdict.limit_inc_deg:g}°"]
    limits += [] if verdict.limit_tf_deg is None else [f"T {verdict.limit_tf_deg:g}°"]
    limits += [] if verdict.limit_g_total_g is None else [f"Gtotal {1e3 * verdict.limit_g_total_g:g} mg"]
    columns = {
        _("I error"): [_with_u(row.inc_error_deg, row.inc_u_deg, "°") for row in verdict.rows],
        _("T error"): [_with_u(row.tf_error_deg, row.tf_u_deg, "°") for row in verdict.rows],
        "Gtotal": [_with_u(row.g_error_g, row.g_u_g, " mg", 1e3) for row in verdict.rows],
    }
    return ", ".join(limits), {name: cells for name, cells in columns.items() if any(cells)}


def _with_u(error: float | None, u: float | None, unit: str, scale: float = 1.0) -> str:
    return "" if error is None or u is None else f"{scale * error:+.4f} ± {scale * u:.4f}{unit}"


def _foot(snapshot: Snapshot) -> str:
    who = ", " + _("held by %(name)s") % {"name": snapshot.operator} if snapshot.operator else ""
    serial = f" ({snapshot.serial})" if snapshot.serial else ""
    lasted = _lasted(snapshot.elapsed_s)
    session = _("session %(name)s") % {"name": snapshot.session}
    return f"{snapshot.tool}{serial} · {told(snapshot.plan.title)} · {lasted}{who} · {session}"


def _lasted(seconds: float) -> str:
    """A time in the unit that fits: 45 s, 12 min, 3 h 05 min."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = int(seconds // 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"

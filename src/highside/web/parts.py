"""The page's parts as HTML, made once for each snapshot and shared by all who look at it.

Everything that comes from outside (names, reasons, remarks) is escaped here; the page puts the strings in as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from highside.bench.session.reasons import Fault
from highside.bench.session.snapshot import PoseRow, PoseState, SessionState, Snapshot, VerdictState, table_reads
from highside.calibration.methods import solves_by_inclination
from highside.web.drawings import pictures

STATES = {
    SessionState.IDLE: "ready",
    SessionState.SOAKING: "temperature",
    SessionState.GUIDING: "set the pose",
    SessionState.SETTLING: "let it rest",
    SessionState.CAPTURING: "hands off",
    SessionState.CHECKING: "checking",
    SessionState.SOLVING: "computing",
    SessionState.REVIEW: "review",
    SessionState.PAUSED: "paused",
    SessionState.NO_DATA: "no data",
    SessionState.ACCEPTED: "accepted",
    SessionState.REJECTED: "rejected",
    SessionState.ABORTED: "aborted",
}
"""What the sign at the top says, in a word or two."""

_MARKS = {
    PoseState.OPEN: ("○", "open"),
    PoseState.DONE: ("✓", "done"),
    PoseState.SKIPPED: ("–", "skipped"),
    PoseState.AGAIN: ("↺", "again"),
}


@dataclass(frozen=True, slots=True)
class PageParts:
    """One string for each place of the page. `spoken`: for a screen reader, changes only with state and pose."""

    sign: str
    prompt: str
    spoken: str
    alarms: str
    numbers: str
    bullseye: str
    dial: str
    still: str
    hold: str
    poses: str
    calibration: str
    result: str
    foot: str


def parts_of(snapshot: Snapshot) -> PageParts:
    """The whole page."""
    drawn = pictures(snapshot)
    return PageParts(
        sign=f'<span class="badge {snapshot.state.value}">{escape(STATES[snapshot.state])}</span>',
        prompt=escape(snapshot.prompt),
        spoken=escape(_spoken(snapshot)),
        alarms=_alarms(snapshot),
        numbers=_numbers(snapshot),
        bullseye=drawn["bullseye"] + _caption("off the pose", _angle(snapshot)),
        dial=drawn["dial"] + _caption("toolface", _toolface(snapshot)),
        still=_still(snapshot, drawn["trace"]),
        hold=_hold(snapshot),
        poses=_poses(snapshot),
        calibration=_calibration(snapshot, drawn["curve"]),
        result=_result(snapshot),
        foot=_foot(snapshot),
    )


def _spoken(snapshot: Snapshot) -> str:
    target = snapshot.target
    where = (
        "" if target is None else f", pose {target.pose}, inclination {target.inc_deg:g}, toolface {target.tf_deg:g}"
    )
    return f"{STATES[snapshot.state]}{where}; {snapshot.plan.done} poses done"


DATA_FAULTS = frozenset({Fault.NO_DATA.value, Fault.LINK_DOWN.value})


def _warning(snapshot: Snapshot) -> str:
    """Why the last pose was not taken; while no data come that is what is said already."""
    if any(fault.code in DATA_FAULTS for fault in snapshot.faults):
        return ""
    return snapshot.last_rejection or ""


def _alarms(snapshot: Snapshot) -> str:
    """What is wrong, each sentence once: what the headline says already is given by its detail alone."""
    out = []
    for fault in snapshot.faults:
        text = " ".join(part for part in ("" if fault.text == snapshot.prompt else fault.text, fault.detail) if part)
        if text:
            out.append(f'<p class="alarm"><b aria-hidden="true">!</b> {escape(text)}</p>')
    if warning := _warning(snapshot):
        out.append(f'<p class="warning"><b aria-hidden="true">↺</b> {escape(warning)}</p>')
    return "".join(out)


def _numbers(snapshot: Snapshot) -> str:
    at, target = snapshot.attitude, snapshot.target
    reads = None if at is None else table_reads(at, target)
    inc = "–" if reads is None else f"{reads[0]:.2f}°"
    tf = "–" if reads is None or reads[1] is None else f"{reads[1]:.2f}°"
    want_inc = "" if target is None else f"to {target.inc_deg:g}°"
    want_tf = "" if target is None else f"to {target.tf_deg:g}°"
    g = "" if at is None else f"|g| {at.g_total:.5f}"
    temp = "" if snapshot.temp_c is None else f"{snapshot.temp_c:.1f} °C"
    stale = " stale" if at is None else ""
    return (
        f'<dl class="figures{stale}"><div><dt>inclination</dt><dd>{inc}</dd><dd class="goal-of">{want_inc}</dd></div>'
        f'<div><dt>toolface</dt><dd>{tf}</dd><dd class="goal-of">{want_tf}</dd></div></dl>'
        f'<p class="mute">{g} {temp}</p>'
    )


def _caption(label: str, value: str) -> str:
    return f'<p class="under"><span class="mute">{label}</span> <strong>{value}</strong></p>'


def _angle(snapshot: Snapshot) -> str:
    deviation = snapshot.deviation
    return "–" if deviation is None else f"{deviation.angle_deg:.2f}°"


def _toolface(snapshot: Snapshot) -> str:
    tf = None if snapshot.attitude is None else table_reads(snapshot.attitude, snapshot.target)[1]
    return "–" if tf is None else f"{tf:.1f}°"


def _still(snapshot: Snapshot, drawn: str) -> str:
    still = snapshot.stillness
    word = "no readings" if still is None else "still" if still.still else "moving"
    return f"{drawn}{_caption('stillness', word)}"


def _hold(snapshot: Snapshot) -> str:
    capture = snapshot.capture
    share = 0.0 if capture is None else capture.progress
    text = "not measuring"
    if capture is not None:
        error = "" if capture.std_error_g is None else f" ± {1e6 * capture.std_error_g:.1f} µg"
        goal = "" if capture.target_std_error_g is None else f" (wanted {1e6 * capture.target_std_error_g:.0f})"
        text = f"{capture.elapsed_s:.0f} s, {capture.readings} readings{error}{goal}"
    return (
        f'<div class="bar" role="progressbar" aria-label="measurement of this pose" aria-valuemin="0"'
        f' aria-valuemax="100" aria-valuenow="{round(100 * share)}"><i style="width:{100 * share:.1f}%"></i></div>'
        f'<p class="under"><span class="mute">measurement</span> <strong>{text}</strong></p>'
    )


def _poses(snapshot: Snapshot) -> str:
    plan = snapshot.plan
    total = "" if plan.poses is None else f" of {plan.poses}"
    stage = "" if plan.stages == 1 else f", step {plan.stage + 1} of {plan.stages}"
    rows = "".join(_pose(row, snapshot) for row in snapshot.poses)
    return (
        f"<table><caption>{plan.done}{total} poses done{stage}</caption>"
        '<thead><tr><th scope="col"><span class="unseen">state</span></th><th scope="col">pose</th>'
        '<th scope="col">I</th><th scope="col">T</th><th scope="col">± µg</th><th scope="col">sigma</th></tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


def _pose(row: PoseRow, snapshot: Snapshot) -> str:
    here = snapshot.target is not None and snapshot.target.pose == row.pose
    mark, word = ("▶", "requested now") if here else _MARKS[row.state]
    cells = (
        "" if row.inc_deg is None else f"{row.inc_deg:.2f}°",
        "" if row.tf_deg is None else f"{row.tf_deg:.1f}°",
        "" if row.std_error_g is None else f"{1e6 * row.std_error_g:.1f}",
        "" if row.sigmas is None else f"{row.sigmas:.1f}",
    )
    names = f"{row.state.value}{' here' if here else ''}"
    out = (
        f'<tr class="{names}"><td><span aria-hidden="true">{mark}</span><span class="unseen">{word}</span></td>'
        f"<td>{escape(row.pose)}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    )
    warning = _warning(snapshot)
    if row.text and row.state in (PoseState.AGAIN, PoseState.OPEN) and not (warning and row.text.startswith(warning)):
        out += f'<tr class="why"><td></td><td colspan="5">{escape(row.text)}</td></tr>'
    return out


def _calibration(snapshot: Snapshot, drawn: str) -> str:
    u = snapshot.uncertainty
    none = "after the first poses" if snapshot.plan.judges is None else "none: this session judges one"
    text = none if u is None else f"I ± {u.rms_inc_std_deg:.4f}°, T ± {u.rms_tf_std_deg:.4f}°"
    closures = "".join(
        f'<li class="{"good" if c.good else "bad"}"><b aria-hidden="true">{"✓" if c.good else "✗"}</b> inclination'
        f" {c.inc_deg:.2f}°: {1e6 * c.size_g:.0f} µg, p = {c.p:.2g}"
        f"{'' if c.good or not c.worst else ' – measure pose ' + escape(c.worst) + ' again'}</li>"
        for c in snapshot.closures
    )
    key = '<p class="key"><span class="i">I</span> <span class="t">T</span> one standard deviation over inclination</p>'
    over = snapshot.result is not None or snapshot.state.ended
    if not closures and solves_by_inclination(snapshot.plan.method) and not over:
        closures = "<li>after the first four poses of an inclination</li>"
    listed = f'<h2>Closure</h2><ul class="closures">{closures}</ul>' if closures else ""
    label = "calibration so far" if not over else "calibration"
    return f"{drawn}{key if u is not None else ''}{_caption(label, text)}{listed}"


def _result(snapshot: Snapshot) -> str:
    result = snapshot.result
    if result is None:
        return ""
    std = ""
    if result.inc_std_deg is not None and result.tf_std_deg is not None:
        std = f"<p class='big'>I ± {result.inc_std_deg:.4f}°, T ± {result.tf_std_deg:.4f}°</p>{_ranges(snapshot)}"
    notes = "".join(f"<li class='bad'>{escape(text)}</li>" for text in result.refused)
    notes += "".join(f"<li>{escape(text)}</li>" for text in result.remarks)
    record = f"<p>record <code>{escape(result.record_id)}</code>{_force(snapshot)}</p>" if result.record_id else ""
    if result.verdict is not None:
        return _verdict(result.verdict) + f"<ul>{notes}</ul>"
    return (
        f"<h2>Result ({escape(result.method)})</h2>{std}<p>{result.poses} poses, {result.retaken} taken again;"
        f" one standard deviation by the calibration alone, rms over all attitudes</p>{record}{_next(snapshot)}"
        f"<ul>{notes}</ul>"
    )


def _ranges(snapshot: Snapshot) -> str:
    """Over inclination: T is less certain the nearer to vertical, which one figure for all attitudes hides."""
    u = snapshot.uncertainty
    if u is None or not u.inc_deg:
        return ""
    rows = []
    for name, stds in (("I", u.inc_std_deg), ("T", u.tf_std_deg)):
        worst = max(range(len(stds)), key=stds.__getitem__)
        rows.append(f"{name} ± {min(stds):.4f}° to {stds[worst]:.4f}° (at I = {u.inc_deg[worst]:.0f}°)")
    return f"<p>by inclination: {', '.join(rows)}</p>"


def _next(snapshot: Snapshot) -> str:
    """What is left to do once the calibration is in force."""
    force, result = snapshot.in_force, snapshot.result
    if force is None or result is None or result.record_id is None or force.present != result.record_id:
        return ""
    return (
        "<p class='next'><b>Next:</b> reload the running service (<code>systemctl reload highside</code>), and it"
        " corrects by this calibration; print the certificate; end this session with Ctrl-C in its terminal.</p>"
    )


def _force(snapshot: Snapshot) -> str:
    """Whether the record is in force, and what else is."""
    force, result = snapshot.in_force, snapshot.result
    if force is None or result is None:
        return ""
    if force.present == result.record_id:
        return ", <strong>in force</strong>"
    present = f"; in force is <code>{escape(force.present[:12])}</code>" if force.present else ""
    return f", not in force{present}"


def _verdict(verdict: VerdictState) -> str:
    """A verification's or roll test's comparisons with their limits."""
    limits = [f"I {verdict.limit_inc_deg:g}°"]
    limits += [] if verdict.limit_tf_deg is None else [f"T {verdict.limit_tf_deg:g}°"]
    limits += [] if verdict.limit_g_total_g is None else [f"Gtotal {1e3 * verdict.limit_g_total_g:g} mg"]
    columns = {
        "I error": [_with_u(row.inc_error_deg, row.inc_u_deg, "°") for row in verdict.rows],
        "T error": [_with_u(row.tf_error_deg, row.tf_u_deg, "°") for row in verdict.rows],
        "Gtotal": [_with_u(row.g_error_g, row.g_u_g, " mg", 1e3) for row in verdict.rows],
    }
    columns = {name: cells for name, cells in columns.items() if any(cells)}
    head = "".join(f'<th scope="col">{name}</th>' for name in ("pose", *columns, "verdict"))
    rows = "".join(
        f"<tr><td>{escape(row.name)}</td>{''.join(f'<td>{cells[k]}</td>' for cells in columns.values())}"
        f"<td class='{'good' if row.verdict == 'pass' else 'bad'}'>{escape(row.verdict)}</td></tr>"
        for k, row in enumerate(verdict.rows)
    )
    changed = (
        ""
        if verdict.consistent is not False
        else (
            "<p class='bad'>The errors are larger than the calibration's own stated uncertainty lets expect: the"
            " sensor has changed.</p>"
        )
    )
    good = verdict.verdict == "pass"
    return (
        f"<h2>Verdict</h2><p class='big {'good' if good else 'bad'}'><b aria-hidden='true'>{'✓' if good else '✗'}</b>"
        f" {escape(verdict.verdict.replace('_', ' '))}</p><p>{escape(verdict.text)}</p>{changed}"
        f"<p>calibration <code>{escape(verdict.record)}</code>; limits {', '.join(limits)}; ± is U (k = 2)</p>"
        '<div class="wide" tabindex="0" role="region" aria-label="comparisons with the limits">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _with_u(error: float | None, u: float | None, unit: str, scale: float = 1.0) -> str:
    return "" if error is None or u is None else f"{scale * error:+.4f} ± {scale * u:.4f}{unit}"


def _foot(snapshot: Snapshot) -> str:
    who = f", held by {escape(snapshot.operator)}" if snapshot.operator else ""
    serial = f" ({escape(snapshot.serial)})" if snapshot.serial else ""
    return (
        f"{escape(snapshot.tool)}{serial} · {escape(snapshot.plan.title)} · {_lasted(snapshot.elapsed_s)}{who} ·"
        f" session {escape(snapshot.session)}"
    )


def _lasted(seconds: float) -> str:
    """A time in the unit that fits: 45 s, 12 min, 3 h 05 min."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = int(seconds // 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"

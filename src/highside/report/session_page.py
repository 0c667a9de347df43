"""The end of a session on one page: before and after by every method, uncertainty, residuals, bench or sensor.

Made from a journal alone, before the operator decides (review) or afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from highside.bench.photographs import Found
from highside.bench.session.entries import Noted
from highside.bench.session.journal import Journal
from highside.bench.session.outcome import solve
from highside.bench.session.snapshot import VerdictRow, VerdictState
from highside.bench.session.verdict import as_state
from highside.calibration.comparison import Errors, MethodComparison, compare
from highside.calibration.method import Solution, SolveRequest
from highside.calibration.methods import all_methods
from highside.calibration.methods.joint import METHOD as JOINT
from highside.calibration.record import PoseColumns, to_utc
from highside.errors import HighsideError
from highside.report.bench_or_sensor import Findings, bench_or_sensor
from highside.report.certificate_evidence import error_headers
from highside.report.document import Page
from highside.report.plots import new_figure, plotting
from highside.words import _, told
from highside.words.errors import error_told

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def session_page(journal: Journal, photographs: Sequence[Found] = ()) -> str:
    """The page as HTML; `photographs` of the session, read back. Raises InputError where matplotlib is missing."""
    header, ledger = journal.header, journal.ledger()
    solved = solve(ledger, header.judged)
    name = f"{header.tool_id}{' ' + header.serial if header.serial else ''}"
    page = Page(_("Session %(session)s: %(tool)s", session=header.session, tool=name))
    page.paragraph(
        _(
            "%(plan)s; %(done)s poses taken, %(again)s again, %(omitted)s omitted. Bench: %(bench)s; operator:"
            " %(operator)s.",
            plan=told(ledger.plan.title),
            done=len(ledger.done),
            again=ledger.retaken,
            omitted=ledger.skipped,
            bench=header.environment.bench or _("not named"),
            operator=header.environment.operator or _("not named"),
        ),
        look="soft",
    )
    add_remarks(page, journal)
    add_photographs(page, photographs)
    if solved.verdict is not None:
        add_verdict(page, as_state(solved.verdict))
        return page.html()
    if solved.solution is None:
        why = _("No calibration follows: %(why)s.", why=told(solved.why)) if solved.why else ""
        page.paragraph(why or _("This session calibrates nothing."))
        return page.html()
    std = (solved.inc_std_deg, solved.tf_std_deg)
    page.paragraph(
        _(
            "Method %(method)s: I within %(inc)s deg, T within %(tf)s deg (one standard deviation by the calibration"
            " alone, over all attitudes where it holds).",
            method=solved.solution.result.method,
            inc=f"{std[0]:.4f}",
            tf=f"{std[1]:.4f}",
        )
    )
    page.bullets([*(_("refused: %(why)s", why=told(text)) for text in solved.refused), *map(told, solved.remarks)])
    with plotting():
        add_methods(page, ledger.solver_columns(), ledger.request(), solved.solution, header.environment.gravity_mps2)
    return page.html()


def add_remarks(page: Page, journal: Journal) -> None:
    """What operators noted for the reader."""
    said = [
        f"{to_utc(at_s)} {entry.text}"
        for entry, at_s in zip(journal.entries, journal.times_s, strict=True)
        if isinstance(entry, Noted) and entry.code == "remark"
    ]
    if said:
        page.heading(_("Notes"))
        page.bullets(said)


def add_photographs(page: Page, photographs: Sequence[Found]) -> None:
    """What was photographed at the bench; what is not the file any more of which the journal holds the hash is said."""
    if photographs:
        page.heading(_("Photographs"))
    for one in photographs:
        entry = one.entry
        said = f"{to_utc(one.at_s)} {entry.operator}{': ' if entry.text else ''}{entry.text}"
        if one.trouble:
            page.badge(_("not shown"), "bad", f"{said}: {told(one.trouble)}.")
        else:
            page.photograph(one.data, f"{said} (SHA-256 {entry.sha256})")


def add_verdict(page: Page, verdict: VerdictState) -> None:
    """What the session says of an existing calibration."""
    page.heading(_("Verdict: %(verdict)s", verdict=told(verdict.verdict.replace("_", " "))))
    judged = _("Calibration judged: %(record)s.", record=verdict.record)
    page.paragraph(f"{told(verdict.text)} {judged}")
    if verdict.consistent is False:
        page.paragraph(_("The errors are larger than its own stated uncertainty lets expect: the sensor has changed."))
    limits = f"I {verdict.limit_inc_deg:g}°"
    limits += "" if verdict.limit_tf_deg is None else f", T {verdict.limit_tf_deg:g}°"
    limits += "" if verdict.limit_g_total_g is None else f", Gtotal {1e3 * verdict.limit_g_total_g:g} mg"

    def cells(row: VerdictRow) -> list[str]:
        values = (row.inc_error_deg, row.inc_u_deg, row.tf_error_deg, row.tf_u_deg, row.g_error_g, row.g_u_g)
        return ["-" if value is None else f"{value:.5f}" for value in values]

    page.table(
        ["", _("I error, deg"), "U", _("T error, deg"), "U", "Gtotal, g", "U", _("verdict")],
        [[row.name, *cells(row), told(row.verdict.replace("_", " "))] for row in verdict.rows],
        _(
            "Limits: %(limits)s. U is the expanded uncertainty (k = 2) of the comparison; guarded acceptance: pass only"
            " where error and U together stay within the limit.",
            limits=limits,
        ),
    )


def add_methods(
    page: Page, columns: PoseColumns, request: SolveRequest, solution: Solution, gravity_mps2: float | None = None
) -> None:
    """Methods side by side, residuals, bench or sensor; within `plotting`."""
    try:
        comparison = compare(columns, request, solved=solution)
    except HighsideError as error:
        page.paragraph(_("The methods cannot be compared: %(why)s.", why=error_told(error)), look="soft")
        return
    page.heading(_("Before and after, by every method"))
    _table(page, comparison, solution.result.method)
    page.figure(
        _uncertainty(comparison),
        _(
            "Stated uncertainty over inclination: one standard deviation, the largest over toolface, by the calibration"
            " alone. A line ends where its method does not hold."
        ),
    )
    left = _("What is left at the poses against the bench, pose by pose in the order of time.")
    page.figure(_errors(comparison), left)
    page.figure(_residuals(solution), _("Residuals of the readings with the method chosen; hollow: rejected."))
    joint = comparison.of(JOINT.name)
    findings = bench_or_sensor(columns, None if joint is None else joint.solution, gravity_mps2=gravity_mps2)
    _findings(page, findings)


def _table(page: Page, comparison: MethodComparison, chosen: str) -> None:
    def cells(errors: Errors) -> list[str]:
        values = (errors.rms[0], errors.largest[0], errors.rms[1], errors.largest[1])
        return ["-" if value is None else f"{value:.4f}" for value in values]

    rows = [[_("before"), *cells(comparison.before), "-", "-"]]
    for outcome in comparison.outcomes:
        name = _("%(method)s (chosen)", method=outcome.method) if outcome.method == chosen else outcome.method
        if outcome.errors is None or outcome.uncertainty is None:
            rows.append([name, *["-"] * 6])
            continue
        at = int(np.argmin(np.abs(outcome.uncertainty.inc_deg - 45.0)))
        stated = (outcome.uncertainty.inc_std_deg[at], outcome.uncertainty.tf_std_deg[at])
        rows.append([name, *cells(outcome.errors), *(f"{v:.4f}" if math.isfinite(v) else "-" for v in stated)])
    page.table(
        ["", *error_headers()],
        rows,
        _(
            "Degrees. Errors are against the bench at poses that took part: a method that has absorbed an error of the"
            " bench agrees with it best. The stated uncertainty u is against gravity: judge by it."
        ),
    )
    page.bullets([f"{outcome.method}: {told(outcome.refused)}" for outcome in comparison.outcomes if outcome.refused])


def _uncertainty(comparison: MethodComparison) -> Figure:
    figure, axes = new_figure(1, 2)
    for outcome in comparison.outcomes:
        u = outcome.uncertainty
        if u is None:
            continue
        for axis, values in zip(axes[0], (u.inc_std_deg, u.tf_std_deg), strict=True):
            axis.semilogy(u.inc_deg, values, ".-", color=all_methods()[outcome.method].colour, label=outcome.method)
    for axis, name in zip(axes[0], ("I", "T"), strict=True):
        axis.set(xlabel=_("inclination, deg"), ylabel=f"u({name}), °")
        axis.legend()
    return figure


def _errors(comparison: MethodComparison) -> Figure:
    figure, axes = new_figure(1, 2)
    at = np.arange(1, len(comparison.poses) + 1)
    for outcome in comparison.outcomes:
        if outcome.errors is None:
            continue
        for axis, values in zip(axes[0], (outcome.errors.inc_deg, outcome.errors.tf_deg), strict=True):
            axis.plot(at, values, ".", color=all_methods()[outcome.method].colour, label=outcome.method)
    for axis, name in zip(axes[0], ("I", "T"), strict=True):
        axis.set(xlabel=_("pose"), ylabel=_("error of %(angle)s, deg", angle=name))
        axis.set_yscale("symlog", linthresh=0.01)
        axis.legend()
    return figure


def _residuals(solution: Solution) -> Figure:
    fit = solution.result.poses
    figure, axes = new_figure(1, 1, height=2.6)
    at = np.arange(1, len(fit.ids) + 1)
    for k, (name, mark, colour) in enumerate((("x", "o", "#2f7fd1"), ("y", "s", "#c2691c"), ("z", "^", "#3d8b40"))):
        values = 1e6 * fit.residual_g[k]
        axes[0][0].plot(at[fit.used], values[fit.used], mark, ms=4, color=colour, label=name)
        axes[0][0].plot(at[~fit.used], values[~fit.used], mark, ms=4, color=colour, fillstyle="none")
    axes[0][0].set(xlabel=_("pose"), ylabel=_("residual, µg"))
    axes[0][0].legend(ncols=3)
    return figure


def _findings(page: Page, findings: Findings) -> None:
    page.heading(_("Is it the bench or the sensor?"))
    page.paragraph(told(findings.answer))
    page.bullets([f"{_(finding.where)}: {told(finding.text)}" for finding in findings.findings])
    if findings.diagnosis is not None and findings.diagnosis.claims:
        page.bullets([_("next: %(what)s", what=told(claim.next_manoeuvre)) for claim in findings.diagnosis.claims])

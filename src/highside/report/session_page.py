"""The end of a session on one page: before and after by every method, uncertainty, residuals, bench or sensor.

Made from a journal alone, before the operator decides (review) or afterwards.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from highside.bench.session.journal import Journal
from highside.bench.session.outcome import solve
from highside.bench.session.snapshot import VerdictRow, VerdictState
from highside.bench.session.verdict import as_state
from highside.calibration.comparison import Errors, MethodComparison, compare
from highside.calibration.method import Solution, SolveRequest
from highside.calibration.methods import all_methods
from highside.calibration.methods.joint import METHOD as JOINT
from highside.calibration.record import PoseColumns
from highside.errors import HighsideError
from highside.report.bench_or_sensor import Findings, bench_or_sensor
from highside.report.document import Page
from highside.report.plots import new_figure, plotting

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def session_page(journal: Journal) -> str:
    """The page as HTML. Raises InputError where matplotlib is missing."""
    header, ledger = journal.header, journal.ledger()
    solved = solve(ledger, header.judged)
    name = f"{header.tool_id}{' ' + header.serial if header.serial else ''}"
    page = Page(f"Session {header.session}: {name}")
    page.paragraph(
        f"{ledger.plan.title}; {len(ledger.done)} poses taken, {ledger.retaken} again, {ledger.skipped} omitted."
        f" Bench: {header.environment.bench or 'not named'}; operator: {header.environment.operator or 'not named'}.",
        look="soft",
    )
    if solved.verdict is not None:
        add_verdict(page, as_state(solved.verdict))
        return page.html()
    if solved.solution is None:
        page.paragraph(f"No calibration follows: {solved.why}." if solved.why else "This session calibrates nothing.")
        return page.html()
    std = (solved.inc_std_deg, solved.tf_std_deg)
    page.paragraph(
        f"Method {solved.solution.result.method}: I within {std[0]:.4f} deg, T within {std[1]:.4f} deg (one standard"
        " deviation by the calibration alone, over all attitudes where it holds)."
    )
    page.bullets([*(f"refused: {text}" for text in solved.refused), *solved.remarks])
    with plotting():
        add_methods(page, ledger.solver_columns(), ledger.request(), solved.solution, header.environment.gravity_mps2)
    return page.html()


def add_verdict(page: Page, verdict: VerdictState) -> None:
    """What the session says of an existing calibration."""
    page.heading(f"Verdict: {verdict.verdict.replace('_', ' ')}")
    page.paragraph(f"{verdict.text} Calibration judged: {verdict.record}.")
    if verdict.consistent is False:
        page.paragraph("The errors are larger than its own stated uncertainty lets expect: the sensor has changed.")
    limits = f"Limits: I {verdict.limit_inc_deg:g} deg"
    limits += "" if verdict.limit_tf_deg is None else f", T {verdict.limit_tf_deg:g} deg"
    limits += "" if verdict.limit_g_total_g is None else f", Gtotal {1e3 * verdict.limit_g_total_g:g} mg"

    def cells(row: VerdictRow) -> list[str]:
        values = (row.inc_error_deg, row.inc_u_deg, row.tf_error_deg, row.tf_u_deg, row.g_error_g, row.g_u_g)
        return ["-" if value is None else f"{value:.5f}" for value in values]

    page.table(
        ["", "I error, deg", "U", "T error, deg", "U", "Gtotal, g", "U", "verdict"],
        [[row.name, *cells(row), row.verdict] for row in verdict.rows],
        f"{limits}. U is the expanded uncertainty (k = 2) of the comparison; guarded acceptance: pass only where error"
        " and U together stay within the limit.",
    )


def add_methods(
    page: Page, columns: PoseColumns, request: SolveRequest, solution: Solution, gravity_mps2: float | None = None
) -> None:
    """Methods side by side, residuals, bench or sensor; within `plotting`."""
    try:
        comparison = compare(columns, request, solved=solution)
    except HighsideError as error:
        page.paragraph(f"The methods cannot be compared: {error}.", look="soft")
        return
    page.heading("Before and after, by every method")
    _table(page, comparison, solution.result.method)
    page.figure(
        _uncertainty(comparison),
        "Stated uncertainty over inclination: one standard deviation, the largest over toolface, by the calibration"
        " alone. A line ends where its method does not hold.",
    )
    page.figure(_errors(comparison), "What is left at the poses against the bench, pose by pose in the order of time.")
    page.figure(_residuals(solution), "Residuals of the readings with the method chosen; hollow: rejected.")
    joint = comparison.of(JOINT.name)
    findings = bench_or_sensor(columns, None if joint is None else joint.solution, gravity_mps2=gravity_mps2)
    _findings(page, findings)


def _table(page: Page, comparison: MethodComparison, chosen: str) -> None:
    def cells(errors: Errors) -> list[str]:
        values = (errors.rms[0], errors.largest[0], errors.rms[1], errors.largest[1])
        return ["-" if value is None else f"{value:.4f}" for value in values]

    rows = [["before", *cells(comparison.before), "-", "-"]]
    for outcome in comparison.outcomes:
        name = f"{outcome.method}{' (chosen)' if outcome.method == chosen else ''}"
        if outcome.errors is None or outcome.uncertainty is None:
            rows.append([name, *["-"] * 6])
            continue
        at = int(np.argmin(np.abs(outcome.uncertainty.inc_deg - 45.0)))
        stated = (outcome.uncertainty.inc_std_deg[at], outcome.uncertainty.tf_std_deg[at])
        rows.append([name, *cells(outcome.errors), *(f"{v:.4f}" if math.isfinite(v) else "-" for v in stated)])
    page.table(
        ["", "I rms", "I largest", "T rms", "T largest", "u(I) at 45", "u(T) at 45"],
        rows,
        "Degrees. Errors are against the bench at poses that took part: a method that has absorbed an error of the"
        " bench agrees with it best. The stated uncertainty u is against gravity: judge by it.",
    )
    page.bullets([f"{outcome.method}: {outcome.refused}" for outcome in comparison.outcomes if outcome.refused])


def _uncertainty(comparison: MethodComparison) -> Figure:
    figure, axes = new_figure(1, 2)
    for outcome in comparison.outcomes:
        u = outcome.uncertainty
        if u is None:
            continue
        for axis, values in zip(axes[0], (u.inc_std_deg, u.tf_std_deg), strict=True):
            axis.semilogy(u.inc_deg, values, ".-", color=all_methods()[outcome.method].colour, label=outcome.method)
    for axis, name in zip(axes[0], ("I", "T"), strict=True):
        axis.set(xlabel="inclination, deg", ylabel=f"u({name}), deg")
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
        axis.set(xlabel="pose", ylabel=f"error of {name}, deg")
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
    axes[0][0].set(xlabel="pose", ylabel="residual, ug")
    axes[0][0].legend(ncols=3)
    return figure


def _findings(page: Page, findings: Findings) -> None:
    page.heading("Is it the bench or the sensor?")
    page.paragraph(findings.answer)
    page.bullets([f"{finding.where}: {finding.text}" for finding in findings.findings])
    if findings.diagnosis is not None and findings.diagnosis.claims:
        page.bullets([f"next: {claim.next_manoeuvre}" for claim in findings.diagnosis.claims])

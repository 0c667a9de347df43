"""The calibration certificate: numbered sheets that say what was measured, how, and how far it can be trusted.

Everything is computed from the record (and, where given, an earlier record and the poses of a verification); what only
people know comes from the fields file. What was not stated is named as such, never filled in.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from highside.calibration.comparison import INCLINATIONS_DEG, compare, uncertainty_over
from highside.calibration.method import Solution
from highside.calibration.methods.joint import METHOD as JOINT
from highside.report.bench_or_sensor import bench_or_sensor
from highside.report.certificate_budget import UncertaintyBudget, budget_at
from highside.report.certificate_conformity import conformity
from highside.report.certificate_evidence import (
    findings as write_findings,
)
from highside.report.certificate_evidence import (
    identity,
    limits_of_proof,
    method,
    method_name,
    poses,
    side_by_side,
)
from highside.report.certificate_inputs import Inputs, degrees, number, or_not_stated
from highside.report.certificate_marks import logo_of, qr_code, verification
from highside.report.certificate_photographs import annex
from highside.report.document import Sheets
from highside.report.plots import new_figure, plotting
from highside.words import _, in_language, language, said_later, told

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BUDGET_AT_DEG = (3.0, 45.0, 90.0)
RELATES = said_later("This certificate relates only to the item described in it.")


def certificate(inputs: Inputs) -> Sheets:
    """The sheets of the certificate, in the language that its fields name, else the present reader's. Raises InputError
    where matplotlib is missing or a part of the input is wrong."""
    with in_language(inputs.fields.issue.language or language()):
        return _certificate(inputs)


def _certificate(inputs: Inputs) -> Sheets:
    record = inputs.record
    has_reference = record.request.reference == "pose"
    solution = Solution(record.result, record.fallback, record.guide)
    comparison = compare(record.pose_columns, record.request, solved=solution) if has_reference else None
    findings = None
    if comparison is not None:
        joint = comparison.of(JOINT.name)
        gravity = record.content["environment"]["gravity_mps2"]
        findings = bench_or_sensor(record.pose_columns, None if joint is None else joint.solution, gravity_mps2=gravity)
    named = number_of(inputs)
    item = _("tool %(tool)s", tool=record.tool_id)
    item += ", " + _("serial number %(serial)s", serial=record.serial) if record.serial else ""
    title = _("Calibration certificate %(number)s", number=named)
    out = Sheets(title, (title, item), _(RELATES))
    with plotting():
        _front(out, inputs, named)
        _statement(out, inputs, solution)
        _budgets(out, inputs)
        conformity(out, inputs)
        method(out, inputs)
        if comparison is not None and findings is not None:
            side_by_side(out, comparison, record.result.method)
            write_findings(out, findings)
        limits_of_proof(out, inputs)
        poses(out, record, comparison)
        identity(out, inputs)
        annex(out, inputs.photographs)
    return out


def number_of(inputs: Inputs) -> str:
    """The certificate's number: as stated, or made from the record."""
    record = inputs.record
    return inputs.fields.issue.number or f"HS-{record.content['created'][:10]}-{record.id[:8]}"


def _front(out: Sheets, inputs: Inputs, named: str) -> None:
    record, fields = inputs.record, inputs.fields
    issue, item, environment = fields.issue, fields.item, record.content["environment"]
    out.letterhead(logo_of(inputs), qr_code(verification(inputs, named)))
    out.title(_("Calibration certificate"))
    out.facts(
        [
            (_("Number"), named),
            (_("Issued by"), or_not_stated(", ".join(part for part in (issue.laboratory, issue.address) if part))),
            (_("Customer"), or_not_stated(issue.customer)),
            (_("Item"), told(item.description)),
            (_("Maker, model"), or_not_stated(", ".join(part for part in (item.maker, item.model) if part))),
            (_("Tool"), record.tool_id),
            (_("Serial number"), or_not_stated(record.serial)),
            (_("Condition on receipt"), or_not_stated(item.condition)),
            (_("Calibrated"), f"{record.content['created']} (UTC)" + (f", {issue.place}" if issue.place else "")),
            (_("Issued"), inputs.issued_utc),
            (_("Operator"), or_not_stated(environment["operator"])),
            (_("Bench"), or_not_stated(environment["bench"])),
            (_("Method"), method_name(record)),
            (_("Record"), record.id),
        ]
    )
    out.heading(_("Result"))
    budgets = [b for inc in BUDGET_AT_DEG if (b := budget_at(record, fields, inc)) is not None]
    if budgets:
        out.table(
            [_("inclination"), "U(I), k = 2", "U(T), k = 2"],
            [[f"{b.inclination_deg:g}°", degrees(b.expanded[0]), degrees(b.expanded[1])] for b in budgets],
            caption=_(
                "Expanded uncertainty of an indication at rest with the corrections of the record; the full statement"
                " follows."
            ),
        )
    referred = (
        _("Angles are referred to gravity.")
        if record.result.frame == "gravity"
        else _("Angles are referred to the bench, which was taken as level.")
    )
    corrections = _(
        "The corrections of the record are the result of this calibration: gravity in the frame of the tool follows"
        " from the readings by them."
    )
    out.paragraph(f"{corrections} {referred}")
    if fields.next is not None:
        when, who = fields.next.next_calibration.isoformat(), fields.next.agreed_with
        out.paragraph(_("Next calibration: %(date)s, as agreed with %(who)s.", date=when, who=who))
    expires = record.content["expires"]
    if expires is not None:
        out.paragraph(_("The software stops using the record on %(date)s.", date=expires))
    signs = (issue.signatory or _("signatory not stated")) + (f", {issue.role}" if issue.role else "")
    out.signature(_("%(name)s (authorised signatory), date", name=signs))


def _statement(out: Sheets, inputs: Inputs, solution: Solution) -> None:
    record, fields = inputs.record, inputs.fields
    out.new_sheet()
    out.heading(_("Uncertainty over inclination"))
    rows = []
    for inc in INCLINATIONS_DEG:
        budget = budget_at(record, fields, inc)
        if budget is None:
            rows.append([f"{inc:g}°", _("not calibrated"), _("not calibrated"), ""])
        else:
            freedom = budget.freedom
            many = _("over 1000") if freedom > 1000 else f"{freedom:.0f}"
            rows.append([f"{inc:g}°", *map(degrees, budget.expanded), many])
    out.table(
        [_("inclination"), "U(I)", "U(T)", _("effective degrees of freedom")],
        rows,
        caption=_("Expanded uncertainty, k = 2, the largest over toolface."),
    )
    out.figure(
        _uncertainty_figure(solution),
        _("Standard uncertainty (k = 1) by the parameters of the correction alone; noise of an indication adds to it."),
    )
    out.paragraph(
        _(
            "The expanded uncertainty is the standard uncertainty multiplied by the coverage factor k = 2, which for a"
            " normal distribution gives a coverage probability of about 95 %%. It was evaluated after the GUM (JCGM"
            " 100). Toolface is not defined at the vertical: its uncertainty grows as 1 / sin I and ends at that of an"
            " angle of which nothing is known (%(most)s deg, standard).",
            most="103.9",
        )
    )
    out.heading(_("Assumptions of the statement"))
    out.bullets(_assumptions(inputs))


def _assumptions(inputs: Inputs) -> list[str]:
    record, use = inputs.record, inputs.fields.use
    out = [
        _("The tool is at rest, and an indication is one reading.")
        if use.readings == 1
        else _(
            "The tool is at rest, and an indication is the mean of %(count)s readings with independent noise.",
            count=use.readings,
        ),
        _(
            "The sensor is as it was during the calibration: no drift, shock or repair since. Stability in time is not"
            " part of the statement."
        ),
    ]
    if use.turn_on_g is None:
        out.append(_("The offset is that of the power-up during which it was calibrated; its scatter was not stated."))
    if use.toolface_zero_deg is None:
        out.append(
            _("Toolface counts from the zero of the clamping; its relation to the tool's scribe line is omitted.")
        )
    span = record.result.main.temperature
    if span is not None and record.result.main.max_power():
        ends = {"low": f"{span.min_c:.1f}", "high": f"{span.max_c:.1f}"}
        out.append(_("The temperature is within %(low)s and %(high)s °C, where it was calibrated.", **ends))
    elif use.temp_half_width_c is not None:
        half = f"{use.temp_half_width_c:g}"
        out.append(_("The temperature is within %(half)s °C of that of the calibration.", half=half))
    else:
        out.append(_("The temperature is that of the calibration; a change of it is not part of the statement."))
    if inputs.fields.bench is None or inputs.fields.bench.inc_expanded_deg is None:
        out.append(
            _("The calibration uncertainty of the bench's scales was not stated and is not part of the statement.")
        )
    if record.result.frame != "gravity":
        out.append(
            _("The bench was taken as level to within %(tilt)s deg (standard deviation of each tilt).", tilt="0.05")
        )
    return out


def _budgets(out: Sheets, inputs: Inputs) -> None:
    out.heading(_("Uncertainty budget"))
    shown = False
    for inc in BUDGET_AT_DEG:
        budget = budget_at(inputs.record, inputs.fields, inc)
        if budget is None:
            continue
        shown = True
        out.table(
            [
                _("source"),
                _("type"),
                _("value"),
                _("distribution"),
                _("divisor"),
                "u(I), °",
                "u(T), °",
            ],
            [*[_source_row(budget, k) for k in range(len(budget.sources))], _combined(budget), _expanded(budget)],
            caption=_(
                "At I = %(inc)s°. Sensitivity of I: 57.3 deg/g, of T: %(slope)s deg/g.",
                inc=f"{inc:g}",
                slope=f"{57.2958 / math.sin(math.radians(inc)):.1f}",
            ),
            words=(0, 2, 3),
            whole=True,
        )
    if not shown:
        out.paragraph(_("The calibration holds at none of 3, 45 and 90 deg; see the statement for where it does."))
    notes = budget_at(inputs.record, inputs.fields, next(iter(_covered(inputs)), 45.0))
    if notes is not None:
        out.bullets([f"{told(source.name)}: {told(source.note)}." for source in notes.sources if source.note])


def _covered(inputs: Inputs) -> list[float]:
    return [inc for inc in INCLINATIONS_DEG if budget_at(inputs.record, inputs.fields, inc) is not None]


def _source_row(budget: UncertaintyBudget, k: int) -> list[str]:
    s = budget.sources[k]
    return [told(s.name), s.kind, told(s.value), _(s.distribution), s.divisor, number(s.inc_deg), number(s.tf_deg)]


def _combined(budget: UncertaintyBudget) -> list[str]:
    return [_("combined standard uncertainty"), "", "", "", "", number(budget.inc_deg), number(budget.tf_deg)]


def _expanded(budget: UncertaintyBudget) -> list[str]:
    inc, tf = budget.expanded
    return [_("expanded uncertainty U (k = 2)"), "", "", "", "", number(inc), number(tf)]


def _uncertainty_figure(solution: Solution) -> Figure:
    figure, axes = new_figure(1, 2, width=9.0, height=2.5)
    grid = np.concatenate([np.geomspace(0.5, 10.0, 20), np.linspace(12.0, 175.0, 60)])
    stated = uncertainty_over(solution, grid.tolist())
    for axis, values, name in zip(axes[0], (stated.inc_std_deg, stated.tf_std_deg), ("I", "T"), strict=True):
        axis.semilogy(stated.inc_deg, values, color="#2f6fb1")
        axis.set(xlabel=_("inclination, deg"), ylabel=f"u({name}), °")
    return figure

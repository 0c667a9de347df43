"""What the result of a certificate rests on: method, references, other methods, poses, and what none of it proves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from highside.calibration.comparison import Errors, MethodComparison
from highside.calibration.method import NO_FALLBACK
from highside.calibration.methods import all_methods, solves_by_inclination
from highside.calibration.record import CalibrationRecord
from highside.config.certificate import ReferenceInstrument
from highside.report.bench_or_sensor import Findings
from highside.report.certificate_inputs import NOT_STATED, Inputs, degrees, signed
from highside.report.document import Sheets
from highside.report.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def method_name(record: CalibrationRecord) -> str:
    request = record.request
    if request.reference == "magnitude":
        return "magnitude of gravity in many attitudes, no bench"
    more = f", {request.fallback} beyond its zones" if request.fallback != NO_FALLBACK else ""
    known = all_methods().get(request.method)
    return (request.method if known is None else known.described.format(triples=request.triples)) + more


def method(out: Sheets, inputs: Inputs) -> None:
    record, fields = inputs.record, inputs.fields
    environment, result = record.content["environment"], record.result
    used = int(np.count_nonzero(result.poses.used))
    out.heading("Method")
    out.paragraph(
        f"{method_name(record).capitalize()}: {len(result.poses.ids)} poses at rest, {used} used; sensor model"
        f" m = A g + b{_more_terms(record)}. Readings are raw; no earlier calibration took part. Standard deviation of"
        f" one setting of the bench as stated: {record.request.pose_sigma_deg:g} deg."
    )
    zones = [z for z in result.zones if z.is_local]
    if zones:
        out.paragraph(
            "It holds in the zones "
            + ", ".join(f"{math.degrees(z.inc_min_rad):.2f} to {math.degrees(z.inc_max_rad):.2f} deg" for z in zones)
            + (f"; elsewhere the {record.request.fallback} correction." if record.fallback is not None else ".")
        )
    out.heading("Environment and references")
    temps = record.content["pose_table"].get("temp_c")
    of_tool = f"{min(temps):.1f} to {max(temps):.1f} °C (sensor's own)" if temps else ""
    if not temps and environment["temp_c"] is not None:
        of_tool = f"{environment['temp_c']:g} °C (stated)"
    room = fields.environment
    gravity = environment["gravity_mps2"]
    of_gravity = NOT_STATED
    if gravity is not None:
        source = f", {fields.gravity_source}" if fields.gravity_source else ""
        of_gravity = f"{gravity:.5f} ± {environment['gravity_std_mps2']:g} m/s² (k = 1){source}"
    out.facts(
        [
            ("Temperature of the tool", of_tool or NOT_STATED),
            ("Room", _room(inputs) or NOT_STATED),
            ("Local gravity", of_gravity),
            ("Bench", _reference(fields.bench, environment["bench"])),
            ("Thermometer", _reference(fields.thermometer, None)),
            ("Remark", room.remark or ""),
        ]
    )


def _room(inputs: Inputs) -> str:
    room = inputs.fields.environment
    parts = (
        (room.temp_c, "°C"),
        (room.humidity_percent, "% relative humidity"),
        (room.pressure_hpa, "hPa"),
    )
    return ", ".join(f"{value[0]:g} to {value[1]:g} {unit}" for value, unit in parts if value is not None)


def _reference(table: ReferenceInstrument | None, name: str | None) -> str:
    if table is None:
        return f"{name + '; ' if name else ''}traceability not stated"
    until = f", valid until {table.valid_until.isoformat()}" if table.valid_until else ""
    by = f" by {table.issued_by}" if table.issued_by else ""
    number = f"certificate {table.certificate}{by}{until}" if table.certificate else "no certificate stated"
    return f"{table.description}; {number}"


def _more_terms(record: CalibrationRecord) -> str:
    main = record.result.main
    terms = []
    if any(name.startswith("K") for name in main.parameters.names):
        terms.append("quadratic, cubic and cross terms as the poses require")
    if main.max_power():
        terms.append(f"temperature to the power {main.max_power()}")
    return f" with {' and '.join(terms)}" if terms else ""


def side_by_side(out: Sheets, comparison: MethodComparison, chosen: str) -> None:
    out.heading("Methods side by side")
    rows = [["before (nominal)", *_error_cells(comparison.before), "", ""]]
    for outcome in comparison.outcomes:
        name = outcome.method + (" (this record)" if outcome.method == chosen else "")
        if outcome.errors is None or outcome.uncertainty is None:
            rows.append([name, "-", "-", "-", "-", "-", "-"])
            continue
        at = int(np.argmin(np.abs(outcome.uncertainty.inc_deg - 45.0)))
        stated = (outcome.uncertainty.inc_std_deg[at], outcome.uncertainty.tf_std_deg[at])
        rows.append([name, *_error_cells(outcome.errors), *(degrees(v) if math.isfinite(v) else "-" for v in stated)])
    out.table(
        ["", "I rms", "I largest", "T rms", "T largest", "u(I) at 45°", "u(T) at 45°"],
        rows,
        caption="Errors at the poses against the bench, in degrees, and stated standard uncertainty by the correction"
        " alone. Poses that took part agree with any method that follows the bench: judge by the uncertainty.",
        words=(0,),
    )
    out.bullets([f"{o.method}: {o.refused}." for o in comparison.outcomes if o.refused])


def _error_cells(errors: Errors) -> list[str]:
    cells = (errors.rms[0], errors.largest[0], errors.rms[1], errors.largest[1])
    return ["-" if value is None else f"{value:.4f}" for value in cells]


def findings(out: Sheets, findings: Findings) -> None:
    out.heading("Bench or sensor")
    out.paragraph(findings.answer)
    out.bullets([f"{finding.where}: {finding.text}." for finding in findings.findings])


def limits_of_proof(out: Sheets, inputs: Inputs) -> None:
    record = inputs.record
    result = record.result
    inc = np.asarray(record.content["pose_table"].get("inc_ref_deg", ()), dtype=float)
    inclinations = np.unique(np.round(inc, 2))
    notes = []
    if record.request.reference == "magnitude":
        notes.append("Without a bench the axes of the tool are those of the sensor: its mounting angle is not known.")
    elif inclinations.size < 2:
        notes.append(
            "With one inclination the bench's tilt cannot be distinguished from scale and rotation of the sensor:"
            " agreement with this bench is not accuracy in the field."
        )
    elif not (np.any(inc < 0) or np.any(inc > 90.5)):
        notes.append(
            "No pose was turned the other way or beyond 90 deg: bench and sensor are separated by the inclinations"
            " between alone."
        )
    if solves_by_inclination(result.method):
        notes.append(
            "The balance correction absorbs every error common to the four poses of an inclination, those of the bench"
            " included: agreement at that inclination is not accuracy there."
        )
    if record.request.reference == "pose":
        notes.append(
            "An error common to all settings of inclination (the zero of its scale) is found only with inclinations on"
            " both sides; an error common to all settings of toolface (the zero of the chuck) is never found."
        )
    notes += [
        "Behaviour while turning, under vibration and under shock was not measured.",
        "Stability from power-up to power-up and over months was not measured.",
    ]
    out.heading("What this calibration cannot prove")
    out.bullets(notes)
    remarks = [remark.text for remark in result.remarks]
    if remarks or inputs.fields.remarks:
        out.heading("Remarks")
        out.bullets([*inputs.fields.remarks, *(f"{text[0].upper()}{text[1:]}." for text in remarks)])


def poses(out: Sheets, record: CalibrationRecord, comparison: MethodComparison | None) -> None:
    table, fit = record.content["pose_table"], record.result.poses
    out.heading("Poses and residuals")
    if comparison is not None:
        out.figure(_residual_figure(record), "Residuals pose by pose; open marks were rejected.")
    own = None if comparison is None else comparison.of(record.result.method)
    errors = own.errors if own is not None else None
    rows = []
    for i, name in enumerate(fit.ids):
        inc, tf = (table[key][i] if key in table else None for key in ("inc_ref_deg", "tf_ref_deg"))
        rows.append(
            [
                name + ("" if fit.used[i] else " (rejected)"),
                *("" if value is None else f"{value:.3f}" for value in (inc, tf)),
                *(f"{table[axis][i]:.6f}" for axis in ("ax", "ay", "az")),
                *(f"{round(1e6 * float(value))}" for value in fit.residual_g[:, i]),
                f"{fit.studentised[i]:.1f}" if fit.studentised[i] else "",
                "" if errors is None else signed(errors.inc_deg[i]),
                "" if errors is None else signed(errors.tf_deg[i]),
            ]
        )
    out.table(
        ["pose", "I set", "T set", "ax", "ay", "az", "rx", "ry", "rz", "sigma", "dI", "dT"],
        rows,
        caption="Settings in degrees; raw means in nominal g; residuals in ug; sigma: departure from what the other"
        " poses predict; dI, dT: indicated less set, degrees, in the frame of the bench.",
        words=(0,),
    )
    if record.result.closures:
        out.table(
            ["closure at inclination", "size, ug", "chi²", "p", "pose to doubt"],
            [
                [
                    f"{math.degrees(c.inc_rad):.3f}°",
                    f"{1e6 * float(np.linalg.norm(c.value)):.1f}",
                    f"{c.chi2:.2f}",
                    f"{c.p:.3g}",
                    c.worst_pose or "-",
                ]
                for c in record.result.closures
            ],
        )


def identity(out: Sheets, inputs: Inputs) -> None:
    record = inputs.record
    raw = record.content["raw"]
    software = record.content["software"]
    out.heading("Identity")
    out.code("Hash of the record (SHA-256):", record.id)
    out.code(f"Hash of the raw data (SHA-256), {raw['name']}:", raw["sha256"])
    if record.signature is not None:
        out.code(
            f"The record was signed (ed25519) on {record.signature.time} by {record.signature.signer}, key:",
            record.signature.key,
        )
    out.paragraph(
        f"Made with {software['name']} {software['version']}. The record holds all poses; `highside calibrate show"
        " RECORD --recompute` solves them again and compares. This certificate is not to be reproduced except in full"
        " without the approval of the issuing laboratory."
    )
    out.paragraph("End of certificate.")


def _residual_figure(record: CalibrationRecord) -> Figure:
    fit = record.result.poses
    figure, axes = new_figure(1, 1, width=9.0, height=2.3)
    axis = axes[0][0]
    at = np.arange(1, len(fit.ids) + 1)
    for k, (name, mark, colour) in enumerate((("x", "o", "#2f6fb1"), ("y", "s", "#b1562f"), ("z", "^", "#3d8b40"))):
        values = 1e6 * fit.residual_g[k]
        axis.plot(at[fit.used], values[fit.used], mark, ms=3.5, color=colour, label=name)
        axis.plot(at[~fit.used], values[~fit.used], mark, ms=3.5, color=colour, fillstyle="none")
    axis.axhline(0.0, color="#808890", lw=0.8)
    axis.set(xlabel="pose, in order", ylabel="residual, ug")
    axis.legend(ncols=3)
    return figure

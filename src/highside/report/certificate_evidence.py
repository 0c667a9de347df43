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
from highside.report.certificate_inputs import NOT_STATED, Inputs, degrees, or_not_stated, signed
from highside.report.document import Sheets
from highside.report.plots import new_figure
from highside.words import _, from_to, told

if TYPE_CHECKING:
    from matplotlib.figure import Figure


READ = ("ax", "ay", "az", "rx", "ry", "rz")
"""Readings and residuals of the axes."""


def method_name(record: CalibrationRecord) -> str:
    request = record.request
    if request.reference == "magnitude":
        return _("magnitude of gravity in many attitudes, no bench")
    more = ""
    if request.fallback != NO_FALLBACK:
        more = ", " + _("%(method)s beyond its zones", method=request.fallback)
    known = all_methods().get(request.method)
    return (request.method if known is None else _(known.described).format(triples=request.triples)) + more


def method(out: Sheets, inputs: Inputs) -> None:
    record, fields = inputs.record, inputs.fields
    environment, result = record.content["environment"], record.result
    used = int(np.count_nonzero(result.poses.used))
    out.heading(_("Method"))
    out.paragraph(
        _(
            "%(method)s: %(poses)s poses at rest, %(used)s used; sensor model %(model)s. Readings are raw; no earlier"
            " calibration took part. Standard deviation of one setting of the bench as stated: %(sigma)s deg.",
            method=first_large(method_name(record)),
            poses=len(result.poses.ids),
            used=used,
            model=_sensor_model(record),
            sigma=f"{record.request.pose_sigma_deg:g}",
        )
    )
    zones = [z for z in result.zones if z.is_local]
    if zones:
        held = ", ".join(
            from_to(*(f"{math.degrees(end):.2f}" for end in (z.inc_min_rad, z.inc_max_rad))) + " deg" for z in zones
        )
        out.paragraph(
            _("It holds in the zones %(zones)s.", zones=held)
            if record.fallback is None
            else _(
                "It holds in the zones %(zones)s; elsewhere the %(method)s correction.",
                zones=held,
                method=record.request.fallback,
            )
        )
    out.heading(_("Environment and references"))
    temps = record.content["pose_table"].get("temp_c")
    of_tool = ""
    if temps:
        ends = {"low": f"{min(temps):.1f}", "high": f"{max(temps):.1f}"}
        of_tool = _("%(low)s to %(high)s °C (sensor's own)", **ends)
    if not temps and environment["temp_c"] is not None:
        of_tool = _("%(temp)s °C (stated)", temp=f"{environment['temp_c']:g}")
    room = fields.environment
    gravity = environment["gravity_mps2"]
    of_gravity = _(NOT_STATED)
    if gravity is not None:
        source = f", {fields.gravity_source}" if fields.gravity_source else ""
        of_gravity = f"{gravity:.5f} ± {environment['gravity_std_mps2']:g} m/s² (k = 1){source}"
    out.facts(
        [
            (_("Temperature of the tool"), or_not_stated(of_tool)),
            (_("Room"), or_not_stated(_room(inputs))),
            (_("Local gravity"), of_gravity),
            (_("Bench"), _reference(fields.bench, environment["bench"])),
            (_("Thermometer"), _reference(fields.thermometer, None)),
            (_("Remark"), room.remark or ""),
        ]
    )


def _room(inputs: Inputs) -> str:
    room = inputs.fields.environment
    parts = (
        (room.temp_c, "°C"),
        (room.humidity_percent, _("%% relative humidity") % {}),
        (room.pressure_hpa, "hPa"),
    )
    return ", ".join(
        f"{from_to(f'{value[0]:g}', f'{value[1]:g}')} {unit}" for value, unit in parts if value is not None
    )


def _reference(table: ReferenceInstrument | None, name: str | None) -> str:
    if table is None:
        return (f"{name}; " if name else "") + _("traceability not stated")
    if not table.certificate:
        return f"{table.description}; " + _("no certificate stated")
    parts = [_("certificate %(number)s", number=table.certificate)]
    if table.issued_by:
        parts[0] = _("certificate %(number)s by %(issuer)s", number=table.certificate, issuer=table.issued_by)
    if table.valid_until:
        parts.append(_("valid until %(date)s", date=table.valid_until.isoformat()))
    return f"{table.description}; {', '.join(parts)}"


def first_large(text: str) -> str:
    """As a sentence begins; names within stay as they are."""
    return text[:1].upper() + text[1:]


def _sensor_model(record: CalibrationRecord) -> str:
    main = record.result.main
    terms = []
    if any(name.startswith("K") for name in main.parameters.names):
        terms.append(_("quadratic, cubic and cross terms as the poses require"))
    if main.max_power():
        terms.append(_("temperature to the power %(power)s", power=main.max_power()))
    return _("m = A g + b with %(terms)s", terms=", ".join(terms)) if terms else "m = A g + b"


def side_by_side(out: Sheets, comparison: MethodComparison, chosen: str) -> None:
    out.heading(_("Methods side by side"))
    rows = [[_("before (nominal)"), *_error_cells(comparison.before), "", ""]]
    for outcome in comparison.outcomes:
        name = _("%(method)s (this record)", method=outcome.method) if outcome.method == chosen else outcome.method
        if outcome.errors is None or outcome.uncertainty is None:
            rows.append([name, "-", "-", "-", "-", "-", "-"])
            continue
        at = int(np.argmin(np.abs(outcome.uncertainty.inc_deg - 45.0)))
        stated = (outcome.uncertainty.inc_std_deg[at], outcome.uncertainty.tf_std_deg[at])
        rows.append([name, *_error_cells(outcome.errors), *(degrees(v) if math.isfinite(v) else "-" for v in stated)])
    out.table(
        ["", *error_headers()],
        rows,
        caption=_(
            "Errors at the poses against the bench, in degrees, and stated standard uncertainty by the correction"
            " alone. Poses that took part agree with any method that follows the bench: judge by the uncertainty."
        ),
        words=(0,),
    )
    out.bullets([f"{o.method}: {told(o.refused)}." for o in comparison.outcomes if o.refused])


def error_headers() -> list[str]:
    """Of the columns with what a method leaves at the poses and states beyond them."""
    names = [_("%(angle)s rms", angle="I"), _("%(angle)s largest", angle="I")]
    names += [_("%(angle)s rms", angle="T"), _("%(angle)s largest", angle="T")]
    return [*names, _("%(what)s at %(inc)s°", what="u(I)", inc=45), _("%(what)s at %(inc)s°", what="u(T)", inc=45)]


def _error_cells(errors: Errors) -> list[str]:
    cells = (errors.rms[0], errors.largest[0], errors.rms[1], errors.largest[1])
    return ["-" if value is None else f"{value:.4f}" for value in cells]


def findings(out: Sheets, findings: Findings) -> None:
    out.heading(_("Bench or sensor"))
    out.paragraph(told(findings.answer))
    out.bullets([f"{_(finding.where)}: {told(finding.text)}." for finding in findings.findings])


def limits_of_proof(out: Sheets, inputs: Inputs) -> None:
    record = inputs.record
    result = record.result
    inc = np.asarray(record.content["pose_table"].get("inc_ref_deg", ()), dtype=float)
    inclinations = np.unique(np.round(inc, 2))
    notes = []
    if record.request.reference == "magnitude":
        notes.append(
            _("Without a bench the axes of the tool are those of the sensor: its mounting angle is not known.")
        )
    elif inclinations.size < 2:
        notes.append(
            _(
                "With one inclination the bench's tilt cannot be distinguished from scale and rotation of the sensor:"
                " agreement with this bench is not accuracy in the field."
            )
        )
    elif not (np.any(inc < 0) or np.any(inc > 90.5)):
        notes.append(
            _(
                "No pose was turned the other way or beyond 90 deg: bench and sensor are separated by the inclinations"
                " between alone."
            )
        )
    if solves_by_inclination(result.method):
        notes.append(
            _(
                "The balance correction absorbs every error common to the four poses of an inclination, those of the"
                " bench included: agreement at that inclination is not accuracy there."
            )
        )
    if record.request.reference == "pose":
        notes.append(
            _(
                "An error common to all settings of inclination (the zero of its scale) is found only with inclinations"
                " on both sides; an error common to all settings of toolface (the zero of the chuck) is never found."
            )
        )
    notes += [
        _("Behaviour while turning, under vibration and under shock was not measured."),
        _("Stability from power-up to power-up and over months was not measured."),
    ]
    out.heading(_("What this calibration cannot prove"))
    out.bullets(notes)
    remarks = [first_large(told(remark.text)) for remark in result.remarks]
    if remarks or inputs.fields.remarks:
        out.heading(_("Remarks"))
        out.bullets([*inputs.fields.remarks, *(f"{text}." for text in remarks)])


def poses(out: Sheets, record: CalibrationRecord, comparison: MethodComparison | None) -> None:
    table, fit = record.content["pose_table"], record.result.poses
    out.heading(_("Poses and residuals"))
    if comparison is not None:
        out.figure(_residual_figure(record), _("Residuals pose by pose; open marks were rejected."))
    own = None if comparison is None else comparison.of(record.result.method)
    errors = own.errors if own is not None else None
    rows = []
    for i, name in enumerate(fit.ids):
        inc, tf = (table[key][i] if key in table else None for key in ("inc_ref_deg", "tf_ref_deg"))
        rows.append(
            [
                name if fit.used[i] else _("%(pose)s (rejected)", pose=name),
                *("" if value is None else f"{value:.3f}" for value in (inc, tf)),
                *(f"{table[axis][i]:.6f}" for axis in ("ax", "ay", "az")),
                *(f"{round(1e6 * float(value))}" for value in fit.residual_g[:, i]),
                f"{fit.studentised[i]:.1f}" if fit.studentised[i] else "",
                "" if errors is None else signed(errors.inc_deg[i]),
                "" if errors is None else signed(errors.tf_deg[i]),
            ]
        )
    out.table(
        [_("pose"), _("%(angle)s set", angle="I"), _("%(angle)s set", angle="T"), *READ, "sigma", "dI", "dT"],
        rows,
        caption=_(
            "Settings in degrees; raw means in nominal g; residuals in µg; sigma: departure from what the other poses"
            " predict; dI, dT: indicated less set, degrees, in the frame of the bench."
        ),
        words=(0,),
    )
    if record.result.closures:
        out.table(
            [_("closure at inclination"), _("size, µg"), "chi²", "p", _("pose to doubt")],
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
    out.heading(_("Identity"))
    out.code(_("Hash of the record (SHA-256):"), record.id)
    out.code(_("Hash of the raw data (SHA-256), %(name)s:", name=raw["name"]), raw["sha256"])
    if record.signature is not None:
        out.code(
            _(
                "The record was signed (ed25519) on %(date)s by %(signer)s, key:",
                date=record.signature.time,
                signer=record.signature.signer,
            ),
            record.signature.key,
        )
    out.paragraph(
        _(
            "To verify: `%(command)s` says whether the record is unchanged and who signed it; its hash has to be the"
            " one above, which the code on the first sheet repeats. A file FILE.sig beside this certificate is its own"
            " signature, verified by the same command.",
            command="highside keys verify RECORD.json --trusted KEYS",
        )
    )
    out.paragraph(
        _(
            "Made with %(software)s. The record holds all poses; `%(command)s` solves them again and compares. This"
            " certificate is not to be reproduced except in full without the approval of the issuing laboratory.",
            software=f"{software['name']} {software['version']}",
            command="highside calibrate show RECORD --recompute",
        )
    )
    out.paragraph(_("End of certificate."))


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
    axis.set(xlabel=_("pose, in order"), ylabel=_("residual, µg"))
    axis.legend(ncols=3)
    return figure

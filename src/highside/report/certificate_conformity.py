"""As found, as left: the earlier calibration and the new one judged against limits, for the certificate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.poses import PoseSet
from highside.calibration.record import CalibrationRecord, pose_set
from highside.calibration.verification import Verification, tilt_of, verify_poses
from highside.report.certificate_inputs import Inputs
from highside.report.document import Sheets
from highside.words import _, said, told

RULE = said(
    "Decision rule: guarded acceptance, guard band w = U (k = 2). Pass where |error| + U is within the limit, fail"
    " where |error| - U is beyond it, undecided between; the probability of a wrong pass, or of a wrong fail, is 2.3 %%"
    " at most for each comparison."
)


@dataclass(frozen=True, slots=True)
class Verified:
    """A verification on the certificate: of which record, at whose poses."""

    found: Verification
    what: str
    independent: bool


def conformity(out: Sheets, inputs: Inputs) -> None:
    record, decision = inputs.record, inputs.fields.decision
    out.heading(_("As found, as left"))
    if decision is None:
        out.paragraph(
            _(
                "No limits of error were stated: no statement of conformity is made. What the poses show before and"
                " after the calibration is in the table of methods."
            )
        )
        return
    limits = {"inc": f"{decision.limit_inc_deg:g}", "tf": f"{decision.limit_tf_deg:g}", "who": decision.agreed_with}
    stated = (
        _("Limits of error: I %(inc)s deg, T %(tf)s deg, agreed with %(who)s.", **limits)
        if decision.agreed_with
        else _("Limits of error: I %(inc)s deg, T %(tf)s deg.", **limits)
    )
    out.paragraph(f"{stated} {told(RULE)}")
    found = as_found(inputs)
    if found is None:
        out.paragraph(_("As found: not assessed, no earlier calibration of the item was presented."))
    else:
        _verified(out, _("As found"), found)
    left = as_left(inputs)
    if left is None:
        short = record.id[:12]
        out.paragraph(
            _("As left: not assessed, record %(record)s has no poses with a reference attitude.", record=short)
        )
    else:
        _verified(out, _("As left"), left)


def as_found(inputs: Inputs) -> Verified | None:
    """The earlier calibration judged at poses measured for it, or at those of this calibration."""
    if inputs.previous is None:
        return None
    poses = inputs.as_found_poses
    known = {"record": inputs.previous.id[:12], "date": inputs.previous.content["created"][:10]}
    if poses is not None:
        what = said("record %(record)s of %(date)s, at %(count)s poses of a verification", count=len(poses), **known)
        return Verified(_verify(inputs, inputs.previous, poses), what, True)
    poses = _own_poses(inputs.record)
    if poses is None:
        return None
    what = said("record %(record)s of %(date)s, at the %(count)s poses of this session", count=len(poses), **known)
    return Verified(_verify(inputs, inputs.previous, poses), what, True)


def as_left(inputs: Inputs) -> Verified | None:
    """The new calibration judged at poses of a verification, or at its own."""
    poses = inputs.as_left_poses
    if poses is not None:
        what = said("this record, at %(count)s poses of a verification", count=len(poses))
        return Verified(_verify(inputs, inputs.record, poses), what, True)
    poses = _own_poses(inputs.record)
    if poses is None:
        return None
    what = said("this record, at the %(count)s poses that it was made from", count=len(poses))
    return Verified(_verify(inputs, inputs.record, poses), what, False)


def _own_poses(record: CalibrationRecord) -> PoseSet | None:
    return pose_set(record.pose_columns, record.request) if record.request.reference == "pose" else None


def _verify(inputs: Inputs, judged: CalibrationRecord, poses: PoseSet) -> Verification:
    decision, bench = inputs.fields.decision, inputs.fields.bench
    assert decision is not None
    sigma = inputs.record.request.pose_sigma_deg
    if bench is not None and bench.inc_expanded_deg is not None:
        sigma = math.hypot(sigma, bench.inc_expanded_deg / 2.0)
    return verify_poses(
        judged,
        poses,
        limit_inc_deg=decision.limit_inc_deg,
        limit_tf_deg=decision.limit_tf_deg,
        bench=BenchAccuracy(pose_rad=math.radians(sigma)),
        tilt=tilt_of(inputs.record),
        toolface_zero_std_deg=inputs.fields.use.toolface_zero_deg or 0.0,
    )


def _verified(out: Sheets, title: str, one: Verified) -> None:
    found = one.found
    out.paragraph(f"{title} ({told(one.what)}). {told(found.text)}", look="verdict")
    if not one.independent:
        out.paragraph(
            _(
                "These poses took part in the calibration: that they agree with it shows that the session is"
                " consistent, and is no independent proof of accuracy."
            )
        )
    inc = [pose.inc for pose in found.poses if pose.inc is not None]
    tf = [pose.tf for pose in found.poses if pose.tf is not None]
    rows = []
    for name, judged in (("I", inc), ("T", tf)):
        if judged:
            worst = max(judged, key=lambda j: abs(j.error) + 2.0 * j.std)
            count = [sum(j.verdict == v for j in judged) for v in ("pass", "undecided", "fail")]
            rows.append([name, f"{worst.error:+.4f}", f"{2.0 * worst.std:.4f}", f"{worst.limit:g}", *map(str, count)])
    out.table(
        ["", _("largest error, deg"), _("its U (k = 2)"), _("limit"), _("pass"), _("undecided"), _("fail")],
        rows,
        words=(0,),
    )


def verdict_lines(inputs: Inputs) -> Sequence[str]:
    """As found and as left in a line each, for the terminal."""
    if inputs.fields.decision is None:
        return ()
    pairs = ((_("As found"), as_found(inputs)), (_("As left"), as_left(inputs)))
    return tuple(f"{title}: {told(one.found.text)}" for title, one in pairs if one is not None)

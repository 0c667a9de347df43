"""The end of a session that calibrates nothing: what its poses say of an existing calibration.

A verification compares each pose with the bench, a roll test the ranges over the toolfaces with their limits
(`calibration.verification`, `calibration.roll_test`); record and limits are those of the plan's criterion. The same
journal gives the same verdict.
"""

from __future__ import annotations

import math

from highside.bench.session.ledger import Ledger
from highside.bench.session.plans import Criterion, SessionKind, SessionPlan
from highside.bench.session.snapshot import VerdictRow, VerdictState
from highside.calibration.budget import K, narrowest
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.record import CalibrationRecord
from highside.calibration.roll_test import RollTest, roll_test
from highside.calibration.verification import Verification, VerifiedQuantity, tilt_of, verify_poses
from highside.errors import InputError

Found = Verification | RollTest


def judge(ledger: Ledger, record: CalibrationRecord, criterion: Criterion) -> Found:
    """The verdict on `record` by the poses of a session. Raises InputError and Refused where none follows."""
    plan = ledger.plan
    sigma_deg = plan.limits.pose_sigma_deg
    if plan.kind is SessionKind.ROLL_TEST:
        return roll_test(
            record,
            ledger.pose_set("magnitude"),
            limit_inc_deg=criterion.limit_inc_deg,
            limit_g_total_g=criterion.limit_g_total_g or math.nan,
            inc_sigma_deg=sigma_deg,
        )
    return verify_poses(
        record,
        ledger.pose_set("pose"),
        limit_inc_deg=criterion.limit_inc_deg,
        limit_tf_deg=criterion.limit_tf_deg or math.nan,
        bench=BenchAccuracy(math.radians(criterion.tilt_sigma_deg), math.radians(sigma_deg)),
        tilt=tilt_of(record) if criterion.same_bench else None,
        toolface_zero_std_deg=criterion.toolface_zero_sigma_deg,
        free_toolface_zero=criterion.free_toolface_zero,
    )


def require_judgeable(record: CalibrationRecord, plan: SessionPlan, criterion: Criterion) -> None:
    """Raises InputError where a criterion asks of a record what it does not know, or limits that no tool could pass."""
    if criterion.same_bench and tilt_of(record) is None:
        raise InputError(
            f"the method {record.result.method} of this record takes the bench as level and knows no tilt",
            field="plan.same_bench",
            remedy="leave it out, and state plan.tilt_sigma_deg",
        )
    if criterion.limit_tf_deg is None:
        return
    width = narrowest(
        [(pose.id, *pose.reference) for pose in plan.poses],
        limit_inc_deg=criterion.limit_inc_deg,
        limit_tf_deg=criterion.limit_tf_deg,
        bench=BenchAccuracy(math.radians(criterion.tilt_sigma_deg), math.radians(plan.limits.pose_sigma_deg)),
        noise_g=plan.limits.std_error_g,
        tilt=tilt_of(record) if criterion.same_bench else None,
        toolface_zero_std_deg=criterion.toolface_zero_sigma_deg,
    )
    if width.hopeless:
        field = "plan.limit_inc_deg" if width.name == "I" else "plan.limit_tf_deg"
        raise InputError(f"no tool could pass: {width.text}", field=field)


def as_state(found: Found) -> VerdictState:
    """For the snapshot."""
    if isinstance(found, RollTest):
        rows = [
            VerdictRow(
                name="range of I",
                inc_error_deg=found.inc.error,
                inc_u_deg=K * found.inc.std,
                verdict=found.inc.verdict.value,
            ),
            VerdictRow(
                name="range of Gtotal",
                g_error_g=found.g_total.error,
                g_u_g=K * found.g_total.std,
                verdict=found.g_total.verdict.value,
            ),
        ]
        return VerdictState(
            kind="roll_test",
            record=found.record_id,
            verdict=found.verdict.value,
            text=found.text,
            consistent=None,
            limit_inc_deg=found.inc.limit,
            limit_g_total_g=found.g_total.limit,
            rows=rows,
        )
    return VerdictState(
        kind="verification",
        record=found.record_id,
        verdict=found.verdict.value,
        text=found.text,
        consistent=found.consistent,
        limit_inc_deg=found.limit_inc_deg,
        limit_tf_deg=found.limit_tf_deg,
        rows=[
            VerdictRow(
                name=pose.pose,
                inc_error_deg=_error(pose.inc),
                inc_u_deg=_expanded(pose.inc),
                tf_error_deg=_error(pose.tf),
                tf_u_deg=_expanded(pose.tf),
                verdict=pose.verdict.value,
            )
            for pose in found.poses
        ],
    )


def _error(one: VerifiedQuantity | None) -> float | None:
    return None if one is None else one.error


def _expanded(one: VerifiedQuantity | None) -> float | None:
    return None if one is None else K * one.std

"""The bench's own encoder and axis, fitted at the end of a session of full turns.

The joint solution of the turns gives the sensor (encoder harmonics are among its unknowns) and the bench's tilt; what
its attitudes differ from the settings then, turn by turn, is the turntable (`rotation.turntable`). The plans of later
sessions on that bench say where the table truly stands at each setting: `at_true_settings`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.attitude.angles import wrap_signed
from highside.attitude.block import attitude_block
from highside.bench.session.ledger import Ledger
from highside.bench.session.plans import SessionPlan
from highside.calibration.comparison import tilt_shift
from highside.calibration.method import Solution
from highside.rotation.compensation import Compensation
from highside.rotation.turntable import correct_settings, fit_turntable


def fit(ledger: Ledger, solution: Solution, source: str, source_sha256: str) -> Compensation:
    """The turntable's errors from the accepted poses. Raises InputError and Refused where none follow."""
    poses, result = ledger.pose_set(), solution.result
    inc_ref, tf_ref = poses.reference()
    inc, tf = attitude_block(result.correct(poses.a))
    shift_inc, shift_tf = tilt_shift(inc_ref, *result.tilt_rad)
    d_tf = wrap_signed(tf - tf_ref - shift_tf)
    # about the toolface zero, which belongs to tool and fixture
    zero = float(np.angle(np.exp(1j * d_tf).mean()))
    used = result.poses.used
    curve = fit_turntable(
        tf_ref[used],
        inc_ref[used],
        zero + np.asarray(wrap_signed(d_tf - zero))[used],
        (inc - inc_ref - shift_inc)[used],
    )
    return curve.compensation(source, source_sha256)


def describe(compensation: Compensation) -> str:
    """One line for the operator."""
    parts = []
    for name, curve in compensation.curves.items():
        sizes = np.hypot(curve.parameters[1::2], curve.parameters[2::2])
        parts.append(f"{name} " + (", ".join(f"{size:.2f}'" for size in sizes) or "no harmonic"))
    noise = compensation.curves["encoder"].noise
    return f"turntable {compensation.id[:12]}: harmonics of {'; '.join(parts)}; a pose about the curve {noise:.2f}'"


def at_true_settings(plan: SessionPlan, compensation: Compensation) -> SessionPlan:
    """The plan with where the bench truly stands at each of its settings."""
    inc = np.array([pose.inc_deg for pose in plan.poses])
    tf = np.array([pose.tf_deg for pose in plan.poses])
    true_inc, true_tf = correct_settings(compensation, inc, tf)
    poses = tuple(
        replace(pose, true_inc_deg=float(i), true_tf_deg=float(t))
        for pose, i, t in zip(plan.poses, true_inc, true_tf, strict=True)
    )
    return replace(plan, poses=poses)

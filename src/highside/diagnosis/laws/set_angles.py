"""Errors of the set angles that were learned as noise: whether a bench makes such, and whether they may hide a law."""

from __future__ import annotations

from highside.diagnosis.laws.noise import LawNoise
from highside.diagnosis.laws.policy import LAW_GROUPS, LAW_VERDICT


def enough_poses() -> int:
    """Poses in which errors of the set angles are distinguished from a law of them: that of the toolface has the most
    functions, a cosine and a sine of each order."""
    return LAW_VERDICT.poses_a_function * max(LAW_GROUPS.cosines, 2 * LAW_GROUPS.orders)


def usual(noise: LawNoise) -> bool:
    """Whether errors of the set angles are such as any bench makes."""
    return float(noise.jitter.max(initial=0.0)) <= LAW_VERDICT.set_angles_rad


def may_hide_a_law(noise: LawNoise, poses: int) -> bool:
    """Whether they are larger, in so few poses that something that the angles follow looks the same."""
    return not usual(noise) and poses < enough_poses()

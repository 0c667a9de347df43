"""Conventional correction: every axis in turn along gravity, the matrix by inversion or least squares.

Three poses (I = 90 T = 0, I = 90 T = 90, I = 0) make W the unit matrix and `C = W S^-1` (equation 7); the zero offset
is then not observable and stays in the matrix. Six poses (each axis up and down) and more are the same as a
least-squares problem, in which the offset is observable. The bench is taken as level and exact; what its tilt and
repeatability do to the result is in the stated covariance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.calibration.linear_errors import (
    NOMINAL_BENCH,
    BenchAccuracy,
    linear_covariance,
    linear_parameters,
    stated_variance,
)
from highside.calibration.poses import PoseSet
from highside.calibration.remark import CalibrationRefused, Reason, Remark
from highside.calibration.result import CalibrationResult, PoseFit
from highside.calibration.zone import Zone
from highside.physics.gravity import gravity_direction, gravity_jacobians

MAX_CONDITION = 1e3
"""Above this the readings do not determine the matrix: noise is multiplied by as much."""

DEFAULT_OFFSET_STD_G = 2e-3
"""Size of a zero offset that a method does not observe (one standard deviation)."""


def position_plan(count: int) -> tuple[Array, Array]:
    """Inclinations and toolfaces (rad) of the conventional plans with 3, 6, 8, 12 or 24 positions.

    3: each axis up. 6: each axis up and down. 8: the corners of the cube. 12: the middles of its edges. 24: four
    toolfaces (on the axes) at I = 90 and the 20 attitudes halfway between axis, edge and corner: the 12 edges and 8
    corners.
    """
    half = np.pi / 2
    faces = [(half, 0.0), (half, half), (0.0, 0.0), (half, 2 * half), (half, 3 * half), (np.pi, 0.0)]
    corner = float(np.arccos(1.0 / np.sqrt(3.0)))
    corners = [(inc, np.pi / 4 + k * half) for inc in (corner, np.pi - corner) for k in range(4)]
    edges = [(inc, k * half) for inc in (np.pi / 4, 3 * np.pi / 4) for k in range(4)]
    edges += [(half, np.pi / 4 + k * half) for k in range(4)]
    level = [face for face in faces if face[0] == half]
    plans = {3: faces[:3], 6: faces, 8: corners, 12: edges, 24: level + edges + corners}
    if count not in plans:
        raise ValueError(f"{count} positions; known plans have {', '.join(map(str, plans))}")
    plan = np.array(plans[count])
    return plan[:, 0], plan[:, 1]


def conventional(
    poses: PoseSet,
    *,
    offset_g: Array | None = None,
    offset_std_g: float = DEFAULT_OFFSET_STD_G,
    bench: BenchAccuracy = NOMINAL_BENCH,
    method: str = "conventional",
) -> CalibrationResult:
    """Solve for A, and for b where the poses allow it, by ordinary least squares (exact for three poses).

    `offset_g` (3,): a known zero offset, subtracted first (0 if None) and used only where the poses do not show it;
    `offset_std_g` is the standard deviation of what is then unknown of it. Raises CalibrationRefused where the poses
    do not determine the matrix.
    """
    inc, tf = poses.reference()
    W = gravity_direction(inc, tf)
    count = len(poses)
    if count < 3:
        raise CalibrationRefused(
            Reason.TOO_FEW_POSES, f"{count} poses cannot give the nine elements of a matrix; measure at least three"
        )
    remarks: list[Remark] = []
    estimate = _estimate(poses, W, offset_g)
    A, b, design = estimate.A, estimate.b, estimate.design
    offset_estimated = estimate.offset_weights is not None
    if not offset_estimated:
        remarks.append(
            Remark(
                Reason.OFFSET_NOT_OBSERVABLE,
                "these poses do not show the zero offset; it is taken as "
                + ("zero" if offset_g is None else "given")
                + f" within {offset_std_g * 1e3:g} mg: add poses with each axis down (six positions)",
            )
        )
    if not poses.std_known:
        remarks.append(Remark(Reason.NOISE_ASSUMED, "the pose table states no noise; 50 ug a reading is assumed"))
    residual = poses.a - A @ W - b[:, None]
    covariance = linear_covariance(estimate.weights, A, poses, bench, offset_std_g, estimate.offset_weights)
    zone = Zone("global", None, 0.0, float(np.pi), linear_parameters(A, b, covariance), estimate.condition)
    redundant = count > len(design)
    away = _studentised(residual, design, A, poses, bench) if redundant else np.zeros(count)
    return CalibrationResult(
        method=method,
        options={"positions": float(count), "offset": "estimated" if offset_estimated else "assumed"},
        frame="bench",
        zones=(zone,),
        poses=PoseFit(poses.ids, residual, away, np.ones(count, bool)),
        variance=stated_variance(poses, bench),
        remarks=tuple(remarks),
    )


class _Estimate(NamedTuple):
    """Matrix and offset with what made them: `weights` (N, 3), those of the offset where it is estimated, the rows of
    the design (3 or 4, N) and their condition number."""

    A: Array
    b: Array
    weights: Array
    offset_weights: Array | None
    design: Array
    condition: float


def _estimate(poses: PoseSet, W: Array, offset_g: Array | None) -> _Estimate:
    """A and b where the poses determine both, else A with the offset as given. Raises CalibrationRefused."""
    count = len(poses)
    full = np.vstack([W, np.ones(count)])
    condition = _condition(full) if count >= 4 else np.inf
    if condition <= MAX_CONDITION:
        pinv: Array = np.asarray(np.linalg.pinv(full), dtype=np.float64)
        both = poses.a @ pinv
        return _Estimate(both[:, :3], both[:, 3], pinv[:, :3], pinv[:, 3], full, float(condition))
    condition = _condition(W)
    if condition > MAX_CONDITION:
        raise CalibrationRefused(
            Reason.SINGULAR,
            f"the {count} poses do not span three directions (condition {condition:.3g}); "
            "add poses that bring each axis along gravity",
        )
    b = np.zeros(3) if offset_g is None else np.asarray(offset_g, dtype=float)
    pinv = np.asarray(np.linalg.pinv(W), dtype=np.float64)
    return _Estimate((poses.a - b[:, None]) @ pinv, b, pinv, None, W, float(condition))


def least_squares(poses: PoseSet, *, bench: BenchAccuracy = NOMINAL_BENCH) -> CalibrationResult:
    """Plain twelve-parameter least squares over any poses: no weights, no bench.

    Raises CalibrationRefused where matrix and offset cannot be separated.
    """
    result = conventional(poses, bench=bench, method="least-squares")
    if result.options["offset"] != "estimated":
        raise CalibrationRefused(
            Reason.UNOBSERVABLE,
            "matrix and offset cannot be separated from these poses; add poses at a second, very different inclination",
        )
    return result


def _condition(rows: Array) -> float:
    s = np.linalg.svd(rows, compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > 0 else np.inf


def _studentised(residual: Array, rows: Array, A: Array, poses: PoseSet, bench: BenchAccuracy) -> Array:
    """Residual of each pose over its standard deviation, the pose itself omitted (largest of the three axes)."""
    inc, tf = poses.reference()
    by_inc, by_tf = (A @ d for d in gravity_jacobians(inc, tf))
    variance = poses.noise_of_mean() ** 2 + bench.pose_rad**2 * (by_inc**2 + by_tf**2)
    hat = np.clip(np.einsum("kn,nk->n", rows, np.linalg.pinv(rows)), 0.0, 1.0 - 1e-9)
    return np.asarray(np.max(np.abs(residual) / np.sqrt(variance * (1.0 - hat)), axis=0))

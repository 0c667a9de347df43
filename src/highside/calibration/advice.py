"""Which pose to measure next, and how good a plan can be at best.

A plan's information matrix is that of the joint estimator: sensor and bench tilt as unknowns, reading noise and pose
errors as weights, inclination and station errors as random columns. Its inverse is the Cramer-Rao bound of the
parameters, and
`J F^-1 J'` that of a later I or T; with the reading's own noise it is the total that no method can beat.

The next best pose is the one that lowers the mean variance of I and of the cross-axis error over the inclinations of
use the most (I-optimality), or that raises the determinant of the information the most (D-optimality). Candidates are
a grid of inclinations from -120 to 150 deg: inclinations turned the other way (-I) and beyond horizontal separate bench
from sensor far better than more poses of the same kind, because there the bench's tilt changes sign against the
sensor's errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from highside.arrays import Array
from highside.attitude.scalar import UNIFORM_ANGLE_STD_RAD
from highside.calibration.forward import BASE_NAMES, Variances, linearise, pose_parts, prior_mean, prior_std, whiten
from highside.calibration.linear_errors import NOMINAL_BENCH, BenchAccuracy
from highside.calibration.poses import PoseSet, group_settings
from highside.calibration.result import angle_std
from highside.calibration.sensor import sensor_columns, sensor_of
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState

DEFAULT_MEAN_NOISE_G = 50e-6 / np.sqrt(2.0 * 10.0)
"""Noise of a pose averaged for 10 s at 50 ug/sqrt(Hz)."""

CANDIDATE_INC_RAD = np.deg2rad(
    np.array([-120.0, -90.0, -60.0, -45.0, -20.0, -5.0, 5.0, 20.0, 45.0, 60.0, 90.0, 120.0, 150.0])
)
CANDIDATE_TF_RAD = np.deg2rad(np.arange(0.0, 360.0, 45.0))
USE_INC_RAD = np.deg2rad(np.array([1.0, 5.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0]))


@dataclass(frozen=True, slots=True)
class NextPose:
    """A pose to measure: the bench's settings, and the rms standard deviation (rad) over the inclinations of use that
    the calibration alone would have with it, and has without it."""

    inc_rad: float
    tf_rad: float
    std_before_rad: float
    std_after_rad: float


def split_equally(bench: BenchAccuracy) -> Variances:
    """The stated pose error halved between a pose's own part and that common to its inclination or station."""
    half = 0.5 * bench.pose_rad**2
    return Variances(half, half, half, half)


def plan_information(
    inc_rad: Array,
    tf_rad: Array,
    *,
    names: tuple[str, ...] = BASE_NAMES,
    theta: Array | None = None,
    noise_g: Array | float = DEFAULT_MEAN_NOISE_G,
    variances: Variances | None = None,
    bench: BenchAccuracy = NOMINAL_BENCH,
    with_prior: bool = True,
) -> Array:
    """Fisher information (P, P) of a plan of poses (N,). `noise_g`: of a pose's mean, one number or (3, N)."""
    v = split_equally(bench) if variances is None else variances
    at = prior_mean(names) if theta is None else theta
    _, design, by_inc, by_tf = linearise(names, at, ChainState.build(inc_rad, tf_rad))
    noise = np.array(np.broadcast_to(np.asarray(noise_g, dtype=float), (3, inc_rad.size)))
    stacked = np.concatenate([design, by_inc[:, :, None], by_tf[:, :, None]], axis=2).transpose(1, 0, 2)
    white, _ = whiten(stacked, pose_parts(noise, by_inc, by_tf), v)
    size = len(names)
    X = white[:, :, :size].reshape(-1, size)
    F = X.T @ X
    random, penalty = [], []
    for column, groups, variance in (
        (white[:, :, size], group_settings(inc_rad), v.station_inc),
        (white[:, :, size + 1], group_settings(tf_rad, modulo=2 * np.pi), v.station_tf),
    ):
        if variance > 0:
            member = np.asarray(groups[:, None] == np.arange(int(groups.max()) + 1), dtype=float)
            random.append((column[:, :, None] * member[:, None, :]).reshape(X.shape[0], -1))
            penalty.append(np.full(member.shape[1], 1.0 / variance))
    if random:
        Z = np.concatenate(random, axis=1)
        middle = Z.T @ Z + np.diag(np.concatenate(penalty))
        XZ = X.T @ Z
        F = F - XZ @ np.linalg.solve(middle, XZ.T)
    if with_prior:
        F = F + np.diag(1.0 / prior_std(names, bench) ** 2)
    return np.asarray(0.5 * (F + F.T))


def bound_of_angles(
    covariance: Array,
    names: tuple[str, ...],
    inc_rad: Array,
    tf_rad: Array,
    *,
    noise_g: float = 0.0,
    theta: Array | None = None,
) -> tuple[Array, Array]:
    """Standard deviations (N,) of I and T (rad) that parameters with `covariance` (P, P) and a reading noise leave:
    `sqrt(noise^2 + J F^-1 J')`."""

    at = prior_mean(names) if theta is None else theta
    C = sensor_of(names, at).C
    g = gravity_direction(inc_rad, tf_rad)
    J = (C @ sensor_columns(names, g)).transpose(2, 1, 0)
    cov = J @ covariance @ J.transpose(0, 2, 1) + noise_g**2 * (C @ C.T)
    return angle_std(inc_rad, tf_rad, cov)


def next_best_poses(
    poses: PoseSet | tuple[Array, Array],
    *,
    bench: BenchAccuracy = NOMINAL_BENCH,
    noise_g: float = DEFAULT_MEAN_NOISE_G,
    count: int = 4,
    criterion: Literal["I", "D"] = "I",
    inc_candidates_rad: Array = CANDIDATE_INC_RAD,
    tf_candidates_rad: Array = CANDIDATE_TF_RAD,
    use_inc_rad: Array = USE_INC_RAD,
) -> list[NextPose]:
    """The `count` poses to add to those measured, greedily, best first.

    The bench's travel is given by the candidates (no negative inclinations for a table that cannot turn the other
    way)."""
    inc, tf = poses.reference() if isinstance(poses, PoseSet) else poses
    grid_inc, grid_tf = (x.ravel() for x in np.meshgrid(inc_candidates_rad, tf_candidates_rad, indexing="ij"))
    out: list[NextPose] = []
    variances = split_equally(bench)

    def score(F: Array) -> tuple[float, float]:
        rms = _rms_of_use(np.asarray(np.linalg.inv(F), dtype=np.float64), use_inc_rad)
        return (rms, rms) if criterion == "I" else (-float(np.linalg.slogdet(F)[1]), rms)

    before = score(plan_information(inc, tf, noise_g=noise_g, variances=variances, bench=bench))[1]
    for _ in range(count):
        trials = []
        for i, t in zip(grid_inc, grid_tf, strict=True):
            F = plan_information(np.append(inc, i), np.append(tf, t), noise_g=noise_g, variances=variances, bench=bench)
            trials.append(score(F))
        best = min(range(len(trials)), key=lambda k: trials[k][0])
        after = trials[best][1]
        out.append(NextPose(float(grid_inc[best]), float(grid_tf[best]), before, after))
        inc, tf, before = np.append(inc, grid_inc[best]), np.append(tf, grid_tf[best]), after
    return out


def _rms_of_use(covariance: Array, use_inc_rad: Array) -> float:
    """Rms (rad) of the errors of I and of the cross-axis error `dT sin I` over the inclinations of use, all around."""
    inc, tf = (x.ravel() for x in np.meshgrid(use_inc_rad, np.deg2rad(np.arange(0.0, 360.0, 45.0)), indexing="ij"))
    std_inc, std_tf = bound_of_angles(covariance, BASE_NAMES, inc, tf)
    across = np.where(std_tf < UNIFORM_ANGLE_STD_RAD, std_tf * np.sin(inc), np.sin(inc))
    return float(np.sqrt(np.mean(std_inc**2 + across**2)))

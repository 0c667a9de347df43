"""Errors of an estimator that is linear in the pose means, propagated to the parameters.

Reading noise, the bench's pose repeatability and its tilt (`BenchAccuracy`) become one covariance of (A, b) and of what
the estimator takes for zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.calibration.poses import PoseSet
from highside.calibration.sensor import (
    MATRIX_NAMES,
    OFFSET_NAMES,
)
from highside.calibration.zone import SHARED_NAMES, Parameters
from highside.physics import effects as library
from highside.physics.forward import ForwardModel
from highside.physics.gravity import gravity_jacobians
from highside.physics.state import ChainState


@dataclass(frozen=True, slots=True)
class BenchAccuracy:
    """What is known beforehand about a bench (one standard deviation each).

    `tilt_rad`: of each of the two tilts; `pose_rad`: of one setting of inclination or toolface (a step of 0.018 deg,
    rounded, gives 0.0052 deg).
    """

    tilt_rad: float = float(np.deg2rad(0.05))
    pose_rad: float = float(np.deg2rad(0.0052))


NOMINAL_BENCH = BenchAccuracy()


def linear_covariance(
    weights: Array,
    A: Array,
    poses: PoseSet,
    bench: BenchAccuracy,
    offset_std_g: float,
    offset_weights: Array | None = None,
) -> Array:
    """Covariance of the errors of (A row by row, b) and of what is taken for zero, for an estimator that is linear in
    the pose means: (14, 14) with the bench's tilt, (17, 17) with the unknown part of the offset too (`SHARED_NAMES`).

    `A_hat = S weights` with `weights` (N, 3); where the offset is estimated too, `b_hat = S offset_weights` (N,), else
    it is taken as known with standard deviation `offset_std_g` in each axis, the same offset that stands in every
    column of S. Errors of S: reading noise, pose repeatability, the bench's tilt (common to all poses).
    """
    inc, tf = poses.reference()
    by_inc, by_tf = (A @ d for d in gravity_jacobians(inc, tf))
    tilt = library.get("base_tilt")
    level = ForwardModel(((tilt, tilt.vector()),)).linearise(ChainState.build(inc, tf))
    # lever of an error at each pose on the 12 parameters, for one axis: (N, 4)
    lever = np.column_stack([weights, np.zeros(len(poses)) if offset_weights is None else offset_weights])
    mean_var = poses.noise_of_mean() ** 2
    per_pose = np.einsum("in,jn->nij", by_inc, by_inc) + np.einsum("in,jn->nij", by_tf, by_tf)
    per_pose = per_pose * bench.pose_rad**2
    per_pose[:, range(3), range(3)] += mean_var.T
    # cov[(i,k),(j,l)] = sum_n Sigma_n[i,j] lever[n,k] lever[n,l]
    cov = np.einsum("nij,nk,nl->ikjl", per_pose, lever, lever)
    by_tilt = np.stack([np.einsum("in,nk->ik", direction, lever) for direction in A @ level.columns])
    cov += np.einsum("tik,tjl->ikjl", by_tilt, by_tilt) * bench.tilt_rad**2
    by_shared, sizes = by_tilt, [bench.tilt_rad] * 2
    if offset_weights is None and offset_std_g > 0:
        taken_up = lever.sum(axis=0)  # what the matrix absorbs of the offset
        taken_up[3] = -1.0  # and what the model then lacks
        by_offset = np.eye(3)[:, :, None] * taken_up  # of each axis, on its own channel
        cov += np.einsum("tik,tjl->ikjl", by_offset, by_offset) * offset_std_g**2
        by_shared, sizes = np.concatenate([by_tilt, by_offset]), sizes + [offset_std_g] * 3
    flat = cov.reshape(12, 12)
    order = [4 * i + k for i in range(3) for k in range(3)] + [4 * i + 3 for i in range(3)]
    variances = np.square(sizes)
    out = np.zeros((12 + len(sizes), 12 + len(sizes)))
    out[:12, :12] = flat[np.ix_(order, order)]
    out[12:, 12:] = np.diag(variances)
    out[12:, :12] = by_shared.reshape(len(sizes), 12)[:, order] * variances[:, None]
    out[:12, 12:] = out[12:, :12].T
    return out


def linear_parameters(A: Array, b: Array, covariance: Array) -> Parameters:
    """Parameters of an affine sensor from A (3, 3), b (3,) and their covariance (12, 12), or that of
    `linear_covariance`, with what was taken for zero."""
    unknown = SHARED_NAMES[: len(covariance) - 12]
    values = np.concatenate([A.ravel(), b, np.zeros(len(unknown))])
    return Parameters(MATRIX_NAMES + OFFSET_NAMES + unknown, values, covariance)


def stated_variance(poses: PoseSet, bench: BenchAccuracy) -> dict[str, float]:
    """Standard deviations of the error components of a method that estimates none: as measured and as stated."""
    return {
        "reading_g": float(np.sqrt(np.mean(poses.noise_of_one() ** 2))),
        "pose_inc_rad": bench.pose_rad,
        "pose_tf_rad": bench.pose_rad,
    }

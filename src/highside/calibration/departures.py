"""How far each pose departs from what the others predict: the joint estimator's check alone, for a session under way.

The affine sensor with the bench's tilt, the variances as stated; no evidence, no variance components, no advice. The
numbers are those of `joint(..., nonlinear="none", encoder="none", estimate_variances=False)`, in a few milliseconds
whatever the poses do not determine.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.calibration.forward import BASE_NAMES
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.mixed_model import PoseRegression, initial_variances, rough_start, solve
from highside.calibration.pose_rejection import poses_reconsidered, reject_outlying
from highside.calibration.poses import PoseSet


def departures(poses: PoseSet, bench: BenchAccuracy) -> Array:
    """Standard deviations (N,) of each pose from what the others predict. Raises numpy's LinAlgError where the poses
    determine nothing."""
    session = PoseRegression.of(poses, bench, 0.0, None)
    start = initial_variances(session, bench)
    used = np.ones(len(poses), dtype=bool)
    fit = solve(session, BASE_NAMES, start, used, rough_start(session, BASE_NAMES))
    used, fit = reject_outlying(session, fit, start, used)
    return poses_reconsidered(session, fit, start, used)[2]

"""Outlying poses of a joint calibration: each is tested against what the others predict, and rejected one at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.forward import (
    Variances,
    linearise,
    pose_covariance,
)
from highside.calibration.mixed_model import (
    MixedModelFit,
    PoseRegression,
    solve,
    studentised,
)
from highside.calibration.poses import Indices

BAD_POSE_SIGMA = 5.0
MAX_BAD_SHARE = 0.1


def reject_outlying(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, used: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], MixedModelFit]:
    """Reject, one at a time, the pose that departs most, while it departs by more than five standard deviations.

    Where the whole session scatters more than was stated the measure is the session's own: the median departure. If
    more than a tenth of the poses would have to go it is not the poses but the model, and none goes: the variances
    will say how badly it fits."""
    count = len(session.poses)
    limit = max(2, int(MAX_BAD_SHARE * count))
    keep, trial = used.copy(), fit
    while True:
        away = studentised(trial, keep)
        worst = int(np.argmax(away))
        typical = np.sort(away[keep])[int(keep.sum()) // 2]
        scale = max(1.0, float(typical) / _MEDIAN_DEPARTURE)
        if away[worst] <= BAD_POSE_SIGMA * scale:
            return keep, trial
        keep[worst] = False
        if count - int(keep.sum()) > limit:
            return used, fit
        trial = solve(session, trial.names, variances, keep, trial.theta)
        trial = solve(session, trial.names, variances, keep, trial.theta)


_MEDIAN_DEPARTURE = 1.538
"""Root of the median of chi-square with three degrees of freedom."""


def poses_reconsidered(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, used: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], MixedModelFit, Array]:
    """Which poses are used (N,), the solution by these, and each pose's `departure` (N,), all three of the final
    variances: a pose rejected under others may agree now, one that was used may not."""
    away = departure(session, fit, variances, used)
    again = used | (away <= BAD_POSE_SIGMA)
    if not np.array_equal(again, used) or away[used].max() > BAD_POSE_SIGMA:
        fit = solve(session, fit.names, variances, again, fit.theta)
        used, fit = reject_outlying(session, fit, variances, again)
        away = departure(session, fit, variances, used)
    return used, fit, away


def departure(session: PoseRegression, fit: MixedModelFit, variances: Variances, used: NDArray[np.bool_]) -> Array:
    """Departure of every pose (N,) from what the others predict, in standard deviations: `studentised` for poses used;
    for those rejected the distance of their reading from its prediction, all variances counted."""
    out = studentised(fit, used)
    for i in np.flatnonzero(~used):
        columns, own = _raw_columns(session, fit, variances, int(i), int(i))
        random = columns[:, fit.theta.size :]
        misfit = fit.left_over[:, i] - random @ fit.effects
        covariance = own + columns @ fit.inverse @ columns.T
        out[i] = np.sqrt(misfit @ np.linalg.solve(covariance, misfit))
    return out


def _raw_columns(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, i: int, noise_of: int
) -> tuple[Array, Array]:
    """Columns (3, P + R + S) of pose `i` and its own covariance (3, 3), with the reading noise of pose `noise_of`."""
    one = slice(i, i + 1)
    u, leg = (None, None) if session.thermal is None else (session.thermal.u[one], session.thermal.leg[one])
    design, by_inc, by_tf = linearise(fit.names, fit.theta, session.state.rows(one), u, leg)[1:]
    columns = np.concatenate(
        [design[:, 0], by_inc * session.inclination_indicator[i], by_tf * session.toolface_indicator[i]], axis=1
    )
    return columns, pose_covariance(session.noise[:, [noise_of]], by_inc, by_tf, variances)[0]


def swapped_pairs(
    session: PoseRegression, fit: MixedModelFit, variances: Variances, bad: Indices
) -> list[tuple[int, int]]:
    """Pairs among the rejected poses whose readings fit each other's setting."""
    if bad.size < 2:
        return []
    predicted = session.poses.a - fit.left_over

    def fits(reading: int, setting: int) -> bool:
        columns, own = _raw_columns(session, fit, variances, setting, reading)
        misfit = session.poses.a[:, reading] - predicted[:, setting] - columns[:, fit.theta.size :] @ fit.effects
        return bool(misfit @ np.linalg.solve(own + columns @ fit.inverse @ columns.T, misfit) < BAD_POSE_SIGMA**2)

    return [(int(i), int(j)) for k, i in enumerate(bad) for j in bad[k + 1 :] if fits(i, j) and fits(j, i)]

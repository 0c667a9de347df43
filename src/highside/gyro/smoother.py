"""Fixed-interval smoothing (Rauch, Tung and Striebel 1965) of the error-state filter: what a whole recording knows.

From the end backwards, with P_k after and P-_k+1 before the update, and F the transition of the errors,

    G = P_k F^T (P-_k+1)^-1;   dx_k = G dx_k+1;   P^s_k = P_k + G (P^s_k+1 - P-_k+1) G^T

where dx_k+1 is the smoothed state less the *predicted* one, its attitude part the rotation between the two. A drift in
azimuth between two events that show it (a stop, a turn) is given out over the time between them. At the end of the
recording smoothed and causal are the same: a smoother does not make the last azimuth better.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import (
    conjugate,
    direction_cosines,
    from_rotation_vector,
    multiply,
    normalised,
    to_rotation_vector,
    up_direction,
)
from highside.gyro import error_state, filter_state, time_update
from highside.units import STANDARD_GRAVITY_MPS2

_RANK = 1e-13
"""eigenvalues of the correlation matrix below this are none: a direction that the filter holds for certain"""


def smoothed(blocks: Array, trace: error_state.Trace, *, carried: bool = False) -> tuple[error_state.Trace, Array]:
    """The trace with all that later blocks tell: blocks (M, 34), a trace with its covariances.

    `carried`: its last three states are a velocity.

    Also leap (M, 3): the rotation vector by which the smoothed end of a block differs from what its smoothed start
    predicts, to be given out over its rows.
    """
    count = blocks.shape[0]
    q, bias, scale, accel = trace.q.copy(), trace.bias.copy(), trace.scale.copy(), trace.accel.copy()
    after, before = trace.P, trace.P_before
    P = after.copy()
    leap = np.zeros((count, 3))
    for k in range(count - 2, -1, -1):
        F = _transition(blocks[k + 1], trace, k, carried=carried)
        G = after[k] @ F.T @ _inverse(before[k + 1])
        # the smoothed state one block on, less the one predicted from here
        dx = np.concatenate(
            [
                to_rotation_vector(multiply(conjugate(trace.q_before[k + 1]), q[k + 1])),
                bias[k + 1] - trace.bias[k],
                [scale[k + 1] - trace.scale[k]],
                accel[k + 1] - trace.accel_before[k + 1],
            ]
        )
        dx = G @ dx
        q[k] = normalised(multiply(q[k], from_rotation_vector(dx[:3])))
        bias[k] += dx[3:6]
        scale[k] += dx[6]
        accel[k] += dx[7:]
        own = after[k] + G @ (P[k + 1] - before[k + 1]) @ G.T
        P[k] = 0.5 * (own + own.T)
        # first order: the start's correction carried to the end, against the end as smoothed
        start = np.concatenate([dx[:3], bias[k] - trace.bias[k], [scale[k] - trace.scale[k]], np.zeros(3)])
        reached = multiply(trace.q_before[k + 1], from_rotation_vector((F @ start)[:3]))
        leap[k + 1] = to_rotation_vector(multiply(conjugate(reached), q[k + 1]))
    rows = np.array([filter_state.azimuth_row((a, b, c, d)) for a, b, c, d in q.tolist()])
    done = trace._replace(
        q=q,
        bias=bias,
        scale=scale,
        accel=accel,
        P=P,
        bias_var=np.ascontiguousarray(np.maximum(np.diagonal(P, axis1=1, axis2=2)[:, 3:6], 0.0)),
        azimuth_var=np.maximum(np.einsum("ki,kij,kj->k", rows, P[:, :3, :3], rows), 0.0),
    )
    return done, leap


def _transition(block: Array, trace: error_state.Trace, k: int, *, carried: bool) -> Array:
    """F over a block that begins with the state k."""
    still, gap = trace.motion[k + 1] == filter_state.STILL, block[31] > 0.0
    if still:
        F = np.eye(filter_state.STATES)
    else:
        turn = filter_state.turn_of_errors(trace.bias[k], trace.scale[k], block)
        F = time_update.transition(direction_cosines(multiply(block[:4], from_rotation_vector(turn))), block)
    if carried and (still or gap):
        # `time_update.zero_velocity_update`: no velocity comes out of an earlier one
        F[7:, 7:] = 0.0
    elif carried:
        push = STANDARD_GRAVITY_MPS2 * block[19]
        time_update.add_velocity(F, push, up_direction(trace.q_before[k + 1]))
    return F


def _inverse(P: Array) -> Array:
    """Of a covariance whose states differ by orders of magnitude and may be known for certain."""
    size = np.sqrt(np.diag(P))
    scale = np.where(size > 0.0, 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    values, vectors = np.linalg.eigh(P * scale[:, None] * scale)
    kept = values > _RANK * values[-1]
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return np.asarray(inverse * scale[:, None] * scale)

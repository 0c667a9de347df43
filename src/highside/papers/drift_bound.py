"""How well gyros and gravity can know the azimuth at best: the Cramer-Rao bound of an experiment.

The readings of `drift_scenarios` are linear in what is unknown as long as errors are small, and their noise is normal:
the bound is then the covariance recursion along the *true* motion, with the true noise levels (van Trees 1968, in its
posterior form: what is known beforehand counts). No estimator that knows only the past does better on average over
many runs; single runs, and a handful of them, may. Written apart from the filter, in the same blocks of a second:

    d' = R d - J b - S s + N sqrt(t),   b' = b + K sqrt(t),   s, a constant
    gravity     p x d + (I - p p') a  with the scatter of a block's mean reading
    at rest     C w_ie x d + b        with N / sqrt(t); the attitude then does not move, and the tool is known to stand

d attitude error (body frame, inertial rate in R), b gyro biases, s scale error along the tool axis, a accelerometer
biases. Of a reading its direction counts: that its length is 1 g to the last digit holds in a simulation only, and
would lower the bound by up to 6 % on a tilted table. `studies/drift_limit.py` finds the same bound another way.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.attitude.quaternion import (
    conjugate,
    direction_cosines,
    from_angles,
    from_rotation_vector,
    multiply,
    to_rotation_vector,
)
from highside.papers.drift_scenarios import DEG_PER_HOUR, DriftExperiment
from highside.physics.gravity import EARTH_RATE_RADPS

_WIDE_RAD = 0.05
"""tilt before any reading"""
_VERTICAL_COS = 0.05


def azimuth_bound(
    experiment: DriftExperiment,
    *,
    azimuth_std_rad: float = 1e-6,
    bias_std_dph: float = 20.0,
    scale_std: float = 1e-3,
    rest: Array | None = None,
    block_s: float = 1.0,
) -> Array:
    """Least standard deviation of the azimuth (M,), rad, at the end of each block of `block_s`.

    `rest` (K, 2): intervals (s) in which the tool is known to stand (None: never). Near the vertical, where azimuth
    means nothing, that of the rotation about Up. A block must turn by less than half a turn.
    """
    e, triad = experiment, experiment.triad
    rate_hz = 1.0 / float(np.median(np.diff(e.t_s)))
    n = max(round(block_s * rate_hz), 1)
    at = np.arange(0, e.t_s.size, n)
    dt = n / rate_hz
    q = from_angles(e.theta[at], e.phi[at], e.psi[at])
    earth = EARTH_RATE_RADPS * np.array([0.0, np.cos(e.latitude_rad), np.sin(e.latitude_rad)])
    turns = to_rotation_vector(
        multiply(conjugate(q[:, :-1]), multiply(from_rotation_vector(earth * dt)[:, None], q[:, 1:]))
    )
    shaken = e.vibrating[np.maximum(at - n // 2, 0)]
    arw = np.hypot(
        triad.arw_deg_sqrt_h * np.pi / 180 / 60, np.radians(triad.gyro_vibration_dps) * shaken / rate_hz**0.5
    )
    reading = np.hypot(triad.accel_noise_g, triad.vibration_rms_g * shaken) / n**0.5
    rrw = triad.rrw_dph_sqrt_h * DEG_PER_HOUR / 60.0
    still = np.zeros(at.size, dtype=bool)
    for begin, end in np.zeros((0, 2)) if rest is None else rest:
        still[1:] |= (e.t_s[at[:-1]] >= begin - 1e-6) & (e.t_s[at[1:]] <= end + 1e-6)

    P = _prior(e, azimuth_std_rad, bias_std_dph, scale_std)
    bound = np.empty(at.size)
    bound[0] = azimuth_std_rad
    for k in range(1, at.size):
        C = direction_cosines(q[:, k])
        if not still[k]:
            F = _transition(turns[:, k - 1], dt)
            P = F @ P @ F.T
            P[:3, :3] += arw[k] ** 2 * dt * np.eye(3)
        P[3:6, 3:6] += rrw**2 * dt * np.eye(3)
        p = C[:, 2]
        H = np.zeros((3, 10))
        H[:, :3] = _cross(p)
        H[:, 7:] = np.eye(3) - np.outer(p, p)
        P = _measured(P, H, reading[k] ** 2)
        if still[k]:
            H = np.zeros((3, 10))
            H[:, :3] = _cross(C @ earth)
            H[:, 3:6] = np.eye(3)
            P = _measured(P, H, arw[k] ** 2 / dt)
        row = _azimuth_row(C)
        bound[k] = np.sqrt(row @ P[:3, :3] @ row)
    return bound


def _prior(e: DriftExperiment, azimuth_std_rad: float, bias_std_dph: float, scale_std: float) -> Array:
    """Covariance (10, 10) of what is known before the first reading."""
    P = np.zeros((10, 10))
    # elevation, toolface and azimuth as rotations of the body: the azimuth is known, not the rotation about Up
    theta, phi = float(e.theta[0]), float(e.phi[0])
    axes = np.array(
        [
            [np.cos(phi), 0.0, np.sin(phi) * np.cos(theta)],
            [0.0, 1.0, -np.sin(theta)],
            [np.sin(phi), 0.0, -np.cos(phi) * np.cos(theta)],
        ]
    ) * np.array([_WIDE_RAD, _WIDE_RAD / max(np.cos(theta), _VERTICAL_COS), azimuth_std_rad])
    P[:3, :3] = axes @ axes.T
    P[3:6, 3:6] = (bias_std_dph * DEG_PER_HOUR) ** 2 * np.eye(3)
    P[6, 6] = scale_std**2
    P[7:, 7:] = e.triad.accel_bias_g**2 * np.eye(3)
    return P


def _transition(turn: Array, dt: float) -> Array:
    """F for a constant rate that turns by `turn` (3,) in dt: Rodrigues."""
    angle = float(np.sqrt(turn @ turn))
    A = _cross(turn)
    if angle > 1e-9:
        c1, c2, c3 = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    else:
        c1, c2, c3 = 1.0, 0.5, 1.0 / 6.0
    J = dt * (np.eye(3) - c2 * A + c3 * A @ A)
    F = np.eye(10)
    F[:3, :3] = np.eye(3) - c1 * A + c2 * A @ A
    F[:3, 3:6] = -J
    F[:3, 6] = -J[:, 1] * turn[1] / dt
    return F


def _measured(P: Array, H: Array, variance: float) -> Array:
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + variance * np.eye(3))
    A = np.eye(10) - K @ H
    return A @ P @ A.T + variance * K @ K.T


def _azimuth_row(C: Array) -> Array:
    square = C[0, 2] ** 2 + C[2, 2] ** 2
    return -C[:, 2] if square < _VERTICAL_COS**2 else np.array([-C[0, 2], 0.0, -C[2, 2]]) / square


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])

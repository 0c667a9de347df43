"""The forward model of a calibration session, linearised: what the joint estimator and the advice on poses share.

A session's unknowns are the sensor (A, b and, where admitted, K2, K3, KX) and the bench (tilt, harmonics of the
toolface encoder). A pose's own errors dI and dT are weights, not unknowns: `Variances` says how large they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.calibration.poses import Array, gravity, gravity_derivatives
from highside.calibration.result import (
    CROSS_NAMES,
    CUBIC_NAMES,
    MATRIX_NAMES,
    OFFSET_NAMES,
    QUADRATIC_NAMES,
    TILT_NAMES,
    BenchAccuracy,
    SensorModel,
    design_row,
)

ENCODER_NAMES = ("enc_c1", "enc_s1", "enc_c2", "enc_s2")
"""Harmonics of the toolface encoder: `dT = c1 cos T + s1 sin T + c2 cos 2T + s2 sin 2T` (rad)."""

BASE_NAMES = MATRIX_NAMES + OFFSET_NAMES + TILT_NAMES
"""What every joint solution estimates."""

GROUPS: dict[str, tuple[str, ...]] = {
    "quadratic": QUADRATIC_NAMES,
    "cubic": CUBIC_NAMES,
    "cross": CROSS_NAMES,
    "encoder": ENCODER_NAMES,
}
"""What may be added, a group at a time."""

HYSTERESIS_NAMES = ("hyst_x", "hyst_y", "hyst_z")
"""Offset on the way up in temperature less that on the way down (g)."""

PRIOR_MATRIX = 0.05
PRIOR_OFFSET_G = 0.05
PRIOR_NONLINEAR_G = 1e-3
PRIOR_THERMAL_MATRIX = 0.01
"""Change of an element of A for each power of reduced temperature (-1 to 1 over the range visited)."""
PRIOR_THERMAL_OFFSET_G = 0.01
PRIOR_HYSTERESIS_G = 1e-3
PRIOR_ENCODER_RAD = float(np.deg2rad(0.01))


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components: of pose errors in rad^2, `reading` as a factor on the stated variance of the readings."""

    pose_inc: float
    pose_tf: float
    ring_inc: float
    station_tf: float
    reading: float = 1.0

    def as_array(self) -> Array:
        return np.array([self.pose_inc, self.pose_tf, self.ring_inc, self.station_tf, self.reading])


def prior_mean(names: tuple[str, ...]) -> Array:
    """Prior means (P,): the nominal sensor on a level bench."""
    return np.array([1.0 if name in ("A_xx", "A_yy", "A_zz") else 0.0 for name in names])


def prior_std(names: tuple[str, ...], bench: BenchAccuracy) -> Array:
    """Prior standard deviations (P,), wide against what a session tells."""
    widths = {
        "A": PRIOR_MATRIX,
        "b": PRIOR_OFFSET_G,
        "tilt": bench.tilt_rad,
        "enc": PRIOR_ENCODER_RAD,
        "hyst": PRIOR_HYSTERESIS_G,
    }
    thermal = {"A": PRIOR_THERMAL_MATRIX, "b": PRIOR_THERMAL_OFFSET_G}
    return np.array(
        [(thermal if "@" in name else widths).get(name.partition("_")[0], PRIOR_NONLINEAR_G) for name in names]
    )


def sensor_of(names: tuple[str, ...], theta: Array) -> SensorModel:
    """The sensor within a vector of parameters."""
    value = dict(zip(names, theta.tolist(), strict=True))

    def block(keys: tuple[str, ...]) -> Array:
        return np.array([value.get(key, 0.0) for key in keys])

    return SensorModel(
        block(MATRIX_NAMES).reshape(3, 3),
        block(OFFSET_NAMES),
        block(QUADRATIC_NAMES),
        block(CUBIC_NAMES),
        block(CROSS_NAMES).reshape(3, 3),
    )


def encoder_harmonics(tf_rad: Array) -> Array:
    """The four harmonics (4, N) that `ENCODER_NAMES` multiply."""
    return np.stack([np.cos(tf_rad), np.sin(tf_rad), np.cos(2 * tf_rad), np.sin(2 * tf_rad)])


def linearise(
    names: tuple[str, ...],
    theta: Array,
    inc: Array,
    tf: Array,
    u: Array | None = None,
    leg: Array | None = None,
) -> tuple[Array, Array, Array, Array]:
    """The forward model at `theta` for poses (N,): readings (3, N), their derivatives by the parameters (3, N, P), by
    inclination (3, N) and by toolface (3, N).

    `u` (N,): reduced temperature, `leg` (N,): +1 on the way up in temperature, -1 on the way down; needed only where
    `names` ask for them."""
    value = dict(zip(names, theta.tolist(), strict=True))
    sensor = sensor_of(names, theta)
    tx, ty = value.get("tilt_x", 0.0), value.get("tilt_y", 0.0)
    harmonics = encoder_harmonics(tf)
    turned = tf + np.array([value.get(name, 0.0) for name in ENCODER_NAMES]) @ harmonics
    w = gravity(inc, turned, tx, ty)
    by_inc, by_tf, by_ty = (sensor.A @ d for d in gravity_derivatives(inc, turned, tx, ty))
    design = np.zeros((3, inc.size, len(names)))
    affine = MATRIX_NAMES + OFFSET_NAMES
    if names[:12] == affine:
        for i in range(3):
            design[i, :, 3 * i : 3 * i + 3] = w.T
            design[i, :, 9 + i] = 1.0
        rest = range(12, len(names))
    else:
        rest = range(len(names))
    for j in rest:
        name = names[j]
        if name == "tilt_x":
            design[:, :, j] = by_inc
        elif name == "tilt_y":
            design[:, :, j] = by_ty
        elif name in ENCODER_NAMES:
            design[:, :, j] = by_tf * harmonics[ENCODER_NAMES.index(name)]
        elif name in HYSTERESIS_NAMES:
            design[HYSTERESIS_NAMES.index(name), :, j] = 0.0 if leg is None else 0.5 * leg
        else:
            design[:, :, j] = design_row(name, w, 0.0 if u is None else u)
    reading = sensor.forward(w)
    extra = [j for j, name in enumerate(names) if "@" in name or name in HYSTERESIS_NAMES]
    if extra:
        reading = reading + design[:, :, extra] @ theta[extra]
    return reading, design, by_inc, by_tf


def pose_covariance(noise: Array, by_inc: Array, by_tf: Array, variances: Variances) -> Array:
    """Covariance (N, 3, 3) of the pose means by reading noise and the pose parts of dI and dT."""
    inc = by_inc.T
    tf = by_tf.T
    out = variances.pose_inc * inc[:, :, None] * inc[:, None, :] + variances.pose_tf * tf[:, :, None] * tf[:, None, :]
    out[:, (0, 1, 2), (0, 1, 2)] += variances.reading * (noise**2).T
    return out


def whiten(columns: Array, noise: Array, by_inc: Array, by_tf: Array, variances: Variances) -> tuple[Array, float]:
    """`L^-1 columns` (N, 3, K), with `L L'` the covariance of each pose, and the sum of the logarithms of its
    determinants.
    """
    lower = np.linalg.cholesky(pose_covariance(noise, by_inc, by_tf, variances))
    diagonal = lower[:, (0, 1, 2), (0, 1, 2)]
    d, e, f = lower[:, 1, 0], lower[:, 2, 0], lower[:, 2, 1]
    out = np.empty_like(columns)
    out[:, 0] = columns[:, 0] / diagonal[:, 0, None]
    out[:, 1] = (columns[:, 1] - d[:, None] * out[:, 0]) / diagonal[:, 1, None]
    out[:, 2] = (columns[:, 2] - e[:, None] * out[:, 0] - f[:, None] * out[:, 1]) / diagonal[:, 2, None]
    return out, 2.0 * float(np.log(diagonal).sum())

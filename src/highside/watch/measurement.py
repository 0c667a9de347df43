"""The two kinds of evidence of a hole, made linear in the deviations: `y = H x + e`, the errors e of unit variance.

Attitudes are not known. Of a still, only the length of the mean says anything. Of a turn, the nine harmonics depend on
inclination and phase, which are projected out of the whitened equations; what they are is taken from the harmonics
themselves, an error of 1 mrad in them costs 1 ug.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.units import STANDARD_GRAVITY_MPS2
from highside.watch.parameters import ARM, GRAVITY, GROWTH, KT, KV, SIZE, TILT, B, S
from highside.watch.policy import StatedNoise

__all__ = ["Linear", "Still", "Surroundings", "Turning", "linear_still", "linear_turning"]

HARMONICS = 3
"""columns of a turn that gravity makes: constant, cosine and sine of the gyro's phase"""
_LEAST_SINE = 1e-3
"""of the inclination, in the derivative by the phase: below it the phase is nobody's"""


@dataclass(frozen=True, slots=True)
class Still:
    """A mean at rest. `mean_g` (3,): corrected; `std_g`: of its length, by the rows' own scatter; `scatter_g` (2, 3):
    of single rows and of means of two seconds, by axis (`axis_noise.scatters`), where there are rows."""

    t_s: float
    mean_g: Array
    std_g: float
    temp_c: float | None = None
    depth_km: float | None = None
    scatter_g: Array | None = None


@dataclass(frozen=True, slots=True)
class Turning:
    """Harmonics of a window in which the tool turns.

    `harmonics_g` (3, 3): by axis the factors of 1, cos and sin of the gyro's phase, corrected, g; `covariance`
    (9, 9), g^2, row by row, by the rows' own scatter. `rate2`: mean square of the rate, (rad/s)^2. `arm_m`: where the
    sensor sits by the accelerations of this window, (2,) m with `arm_covariance` (2, 2), or None where the rate did not
    change. `vibration_g`: rms, where it is known.
    """

    t_s: float
    harmonics_g: Array
    covariance: Array
    rate2: float
    arm_m: Array | None = None
    arm_covariance: Array | None = None
    temp_c: float | None = None
    depth_km: float | None = None
    vibration_g: float = 0.0


class Surroundings(NamedTuple):
    """What is not the tool's: degrees from where the coefficients are zero; what gravity has grown with (hours since
    the start, or km of depth), and how much of that is expected."""

    warmer_c: float
    deeper: float
    gravity: float


class Linear(NamedTuple):
    """`y = H x + e`: y (M,), H (M, N), e of unit variance, of which `share` (M, M) is the sensor's noise; `f_g` (3,)
    the specific force, and whether it is at rest."""

    y: Array
    H: Array
    f_g: Array
    at_rest: bool
    share: Array


def linear_still(
    still: Still, around: Surroundings, noise: StatedNoise, level: float = 1.0, times: Array | None = None
) -> Linear:
    """`|mean| - 1 = f'b + f'S f + ...`, to a second order of 0.5 ug where b is 1 mg. `level`: of the sensor's noise, in
    units of what the measurement and the tool's class state. `times` (3,): how much noisier each axis is than before by
    the rest's own readings, where that is known: its floor is as much higher."""
    length = float(np.linalg.norm(still.mean_g))
    f = still.mean_g / length
    row = np.zeros(SIZE)
    row[B : B + 3] = f
    row[S : S + 9] = np.outer(f, f).ravel()
    row[KT : KT + 3] = f * around.warmer_c
    row[GRAVITY], row[GROWTH] = 1.0, around.deeper
    floor = level if times is None else max(level, float(np.linalg.norm(f * times)))
    std = np.hypot(level * still.std_g, floor * noise.still_floor_g)
    return Linear(np.array([length - 1.0 - around.gravity]) / std, row[None, :] / std, f, True, np.eye(1))


def linear_turning(turn: Turning, around: Surroundings, noise: StatedNoise, level: float = 1.0) -> Linear:
    """Seven combinations of the nine harmonics that neither inclination nor phase moves, and the sensor's place.
    `level`: as of `linear_still`; whirl is none of the sensor's noise."""
    M = turn.harmonics_g
    across = np.array([M[0, 1] + M[1, 2], M[1, 1] - M[0, 2]]) / 2.0
    size = float(np.hypot(*across))
    cp, sp = across / size if size > 0.0 else np.array([1.0, 0.0])
    inclination = np.arctan2(size, M[2, 0])
    s, c = float(np.sin(inclination)), float(np.cos(inclination))
    F = np.array([[0.0, s * cp, -s * sp], [0.0, s * sp, s * cp], [c, 0.0, 0.0]])
    by_inclination = np.array([[0.0, c * cp, -c * sp], [0.0, c * sp, c * cp], [-s, 0.0, 0.0]])
    by_phase = np.array([[0.0, -sp, -cp], [0.0, cp, -sp], [0.0, 0.0, 0.0]]) * max(s, _LEAST_SINE)
    H = _design(F, around, turn)
    r = (M - F * (1.0 + around.gravity)).ravel()
    own = level**2 * (turn.covariance + noise.window_floor_g**2 * np.eye(9))
    R = own.copy()
    whirl = (noise.whirl_m * turn.rate2 / STANDARD_GRAVITY_MPS2) ** 2
    R[0, 0] += whirl
    R[3, 3] += whirl
    root = np.linalg.cholesky(R)
    r, H, G = (
        np.linalg.solve(root, part) for part in (r, H, np.stack([by_inclination.ravel(), by_phase.ravel()], axis=1))
    )
    beyond = np.linalg.qr(G, mode="complete")[0][:, G.shape[1] :]
    y, H = beyond.T @ r, beyond.T @ H
    half = np.linalg.solve(root, own)
    share = beyond.T @ np.linalg.solve(root, half.T) @ beyond
    if turn.arm_m is not None and turn.arm_covariance is not None:
        root = np.linalg.cholesky(turn.arm_covariance)
        place = np.zeros((2, SIZE))
        place[:, ARM : ARM + 2] = np.eye(2)
        y = np.concatenate([y, np.linalg.solve(root, turn.arm_m)])
        H = np.concatenate([H, np.linalg.solve(root, place)])
        share = np.pad(share, (0, 2))
    return Linear(y, H, np.array([s * cp, s * sp, c]), False, share)


def _design(F: Array, around: Surroundings, turn: Turning) -> Array:
    """(9, N): derivative of the harmonics, row by row, by the state."""
    D = np.zeros((3, HARMONICS, SIZE))
    for i in range(3):
        D[i, 0, B + i] = 1.0
        D[i, 0, KT + i] = around.warmer_c
        D[i, 0, KV + i] = turn.vibration_g**2
        for j in range(3):
            D[i, :, S + 3 * i + j] = F[j]
    # an axis of rotation that leans in the tool: a small rotation of what is felt
    D[1, :, TILT], D[2, :, TILT] = -F[2], F[1]
    D[0, :, TILT + 1], D[2, :, TILT + 1] = F[2], -F[0]
    for axis in range(2):
        D[axis, 0, ARM + axis] = -turn.rate2 / STANDARD_GRAVITY_MPS2
    D[:, :, GRAVITY], D[:, :, GROWTH] = F, F * around.deeper
    return D.reshape(9, SIZE)

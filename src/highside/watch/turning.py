"""From the rows of a window of rotation to its harmonics: one joint fit for each axis on the phase of the gyro.

Gravity turns in the tool frame by minus the tool's own turn, `T = T0 - integral of rate`. The regressors are 1, cos and
sin of that phase, the rate squared less its mean, and the angular acceleration: the last two are what a sensor off the
axis feels, and without them they would be read as bias. The gyro's scale, bias and delay bend the phase; the
accelerometers say how, turn by turn, and a line in phase, time and rate is taken off. A phase made of the raw
accelerometers would carry their bias, second moments would carry their noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.units import STANDARD_GRAVITY_MPS2
from highside.watch.measurement import Turning

__all__ = ["TURNING", "Left", "TurningRows", "fit_turning"]


@dataclass(frozen=True)
class TurningPolicy:
    """Of what counts as rotation, and of the fit."""

    rate_dps: float = 6.0
    """1 rpm: slower is no rotation"""
    window_s: float = 300.0
    """of one window at most: inclination changes by less than 0.1 deg while drilling"""
    shortest_s: float = 30.0
    fewest_turns: float = 3.0
    rows_a_turn: float = 8.0
    """below which a harmonic is not resolved"""
    piece_s: float = 2.0
    """over whole turns of at least so long the phase is compared with the accelerometers"""
    largest_phase_rad: float = 0.3
    """rms by which gyro and accelerometers may disagree after the line"""
    least_across_g: float = 5e-3
    """amplitude of gravity across the axis below which the phase cannot be compared, and hardly matters"""
    arm_m: float = 0.01
    changes_g: float = 2e-6
    """what the change of rate must make of an arm of `arm_m` for it to be fitted: below, it is lost in the floor"""


TURNING = TurningPolicy()


@dataclass(frozen=True, slots=True)
class TurningRows:
    """Rows of a window: time (K,) s, corrected readings (3, K) g, rate about z (K,) rad/s, and what was recorded
    beside them."""

    t_s: Array
    c: Array
    rate_radps: Array
    temp_c: float | None = None
    depth_km: float | None = None
    vibration_g: float = 0.0
    span_s: Array | None = None
    """(K,) of readings that are means themselves: over how long, as `mean_span` has it; None: they are not"""


def mean_span(first_s: float, last_s: float, n: int) -> float:
    """Length, s, of the continuous mean that dampens a rotation as much as a mean of `n` readings from `first_s` to
    `last_s` does: `dt sqrt(n^2 - 1)`, to fourth order in the angle between two of them."""
    return (last_s - first_s) * float(np.sqrt((n + 1) / (n - 1))) if n > 1 else 0.0


@dataclass(frozen=True, slots=True)
class Left:
    """A window that is not used, and why."""

    reason: str


def fit_turning(rows: TurningRows) -> Turning | Left:
    """The harmonics of a window, or why there are none."""
    t = rows.t_s - rows.t_s[0]
    steps = np.diff(t)
    phase = -np.concatenate([[0.0], np.cumsum(0.5 * (rows.rate_radps[1:] + rows.rate_radps[:-1]) * steps)])
    turns = float(np.abs(phase[-1])) / (2.0 * np.pi)
    if turns < TURNING.fewest_turns:
        return Left("fewer than three turns")
    if t.size / turns < TURNING.rows_a_turn:
        return Left("too few rows a turn")
    correction = _phase_correction(t, phase, rows)
    if correction is None:
        return Left("gyro and accelerometers disagree about the turn")
    phase = phase + correction
    rate2, acceleration = rows.rate_radps**2, np.gradient(rows.rate_radps, t)
    # a mean over a part of the turn is shorter than what it is of: 0.6 mg/g for 10 ms at 120 rpm
    left = 1.0 if rows.span_s is None else np.sinc(rows.rate_radps * rows.span_s / (2.0 * np.pi))
    X = np.column_stack([np.ones_like(t), left * np.cos(phase), left * np.sin(phase)])
    beside = np.column_stack([rate2 - rate2.mean(), acceleration - acceleration.mean()])
    M, covariance, arms = np.empty((3, 3)), np.zeros((9, 9)), []
    for axis in range(3):
        full = np.column_stack([X, beside]) if axis < 2 else X
        used = _used(full)
        found, cov = _fit(full[:, used], rows.c[axis], t)
        M[axis] = found[:3]
        covariance[3 * axis : 3 * axis + 3, 3 * axis : 3 * axis + 3] = cov[:3, :3]
        arms.append({int(k): (found[i], cov[i, i]) for i, k in enumerate(used) if k >= 3})
    arm, arm_covariance = _arm(arms)
    return Turning(
        float(rows.t_s.mean()),
        M,
        covariance,
        float(rate2.mean()),
        arm,
        arm_covariance,
        rows.temp_c,
        rows.depth_km,
        rows.vibration_g,
    )


def _phase_correction(t: Array, phase: Array, rows: TurningRows) -> Array | None:
    """(K,) rad to add to the gyro's phase; None where it has nothing to do with the accelerometers'."""
    turned = np.abs(phase) / (2.0 * np.pi)
    each = max(1.0, np.ceil(TURNING.piece_s * turned[-1] / t[-1]))
    piece = np.floor(turned / each).astype(int)
    whole = piece < piece[-1] if piece[-1] >= 3 else np.ones_like(piece, dtype=bool)
    count = np.bincount(piece[whole])
    across = (rows.c[0] + 1j * rows.c[1]) * np.exp(-1j * phase)

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(piece[whole], weights=values[whole]) / np.maximum(count, 1))

    sums = mean(across.real) + 1j * mean(across.imag)
    kept = count > 0
    sums = sums[kept]
    if float(np.median(np.abs(sums))) < TURNING.least_across_g:
        return np.zeros_like(t)
    angle = np.unwrap(np.angle(sums))
    regressors = [np.ones_like(t), phase, t, rows.rate_radps]
    at = np.column_stack([mean(one)[kept] for one in regressors])
    scale = np.maximum(np.abs(at).max(axis=0), 1e-12)
    found = np.linalg.lstsq(at / scale, angle, rcond=1e-6)[0] / scale
    left = angle - at @ found
    if float(np.sqrt(np.mean(left**2))) > TURNING.largest_phase_rad:
        return None
    return np.asarray(np.stack(regressors[1:], axis=1) @ found[1:])


def _used(X: Array) -> list[int]:
    """The harmonics, and of what a changing rate makes the columns that change enough to say something."""
    spread = X.std(axis=0)
    return [
        k for k in range(X.shape[1]) if k < 3 or spread[k] * TURNING.arm_m > TURNING.changes_g * STANDARD_GRAVITY_MPS2
    ]


def _fit(X: Array, y: Array, t: Array) -> tuple[Array, Array]:
    """Least squares with the covariance that residuals of any colour over a second or so leave."""
    scale = np.sqrt(np.mean(X**2, axis=0))
    inverse = np.linalg.pinv((X / scale).T @ (X / scale)) / np.outer(scale, scale)
    found = inverse @ (X.T @ y)
    left = y - X @ found
    variance = float(left @ left) / max(1, y.size - X.shape[1])
    batch = np.floor(t).astype(int)
    count = np.bincount(batch)
    sums = np.bincount(batch, weights=left)
    coloured = float(np.sum(sums**2)) / float(np.sum(count)) / variance if variance > 0.0 else 1.0
    return np.asarray(found), np.asarray(inverse * variance * max(1.0, coloured))


def _arm(found: list[dict[int, tuple[float, float]]]) -> tuple[Array | None, Array | None]:
    """Where the sensor sits, (2,) m, by the squared rate on its own axis and the angular acceleration on the other."""
    g = STANDARD_GRAVITY_MPS2
    ways = [
        [(-one[0] * g, one[1] * g**2) for one in (found[0].get(3),) if one]
        + [(one[0] * g, one[1] * g**2) for one in (found[1].get(4),) if one],
        [(-one[0] * g, one[1] * g**2) for one in (found[1].get(3),) if one]
        + [(-one[0] * g, one[1] * g**2) for one in (found[0].get(4),) if one],
    ]
    if not all(ways):
        return None, None
    values, variances = [], []
    for way in ways:
        weight = sum(1.0 / (variance + 1e-12) for _, variance in way)
        values.append(sum(value / (variance + 1e-12) for value, variance in way) / weight)
        # a rate that is a little wrong bends the arm too: never better than a tenth of a millimetre
        variances.append(1.0 / weight + 1e-8)
    return np.array(values), np.diag(variances)

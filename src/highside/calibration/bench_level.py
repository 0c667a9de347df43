"""How a bench leans, as the poses of a comparison show it.

A tilt (tx in the plane of inclination, ty across it) adds `s tx` to the indicated I and `s ty / sin I` to T, to first
order (`leaning`), where s is +1, or -1 where the table is turned the other way. Two things set it apart from what is
wrong with the tool:

- *Reversed poses.* (I, T) and (-I, T + 180 deg) are one attitude to the tool, whatever its errors are, but the tilt
  counts once with either sign: half the difference is the tilt. Nothing is assumed of the tool.
- *Pattern.* Offsets, scales and axes of a triad that have changed (twelve numbers, all free) cannot make the pattern of
  a tilt at all of many attitudes. What they leave free of it shows a lean, provided that they describe the errors at
  all: where the errors do not fit (chi-square), or too few comparisons are left over to see that, this is not used. But
  a tool that is wrong alike everywhere makes the same pattern: from one side an observed lean is never proof of the
  bench's, so it is taken off for no verdict but "undecided". All that a bench may lean by what was stated counts in U.

Errors of one setting of the bench and of reading noise are independent from pose to pose; a scatter larger than stated
widens the standard deviations by its size (Birge's ratio).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.comparison import attitudes_set
from highside.physics.gravity import attitude_of, bench_gravity, gravity_direction, gravity_jacobians

Mask = NDArray[np.bool_]

SAME_ATTITUDE_RAD = math.radians(0.5)
"""Two settings nearer than this are one attitude: an error of the tool changes over it by 1 % of itself."""
VERTICAL_RAD = math.radians(0.05)
"""Nearer to the vertical than this there is no toolface to compare."""
FIT_P = 1e-3
"""Errors that a change of offsets, scales and axes makes with a smaller probability are of another kind."""
FIT_SPARE = 20
"""So many comparisons beyond what is fitted see errors of another kind of the size that matters: with the 62 that 44
poses leave, a third harmonic of 0.1 deg is detected in all of 300 simulated sessions."""
ROUNDS = 3
"""Of the fit by the pattern: its second step is below 1e-6 deg for tilts of a degree at 5 deg of inclination."""
TILT_STEP_RAD = 1e-6
CONTRADICTS_SIGMAS = 4.0
"""What is said of a bench beforehand is wrong where the poses say otherwise by more than this."""
UNPROVEN_SIGMAS = 3.0
"""A lean observed from one side that is larger than this, by what was stated, is shown and nothing is decided: of
benches as level as stated one in 200 is beyond it (two tilts), and a good tool there must not fail."""


class LevelSource(StrEnum):
    """Where the level of a bench is known from."""

    STATED = "stated"
    """so far level that its tilts are zero within what is stated (`tilt_sigma_deg`)"""
    RECORD = "record"
    """as the joint calibration found it that the record holds (`same_bench`)"""
    REVERSED = "reversed"
    """from poses set with the table turned the other way"""
    PATTERN = "pattern"
    """observed in the pattern over many attitudes, and beyond what was stated: the bench's, or the tool's"""

    @property
    def text(self) -> str:
        return {
            LevelSource.STATED: "as stated",
            LevelSource.RECORD: "as the record found it",
            LevelSource.REVERSED: "by poses with the table turned the other way",
            LevelSource.PATTERN: "by the pattern over all poses",
        }[self]


@dataclass(frozen=True, slots=True)
class BenchLevel:
    """The tilts of a bench (in the plane of inclination, across it) with their standard deviations; rad."""

    x_rad: float
    y_rad: float
    x_std_rad: float
    y_std_rad: float
    source: LevelSource = LevelSource.RECORD

    @classmethod
    def stated(cls, tilt_rad: float) -> BenchLevel:
        return cls(0.0, 0.0, tilt_rad, tilt_rad, LevelSource.STATED)

    @property
    def worst_std_rad(self) -> float:
        return max(self.x_std_rad, self.y_std_rad)

    @property
    def unproven(self) -> bool:
        """Whether this is a lean that was not expected and could as well be an error of the tool."""
        return self.source is LevelSource.PATTERN

    def contradicts(self, other: BenchLevel, sigmas: float = CONTRADICTS_SIGMAS) -> bool:
        """Whether two answers differ by more than they allow for."""
        return any(
            abs(mine - theirs) > sigmas * math.hypot(std, others)
            for mine, theirs, std, others in (
                (self.x_rad, other.x_rad, self.x_std_rad, other.x_std_rad),
                (self.y_rad, other.y_rad, self.y_std_rad, other.y_std_rad),
            )
        )


@dataclass(frozen=True, slots=True)
class ReferenceComparison:
    """N poses: the bench's settings, the standard deviations of the comparison but for its tilts, and the errors found
    (None before anything is measured: then the answers have standard deviations alone). All (N,) in rad; an error that
    is not a number was not found."""

    inc_set: Array
    tf_set: Array
    inc_std: Array
    tf_std: Array
    inc_error: Array | None = None
    tf_error: Array | None = None

    def usable(self) -> tuple[Mask, Mask]:
        """Which errors of I and which of T count."""
        found = np.ones(self.inc_set.size, dtype=bool) if self.inc_error is None else np.isfinite(self.inc_error)
        return found, found & (np.abs(np.sin(self.inc_set)) > math.sin(VERTICAL_RAD))


def best_level(poses: ReferenceComparison, stated_level: BenchLevel) -> BenchLevel:
    """The stated level of the bench, or that measured by reversed poses where it is more certain or contradicts the
    stated one; else a lean observed from one side that is more than was stated (`unproven`).

    A bench may lean more than was stated, or have been moved since its record was made.
    """
    measured = from_reversed(poses)
    if measured is not None and (
        measured.worst_std_rad < stated_level.worst_std_rad or measured.contradicts(stated_level)
    ):
        return measured
    fitted = from_pattern(poses)
    return fitted if fitted is not None and fitted.contradicts(stated_level, UNPROVEN_SIGMAS) else stated_level


def from_reversed(poses: ReferenceComparison) -> BenchLevel | None:
    """By reversed poses; None where there are none."""
    inc_ok, tf_ok = poses.usable()
    sine = np.abs(np.sin(poses.inc_set))
    x = _half_differences(poses, inc_ok, poses.inc_error, poses.inc_std, np.ones_like(sine))
    y = _half_differences(poses, tf_ok, poses.tf_error, poses.tf_std, sine)
    if x is None or y is None:
        return None
    return BenchLevel(x[0], y[0], x[1], y[1], LevelSource.REVERSED)


def _half_differences(
    poses: ReferenceComparison, use: Mask, error: Array | None, std: Array, size: Array
) -> tuple[float, float] | None:
    """Weighted mean of half the differences over the attitudes set on both sides, times `size`, and its standard
    deviation."""
    values, variances = [], []
    for ahead, reversed_ in _attitudes_on_both_sides(poses, use):
        both = np.concatenate([ahead, reversed_])
        scale = float(np.mean(size[both]))
        parts = [np.mean(std[side] ** 2) / side.size for side in (ahead, reversed_)]
        variances.append(scale**2 * sum(parts) / 4.0)
        # about the first of them: two toolfaces may be half a turn off
        first = 0.0 if error is None else float(error[both[0]])
        measured = [
            0.0 if error is None else float(np.mean(_turned(error[side] - first))) for side in (ahead, reversed_)
        ]
        values.append(scale * (measured[0] - measured[1]) / 2.0)
    if not values:
        return None
    weights = 1.0 / np.array(variances)
    mean = float(np.sum(weights * values) / np.sum(weights))
    spread = float(np.sum(weights * (np.array(values) - mean) ** 2)) / max(len(values) - 1, 1)
    return mean, math.sqrt(max(1.0, spread) / float(np.sum(weights)))


def _turned(angle: Array) -> Array:
    return np.asarray(np.mod(angle + np.pi, 2.0 * np.pi) - np.pi)


def _attitudes_on_both_sides(poses: ReferenceComparison, use: Mask) -> list[tuple[Array, Array]]:
    """Indices of the poses of one attitude, by the side of the table, where there are some on both."""
    directions = gravity_direction(*attitudes_set(poses.inc_set, poses.tf_set))
    groups: list[list[int]] = []
    for k in np.flatnonzero(use):
        near = (g for g in groups if np.linalg.norm(directions[:, k] - directions[:, g[0]]) < SAME_ATTITUDE_RAD)
        group = next(near, None)
        if group is None:
            groups.append([int(k)])
        else:
            group.append(int(k))
    sides = [
        (np.array([k for k in g if poses.inc_set[k] >= 0]), np.array([k for k in g if poses.inc_set[k] < 0]))
        for g in groups
    ]
    return [(ahead.astype(int), back.astype(int)) for ahead, back in sides if ahead.size and back.size]


def from_pattern(poses: ReferenceComparison) -> BenchLevel | None:
    """By the pattern over all poses, whatever offsets, scales and axes of the tool have become; None where that is not
    to be estimated (see the module)."""
    inc_ok, tf_ok = poses.usable()
    std = np.concatenate([poses.inc_std[inc_ok], poses.tf_std[tf_ok]])
    spare = std.size - 12 - 2
    if spare < FIT_SPARE:
        return None
    x = np.zeros(2)
    for _ in range(ROUNDS):
        tilt, tool = (
            np.vstack([rows[ok] for rows, ok in zip(both, (inc_ok, tf_ok), strict=True)]) / std[:, None]
            for both in (_tilt_rows(poses, x), _tool_rows(poses, x))
        )
        spanned = _basis(tool)
        free = tilt - spanned @ (spanned.T @ tilt)
        normal = free.T @ free
        if np.linalg.cond(normal) > 1e8:
            return None
        cov = np.linalg.inv(normal)
        x_std, y_std = np.sqrt(np.diag(cov)).tolist()
        if poses.inc_error is None or poses.tf_error is None:
            return BenchLevel(0.0, 0.0, x_std, y_std, LevelSource.PATTERN)
        shift_inc, shift_tf = leaning(poses.inc_set, poses.tf_set, *x)
        tf_error = poses.tf_error[tf_ok] - shift_tf[tf_ok]
        # about their middle: a tool clamped half a turn off has errors near +-180 deg
        tf_error = _turned(tf_error - math.atan2(np.sin(tf_error).sum(), np.cos(tf_error).sum()))
        y = np.concatenate([poses.inc_error[inc_ok] - shift_inc[inc_ok], tf_error]) / std
        step = cov @ (free.T @ y)
        x = x + step
    left = y - spanned @ (spanned.T @ y) - free @ step
    chi2 = float(left @ left)
    from scipy.stats import chi2 as law

    if law.sf(chi2, spare) < FIT_P:
        return None
    wider = math.sqrt(max(1.0, chi2 / spare))
    return BenchLevel(float(x[0]), float(x[1]), wider * x_std, wider * y_std, LevelSource.PATTERN)


def leaning(inc_set: Array, tf_set: Array, tilt_x_rad: float, tilt_y_rad: float) -> tuple[Array, Array]:
    """What a tilt adds to I and T (rad) at settings (N,): exact, for near the vertical 1 / sin I is too rough. No
    toolface is shifted at the vertical, where there is none."""
    inc, tf = attitude_of(bench_gravity(inc_set, tf_set, tilt_x_rad, tilt_y_rad))
    level_inc, level_tf = attitudes_set(inc_set, tf_set)
    upright = np.abs(np.sin(inc_set)) <= math.sin(VERTICAL_RAD)
    return inc - level_inc, np.where(upright, 0.0, _turned(tf - level_tf))


def _tilt_rows(poses: ReferenceComparison, tilt: Array) -> tuple[Array, Array]:
    """What (tx, ty) do to I and to T at each pose of a bench that leans by `tilt`: two (N, 2)."""
    steps = [np.array([TILT_STEP_RAD, 0.0]), np.array([0.0, TILT_STEP_RAD])]
    ways = [[leaning(poses.inc_set, poses.tf_set, *(tilt + sign * step)) for sign in (1.0, -1.0)] for step in steps]
    inc, tf = ([_turned(up[k] - down[k]) / (2.0 * TILT_STEP_RAD) for up, down in ways] for k in (0, 1))
    return np.column_stack(inc), np.column_stack(tf)


def _tool_rows(poses: ReferenceComparison, tilt: Array) -> tuple[Array, Array]:
    """What a change of each element of [A | b] does to I and to T at each pose: two (N, 12)."""
    g = bench_gravity(poses.inc_set, poses.tf_set, *tilt)
    inc, tf = attitude_of(g)
    along, across = gravity_jacobians(inc, tf)
    sine2 = np.maximum(np.sin(inc), math.sin(VERTICAL_RAD)) ** 2
    direction = np.vstack([g, np.ones(inc.size)])
    rows = [np.einsum("in,jn->nij", side, direction).reshape(inc.size, 12) for side in (along, across / sine2)]
    return rows[0], rows[1]


def _basis(matrix: Array) -> Array:
    """An orthonormal basis (N, rank) of what the columns of a matrix span."""
    u, s, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])

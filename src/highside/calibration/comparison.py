"""All methods on one pose table, side by side: what each leaves at the poses, and what it states beyond them.

The errors at the poses are those of readings that took part in the solution, against the bench: they show whether a
method describes the session, not how accurate it is (a method that has absorbed an error of the bench agrees with it
best). The stated uncertainty is that against gravity. A method that refuses says why in `refused`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import difference, wrap_positive
from highside.attitude.block import attitude_block
from highside.calibration.method import NO_FALLBACK, Solution, SolveRequest
from highside.calibration.methods import all_methods
from highside.calibration.poses import PoseSet
from highside.calibration.record import PoseColumns, pose_set, solve_poses
from highside.calibration.result import CalibrationResult
from highside.calibration.zone import Zone
from highside.errors import HighsideError
from highside.physics.gravity import gravity_direction

TOOLFACES_RAD = np.deg2rad(np.arange(0.0, 360.0, 15.0))
INCLINATIONS_DEG = (0.6, 1.2, 3.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 135.0, 150.0, 175.0)
"""Where uncertainty is stated."""
VERTICAL_DEG = 0.05
"""Nearer to the vertical a toolface is not compared."""


@dataclass(frozen=True, slots=True)
class Errors:
    """What is indicated at N poses less what the bench says: I and T in degrees, not a number where nothing is."""

    inc_deg: Array
    tf_deg: Array

    @property
    def rms(self) -> tuple[float | None, float | None]:
        return _rms(self.inc_deg), _rms(self.tf_deg)

    @property
    def largest(self) -> tuple[float | None, float | None]:
        return _largest(self.inc_deg), _largest(self.tf_deg)


@dataclass(frozen=True, slots=True)
class CalibrationUncertainty:
    """Standard deviations of I and T (deg) by the calibration alone at K inclinations: the largest over toolface. Not a
    number where the calibration does not hold."""

    inc_deg: Array
    inc_std_deg: Array
    tf_std_deg: Array


@dataclass(frozen=True, slots=True)
class MethodOutcome:
    """One method: its solution with what follows from it, or the reason why there is none."""

    method: str
    solution: Solution | None
    refused: str
    errors: Errors | None
    uncertainty: CalibrationUncertainty | None


@dataclass(frozen=True, slots=True)
class MethodComparison:
    """Before any calibration, and after each."""

    poses: PoseSet
    before: Errors
    outcomes: tuple[MethodOutcome, ...]

    def of(self, method: str) -> MethodOutcome | None:
        return next((outcome for outcome in self.outcomes if outcome.method == method), None)


def compare(
    columns: PoseColumns,
    request: SolveRequest,
    *,
    solved: Solution | None = None,
    inclinations_deg: Sequence[float] = INCLINATIONS_DEG,
) -> MethodComparison:
    """Solve a pose table by all methods. `solved`: the solution of `request`, if it is known already.

    Raises InputError for a pose table that is none, or has no reference attitudes.
    """
    poses = pose_set(columns, request)
    inc_ref, tf_ref = attitudes_set(*poses.reference())
    outcomes = []
    for method in all_methods():
        own = method == request.method
        own_request = request if own else replace(request, method=method, fallback=NO_FALLBACK)
        try:
            solution = solved if own and solved is not None else solve_poses(columns, own_request)
        except HighsideError as error:
            outcomes.append(MethodOutcome(method, None, str(error), None, None))
            continue
        errors = errors_at(solution, poses)
        outcomes.append(MethodOutcome(method, solution, "", errors, uncertainty_over(solution, inclinations_deg)))
    return MethodComparison(poses, _errors(poses.a, inc_ref, tf_ref), tuple(outcomes))


def attitudes_set(inc: Array, tf: Array) -> tuple[Array, Array]:
    """The bench's settings (rad) as the attitudes they give: inclination in 0 to pi; a table turned the other way
    (negative inclination) gives the opposite toolface."""
    return np.abs(inc), wrap_positive(np.where(inc < 0, tf + np.pi, tf))


def holds_at(solution: Solution, inc_rad: float) -> tuple[CalibrationResult, Zone] | None:
    """The calibration and zone that holds at an inclination; None where none does."""
    zone = solution.result.zone_at(inc_rad)
    if zone is not None:
        return solution.result, zone
    if solution.fallback is not None:
        return solution.fallback, solution.fallback.main
    return None


def tilt_shift(inc_set_rad: Array, tilt_x_rad: float, tilt_y_rad: float) -> tuple[Array, Array]:
    """What a tilt of the bench adds to I and T (rad) at settings of inclination (N,): its sign turns with the table.

    `I - tx` and `T - ty / sin I` in the bench's own count of a setting; where that is negative the attitude is counted
    from the other side. No toolface is shifted at the vertical, where there is none.
    """
    side = np.where(inc_set_rad < 0, -1.0, 1.0)
    sine = np.abs(np.sin(inc_set_rad))
    across = np.divide(tilt_y_rad, sine, out=np.zeros_like(sine), where=sine > np.sin(np.deg2rad(VERTICAL_DEG)))
    return side * tilt_x_rad, side * across


def errors_at(solution: Solution, poses: PoseSet) -> Errors:
    """Errors at the poses in the frame of the bench (an estimated tilt is taken off: it is no error of the sensor)."""
    inc_set, tf_set = poses.reference()
    inc_ref, tf_ref = attitudes_set(inc_set, tf_set)
    count = len(poses)
    inc_deg, tf_deg = np.full(count, np.nan), np.full(count, np.nan)
    for i in range(count):
        held = holds_at(solution, float(inc_ref[i]))
        if held is None:
            continue
        result, zone = held
        temp = None if poses.temp_c is None else float(poses.temp_c[i])
        g = result.correct(poses.a[:, i], temp, zone)
        inc, tf = attitude_block(g[:, None])
        shift_inc, shift_tf = tilt_shift(inc_set[i : i + 1], *result.tilt_rad)
        one = _errors_of(inc - shift_inc, tf - shift_tf, inc_ref[i : i + 1], tf_ref[i : i + 1])
        inc_deg[i], tf_deg[i] = one.inc_deg[0], one.tf_deg[0]
    return Errors(inc_deg, tf_deg)


def uncertainty_over(solution: Solution, inclinations_deg: Sequence[float]) -> CalibrationUncertainty:
    """The stated uncertainty over inclination."""
    inc_std, tf_std = np.full(len(inclinations_deg), np.nan), np.full(len(inclinations_deg), np.nan)
    for k, inc_deg in enumerate(inclinations_deg):
        held = holds_at(solution, float(np.deg2rad(inc_deg)))
        if held is None:
            continue
        result, zone = held
        by_inc, by_tf = result.predict_std(np.deg2rad(inc_deg), TOOLFACES_RAD, 0.0, zone=zone)
        inc_std[k], tf_std[k] = np.rad2deg(by_inc.max()), np.rad2deg(by_tf.max())
    return CalibrationUncertainty(np.array(inclinations_deg, dtype=float), inc_std, tf_std)


def g_total_std(solution: Solution, inc_rad: float) -> float | None:
    """Standard deviation (g) of Gtotal by the calibration alone at an inclination, the largest over toolface."""
    held = holds_at(solution, inc_rad)
    if held is None:
        return None
    result, zone = held
    g = gravity_direction(np.full_like(TOOLFACES_RAD, inc_rad), TOOLFACES_RAD)
    cov = result.covariance_of(g, zone=zone)
    return float(np.sqrt(np.einsum("in,nij,jn->n", g, cov, g).max()))


def _errors(a: Array, inc_ref: Array, tf_ref: Array) -> Errors:
    inc, tf = attitude_block(np.ascontiguousarray(a))
    return _errors_of(inc, tf, inc_ref, tf_ref)


def _errors_of(inc: Array, tf: Array, inc_ref: Array, tf_ref: Array) -> Errors:
    d_tf = np.rad2deg(difference(tf, tf_ref))
    return Errors(np.rad2deg(inc - inc_ref), np.where(np.sin(inc_ref) > np.sin(np.deg2rad(VERTICAL_DEG)), d_tf, np.nan))


def _rms(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else None


def _largest(values: Array) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.abs(known).max()) if known.size else None

"""Which pose the tool is at, how far it is from the one requested, and what to say about it.

Readings are compared with what the sensor *should* read at each planned pose. What it should read is known only as
well as the sensor: at first within the plan's prior (some mg of offset, some tenths of a degree of misalignment), then
ever better from the poses taken (`Provisional`: an affine fit drawn to the nominal sensor, with its covariance). The
tolerance of a pose follows that knowledge, so that a rough sensor can begin and a pose set five degrees off is not
taken in the end. The provisional fit is used for recognition alone; what is measured stays raw.

A reading cannot tell inclination -I from I with the toolface turned by 180 deg, nor toolfaces at the vertical, nor one
step of temperature from another: among poses that the reading cannot distinguish the one requested counts. Where they
are different settings of the bench (`Chart.alike`) its tilt is in them with different signs: such a pose is never
guessed, and never measured before the tool has left the other (`watch`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.attitude.scalar import attitude
from highside.bench.session.plans import Limits
from highside.bench.session.snapshot import AttitudeState, Deviation
from highside.physics.gravity import gravity_direction

VERTICAL_SIN = 0.003
"""Below 0.17 deg of inclination toolface is not requested."""
TOLERANCE_SIGMAS = 3.0
AMBIGUITY_SIGMAS = 2.0
FIT_FLOOR_G = 2e-4
"""Bench and model errors of a pose in the provisional fit; generous, for it only recognises."""


@dataclass(frozen=True, slots=True)
class Provisional:
    """A = `matrix`, b = `offset` so far, with the covariance (4, 4) of one row of [A | b]."""

    matrix: Array
    offset: Array
    covariance: Array

    @classmethod
    def fit(cls, inc_deg: Sequence[float], tf_deg: Sequence[float], a: Array, limits: Limits) -> Provisional:
        """From the N poses taken; `a` (3, N) raw means. The prior alone for none."""
        precision = np.diag([limits.prior_matrix**-2] * 3 + [limits.prior_offset_g**-2])
        nominal = np.eye(3, 4)
        if len(inc_deg) == 0:
            return cls(np.eye(3), np.zeros(3), np.asarray(np.linalg.inv(precision), dtype=np.float64))
        rows = np.vstack([gravity_direction(np.deg2rad(inc_deg), np.deg2rad(tf_deg)), np.ones(len(inc_deg))])
        spread = math.radians(limits.pose_sigma_deg)
        weight = 1.0 / (FIT_FLOOR_G**2 + spread**2)
        covariance: Array = np.asarray(np.linalg.inv(precision + weight * rows @ rows.T), dtype=np.float64)
        estimate = nominal + weight * ((a - nominal @ rows) @ rows.T) @ covariance
        return cls(estimate[:, :3], estimate[:, 3], covariance)

    def correct(self, a: Array) -> Array:
        """Gravity (3,) from a raw reading."""
        return np.asarray(np.linalg.solve(self.matrix, a - self.offset))

    def std_rad(self, g: Array) -> float:
        """Standard deviation of the direction of a reading near `g` (3,) by what is not known of the sensor."""
        row = np.append(g, 1.0)
        return float(np.sqrt(row @ self.covariance @ row))


@dataclass(frozen=True, slots=True)
class CandidatePose:
    """A pose that may be recognised."""

    id: str
    inc_deg: float
    tf_deg: float
    open: bool

    def direction(self) -> Array:
        """Gravity (3,) in the tool frame."""
        return np.asarray(
            gravity_direction(np.array([math.radians(self.inc_deg)]), np.array([math.radians(self.tf_deg)]))[:, 0]
        )


@dataclass(frozen=True, slots=True)
class Recognised:
    """`pose` the planned pose at which the tool is, or None; `tolerance_deg` that of the target."""

    pose: CandidatePose | None
    angle_deg: float
    tolerance_deg: float


def angle_between_deg(a: Array, b: Array) -> float:
    """Angle between two vectors (3,), exact for small ones."""
    cross = np.cross(a, b)
    return math.degrees(math.atan2(math.sqrt(float(cross @ cross)), float(a @ b)))


def tolerance_deg(model: Provisional, pose: CandidatePose, limits: Limits) -> float:
    """How far from a pose the reading may be and still be taken for it."""
    return limits.align_deg + TOLERANCE_SIGMAS * math.degrees(model.std_rad(pose.direction()))


@dataclass(frozen=True, slots=True)
class Chart:
    """The poses that may be recognised, with what a window is compared with: directions (3, N), tolerances and doubts
    (N,) in degrees (within its doubt a reading could be another pose's)."""

    poses: tuple[CandidatePose, ...]
    directions: Array
    tolerances_deg: Array
    doubts_deg: Array
    alike: Mapping[str, frozenset[str]]
    """for each pose the other settings of the bench that read the same"""

    @classmethod
    def of(cls, poses: Sequence[CandidatePose], model: Provisional, limits: Limits) -> Chart:
        return cls(
            tuple(poses),
            np.array([pose.direction() for pose in poses]).reshape(-1, 3).T,
            np.array([tolerance_deg(model, pose, limits) for pose in poses]),
            np.array([AMBIGUITY_SIGMAS * math.degrees(model.std_rad(pose.direction())) for pose in poses]),
            _alike(poses, limits.align_deg),
        )

    def candidate(self, name: str) -> CandidatePose | None:
        return next((pose for pose in self.poses if pose.id == name), None)


def _alike(poses: Sequence[CandidatePose], within_deg: float) -> dict[str, frozenset[str]]:
    """For each pose the others whose readings differ by less than `within_deg`, but whose settings do not."""
    if not poses:
        return {}
    directions = np.array([pose.direction() for pose in poses])
    inc, tf = (np.array([pose.inc_deg for pose in poses]), np.array([pose.tf_deg for pose in poses]))
    same_reading = np.linalg.norm(directions[:, None] - directions[None], axis=2) < math.radians(within_deg)
    turned = np.abs(np.mod(tf[:, None] - tf[None] + 180.0, 360.0) - 180.0)
    same_setting = (np.abs(inc[:, None] - inc[None]) < within_deg) & (turned < within_deg)
    return {
        pose.id: frozenset(poses[k].id for k in np.flatnonzero(row).tolist())
        for pose, row in zip(poses, same_reading & ~same_setting, strict=True)
    }


def recognise(a: Array, model: Provisional, chart: Chart, target: CandidatePose | None, limits: Limits) -> Recognised:
    """The planned pose nearest to a raw mean `a` (3,); the target where the reading could be either's."""
    g = model.correct(a)
    limit = tolerance_deg(model, target, limits) if target is not None else limits.align_deg
    if not chart.poses:
        return Recognised(None, math.inf, limit)
    x, y, z = chart.directions
    cross = (g[1] * z - g[2] * y) ** 2 + (g[2] * x - g[0] * z) ** 2 + (g[0] * y - g[1] * x) ** 2
    angles = np.rad2deg(np.arctan2(np.sqrt(cross), g @ chart.directions))
    allowed = np.where(angles <= chart.tolerances_deg, angles, np.inf)
    nearest = int(np.argmin(allowed))
    if not np.isfinite(allowed[nearest]):
        return Recognised(None, math.inf, limit)
    best = chart.poses[nearest]
    doubt = 0.5 * float(chart.doubts_deg[nearest]) + 1e-6
    alike = [chart.poses[k] for k in np.flatnonzero(angles <= angles[nearest] + doubt) if chart.poses[k].open]
    if target is not None and angles[nearest] <= limit and any(pose.id == target.id for pose in alike):
        best = target
    elif not best.open:
        # measured already, but an open one reads the same (a reversed inclination, the next step of temperature)
        direction = best.direction()
        best = next((p for p in alike if angle_between_deg(p.direction(), direction) < doubt), best)
    return Recognised(best, angle_between_deg(g, best.direction()), limit)


def attitude_of(a: Array, model: Provisional) -> AttitudeState:
    """Inclination and toolface of a raw mean, as far as is known."""
    g = model.correct(a)
    inc, tf = attitude(float(g[0]), float(g[1]), float(g[2]))
    shown = None if abs(math.sin(inc)) < VERTICAL_SIN else math.degrees(tf)
    return AttitudeState(inc_deg=math.degrees(inc), tf_deg=shown, g_total=float(np.linalg.norm(g)))


def deviation_of(a: Array, model: Provisional, target: CandidatePose, limits: Limits) -> Deviation:
    """What is missing to the target, in the settings of the bench."""
    g = model.correct(a)
    inc_rad, tf_rad = attitude(float(g[0]), float(g[1]), float(g[2]))
    inc, tf = math.degrees(inc_rad), math.degrees(tf_rad)
    missing = _turn(target.tf_deg - tf)
    if target.inc_deg < 0.0:
        # the table turned the other way: what reads (I, T) is set as (-I, T + 180)
        inc, missing = -inc, _turn(target.tf_deg - tf - 180.0)
    vertical = abs(math.sin(math.radians(target.inc_deg))) < VERTICAL_SIN
    return Deviation(
        inc_deg=target.inc_deg - inc,
        tf_deg=None if vertical else missing,
        angle_deg=angle_between_deg(g, target.direction()),
        tolerance_deg=tolerance_deg(model, target, limits),
    )


def _turn(angle_deg: float) -> float:
    """In (-180, 180]."""
    turned = math.remainder(angle_deg, 360.0)
    return 180.0 if turned == -180.0 else turned


def instruction(deviation: Deviation, *, reversed_side: bool = False) -> str:
    """What to do: "turn 12 deg clockwise, raise 0.4 deg" (looking down-hole; raise: more inclined, on whichever side
    of vertical the table is)."""
    parts = []
    coarse = 0.5 * deviation.tolerance_deg
    if deviation.tf_deg is not None and abs(deviation.tf_deg) >= 0.05:
        parts.append(f"turn {_amount(deviation.tf_deg)} deg {'' if deviation.tf_deg > 0 else 'counter'}clockwise")
    if abs(deviation.inc_deg) >= min(0.05, coarse):
        parts.append(
            f"{'raise' if (deviation.inc_deg > 0) is not reversed_side else 'lower'} {_amount(deviation.inc_deg)} deg"
        )
    return ", ".join(parts) if parts else "hold it there"


def _amount(angle_deg: float) -> str:
    size = abs(angle_deg)
    return f"{size:.0f}" if size >= 10.0 else f"{size:.1f}" if size >= 1.0 else f"{size:.2f}"


def setting(inc_deg: float, tf_deg: float) -> str:
    """A pose in words."""
    return f"inclination {inc_deg:g}, toolface {tf_deg:g}"


SIGNED_PERMUTATIONS: tuple[tuple[str, Array], ...] = tuple(
    (
        "".join(("-" if s < 0 else "") + "xyz"[p] for p, s in zip(order, signs, strict=True)),
        np.array([[s if column == p else 0.0 for column in range(3)] for p, s in zip(order, signs, strict=True)]),
    )
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
    if (order, signs) != ((0, 1, 2), (1.0, 1.0, 1.0))
)
"""All 47 ways to confuse axes and signs: how to write the mapping, and the matrix."""


def axes_that_fit(a: Array, model: Provisional, target: CandidatePose, limits: Limits) -> list[str]:
    """The axis mappings under which a reading would be the target's: what a confused configuration looks like."""
    limit = tolerance_deg(model, target, limits)
    direction = target.direction()
    return [name for name, matrix in SIGNED_PERMUTATIONS if angle_between_deg(matrix @ a, direction) <= limit]


def handedness(gravity_mean: Array, gravity_step: Array, gyro_rad: Array) -> tuple[float, float]:
    """Evidence of one window whether rate sensors and accelerometers agree: `dG = -w x G dt` in a right-handed frame.

    `gravity_step` (3,) change of the mean over a step of time, `gyro_rad` (3,) the angle turned in it (rad). Returns
    (product of measured and predicted change, size of the predicted one squared): their ratio, summed over a move, is
    near 1 for a good mapping and near -1 for a mirrored one.
    """
    predicted = -np.cross(gyro_rad, gravity_mean)
    return float(predicted @ gravity_step), float(predicted @ predicted)

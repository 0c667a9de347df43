"""Balance correction: four poses at one inclination Ic, toolfaces 45, 135, 225 and 315 deg, a matrix for each zone.

Three of the four poses (a *triple*, by quadrant) give `C = W S^-1`, W and S having the poses as columns. The average
of the four triples equals the least-squares matrix over the four poses to second order. All four share `gz = cos Ic`
(equation 15), so an offset looks exactly like a third column of the matrix: `1 = gz / cos Ic`. Hence three things that
the method must say:

- it is local: an error d common to the poses (offset, bench tilt) vanishes at Ic and comes back as `d (1 - cos I / cos
  Ic)`;
- at Ic = 90 deg the third row of W is zero. S may still be invertible, and the corrected gz is then identically zero,
  which looks like perfect inclination and is none: refused;
- it absorbs errors of the bench too, so that agreement with the bench is not accuracy in the field.

*Closure*: for an affine sensor on a perfect rig `S1 - S2 + S3 - S4 = 0`.
"""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.calibration.conventional import DEFAULT_OFFSET_STD_G, MAX_CONDITION
from highside.calibration.linear_errors import (
    NOMINAL_BENCH,
    BenchAccuracy,
    linear_covariance,
    linear_parameters,
    stated_variance,
)
from highside.calibration.poses import SAME_TEMPERATURE_C, Indices, PoseSet, group_settings
from highside.calibration.remark import CalibrationRefused, Reason, Remark
from highside.calibration.result import CalibrationResult, Closure, PoseFit
from highside.calibration.zone import Zone
from highside.physics.gravity import gravity_direction, gravity_jacobians

TRIPLES: dict[str, tuple[int, int, int]] = {
    "1-2-3": (0, 1, 2),
    "2-3-4": (1, 2, 3),
    "3-4-1": (2, 3, 0),
    "4-1-2": (3, 0, 1),
}
"""The four topologies: which quadrants make the matrix."""

TOPOLOGIES = (*TRIPLES, "average", "least-squares")

QUADRANT_TOLERANCE_RAD = np.deg2rad(10.0)
HORIZONTAL_COS = 0.01
"""Within 0.57 deg of horizontal the third row of W is refused as zero: errors common to the poses would come back a
hundredfold one degree away."""
ZONE_COMMON_SHARE = 0.05
"""A zone ends where more than this share of an error common to its poses comes back ..."""
ZONE_NOISE_GAIN = 2.0
"""... or where its matrix multiplies the noise of the cross axes by more than this."""
CLOSURE_P = 1e-3
"""A session is refused if its closures would be exceeded by chance with less than this probability."""


def balance(
    poses: PoseSet,
    *,
    triples: str = "average",
    offset_g: Array | None = None,
    offset_std_g: float = DEFAULT_OFFSET_STD_G,
    bench: BenchAccuracy = NOMINAL_BENCH,
) -> CalibrationResult:
    """A matrix for each inclination of the session.

    `triples`: "1-2-3", "2-3-4", "3-4-1", "4-1-2" (by quadrant), "average" or "least-squares" (all poses of the
    inclination).
    `offset_g` (3,): the zero offset, subtracted first (0 if None), known to `offset_std_g`. An inclination that cannot
    be solved is omitted with a remark marked `refused`. Raises CalibrationRefused where none can.
    """
    if triples not in TOPOLOGIES:
        raise ValueError(f"{triples!r} is none of {', '.join(TOPOLOGIES)}")
    inc, _ = poses.reference()
    offset = np.zeros(3) if offset_g is None else np.asarray(offset_g, dtype=float)
    zones: list[Zone] = []
    fours: list[Indices] = []
    remarks: list[Remark] = []
    residual = np.zeros((3, len(poses)))
    used = np.zeros(len(poses), dtype=bool)
    inclinations = poses.inclination_stations()
    for inclination in range(int(inclinations.max()) + 1):
        members = np.flatnonzero(inclinations == inclination)
        center = float(np.mean(inc[members]))
        try:
            chosen = _members_by_quadrant(poses, members, center)
            _require_invertible(center)
            zone, fitted = _solve_inclination(poses, members, chosen, center, triples, offset, offset_std_g, bench)
        except CalibrationRefused as refusal:
            text, names = refusal.remark.text, refusal.remark.poses
            remarks.append(Remark(refusal.remark.reason, text, names, refused=True))
            continue
        zones.append(zone)
        members_used = members if triples == "least-squares" else chosen
        residual[:, members_used] = (poses.a - offset[:, None])[:, members_used] - fitted
        used[members_used] = True
        fours.append(chosen)
    if not zones:
        others = f" (and {len(remarks) - 1} other inclinations for a like reason)" if len(remarks) > 1 else ""
        raise CalibrationRefused(remarks[0].reason, remarks[0].text + others, remarks[0].poses)
    closures = closures_of(poses, fours, [zone.model().A for zone in zones], pose_rad=bench.pose_rad)
    remarks += closure_remarks(closures)
    if not poses.std_known:
        remarks.append(Remark(Reason.NOISE_ASSUMED, "the pose table states no noise; 50 ug a reading is assumed"))
    studentised = _departures(poses, closures)
    return CalibrationResult(
        method="balance",
        options={"triples": triples, "offset": "given" if offset_g is not None else "zero"},
        frame="bench",
        zones=tuple(zones),
        poses=PoseFit(poses.ids, residual, studentised, used),
        closures=tuple(closures),
        variance=stated_variance(poses, bench),
        remarks=tuple(remarks),
    )


def _departures(poses: PoseSet, closures: list[Closure]) -> Array:
    """Departure of each pose (N,) in standard deviations: the four of an inclination have one redundancy and share
    it."""
    out = np.zeros(len(poses))
    index = {name: i for i, name in enumerate(poses.ids)}
    for closure in closures:
        for name in closure.poses:
            out[index[name]] = np.sqrt(closure.chi2 / 3.0)
    return out


def balance_matrix(S: Array, W: Array, triples: str = "average") -> Array:
    """C (..., 3, 3) from the four columns S (..., 3, 4), offset subtracted, and W (3, 4), both in order of quadrants.

    Leading dimensions of S are sessions of their own.
    """
    if triples in TRIPLES:
        pick = list(TRIPLES[triples])
        return np.asarray(W[..., pick] @ np.linalg.inv(S[..., pick]))
    if triples == "average":
        return np.asarray(np.mean([balance_matrix(S, W, name) for name in TRIPLES], axis=0))
    return np.asarray(W @ np.linalg.pinv(S))


def zone_limits(center_rad: float) -> tuple[float, float]:
    """Range of inclination (rad) in which a matrix taken at `center_rad` may be used.

    It ends where `|1 - cos I / cos Ic|` exceeds `ZONE_COMMON_SHARE`, or where the noise of the cross axes is
    multiplied by more than `ZONE_NOISE_GAIN` = sin I / sin Ic.
    """
    cos_c, sin_c = np.cos(center_rad), np.sin(center_rad)
    edges = np.arccos(np.clip(cos_c * np.array([1.0 + ZONE_COMMON_SHARE, 1.0 - ZONE_COMMON_SHARE]), -1.0, 1.0))
    lo, hi = float(edges.min()), float(edges.max())
    gain = ZONE_NOISE_GAIN * sin_c
    if gain < 1.0:
        reach = float(np.arcsin(gain))
        if center_rad <= np.pi / 2:
            hi = min(hi, reach)
        else:
            lo = max(lo, np.pi - reach)
    return lo, hi


def closures_of(
    poses: PoseSet,
    fours: list[Indices],
    A: list[Array],
    *,
    pose_rad: float = 0.0,
    pose_covariance: Array | None = None,
) -> list[Closure]:
    """Closures of inclinations; `fours` are the indices of their four poses in the order of the quadrants, `A` their
    matrices.

    The covariance is the sum of those of the four poses: reading noise and the pose errors, `pose_rad` in both
    inclination and toolface, or `pose_covariance` (N, 3, 3; reading noise included) as the joint estimator found them.
    An error common to the inclination cancels. The coefficients are 1, -1, 1, -1 on exact toolfaces, else the null
    vector of W.
    """
    if not fours:
        return []
    inc, tf = poses.reference()
    index = np.stack(fours)
    W = gravity_direction(inc[index], tf[index]).transpose(1, 0, 2)
    null = np.linalg.svd(W)[2][:, 3]
    null = null / np.max(np.abs(null), axis=1, keepdims=True) * np.sign(null[:, :1])
    value = np.einsum("irk,rk->ri", poses.a[:, index], null)
    if pose_covariance is None:
        matrices = np.stack(A)
        by_inc, by_tf = (np.einsum("rij,jrk->rki", matrices, d) for d in gravity_jacobians(inc[index], tf[index]))
        sigma = by_inc[..., :, None] * by_inc[..., None, :] + by_tf[..., :, None] * by_tf[..., None, :]
        sigma = sigma * pose_rad**2
        sigma[..., (0, 1, 2), (0, 1, 2)] += np.moveaxis(poses.noise_of_mean()[:, index] ** 2, 0, -1)
    else:
        sigma = pose_covariance[index]
    covariance = np.einsum("rk,rkij->rij", null**2, sigma)
    inverse = np.linalg.inv(covariance)
    chi2 = np.einsum("ri,rij,rj->r", value, inverse, value).tolist()
    centers = inc[index].mean(axis=1).tolist()
    out = []
    for r, four in enumerate(fours):
        p = _chi2_3_tail(chi2[r])
        suspects = _closure_suspects(poses, four, A[r], null[r], value[r], inverse[r]) if p < CLOSURE_P else ""
        ids = tuple(poses.ids[i] for i in four)
        out.append(Closure(centers[r], value[r], covariance[r], chi2[r], p, ids, suspects))
    return out


def _chi2_3_tail(chi2: float) -> float:
    """Probability that chi-square with three degrees of freedom exceeds `chi2`."""
    return math.erfc(math.sqrt(0.5 * chi2)) + math.sqrt(2.0 * chi2 / math.pi) * math.exp(-0.5 * chi2)


def _closure_suspects(poses: PoseSet, four: Indices, A: Array, null: Array, value: Array, inverse: Array) -> str:
    """Which pose, displaced in both angles, would explain the closure best ("1 or 3" where two do alike)."""
    inc, tf = poses.reference()
    by_inc, by_tf = (A @ d for d in gravity_jacobians(inc[four], tf[four]))
    explained = []
    for k in range(4):
        G = np.stack([by_inc[:, k], by_tf[:, k]], axis=1) * null[k]
        normal = G.T @ inverse @ G
        normal = normal + 1e-12 * np.trace(normal) * np.eye(2)
        right = G.T @ inverse @ value
        explained.append(float(right @ np.linalg.solve(normal, right)))
    best = max(explained)
    suspects = [poses.ids[four[k]] for k in range(4) if explained[k] > best - max(4.0, 0.02 * best)]
    return " or ".join(suspects) if len(suspects) < 4 else ""


def closure_remarks(closures: list[Closure]) -> list[Remark]:
    """A refusal for every closure that chance does not explain, the whole session held to `CLOSURE_P`."""
    out = []
    for closure in closures:
        if closure.p < CLOSURE_P / len(closures):
            again = f"pose {closure.worst_pose}" if closure.worst_pose else f"poses {', '.join(closure.poses)}"
            size = float(np.linalg.norm(closure.value)) * 1e3
            out.append(
                Remark(
                    Reason.CLOSURE,
                    f"the four readings at {np.rad2deg(closure.inc_rad):.3f} deg do not close by {size:.3f} mg "
                    f"(p = {closure.p:.1e}): a wrong pose, a moved tool or physics that is not modelled; "
                    f"measure {again} again",
                    closure.poses,
                    refused=True,
                )
            )
    return out


def quadrant_poses(poses: PoseSet) -> list[Indices]:
    """The four poses nearest the middles of the quadrants, for every inclination that has them."""
    away = _away_from_quadrants(poses.reference()[1])
    inclinations = poses.inclination_stations()
    if poses.temp_c is not None:  # an inclination is measured at one temperature
        stage = group_settings(poses.temp_c, tolerance=SAME_TEMPERATURE_C)
        inclinations = inclinations * (int(stage.max()) + 1) + stage
    members = inclinations == np.arange(int(inclinations.max()) + 1)[:, None]
    apart = np.where(members[:, None, :], away, np.inf)
    nearest = apart.argmin(axis=2)
    whole = np.take_along_axis(apart, nearest[:, :, None], axis=2).max(axis=(1, 2)) <= QUADRANT_TOLERANCE_RAD
    return list(nearest[whole & (members.sum(axis=1) >= 4)])


def _away_from_quadrants(tf: Array) -> Array:
    """Distance (4, N) of toolfaces (N,) from 45, 135, 225 and 315 deg."""
    return np.asarray(np.abs((tf[None, :] - _QUADRANT_MIDDLES[:, None] + np.pi) % (2 * np.pi) - np.pi))


_QUADRANT_MIDDLES = np.deg2rad(np.array([45.0, 135.0, 225.0, 315.0]))


def _members_by_quadrant(poses: PoseSet, members: Indices, center: float) -> Indices:
    """Indices of the poses nearest to 45, 135, 225 and 315 deg. Raises CalibrationRefused where one lacks."""
    tf = poses.reference()[1][members]
    away = _away_from_quadrants(tf)
    nearest = np.argmin(away, axis=1)
    lacking = [
        f"{np.rad2deg(middle):.0f}"
        for middle, k, row in zip(_QUADRANT_MIDDLES, nearest, away, strict=True)
        if row[k] > QUADRANT_TOLERANCE_RAD
    ]
    if lacking:
        raise CalibrationRefused(
            Reason.NOT_FOUR_QUADRANTS,
            f"at inclination {np.rad2deg(center):.3f} deg there is no pose near toolface {', '.join(lacking)} deg; "
            "balance needs 45, 135, 225 and 315 deg",
            tuple(poses.ids[i] for i in members),
        )
    return np.asarray(members[nearest], dtype=np.intp)


def _require_invertible(center: float) -> None:
    inc_deg = np.rad2deg(center)
    if center < 0:
        raise CalibrationRefused(
            Reason.SINGULAR,
            f"the reversed poses at {inc_deg:.3f} deg are of use to the joint method only; omitted from balance",
        )
    if abs(np.cos(center)) < HORIZONTAL_COS:
        raise CalibrationRefused(
            Reason.NEAR_HORIZONTAL,
            f"balance at {inc_deg:.3f} deg is refused: all four poses have gz near zero, so the axial row "
            "of the matrix is not determined and a corrected gz of zero would only look exact; "
            "use the joint or conventional method there",
        )
    if abs(np.sin(center)) * MAX_CONDITION < 1.0:
        raise CalibrationRefused(
            Reason.SINGULAR,
            f"balance at {inc_deg:.3f} deg is refused: the poses differ by less than noise allows; "
            "use an inclination above 0.06 deg",
        )


def _solve_inclination(
    poses: PoseSet,
    members: Indices,
    four: Indices,
    center: float,
    triples: str,
    offset: Array,
    offset_std_g: float,
    bench: BenchAccuracy,
) -> tuple[Zone, Array]:
    """The zone of one ring, and the readings (offset subtracted) that its model gives for the poses used."""
    inc, tf = poses.reference()
    use = members if triples == "least-squares" else four
    W = gravity_direction(inc[use], tf[use])
    S = poses.a[:, use] - offset[:, None]
    determined = W[:, list(TRIPLES[triples])] if triples in TRIPLES else W
    sizes = np.linalg.svd(determined, compute_uv=False)
    condition = float(sizes[0] / sizes[-1]) if sizes[-1] > 0 else np.inf
    C = balance_matrix(S, W, triples)
    A: Array = np.asarray(np.linalg.inv(C), dtype=np.float64)
    covariance = linear_covariance(_weights(W, triples), A, poses.subset(use), bench, offset_std_g)
    lo, hi = zone_limits(center)
    zone = Zone(f"zone {np.rad2deg(center):.3f}", center, lo, hi, linear_parameters(A, offset, covariance), condition)
    return zone, A @ W


def _weights(W: Array, triples: str) -> Array:
    """Weights (N, 3) of the equivalent linear estimator `A = S weights` (exact for triples, to first order else)."""
    if triples == "least-squares":
        return np.asarray(np.linalg.pinv(W))
    names = list(TRIPLES) if triples == "average" else [triples]
    out = np.zeros((4, 3))
    for name in names:
        pick = list(TRIPLES[name])
        out[pick] += np.linalg.inv(W[:, pick]) / len(names)
    return out

"""Zone refinement: what the joint estimator's model leaves over, ring by ring, shrunken.

A sensor may have structure that no model has. Within one ring (inclination) what is left of the residuals is fitted by
a local affine change of the sensor, `delta m = p cos T + q sin T + r` for each channel: exactly what a balance matrix
can express. Three things keep it from fitting the bench instead:

- tilt-aware: the residuals are those of the joint estimator, the bench's tilt taken out;
- weighted: ring-common and station-common errors of the bench are in the covariance of the residuals, so that a change
  that the bench could make by itself is not believed;
- shrunken: the size of true structure is estimated over all rings (variances of p, q together and of r, by restricted
  maximum likelihood), and each ring's change is the posterior mean under it. Where the rings show no structure beyond
  noise there is no zone at all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from highside.calibration.forward import Variances, pose_covariance
from highside.calibration.poses import Array, Indices, PoseSet
from highside.calibration.result import CalibrationResult, Parameters, Zone
from highside.calibration.sensor import MATRIX_NAMES, OFFSET_NAMES
from highside.physics.effect import AXES
from highside.physics.gravity import gravity_jacobians

ADMIT_LOG_LIKELIHOOD = 8.0
"""Gain in log likelihood for two variances before structure is believed."""
MIN_POSES_IN_RING = 4


def refine(result: CalibrationResult, poses: PoseSet) -> CalibrationResult:
    """Add a local zone for each ring to a joint `result` of the same `poses`, if the rings show structure at all.

    A zone reaches from the ring below to the ring above, for the schedule to blend. The uncertainty of a zone is that
    of the global sensor, that of its change, and the structure expected between rings is in neither: it is reported as
    the option `structure_g`.
    """
    inc, tf = poses.reference()
    tf = tf + result.toolface_zero_rad
    used = result.poses.used
    rings = poses.rings()
    usable = [
        members
        for members in (np.flatnonzero((rings == ring) & used) for ring in range(int(rings.max()) + 1))
        if members.size >= MIN_POSES_IN_RING and 0.0 < float(inc[members].mean()) < np.pi
    ]
    if len(usable) < 3:
        return result
    blocks = [_block(result, poses, inc, tf, members) for members in usable]
    spread, gain = _structure(blocks)
    if gain < ADMIT_LOG_LIKELIHOOD:
        return replace(result, options=dict(result.options) | {"structure_g": 0.0})
    zones = []
    centers = [float(inc[members].mean()) for members in usable]
    for k, (center, block) in enumerate(zip(centers, blocks, strict=True)):
        lo = centers[k - 1] if k > 0 else 0.0
        hi = centers[k + 1] if k + 1 < len(centers) else min(np.pi, 2 * center - lo)
        zones.append(_zone(result.main, center, lo, float(hi), block, spread))
    size = float(np.sqrt(spread[0] + spread[1]))
    return replace(result, zones=(result.main, *zones), options=dict(result.options) | {"structure_g": size})


def _block(
    result: CalibrationResult, poses: PoseSet, inc: Array, tf: Array, members: Indices
) -> tuple[Array, Array, Array]:
    """Residuals (3 M,), basis (3 M, 9) and covariance (3 M, 3 M) of a ring of M poses."""
    A = result.A
    by_inc, by_tf = (A @ d for d in gravity_jacobians(inc[members], tf[members]))
    # structure inflates the estimated scatter of the bench: no more than was stated is put down to it
    stated = np.deg2rad(float(result.options["pose_sigma_deg"]))
    v = {name: min(value, stated) for name, value in result.variance.items()}
    own = Variances(v["pose_inc_rad"] ** 2, v["pose_tf_rad"] ** 2 + v["station_tf_rad"] ** 2, 0.0, 0.0)
    blocks = pose_covariance(poses.noise_of_mean()[:, members], by_inc, by_tf, own)
    count = members.size
    covariance = np.zeros((count, 3, count, 3))
    covariance[range(count), :, range(count), :] = blocks
    common = by_inc.T.reshape(-1) * v["ring_inc_rad"]
    flat = covariance.reshape(3 * count, 3 * count) + np.outer(common, common)
    # the global sensor's own uncertainty moves all residuals of a ring together
    J = result.main.design(_ring_gravity(inc, tf, members)).transpose(2, 0, 1).reshape(3 * count, -1)
    p = result.main.parameters
    known = p.covariance.copy()
    for axis, name in zip(AXES, OFFSET_NAMES, strict=True):
        # what stands there for structure is what this module is after
        known[p.names.index(name), p.names.index(name)] -= result.variance.get(f"misfit_{axis}_g", 0.0) ** 2
    flat = flat + J @ known @ J.T
    return result.poses.residual_g[:, members].T.reshape(-1), _basis(tf[members]), flat


def _ring_gravity(inc: Array, tf: Array, members: Indices) -> Array:
    s, c = np.sin(inc[members]), np.cos(inc[members])
    return np.stack([s * np.cos(tf[members]), s * np.sin(tf[members]), c])


def _basis(tf: Array) -> Array:
    """(3 M, 9): for each channel cos T, sin T, 1."""
    rows = np.stack([np.cos(tf), np.sin(tf), np.ones_like(tf)], axis=1)
    return np.asarray((np.eye(3)[None, :, :, None] * rows[:, None, None, :]).reshape(3 * tf.size, 9))


def _prior(spread: tuple[float, float]) -> Array:
    """Variances (9,) of the change: `spread` of the turning part and of the constant one."""
    return np.tile([spread[0], spread[0], spread[1]], 3)


def _structure(blocks: list[tuple[Array, Array, Array]]) -> tuple[tuple[float, float], float]:
    """Variances (turning, constant) of the structure over rings, and the gain in log likelihood against none."""
    from scipy.optimize import minimize

    reduced = []
    for residual, basis, covariance in blocks:
        weighted = np.linalg.solve(covariance, np.column_stack([basis, residual]))
        reduced.append((basis.T @ weighted[:, :9], basis.T @ weighted[:, 9]))

    def loss(log_spread: Array) -> float:
        prior = _prior((float(np.exp(log_spread[0])), float(np.exp(log_spread[1]))))
        total = 0.0
        for normal, right in reduced:
            M = normal + np.diag(1.0 / prior)
            total += 0.5 * (np.linalg.slogdet(M)[1] + np.log(prior).sum() - right @ np.linalg.solve(M, right))
        return float(total)

    none = np.log(np.array([1e-14, 1e-14]))
    starts = [np.log(np.array([size, size])) for size in (1e-10, 1e-8, 1e-6)]
    best = min((minimize(loss, start, method="Nelder-Mead") for start in starts), key=lambda fit: float(fit.fun))
    spread = (float(np.exp(best.x[0])), float(np.exp(best.x[1])))
    return spread, loss(none) - float(best.fun)


def _zone(
    main: Zone,
    center: float,
    lo: float,
    hi: float,
    block: tuple[Array, Array, Array],
    spread: tuple[float, float],
) -> Zone:
    """The global sensor changed by the posterior mean of a ring's structure."""
    residual, basis, covariance = block
    weighted = np.linalg.solve(covariance, np.column_stack([basis, residual]))
    posterior = np.linalg.inv(basis.T @ weighted[:, :9] + np.diag(1.0 / _prior(spread)))
    change = posterior @ (basis.T @ weighted[:, 9])
    # p cos T + q sin T + r as a change of A (first two columns, over sin I) and of b
    to_parameters = np.zeros((12, 9))
    for i in range(3):
        to_parameters[3 * i, 3 * i] = to_parameters[3 * i + 1, 3 * i + 1] = 1.0 / np.sin(center)
        to_parameters[9 + i, 3 * i + 2] = 1.0
    p = main.parameters
    index = [p.names.index(name) for name in MATRIX_NAMES + OFFSET_NAMES]
    values, total = p.values.copy(), p.covariance.copy()
    values[index] += to_parameters @ change
    total[np.ix_(index, index)] += to_parameters @ posterior @ to_parameters.T
    return Zone(
        f"zone {np.rad2deg(center):.3f}",
        center,
        lo,
        hi,
        Parameters(p.names, values, total),
        main.condition,
        main.temperature,
    )

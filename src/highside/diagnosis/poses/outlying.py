"""Poses that do not belong to the others: a knock, a wrong angle written down, a reading taken on the way.

One such pose is enough to raise what is learnt of the noise (and hide what else is there), or to be fitted by a narrow
law. A pose is judged by what the others predict for it: with the base effects fitted, r (3,) its residual and H (3, 3)
its block of the projection on their columns, both in units of a robust scale of each channel (the median of the
absolute residuals), r' (I - H)^-1 r is the square of its deletion residual, chi-square with 3 degrees of freedom
(Cook and Weisberg, Residuals and Influence in Regression, 1982, section 2.2). Poses are taken out one by one, the
largest first; those taken out are outlying if they are few and far off, and the largest of the rest is quiet and far
below them. Physics that acts in many poses leaves no such rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from highside.arrays import Array
from highside.diagnosis.core.fit import Observed, base_fit
from highside.diagnosis.core.floor import NoiseFloor
from highside.diagnosis.core.result import Finding
from highside.diagnosis.poses.policy import OUTLYING
from highside.diagnosis.poses.session import PoseSession
from highside.physics.forward import ForwardModel

CHECK = "outlying_pose"
_CHANNELS = ("ax", "ay", "az")


def without_outlying_poses(
    session: PoseSession, model: ForwardModel, free: Sequence[str]
) -> tuple[PoseSession, tuple[Finding, ...]]:
    """The session without the poses that do not belong to the others, and a finding for each of them."""
    if session.n < OUTLYING.least:
        return session, ()
    observed = Observed(session.state, session.mean)
    fitted, residual = base_fit(model, observed, free)
    columns = observed.jacobian(fitted, fitted.free_names(list(free)))
    out, sizes = outlying_poses(residual, columns)
    if not out:
        return session, ()
    findings = tuple(
        _finding(session, pose, residual_there, size)
        for pose, size, residual_there in zip(out, sizes, _predicted(residual, columns, out), strict=True)
    )
    return _without(session, out), findings


def outlying_poses(residual: Array, columns: Array) -> tuple[list[int], list[float]]:
    """Which poses of a residual (3, n) are outlying beside columns (k, 3, n), and their deletion residuals in sigma."""
    n = residual.shape[1]
    kept = np.ones(n, dtype=bool)
    taken: list[int] = []
    sizes: list[float] = []
    for _ in range(min(max(1, int(OUTLYING.share * n)), OUTLYING.most) + 1):
        size = _deletion_residuals(residual[:, kept], columns[:, :, kept])
        largest = int(np.argmax(size))
        quiet = size[largest] < OUTLYING.sigma
        if taken and quiet and min(sizes) > max(OUTLYING.sigma, OUTLYING.apart * size[largest]):
            return taken, sizes
        if quiet:
            break
        taken.append(int(np.flatnonzero(kept)[largest]))
        sizes.append(float(size[largest]))
        kept[taken[-1]] = False
    return [], []


def _deletion_residuals(residual: Array, columns: Array) -> Array:
    """(n,) how far each pose is from what the others predict for it, in units of their noise."""
    n = residual.shape[1]
    basis = _basis(columns)
    # what is left beside the columns of these poses: those taken out no longer pull
    free = (residual.T.reshape(-1) - basis @ (basis.T @ residual.T.reshape(-1))).reshape(n, 3)
    scale = np.maximum(np.median(np.abs(free), axis=0) * OUTLYING.of_median, OUTLYING.least_g)
    basis = _basis(columns / scale[None, :, None])
    white = (residual.T / scale).reshape(-1)
    left = (white - basis @ (basis.T @ white)).reshape(n, 3)
    blocks = basis.reshape(n, 3, -1)
    hat = blocks @ blocks.transpose(0, 2, 1)
    # a pose that nothing but itself fits is judged by no other
    others = np.eye(3) - hat + OUTLYING.rank * np.eye(3)
    spread = max(1.0 - basis.shape[1] / (3 * n), OUTLYING.rank)
    square = np.einsum("ni,ni->n", left, np.linalg.solve(others, left[:, :, None])[:, :, 0])
    return np.asarray(np.sqrt(np.maximum(square, 0.0) * spread))


def _basis(columns: Array) -> Array:
    """An orthonormal basis (3n, r) of columns (k, 3, n), pose by pose."""
    table = columns.transpose(2, 1, 0).reshape(3 * columns.shape[2], -1)
    norm = np.linalg.norm(table, axis=0)
    basis, values, _ = np.linalg.svd(table[:, norm > 0] / norm[norm > 0], full_matrices=False)
    return np.asarray(basis[:, values > OUTLYING.rank * values[0]] if values.size else basis)


def _predicted(residual: Array, columns: Array, out: Sequence[int]) -> list[Array]:
    """(3,) each: by how much a pose is off what the poses that stay say of it, g."""
    stay = np.setdiff1d(np.arange(residual.shape[1]), out)
    table = columns[:, :, stay].reshape(len(columns), -1)
    sizes = np.linalg.lstsq(table.T, residual[:, stay].reshape(-1), rcond=OUTLYING.rank)[0]
    return [residual[:, pose] - sizes @ columns[:, :, pose] for pose in out]


def _finding(session: PoseSession, pose: int, off_g: Array, size: float) -> Finding:
    inc, tf = np.degrees(session.state.inc_rad[pose]), np.degrees(session.state.tf_rad[pose]) % 360.0
    worst = int(np.argmax(np.abs(off_g)))
    place = f"pose {pose + 1} of {session.n}, at inclination {inc:.4g} and toolface {tf:.4g} deg"
    return Finding(
        CHECK,
        (_CHANNELS[worst],),
        float(min(1.0, session.n * chdtrc(3, size**2))),
        f"{place}, reads {off_g[worst]:.3g} g off what the others say ({size:.3g} sigma) and was left out:"
        " measure it again; what acts there alone cannot be told from a fault",
    )


def _without(session: PoseSession, out: Sequence[int]) -> PoseSession:
    stay = np.setdiff1d(np.arange(session.n), out)
    floor = session.floor
    return replace(
        session,
        mean=session.mean[:, stay],
        count=session.count[stay],
        state=session.state.rows(stay),
        scatter=None if session.scatter is None else session.scatter[:, stay],
        floor=None if floor is None else NoiseFloor(floor.sigma[:, stay], floor.freedom),
    )

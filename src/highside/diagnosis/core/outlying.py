"""Still readings that do not belong to the others: a shock, a wrong angle written down, one taken on the way.

One of them is enough to raise what is learnt of the noise (and hide what else is there), or to be fitted by a narrow
law. A reading is judged by what the others predict for it: with the base effects fitted, r (C,) its residual and H
(C, C) its block of the projection on their columns, both in units of a robust scale of each channel (the median of the
absolute residuals), r' (I - H)^-1 r is the square of its deletion residual, chi-square with C degrees of freedom (Cook
and Weisberg, Residuals and Influence in Regression, 1982, section 2.2). Readings are taken out one by one, the largest
first; those taken out are outlying if they are few and far off, and the largest of the rest is quiet and far below
them. Physics that acts in many leaves no such rest. Nor are those left out that stand together, one after the other or
at one end of a covariate: what begins late, or grows with the temperature, acts in such.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import OUTLYING
from highside.diagnosis.core.result import Finding
from highside.special import chdtrc

CHECK = "outlying_pose"


def outlying_findings(
    residual: Array, columns: Array, channels: Sequence[str], place: Callable[[int], str], covariates: Sequence[Array]
) -> tuple[list[int], tuple[Finding, ...]]:
    """The outlying of n readings in the order of time, and a finding for each; residual (C, n) in g beside the columns
    (k, C, n) of the base effects, and `covariates` (n,) each. `place` says where a reading was taken."""
    if residual.shape[1] < OUTLYING.least:
        return [], ()
    out, sizes = outlying_readings(residual, columns)
    if _stand_together(out, covariates):
        return [], ()
    findings = []
    for number, size, off in zip(out, sizes, _predicted(residual, columns, out) if out else (), strict=True):
        worst = int(np.argmax(np.abs(off)))
        findings.append(
            Finding(
                CHECK,
                (channels[worst],),
                float(min(1.0, residual.shape[1] * chdtrc(len(channels), size**2))),
                f"{place(number)}, reads {off[worst]:.3g} g off what the others say ({size:.3g} sigma) and was left"
                " out: measure it again; what acts there alone cannot be told from a fault",
            )
        )
    return out, tuple(findings)


def _stand_together(out: Sequence[int], covariates: Sequence[Array]) -> bool:
    """Whether two readings follow one another in time, or are the two at one end of a covariate that varies."""
    if np.any(np.diff(sorted(out)) == 1):
        return True
    ends = [set(end) for values in covariates if np.ptp(values) > 0 for end in _ends(np.argsort(values, kind="stable"))]
    return any(end <= set(out) for end in ends)


def _ends(order: NDArray[np.intp]) -> tuple[list[int], list[int]]:
    return order[:2].tolist(), order[-2:].tolist()


def outlying_readings(residual: Array, columns: Array) -> tuple[list[int], list[float]]:
    """Which of n still readings are outlying by their residual (C, n) beside the columns (k, C, n) of a fit, and their
    deletion residuals in sigma."""
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
    """(n,) how far each reading is from what the others predict for it, in units of their noise."""
    channels, n = residual.shape
    basis = _basis(columns)
    # what is left beside the columns of these readings: those taken out no longer pull
    free = (residual.T.reshape(-1) - basis @ (basis.T @ residual.T.reshape(-1))).reshape(n, channels)
    scale = np.maximum(np.median(np.abs(free), axis=0) * OUTLYING.of_median, OUTLYING.least_g)
    basis = _basis(columns / scale[None, :, None])
    white = (residual.T / scale).reshape(-1)
    left = (white - basis @ (basis.T @ white)).reshape(n, channels)
    blocks = basis.reshape(n, channels, -1)
    hat = blocks @ blocks.transpose(0, 2, 1)
    # a reading that nothing but itself fits is judged by no other
    others = np.eye(channels) - hat + OUTLYING.rank * np.eye(channels)
    spread = max(1.0 - basis.shape[1] / (channels * n), OUTLYING.rank)
    square = np.einsum("ni,ni->n", left, np.linalg.solve(others, left[:, :, None])[:, :, 0])
    return np.asarray(np.sqrt(np.maximum(square, 0.0) * spread))


def _basis(columns: Array) -> Array:
    """An orthonormal basis (C n, r) of columns (k, C, n), reading by reading."""
    table = columns.transpose(2, 1, 0).reshape(columns.shape[1] * columns.shape[2], -1)
    norm = np.linalg.norm(table, axis=0)
    basis, values, _ = np.linalg.svd(table[:, norm > 0] / norm[norm > 0], full_matrices=False)
    return np.asarray(basis[:, values > OUTLYING.rank * values[0]] if values.size else basis)


def _predicted(residual: Array, columns: Array, out: Sequence[int]) -> list[Array]:
    """(C,) each: by how much a reading is off what those that stay say of it."""
    stay = np.setdiff1d(np.arange(residual.shape[1]), out)
    table = columns[:, :, stay].reshape(len(columns), -1)
    sizes = np.linalg.lstsq(table.T, residual[:, stay].reshape(-1), rcond=OUTLYING.rank)[0]
    return [residual[:, reading] - sizes @ columns[:, :, reading] for reading in out]

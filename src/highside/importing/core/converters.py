"""What the converter behind the numbers shows: the steps in which rates come, counts of one g over poses at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.importing.core.policy import POLICY, ImportPolicy

Block = NDArray[np.float64]
RATE_COUNTS = (262.4, 131.0, 65.5, 32.8, 16.4, 228.571, 114.286, 57.143, 28.571, 14.286)
"""counts per deg/s in data sheets: InvenSense and Bosch (full scales 125 to 2,000 deg/s; 32,768 / full scale is within
0.1 %), ST (4.375 to 70 mdeg/s a count)"""
_IN_STEPS = (("deg/s", 1.0, (*RATE_COUNTS, 16.0)), ("rad/s", 180.0 / np.pi, (*RATE_COUNTS, 15.7080)))
"""beside them the 1/16 deg/s and 1/900 rad/s of Bosch's BNO055"""
_ZEROS = (0.0, *(float(1 << bits) for bits in (7, 9, 11, 13, 15, 23)))
"""middle of converters that count from zero"""


@dataclass(frozen=True, slots=True)
class Steps:
    """A unit in which the numbers come in steps of a known converter, and its counts per deg/s."""

    unit: str
    counts: float
    share: float
    """1: mean cosine of the phases, 1 for steps without any noise"""


def steps_of_rates(block: Block, policy: ImportPolicy = POLICY) -> Steps | None:
    """The one unit in which the rates (3, N) are multiples of the count of a known converter; None where none is, or
    both are."""
    found = []
    for name, factor, per_dps in _IN_STEPS:
        best: Steps | None = None
        for counts in per_dps:
            n = block[:, : policy.judged_rows].ravel() * (factor * counts)
            # none at zero, where all that is small lies in any unit
            n = n[(np.abs(n) < policy.step_counts) & (np.abs(n) > 0.5)]
            if n.size < policy.least_stepped or np.unique(np.rint(n)).size < policy.step_values:
                continue
            share = float(np.cos(2 * np.pi * n).mean())
            if share > policy.step_share and (best is None or share > best.share):
                best = Steps(name, counts, share)
        if best is not None:
            found.append(best)
    return found[0] if len(found) == 1 else None


@dataclass(frozen=True, slots=True)
class Sphere:
    """Counts of one g over poses at rest, the zero of the converter, and what is left of |a|."""

    counts: float
    zero: float
    rests: int
    rms_share: float


def sphere_of(block: Block, policy: ImportPolicy = POLICY) -> Sphere | None:
    """The sphere through the means of rests (3, N): None where they do not point all round, or lie on none."""
    count = block.shape[1] // policy.rest_rows
    if count < policy.least_rests:
        return None
    rows = block[:, : count * policy.rest_rows].reshape(3, count, policy.rest_rows)
    noise = rows.std(axis=2).max(axis=0)
    means = rows.mean(axis=2)
    means = means[:, np.isfinite(noise) & (noise <= np.nanquantile(noise, 0.5))]
    centre, radius, rms = _fitted(means)
    for _ in range(2):
        if not np.isfinite(radius) or radius <= 0:
            return None
        far = np.abs(np.linalg.norm(means - centre[:, None], axis=0) - radius)
        means = means[:, far <= max(3 * rms, policy.rest_share * radius)]
        if means.shape[1] < policy.least_rests:
            return None
        centre, radius, rms = _fitted(means)
    directions = (means - centre[:, None]) / radius
    spread = float(np.linalg.eigvalsh(np.cov(directions))[0])
    if rms > policy.rest_share * radius or spread < policy.rest_spread:
        return None
    zeros = [zero for zero in _ZEROS if float(np.abs(centre - zero).max()) < policy.zero_share * radius]
    if len(zeros) != 1:
        return None
    return Sphere(radius, zeros[0], int(means.shape[1]), rms / radius)


def _fitted(means: Block) -> tuple[Block, float, float]:
    """Centre (3,), radius and rms of the distances of points (3, K) from the sphere."""
    middle = means.mean(axis=1)
    at = means - middle[:, None]
    design = np.vstack([2 * at, np.ones(at.shape[1])]).T
    solved = np.linalg.lstsq(design, (at**2).sum(axis=0), rcond=None)[0]
    radius = float(np.sqrt(max(0.0, solved[3] + solved[:3] @ solved[:3])))
    rms = float(np.sqrt(np.mean((np.linalg.norm(at - solved[:3, None], axis=0) - radius) ** 2)))
    return middle + solved[:3], radius, rms

"""Single readings far off their neighbours: glitches of a link or shocks, which a mean or a fit would take for physics.

Each reading is compared with what its stop, or its neighbours in time, have beside what the reference predicts, in
units of the scatter around it. How heavy the tails of healthy noise are is read off its quantiles, so that a rough
but healthy noise shows no impulses.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.probability import student_beyond, student_quantile
from highside.diagnosis.core.result import Finding
from highside.diagnosis.intake.clock import chance
from highside.diagnosis.intake.policy import CLOCK, IMPULSES


def find_impulses(
    accel: Array, group: NDArray[np.intp], reference: Array | None
) -> tuple[NDArray[np.intp], list[Finding]]:
    """Rows of impulses in readings (3, N), and what to say of them.

    `group` (N,) numbers the stretches that hang together (stops, or one for all); `reference` (3, N) is gravity as the
    bench says, where it is known.
    """
    n = accel.shape[1]
    rows: set[int] = set()
    found: list[Finding] = []
    if n < IMPULSES.least_rows:
        return np.empty(0, dtype=np.intp), found
    values = accel
    if reference is not None:
        basis = np.vstack([reference, np.ones(n)])
        values = accel - np.linalg.lstsq(basis.T, accel.T, rcond=None)[0].T @ basis
    for channel, name in enumerate(("ax", "ay", "az")):
        z = _in_scatters(values[channel], group)
        if z is None:
            continue
        size = np.abs(z)
        ratio = float(np.quantile(size, IMPULSES.tail) / max(np.quantile(size, 0.5), 1e-12))
        freedom = max(
            (
                v
                for v in IMPULSES.tails
                if student_quantile(0.5 + IMPULSES.tail / 2, v) / student_quantile(IMPULSES.middle, v)
                >= IMPULSES.slack * ratio
            ),
            default=IMPULSES.tails[0],
        )
        single = 2 * student_beyond(size, freedom)
        far = np.flatnonzero(single * n < IMPULSES.expected)
        if not far.size or far.size > IMPULSES.share * n:
            continue
        p = float(min(n * single.min(), chance(int(far.size), n, IMPULSES.expected / n)))
        if p < CLOCK.sure:
            rows |= {int(k) for k in far}
            words = (
                f"{far.size} readings are up to {size.max():.0f} times the scatter off their neighbours: they are left "
                "out; look for a loose contact or a shock"
            )
            found.append(Finding("impulses", (name,), p, words))
    return np.array(sorted(rows), dtype=np.intp), found


def _in_scatters(values: Array, group: NDArray[np.intp]) -> Array | None:
    """Each value less the median of its neighbours in its stretch, over the scatter around it; None where there is no
    scatter."""
    left = np.zeros(values.size)
    borders = np.flatnonzero(np.diff(group)) + 1
    for part in np.split(np.arange(values.size), borders):
        if part.size < IMPULSES.least_stop:
            continue
        own = values[part]
        left[part] = own - (
            np.median(own) if part.size <= IMPULSES.window else _running_median(own, IMPULSES.neighbours)
        )
    if not left.any():
        # no stop has rows enough to have neighbours
        return None
    scatter = INTERVALS.from_mad * _running_median(np.abs(left), IMPULSES.windows * IMPULSES.window + 1)
    usual = float(np.median(scatter[scatter > 0])) if np.any(scatter > 0) else 0.0
    if usual == 0.0:
        return None
    # a quiet stretch of a coarse converter has no scatter of its own
    return np.asarray(left / np.maximum(scatter, IMPULSES.quietest * usual))


def _running_median(values: Array, width: int) -> Array:
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(values, size=min(width, values.size), mode="nearest"))

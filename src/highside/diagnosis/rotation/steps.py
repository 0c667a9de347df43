"""The instant of a large step in a rotating recording, to a row.

Instants are tried on a grid. What a step leaves between two of them is small beside it, but of a large one above the
noise, and varies as slowly as a random walk does. So the instant at which offsets change most is tried as well.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rotation.policy import STEPS
from highside.diagnosis.rows.policy import DESIGN
from highside.diagnosis.rows.session import RotationSession


def found_step(session: RotationSession, residual: Array) -> float | None:
    """Time in s since the first row at which the means of channels (C, n) before and after differ most, in units of the
    noise of neighbouring rows; None where they differ by little."""
    n = session.n
    least = max(1, round(DESIGN.step_margin * n))
    kept = np.ones(n) if session.omitted is None else (~session.omitted).astype(float)
    noise = np.maximum(np.median(np.abs(np.diff(residual, axis=1)), axis=1), 1e-300) / STEPS.median_of_differences
    values = kept * (residual - residual.mean(axis=1, keepdims=True)) / noise[:, None]
    before = np.cumsum(kept)
    after = np.maximum(before[-1] - before, 1.0)
    total = np.cumsum(values, axis=1)
    apart = total / np.maximum(before, 1.0) - (total[:, -1:] - total) / after
    square = np.sum(apart**2, axis=0) * before * after / before[-1]
    square[:least], square[n - least :] = 0.0, 0.0
    at = int(np.argmax(square))
    if square[at] < STEPS.strength:
        return None
    elapsed = session.state.t_s - session.state.t_s[0]
    return float(elapsed[at] + elapsed[at + 1]) / 2

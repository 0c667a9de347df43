"""The instant of a large step in a rotating recording, to a row.

Instants are tried on a grid. What a step leaves between two of them is small beside it, but of a large one above the
noise, and varies as slowly as a random walk does. So the instant at which offsets change most is tried as well.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rotation.policy import STEPS
from highside.diagnosis.rows.noise import windows
from highside.diagnosis.rows.policy import DESIGN
from highside.diagnosis.rows.session import RotationSession
from highside.long_arrays import runs_of


def found_step(session: RotationSession, residual: Array) -> float | None:
    """Time in s since the first row at which the means of channels (C, n) before and after differ most, in units of the
    noise of neighbouring rows; None where they differ by little."""
    n = session.n
    least = max(1, round(DESIGN.step_margin * n))
    near = [np.abs(np.diff(residual[:, part], axis=1)) for part in windows(n)]
    noise = np.maximum(np.median(np.concatenate(near, axis=1), axis=1), 1e-300) / STEPS.median_of_differences
    middle = residual.mean(axis=1, keepdims=True)

    def values(part: slice) -> tuple[Array, Array]:
        """1 for a row that counts (n,), and the residual of those in units of the noise (C, n)."""
        kept = np.ones(part.stop - part.start) if session.omitted is None else (~session.omitted[part]).astype(float)
        return kept, kept * (residual[:, part] - middle) / noise[:, None]

    every, whole = 0.0, np.zeros(len(residual))
    for part in runs_of(n):
        kept, own = values(part)
        every, whole = every + float(kept.sum()), whole + own.sum(axis=1)
    best, at = 0.0, 0
    passed, summed = 0.0, np.zeros(len(residual))
    for part in runs_of(n):
        kept, own = values(part)
        before, total = passed + np.cumsum(kept), summed[:, None] + np.cumsum(own, axis=1)
        after = np.maximum(every - before, 1.0)
        apart = total / np.maximum(before, 1.0) - (whole[:, None] - total) / after
        square = np.sum(apart**2, axis=0) * before * after / every
        row = np.arange(part.start, part.stop)
        square[(row < least) | (row >= n - least)] = 0.0
        if square.max() > best:
            best, at = float(square.max()), part.start + int(np.argmax(square))
        passed, summed = float(before[-1]), total[:, -1]
    if best < STEPS.strength:
        return None
    elapsed = session.state.t_s[at : at + 2] - session.state.t_s[0]
    return float(elapsed.sum()) / 2

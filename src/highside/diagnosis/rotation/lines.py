"""Lines in a rotating recording: fixed frequencies (a hum), and orders of the rotation (something that turns along).

Both are found in the residual of the base fit by a Fourier transform: over the time for frequencies, over the unwrapped
rotor angle for orders (the rows are gathered by their angle first). A line that stands there is tried as a candidate at
its own frequency; how many were looked through is counted against it.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import rfft

from highside.arrays import Array
from highside.diagnosis.rotation.policy import LINES_POLICY
from highside.diagnosis.rows.design import Line
from highside.diagnosis.rows.policy import SPECTRUM
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.rows.spectrum import best_frequency, highest, strongest_line
from highside.physics.effects import all_effects


def found_lines(session: RotationSession, residual: Array) -> list[Line]:
    """The lines worth trying; `residual` (C, n), of which the accelerometers are searched."""
    frequencies = max(session.n // 2, 1)
    of_time, of_turns = (
        [(e.id, e.line) for e in all_effects().values() if e.line is not None and e.line.line_over == over]
        for over in ("time", "turns")
    )
    known = [(name, hz) for name, frequency in of_time for hz in frequency.grid if _visible(session, hz)]
    lines = [Line(name, hz, frequencies) for name, hz in known]
    rows = residual[:3] / residual[:3].std(axis=1, keepdims=True)
    line = strongest_line(rows, session.places)
    if line is not None:
        lines += [Line(name, line / session.step_s, frequencies) for name, _ in of_time]
    order = _order(session, rows)
    if order is not None:
        lines += [Line(name, *order) for name, _ in of_turns]
    return lines


def _visible(session: RotationSession, hz: float) -> bool:
    """Whether a frequency does not fold onto a constant at this rate of sampling."""
    turns = hz * session.step_s
    return abs(turns - round(turns)) > 1.0 / session.n


def _order(session: RotationSession, rows: Array) -> tuple[float, int] | None:
    turned = session.state.tf_rad / (2 * np.pi)
    turned = turned - turned.min()
    turns = float(turned.max())
    if turns < LINES_POLICY.turns:
        return None
    size = int(2 ** np.ceil(np.log2(turns * 2 * LINES_POLICY.max_order * LINES_POLICY.spare)))
    cell = np.minimum((turned / turns * size).astype(np.intp), size - 1)
    gathered = np.stack([np.bincount(cell, weights=row, minlength=size) for row in rows])
    length = SPECTRUM.padded * size
    spectrum = np.abs(rfft(gathered, length, axis=1)) ** 2
    orders = np.arange(spectrum.shape[1]) / turns * (size / length)
    use = orders < LINES_POLICY.max_order
    orders = orders[use]
    near = np.abs(orders - np.round(orders)) < LINES_POLICY.beside / turns
    peak = highest(
        spectrum[:, use],
        (near & (np.round(orders) <= LINES_POLICY.largest_whole)) | (orders < LINES_POLICY.least_order),
    )
    if peak is None:
        return None
    at, channel = peak
    tries = orders[at] + np.linspace(-SPECTRUM.about, SPECTRUM.about, SPECTRUM.finer) / turns
    return best_frequency(tries, turned, rows[channel]), orders.size // SPECTRUM.padded

"""Lines in a rotating recording: fixed frequencies (a hum), and orders of the rotation (something that turns along).

Both are found in the residual of the base fit by a Fourier transform: over the time for frequencies, over the unwrapped
rotor angle for orders (the rows are gathered by their angle first). A line that stands there is tried as a candidate at
its own frequency; how many were looked through is counted against it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from highside.diagnosis.design import Line
from highside.diagnosis.rotation_session import RotationSession

Array = NDArray[np.float64]

MAINS_HZ = (50.0, 60.0)
STANDS_OUT = 3.0
"""A peak must be so many times what the largest of as many chance values is."""
MAX_ORDER = 60.0
LARGEST_WHOLE = 12
"""Whole orders up to this are harmonics of the toolface, which other effects and the scan stand for."""
CELLS_PER_TURN = 512
SMOOTH = 101


def found_lines(session: RotationSession, residual: Array) -> list[Line]:
    """The lines worth trying; `residual` (C, n), of which the accelerometers are searched."""
    frequencies = max(session.n // 2, 1)
    lines = [Line("tone", hz, frequencies) for hz in MAINS_HZ if _visible(session, hz)]
    rows = residual[:3] / residual[:3].std(axis=1, keepdims=True)
    hz = _frequency(session, rows)
    if hz is not None:
        lines.append(Line("tone", hz, frequencies))
    order = _order(session, rows)
    if order is not None:
        lines.append(Line("aliased_vibration", *order))
    return lines


def _visible(session: RotationSession, hz: float) -> bool:
    """Whether a frequency does not fold onto a constant at this rate of sampling."""
    turns = hz * session.step_s
    return abs(turns - round(turns)) > 1.0 / session.n


def _peak(power: Array, skip: NDArray[np.bool_]) -> int | None:
    """The highest peak of a spectrum above its neighbourhood, if it is more than chance gives."""
    from scipy.ndimage import median_filter

    level = median_filter(power, size=min(SMOOTH, power.size | 1), mode="nearest") / np.log(2)
    ratio = np.where(skip, 0.0, power / np.maximum(level, 1e-30))
    at = int(np.argmax(ratio))
    return at if ratio[at] > np.log(power.size) + STANDS_OUT else None


def _frequency(session: RotationSession, rows: Array) -> float | None:
    n = session.n
    spectrum = np.abs(np.fft.rfft(rows, axis=1)) ** 2
    power = spectrum.max(axis=0)
    skip = np.zeros(power.size, dtype=bool)
    # what is slower than a few waves is drift
    skip[:24] = True
    at = _peak(power, skip)
    if at is None:
        return None
    # the frequency between the cells: the best of a fine grid on the row itself
    channel = int(np.argmax(spectrum[:, at]))
    tries = (at + np.linspace(-0.75, 0.75, 31)) / n
    phase = np.exp(-2j * np.pi * tries[:, None] * np.arange(n))
    best = float(tries[int(np.argmax(np.abs(phase @ rows[channel])))])
    return best / session.step_s


def _order(session: RotationSession, rows: Array) -> tuple[float, int] | None:
    turned = session.state.tf_rad / (2 * np.pi)
    turned = turned - turned.min()
    turns = float(turned.max())
    if turns < 3:
        return None
    size = int(2 ** np.ceil(np.log2(turns * 2 * MAX_ORDER * 1.2)))
    cell = np.minimum((turned / turns * size).astype(np.intp), size - 1)
    count = np.bincount(cell, minlength=size)
    gathered = np.stack([np.bincount(cell, weights=row, minlength=size) for row in rows])
    spectrum = np.abs(np.fft.rfft(gathered, axis=1)) ** 2
    orders = np.arange(spectrum.shape[1]) / turns
    use = orders < MAX_ORDER
    power = spectrum.max(axis=0)[use]
    orders = orders[use]
    near = np.abs(orders - np.round(orders)) < 2.5 / turns
    at = _peak(power, (near & (np.round(orders) <= LARGEST_WHOLE)) | (orders < 0.1))
    if at is None or count.max() == 0:
        return None
    channel = int(np.argmax(spectrum[:, at]))
    tries = orders[at] + np.linspace(-0.75, 0.75, 31) / turns
    phase = np.exp(-2j * np.pi * tries[:, None] * turned)
    return float(tries[int(np.argmax(np.abs(phase @ rows[channel])))]), int(orders.size)

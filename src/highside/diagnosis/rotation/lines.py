"""Lines in a rotating recording: fixed frequencies (a hum), and orders of the rotation (something that turns along).

Both are found in the residual of the base fit by a Fourier transform: over the time for frequencies, over the unwrapped
rotor angle for orders (the rows are gathered by their angle first). A line that stands there is tried as a candidate at
its own frequency; how many were looked through is counted against it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

from highside.arrays import Array
from highside.diagnosis.rotation.policy import LINES_POLICY
from highside.diagnosis.rows.design import Line
from highside.diagnosis.rows.session import RotationSession
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
    hz = _frequency(session, rows, flattened(rows))
    if hz is not None:
        lines += [Line(name, hz, frequencies) for name, _ in of_time]
    order = _order(session, rows)
    if order is not None:
        lines += [Line(name, *order) for name, _ in of_turns]
    return lines


def _visible(session: RotationSession, hz: float) -> bool:
    """Whether a frequency does not fold onto a constant at this rate of sampling."""
    turns = hz * session.step_s
    return abs(turns - round(turns)) > 1.0 / session.n


def _peak(power: Array, skip: NDArray[np.bool_]) -> tuple[int, int] | None:
    """Cell and strongest channel of the highest peak of spectra (C, cells) above their neighbourhood, if it is
    more than chance gives: each in units of its local level is exponential, so their sum has a gamma distribution."""
    from scipy.special import gammainccinv

    stretches = np.array_split(power, max(1, power.shape[1] // (LINES_POLICY.padded * LINES_POLICY.smooth)), axis=1)
    level = np.concatenate(
        [np.broadcast_to(np.median(s, axis=1, keepdims=True), s.shape) for s in stretches], axis=1
    ) / np.log(2)
    ratio = power / np.maximum(level, 1e-30)
    total = np.where(skip, 0.0, ratio.sum(axis=0))
    at = int(np.argmax(total))
    limit = float(gammainccinv(power.shape[0], LINES_POLICY.chance / power.shape[1]))
    return (at, int(np.argmax(ratio[:, at]))) if total[at] > limit else None


def flattened(rows: Array) -> Array:
    """Rows (C, n) less what the row before says of each: the median of a neighbourhood is no level of a steep spectrum,
    and a filter of one term has no notch in which a line would hide."""
    before = np.sum(rows[:, 1:] * rows[:, :-1], axis=1) / np.sum(rows**2, axis=1)
    result = rows.copy()
    result[:, 1:] -= before[:, None] * rows[:, :-1]
    return result


def _frequency(session: RotationSession, rows: Array, flat: Array) -> float | None:
    places = session.places
    n = int(places[-1]) + 1
    length = next_fast_len(LINES_POLICY.padded * n, real=True)
    spectrum = np.abs(rfft(on_grid(flat, places), length, axis=1)) ** 2
    skip = np.zeros(spectrum.shape[1], dtype=bool)
    # what is slower than a few waves is drift
    skip[: LINES_POLICY.slowest * length // n] = True
    peak = _peak(spectrum, skip)
    if peak is None:
        return None
    # the frequency between the cells: the best of a fine grid on the row itself
    at, channel = peak
    tries = at / length + np.linspace(-LINES_POLICY.about, LINES_POLICY.about, LINES_POLICY.finer) / n
    best = _best(tries, places, rows[channel])
    return best / session.step_s


def on_grid(rows: Array, places: Array) -> Array:
    """Rows (C, n) at whole places that rise, 0 at those that are missing."""
    if places[-1] - places[0] + 1 == places.size:
        return rows
    filled = np.zeros((len(rows), int(places[-1] - places[0]) + 1))
    filled[:, (places - places[0]).astype(np.intp)] = rows
    return filled


def _best(tries: Array, places: Array, row: Array) -> float:
    """The frequency (cycles for a unit of `places`), of evenly spaced ones, of a wave in a row (n,)."""
    turned = row * np.exp(-2j * np.pi * tries[0] * places)
    onward = np.exp(-2j * np.pi * (tries[1] - tries[0]) * places)
    power = np.empty(tries.size)
    for k in range(tries.size):
        power[k] = np.abs(turned.sum())
        turned *= onward
    return float(tries[int(np.argmax(power))])


def _order(session: RotationSession, rows: Array) -> tuple[float, int] | None:
    turned = session.state.tf_rad / (2 * np.pi)
    turned = turned - turned.min()
    turns = float(turned.max())
    if turns < LINES_POLICY.turns:
        return None
    size = int(2 ** np.ceil(np.log2(turns * 2 * LINES_POLICY.max_order * LINES_POLICY.spare)))
    cell = np.minimum((turned / turns * size).astype(np.intp), size - 1)
    gathered = np.stack([np.bincount(cell, weights=row, minlength=size) for row in rows])
    length = LINES_POLICY.padded * size
    spectrum = np.abs(rfft(gathered, length, axis=1)) ** 2
    orders = np.arange(spectrum.shape[1]) / turns * (size / length)
    use = orders < LINES_POLICY.max_order
    orders = orders[use]
    near = np.abs(orders - np.round(orders)) < LINES_POLICY.beside / turns
    peak = _peak(
        spectrum[:, use],
        (near & (np.round(orders) <= LINES_POLICY.largest_whole)) | (orders < LINES_POLICY.least_order),
    )
    if peak is None:
        return None
    at, channel = peak
    tries = orders[at] + np.linspace(-LINES_POLICY.about, LINES_POLICY.about, LINES_POLICY.finer) / turns
    return _best(tries, turned, rows[channel]), orders.size // LINES_POLICY.padded

"""Lines in a rotating recording: fixed frequencies (a hum), and orders of the rotation (something that turns along).

Both are found in the residual of the base fit by a Fourier transform: over the time for frequencies, over the unwrapped
rotor angle for orders (the rows are gathered by their angle first). A line that stands there is tried as a candidate at
its own frequency; how many were looked through is counted against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.rotation.policy import LINES_POLICY
from highside.diagnosis.rows.design import Line
from highside.diagnosis.rows.policy import SPECTRUM
from highside.diagnosis.rows.session import RotationSession
from highside.diagnosis.rows.spectrum import best_frequency, flattened, heights, highest, strongest_line
from highside.long_arrays import runs_of
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
    part = searched(session)
    some, rows = session.stretch(part), residual[:3, part]
    rows = rows / rows.std(axis=1, keepdims=True)
    line = strongest_line(rows, some.places)
    if line is not None:
        if some.n < session.n:
            line = _over_all_rows(line, 1.0 / some.n, session.places, residual)
        lines += [Line(name, line / session.step_s, frequencies) for name, _ in of_time]
    order = _order(some, rows)
    if order is not None:
        if some.n < session.n:
            turned = session.state.tf_rad / (2 * np.pi)
            order = _over_all_rows(order[0], 1.0 / float(np.ptp(turned[part])), turned, residual), order[1]
        lines += [Line(name, *order) for name, _ in of_turns]
    return lines


def searched(session: RotationSession) -> slice:
    """The rows in which lines are looked for."""
    first = max(0, session.n - LINES_POLICY.most_rows) // 2
    return slice(first, min(session.n, first + LINES_POLICY.most_rows))


def _over_all_rows(frequency: float, width: float, places: Array, residual: Array) -> float:
    """A frequency that is known to `width` from a stretch, as all rows (C, N) at their places (N,) have it.

    Rows are summed in short blocks at the frequency found; what is off by less than a width turns by little in a block.
    """
    sums, middles = [], []
    for part in runs_of(residual.shape[-1], LINES_POLICY.most_rows // LINES_POLICY.blocks):
        own = places[part]
        sums.append(residual[:3, part] @ np.exp(-2j * np.pi * frequency * own))
        middles.append(float(own.mean()))
    at = np.array(middles)
    step = 1.0 / (LINES_POLICY.finer * max(float(np.ptp(at)), 1.0 / width))
    off = np.arange(-np.ceil(width / step), np.ceil(width / step) + 1) * step
    power = np.sum(np.abs(np.array(sums).T @ np.exp(-2j * np.pi * np.outer(at, off))) ** 2, axis=0)
    return float(frequency + off[int(np.argmax(power))])


def _visible(session: RotationSession, hz: float) -> bool:
    """Whether a frequency does not fold onto a constant at this rate of sampling."""
    turns = hz * session.step_s
    return abs(turns - round(turns)) > 1.0 / session.n


@dataclass(frozen=True)
class _Turns:
    """Spectra (C, cells) over the unwrapped rotor angle, the order of each cell, and what they are of."""

    orders: Array
    power: Array
    turned: Array
    """(n,) turns of each row"""

    @property
    def turns(self) -> float:
        """Of the recording."""
        return float(self.turned.max())

    @property
    def count(self) -> int:
        """Orders that can be distinguished."""
        return self.orders.size // SPECTRUM.padded

    def beside_whole(self) -> NDArray[np.bool_]:
        """Cells that belong to a whole order."""
        return np.asarray(np.abs(self.orders - np.round(self.orders)) < LINES_POLICY.beside / self.turns)


def _over_turns(session: RotationSession, rows: Array, *, means: bool = False) -> _Turns | None:
    """Of sums over cells of the angle, or of their means: rows in step with the turn fill cells by a pattern of their
    own, which sums of what is slow show."""
    turned = session.state.tf_rad / (2 * np.pi)
    turned = turned - turned.min()
    turns = float(turned.max())
    if turns < LINES_POLICY.turns:
        return None
    size = int(2 ** np.ceil(np.log2(turns * 2 * LINES_POLICY.max_order * LINES_POLICY.spare)))
    cell = np.minimum((turned / turns * size).astype(np.intp), size - 1)
    gathered: Array = np.stack([np.bincount(cell, weights=row, minlength=size) for row in rows])
    if means:
        gathered = gathered / np.maximum(np.bincount(cell, minlength=size), 1)
    length = SPECTRUM.padded * size
    from scipy.fft import rfft

    spectrum = np.abs(rfft(gathered, length, axis=1)) ** 2
    orders = np.arange(spectrum.shape[1]) / turns * (size / length)
    use = orders < LINES_POLICY.max_order
    return _Turns(orders[use], spectrum[:, use], turned)


def _order(session: RotationSession, rows: Array) -> tuple[float, int] | None:
    """A line whose order is no whole number, and how many orders were looked through. A whole one is a harmonic of the
    toolface: something that turns along as well, but that a vibration makes it no rate of rotation can show."""
    over = _over_turns(session, rows)
    if over is None:
        return None
    low_whole = over.beside_whole() & (np.round(over.orders) <= LINES_POLICY.largest_whole)
    found = _finest(over, rows, low_whole | (over.orders < LINES_POLICY.least_order))
    if found is not None and abs(found - round(found)) * over.turns < LINES_POLICY.whole:
        found = _finest(over, rows, over.beside_whole() | (over.orders < LINES_POLICY.least_order))
    return None if found is None else (found, over.count)


def _finest(over: _Turns, rows: Array, skip: NDArray[np.bool_]) -> float | None:
    """The order of the highest peak, between the cells."""
    peak = highest(over.power, skip)
    if peak is None:
        return None
    at, channel = peak
    tries = over.orders[at] + np.linspace(-SPECTRUM.about, SPECTRUM.about, SPECTRUM.finer) / over.turns
    return best_frequency(tries, over.turned, rows[channel])


def found_orders(session: RotationSession, residual: Array) -> tuple[float, ...]:
    """Orders of the turn above `LINES_POLICY.smooth_orders` at which the residual (C, n) beyond doubt has a line: whole
    ones, the clearest first, and one that is none."""
    rows = flattened(residual[:3] / np.maximum(residual[:3].std(axis=1, keepdims=True), 1e-300))
    over = _over_turns(session, rows, means=True)
    if over is None:
        return ()
    height = np.where(np.round(over.orders) > LINES_POLICY.smooth_orders, heights(over.power).sum(axis=0), 0.0)
    least = max(LINES_POLICY.sure, LINES_POLICY.beside_strongest * float(height.max()))
    whole = np.where(over.beside_whole(), height, 0.0)
    found: list[float] = []
    while len(found) < LINES_POLICY.most_whole and whole.max() >= least:
        found.append(float(np.round(over.orders[int(np.argmax(whole))])))
        whole[np.round(over.orders) == found[-1]] = 0.0
    rest = np.where(over.beside_whole(), 0.0, heights(over.power).sum(axis=0))
    if not found and rest.max() >= LINES_POLICY.sure:
        fraction = _finest(over, rows, over.beside_whole() | (over.orders < LINES_POLICY.least_order))
        found += [] if fraction is None else [fraction]
    return tuple(found)

"""From the rows of a recording to the measurements of a watch: where the tool lay still, where it turned.

Rests are the still intervals that calibration takes (`calibration.still_intervals`), none in which the gyros say it
turned; rotation needs gyros. What is neither, or too short, says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from highside.arrays import Array
from highside.calibration.still_intervals import find_still_intervals
from highside.errors import InputError
from highside.watch.axis_noise import block_means, scatters
from highside.watch.measurement import Still, Turning
from highside.watch.monitor import Watch
from highside.watch.turning import TURNING, Left, TurningRows, fit_turning

__all__ = ["REST", "Calmest", "Rows", "feed", "stills", "turnings", "wanders"]

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class RestPolicy:
    """Of what counts as rest."""

    shortest_s: float = 20.0
    longest_s: float = 600.0
    """of one mean: a longer rest is several"""
    gap_s: float = 30.0
    """without rows, that ends a rest or a window"""
    rate_dps: float = 1.5
    """mean rate from which a tool does not lie still; below it may be a bias of the gyro"""
    rows: float = 10.0
    """in a window in which stillness is judged, at least: the scatter of five falls out of its limits by chance, and
    breaks rests of 10 rows a second"""
    batches: int = 16
    """of a rest, whose scatter says how well its mean is known where its noise is coloured"""
    shaking: float = 4.0
    """scatter of a rest, in units of the calmest one, from which it is none: pumps and rotation elsewhere in the string
    shake a tool that does not turn, and rectify. As `service.stillness` has it of windows (16 of the variance)"""
    calm_memory_s: float = 3600.0
    """in about this time the calmest rest is forgotten: a sensor's noise may grow"""
    moving: float = 30.0
    """scatter of means of two seconds, in units of that in the other rests of a recording, from which the tool moves: a
    turn of 0.1 deg/s makes 3 mg of them, where a good tool at rest has 0.05 mg"""
    bends_g: float = 1e-5
    """by which a direction that wanders within a rest shortens its mean, from which it is none: the floor of a good
    tool's still. A toolface that moves by 1 deg within a rest at 45 deg makes 6 ug, by 5 deg 0.16 mg; 1/f noise of
    0.3 mg makes 0.05 ug"""
    fewest_blocks: int = 5
    """means of two seconds that this is judged by"""
    bends_sigmas: float = 4.0
    """standard deviations by which that must be more than what the readings' own noise makes of it"""


REST = RestPolicy()
_SMOOTH_S = 10.0


@dataclass(frozen=True)
class Rows:
    """A recording: time (N,) s, corrected readings (3, N) g, and what there is of rates (3, N) rad/s, temperature,
    vertical depth in m and vibration rms in g, (N,) each."""

    t_s: Array
    c: Array
    rate_radps: Array | None = None
    temp_c: Array | None = None
    depth_m: Array | None = None
    vibration_g: Array | None = None
    span_s: Array | None = None
    """of rows that are means themselves: `turning.mean_span`"""
    left_out: list[str] = field(default_factory=list)

    def mean_of(self, values: Array | None, rows: Indices) -> float | None:
        """Of a column over some rows; None where it says nothing there."""
        if values is None:
            return None
        part = values[rows]
        part = part[np.isfinite(part)]
        return float(part.mean()) if part.size else None

    def depth_km(self, rows: Indices) -> float | None:
        """Mean depth of some rows, km; None where it is not known."""
        found = self.mean_of(self.depth_m, rows)
        return None if found is None else found / 1000.0


@dataclass
class Calmest:
    """The calmest rest of the last hour: `g`, scatter of a reading along gravity, and when that was last judged."""

    g: float | None = None
    s: float = 0.0

    def shakes(self, still: Still) -> bool:
        """Whether this rest scatters so much more that it is none; it is remembered in any case."""
        scatter = along(still)
        if self.g is None:
            self.g, self.s = scatter, still.t_s
        share = min(max(still.t_s - self.s, 0.0) / REST.calm_memory_s, 1.0)
        before = self.g
        self.g, self.s = min(scatter, before + share * (scatter - before)), still.t_s
        return scatter > REST.shaking * before


def along(still: Still) -> float:
    """Scatter of single readings of a rest along gravity, g."""
    if still.scatter_g is None:
        return 0.0
    f = still.mean_g / np.linalg.norm(still.mean_g)
    return float(np.nan_to_num(np.linalg.norm(f * still.scatter_g[0])))


def feed(watch: Watch, rows: Rows) -> None:
    """Give a watch all that a recording has to say, in the order of time. Raises InputError for too few rows."""
    turning = list(turnings(rows))
    found: list[Still | Turning] = [one for one in turning if isinstance(one, Turning)]
    for left in turning:
        if isinstance(left, Left):
            watch.leave_out(left.reason)
    rests = _rests(rows, 0, rows.t_s.size)
    calm = list(stills(rows, watch.leave_out, rests))
    found += [*calm, *noisy_stills(rows, rests, calm)]
    calmest = Calmest()
    for one in sorted(found, key=lambda one: one.t_s):
        if isinstance(one, Still):
            (watch.shaken if calmest.shakes(one) else watch.still)(one)
        else:
            watch.turning(one)


def stills(rows: Rows, leave_out: Callable[[str], None], rests: Sequence[Indices] | None = None) -> Iterator[Still]:
    """The means at rest, `rests` where they were found already; `leave_out` is told why something that looked like rest
    is none."""
    step = float(np.median(np.diff(rows.t_s)))
    for rest in _rests(rows, 0, rows.t_s.size) if rests is None else rests:
        for piece in _pieces(rows.t_s, rest, REST.longest_s):
            if rows.t_s[piece[-1]] - rows.t_s[piece[0]] < REST.shortest_s - step:
                leave_out("rest too short")
            elif rows.rate_radps is not None and _turns(rows.rate_radps[:, piece]):
                leave_out("rest in which the gyros turn")
            elif wanders(rows.t_s[piece], rows.c[:, piece]):
                leave_out("rest in which the tool moves slowly")
            else:
                yield _still(rows, piece)


def noisy_stills(rows: Rows, rests: Sequence[Indices], calm: Sequence[Still]) -> Iterator[Still]:
    """The rests of a recording that are none by the noise of its calmest parts, which made `rests` and `calm`, but by
    their own: the noise of a sensor may have grown. A stretch of a stream is judged by its own noise as it is."""
    if not calm:
        return
    limit = REST.moving * np.median([one.scatter_g[1] for one in calm if one.scatter_g is not None], axis=0)
    others = np.ones(rows.t_s.size, dtype=bool)
    for rest in rests:
        others[rest[0] : rest[-1] + 1] = False
    for part in _pieces(rows.t_s, np.flatnonzero(others), REST.longest_s):
        # what lies on both sides of a short rest is no one piece
        for run in np.split(part, np.flatnonzero(np.diff(part) > 1) + 1):
            for rest in _rests(rows, int(run[0]), int(run[-1]) + 1):
                lasts = float(rows.t_s[rest[-1]] - rows.t_s[rest[0]])
                if lasts < REST.shortest_s or (rows.rate_radps is not None and _turns(rows.rate_radps[:, rest])):
                    continue
                if wanders(rows.t_s[rest], rows.c[:, rest]):
                    continue
                still = _still(rows, rest)
                if still.scatter_g is not None and (still.scatter_g[1] <= limit).all():
                    yield still


def _rests(rows: Rows, start: int, stop: int) -> list[Indices]:
    """Row numbers of each rest from row `start` to `stop` (excluded), by the noise of these alone."""
    step = float(np.median(np.diff(rows.t_s)))
    window_s = max(0.5, REST.rows * step)
    try:
        found = find_still_intervals(rows.c[:, start:stop], 1.0 / step, min_s=REST.shortest_s, window_s=window_s)
    except InputError:
        return []
    return [start + interval.rows() for interval in found]


def _turns(rate_radps: Array) -> bool:
    """Whether the mean rate (3, K) is more than a bias of the gyros."""
    return bool(np.degrees(np.linalg.norm(np.nanmean(rate_radps, axis=1))) > REST.rate_dps)


def wanders(t_s: Array, c: Array) -> bool:
    """Whether the direction of readings (3, K) moves slowly, so that their mean is shorter than gravity: by half the
    variance of its angle. Of means of two seconds that is what their variance across gravity is more than that of
    neighbours, which noise that is white between them makes alike (von Neumann's ratio, whose variance is 1 / n)."""
    means = block_means(t_s, c)
    n = means.shape[1]
    if n < REST.fewest_blocks:
        return False
    f = means.mean(axis=1)
    f = f / np.linalg.norm(f)
    across = means - np.outer(f, f @ means)
    apart = across - across.mean(axis=1, keepdims=True)
    whole = float(np.sum(apart**2)) / (n - 1)
    of_neighbours = float(np.sum(np.diff(across, axis=1) ** 2)) / (2.0 * (n - 1))
    chance = REST.bends_sigmas * of_neighbours / np.sqrt(n)
    return bool(0.5 * (whole - of_neighbours - chance) > REST.bends_g)


def _still(rows: Rows, piece: Indices) -> Still:
    c = rows.c[:, piece]
    mean = c.mean(axis=1)
    along = mean / np.linalg.norm(mean) @ c
    white = float(along.var(ddof=1)) / along.size
    batches = along[: along.size // REST.batches * REST.batches].reshape(REST.batches, -1).mean(axis=1)
    coloured = float(batches.var(ddof=1)) / REST.batches if batches.size else white
    return Still(
        float(rows.t_s[piece].mean()),
        mean,
        float(np.sqrt(max(white, coloured))),
        rows.mean_of(rows.temp_c, piece),
        rows.depth_km(piece),
        scatters(rows.t_s[piece], c),
    )


def turnings(rows: Rows) -> Iterator[Turning | Left]:
    """The windows of rotation; nothing without gyros."""
    if rows.rate_radps is None:
        return
    rate = rows.rate_radps[2]
    step = float(np.median(np.diff(rows.t_s)))
    # stick-slip stops for a moment in the midst of a turn: judged over ten seconds
    width = max(1, round(_SMOOTH_S / step))
    calm = uniform_filter1d(np.abs(np.nan_to_num(rate)), width, mode="constant")
    turns = np.flatnonzero((calm > np.radians(TURNING.rate_dps)) & np.isfinite(rate))
    for piece in _pieces(rows.t_s, turns, TURNING.window_s):
        lasts = float(rows.t_s[piece[-1]] - rows.t_s[piece[0]])
        if lasts < TURNING.shortest_s:
            # the moving mean of the rate reaches a little into the rests beside a turn
            if lasts > _SMOOTH_S:
                yield Left("rotation too short")
            continue
        vibration = rows.mean_of(rows.vibration_g, piece)
        yield fit_turning(
            TurningRows(
                rows.t_s[piece],
                rows.c[:, piece],
                rate[piece],
                rows.mean_of(rows.temp_c, piece),
                rows.depth_km(piece),
                0.0 if vibration is None else vibration,
                None if rows.span_s is None else rows.span_s[piece],
            )
        )


def _pieces(t: Array, rows: Indices, longest_s: float) -> Iterator[Indices]:
    """Row numbers split at gaps (of rows or of time), and then evenly into pieces no longer than that."""
    if rows.size < 2:
        return
    # a few rows that were taken out of a rest do not end it
    borders = np.flatnonzero(np.diff(t[rows]) > REST.gap_s) + 1
    for part in np.split(rows, borders):
        if part.size < 2:
            continue
        lasts = float(t[part[-1]] - t[part[0]])
        yield from np.array_split(part, max(1, int(np.ceil(lasts / longest_s - 1e-9))))

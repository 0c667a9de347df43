"""Still intervals of a recording, found by the sensor's own noise, and the poses they make.

The scatter of short windows has a floor that is the noise at rest; an interval is still where all windows stay near
that floor and do not step from one to the next. No threshold in g is required of the user.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from highside.arrays import Array
from highside.calibration.poses import Indices, PoseSet
from highside.errors import InputError


@dataclass(frozen=True, slots=True)
class StillInterval:
    """A pose in a recording: rows `start` to `stop` (excluded), without `gaps` (pairs of rows) in which it was
    disturbed.
    """

    start: int
    stop: int
    gaps: tuple[tuple[int, int], ...] = ()

    def rows(self) -> Indices:
        """Indices of the rows in which the tool lay still."""
        keep = np.ones(self.stop - self.start, dtype=bool)
        for first, last in self.gaps:
            keep[first - self.start : last - self.start] = False
        return np.asarray(np.flatnonzero(keep) + self.start, dtype=np.intp)


def find_still_intervals(
    a: Array,
    rate_hz: float,
    *,
    min_s: float = 1.5,
    window_s: float = 0.5,
    labels: Array | None = None,
) -> list[StillInterval]:
    """Find the still intervals of a recording `a` (3, N) sampled at `rate_hz`.

    The noise at rest is the floor of the scatter of short windows, so nothing but the recording itself sets the
    threshold. Neighbouring windows must also agree in their means, which tells a slow turn from rest, and both ends of
    an interval are trimmed until they agree with its middle; one that is too short is followed on into the windows that
    it shares with a movement, as a short hold lies in few whole windows. `labels` (N,), for example a pose number,
    forces a border where it changes. Raises InputError where nothing is still.
    """
    count = a.shape[1]
    width = max(4, round(window_s * rate_hz))
    if a.ndim != 2 or a.shape[0] != 3 or count < 2 * width:
        raise InputError(
            f"{count} rows are too few to look for still intervals", remedy=f"record at least {2 * width} rows"
        )
    blocks = count // width
    windows = a[:, : blocks * width].reshape(3, blocks, width)
    scatter = windows.std(axis=2, ddof=1)
    mean = windows.mean(axis=2)
    noise = _noise_floor(_detrended_scatter(windows, mean))
    still = np.all(scatter <= _SCATTER_FACTOR * noise[:, None], axis=0)
    # the mean of a window scatters by noise / sqrt(width) if white; low-frequency noise of real sensors adds to it
    step = np.abs(np.diff(mean, axis=1))
    quiet_steps = step[:, still[1:] & still[:-1]]
    if quiet_steps.size == 0:
        raise InputError("the tool never lies still in this recording", remedy="hold each pose for a few seconds")
    typical = np.maximum(np.median(quiet_steps, axis=1) / 0.6745, noise / np.sqrt(width))
    joined = np.all(step <= _STEP_FACTOR * typical[:, None], axis=0)
    intervals = []
    start: int | None = None
    for i in range(blocks + 1):
        ends = i == blocks or not still[i] or (i > 0 and not joined[i - 1])
        if ends and start is not None:
            intervals.append(StillInterval(start * width, i * width))
            start = None
        if i < blocks and still[i] and start is None:
            start = i
    if labels is not None:
        intervals = [part for whole in intervals for part in _split_at_labels(whole, labels)]
    trimmed = [_fit_ends(a, interval, noise, width) for interval in intervals]
    merged = _join_disturbed(a, trimmed, noise, labels)
    least = round(min_s * rate_hz)
    merged = [
        whole if whole.rows().size >= least else _to_its_ends(a, whole, noise, width, _room(merged, k, count, labels))
        for k, whole in enumerate(merged)
    ]
    kept = [interval for interval in merged if interval.rows().size >= least]
    if not kept:
        raise InputError(
            f"no interval of {min_s:g} s is still", remedy="hold each pose longer, or give a shorter minimum duration"
        )
    return kept


def labelled_intervals(a: Array, labels: Array) -> list[StillInterval]:
    """The poses of a recording `a` (3, N) whose rows carry a pose number (N,), negative for rows in no pose.

    Each run of one number is a pose; rows in it that depart from its median by more than six times the noise of a
    reading (the way in and out, a touch) are omitted, and a run of which less than half remains was no pose. The noise
    is that between neighbouring rows, median over all runs, so slow readings (one a second) do as well as fast ones.
    """
    borders = np.flatnonzero(np.diff(labels)) + 1
    runs = [
        run for run in pairwise([0, *borders.tolist(), labels.size]) if labels[run[0]] >= 0 and run[1] - run[0] >= 3
    ]
    if not runs:
        raise InputError("no pose number has three rows", remedy="number the rows of each pose, or leave `pose` out")
    steps = [np.diff(a[:, start:stop], axis=1).std(axis=1, ddof=1) for start, stop in runs]
    noise = np.maximum(np.median(steps, axis=0) / np.sqrt(2.0), 1e-12)
    out = []
    for start, stop in runs:
        part = a[:, start:stop]
        good = np.all(np.abs(part - np.median(part, axis=1, keepdims=True)) <= 6.0 * noise[:, None], axis=0)
        if 2 * np.count_nonzero(good) <= good.size:
            continue
        rows = np.flatnonzero(good) + start
        gaps = [(int(lo) + 1, int(hi)) for lo, hi in pairwise(rows) if hi - lo > 1]
        out.append(StillInterval(int(rows[0]), int(rows[-1]) + 1, tuple(gaps)))
    if not out:
        raise InputError("the tool moves in every numbered pose", remedy="number only rows at rest")
    return out


_SCATTER_FACTOR = 2.0
_STEP_FACTOR = 8.0
_SAME_ATTITUDE = 1.5
"""In units of the noise of one reading."""


def _detrended_scatter(windows: Array, mean: Array) -> Array:
    """Standard deviation within each window about its own straight line: a steady turn is no noise. (3, windows)."""
    width = windows.shape[2]
    ramp = np.arange(width) - 0.5 * (width - 1)
    slope = windows @ ramp / (ramp @ ramp)
    rest = windows - mean[:, :, None] - slope[:, :, None] * ramp
    return np.asarray(np.sqrt(np.sum(rest**2, axis=2) / (width - 2)))


def _noise_floor(scatter: Array) -> Array:
    """Noise of one reading (3,): the median scatter of the calm windows, those near the low end of all."""
    low = np.quantile(scatter, 0.2, axis=1)
    calm = scatter <= 1.6 * np.maximum(low, 1e-12)[:, None]
    return np.array([max(float(np.median(row[keep])), 1e-12) for row, keep in zip(scatter, calm, strict=True)])


def _split_at_labels(interval: StillInterval, labels: Array) -> list[StillInterval]:
    part = labels[interval.start : interval.stop]
    borders = np.flatnonzero(part[1:] != part[:-1]) + 1 + interval.start
    edges = [interval.start, *borders.tolist(), interval.stop]
    return [StillInterval(lo, hi) for lo, hi in pairwise(edges)]


def _fit_ends(a: Array, interval: StillInterval, noise: Array, width: int) -> StillInterval:
    """Trim pieces at either end whose mean departs from that of the middle."""
    start, stop = interval.start, interval.stop
    piece = max(2, width // 4)
    while stop - start > 4 * width:
        middle = np.median(a[:, start + width : stop - width], axis=1)
        limit = 6.0 * noise / np.sqrt(piece) + 0.5 * noise
        if np.any(np.abs(a[:, start : start + piece].mean(axis=1) - middle) > limit):
            start += piece
        elif np.any(np.abs(a[:, stop - piece : stop].mean(axis=1) - middle) > limit):
            stop -= piece
        else:
            break
    return StillInterval(start, stop)


def _room(intervals: Sequence[StillInterval], k: int, count: int, labels: Array | None) -> tuple[int, int]:
    """Rows to which an interval may reach: its neighbours, the recording, and the border of its label."""
    low = intervals[k - 1].stop if k else 0
    high = intervals[k + 1].start if k + 1 < len(intervals) else count
    if labels is None:
        return low, high
    own = intervals[k].start
    borders = np.flatnonzero(labels[low + 1 : high] != labels[low : high - 1]) + low + 1
    before, after = borders[borders <= own], borders[borders > own]
    return int(before[-1]) if before.size else low, int(after[0]) if after.size else high


def _to_its_ends(a: Array, interval: StillInterval, noise: Array, width: int, room: tuple[int, int]) -> StillInterval:
    """An interval with the pieces beyond its ends that agree with it, as `_fit_ends` takes off those that do not."""
    start, stop = interval.start, interval.stop
    piece = max(2, width // 4)
    middle = a[:, interval.rows()].mean(axis=1, keepdims=True)
    limit = 6.0 * noise / np.sqrt(piece) + 0.5 * noise

    def agrees(rows: Array) -> bool:
        apart = rows - middle
        return bool(np.all(np.abs(apart.mean(axis=1)) <= limit) and np.all(np.abs(apart) <= 6.0 * noise[:, None]))

    while start - piece >= room[0] and agrees(a[:, start - piece : start]):
        start -= piece
    while stop + piece <= room[1] and agrees(a[:, stop : stop + piece]):
        stop += piece
    return StillInterval(start, stop, interval.gaps)


def _join_disturbed(
    a: Array, intervals: list[StillInterval], noise: Array, labels: Array | None
) -> list[StillInterval]:
    """Join neighbours in the same attitude: one pose, disturbed in between (a touch, a passing vehicle)."""
    out: list[StillInterval] = []
    for interval in intervals:
        if out:
            last = out[-1]
            apart = np.abs(a[:, interval.rows()].mean(axis=1) - a[:, last.rows()].mean(axis=1))
            same_label = labels is None or labels[last.start] == labels[interval.start]
            if same_label and np.all(apart <= _SAME_ATTITUDE * noise):
                out[-1] = StillInterval(last.start, interval.stop, (*last.gaps, (last.stop, interval.start)))
                continue
        out.append(interval)
    return out


def poses_from_intervals(
    a: Array,
    intervals: Sequence[StillInterval],
    *,
    temp_c: Array | None = None,
    inc_ref_rad: Array | None = None,
    tf_ref_rad: Array | None = None,
    direction: Array | None = None,
    where: str | None = None,
) -> PoseSet:
    """Average each interval of the recording `a` (3, N) into a pose. The other rows (N,) are carried along:
    temperature by its mean, the bench's settings and the direction of approach by their median."""
    rows = [interval.rows() for interval in intervals]
    parts = [a[:, row] for row in rows]

    def each(values: Array | None, how: str) -> Array | None:
        if values is None:
            return None
        return np.array([float(np.mean(values[row]) if how == "mean" else np.median(values[row])) for row in rows])

    return PoseSet.build(
        np.stack([part.mean(axis=1) for part in parts], axis=1),
        n=np.array([float(part.shape[1]) for part in parts]),
        std=np.stack([part.std(axis=1, ddof=1) for part in parts], axis=1),
        temp_c=each(temp_c, "mean"),
        inc_ref_rad=each(inc_ref_rad, "median"),
        tf_ref_rad=each(tf_ref_rad, "median"),
        direction=each(direction, "median"),
        where=where,
    )

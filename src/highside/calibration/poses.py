"""The readings of a calibration session: a set of still poses, checked once on the way in, and how to find them.

A *pose* is an interval in which the tool lay still: the mean of its readings, their number and their scatter. On a
bench the turntable says where the tool was (`inc_ref_rad`, `tf_ref_rad`); in a hand session nothing does, and only the
magnitude of gravity is known.

Gravity in the tool frame at inclination I and toolface T is `physics.gravity.gravity_direction`; a bench that is not
level adds a tilt (`physics.effects.base_tilt`). A negative I is the table turned the other way.

Still intervals are found by the sensor's own noise: the scatter of short windows has a floor that is the noise at rest;
an interval is still where all windows stay near that floor and do not step from one to the next. No threshold in g is
asked of the user.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.errors import InputError
from highside.units import STANDARD_GRAVITY_MPS2

Indices = NDArray[np.intp]

DEFAULT_NOISE_G = 50e-6
"""Standard deviation assumed for one reading where a pose table states none."""

SAME_SETTING_RAD = float(np.deg2rad(0.02))
"""Settings of a bench closer than this are the same ring or station; just above the usual step of 0.018 deg."""


SAME_TEMPERATURE_C = 3.0
"""Poses within this of one another belong to one step of an oven cycle."""


def group_settings(values: Array, *, modulo: float | None = None, tolerance: float = SAME_SETTING_RAD) -> Indices:
    """Number the distinct settings among `values` (N,): equal numbers for neighbours within `tolerance`.

    `modulo` folds the values first (2 pi for toolfaces).
    """
    row = np.asarray(values, dtype=float)
    if modulo is not None:
        row = np.mod(row + tolerance, modulo)
    order = np.argsort(row, kind="stable")
    steps = np.diff(row[order]) > tolerance
    groups = np.empty(row.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(steps)]) if row.size else 0
    return groups


@dataclass(frozen=True, slots=True)
class PoseSet:
    """N poses.

    `a` (3, N): raw means in nominal g. `n` (N,): readings averaged. `std` (3, N): standard deviation of one reading in
    g, `std_known` whether it was measured (else `DEFAULT_NOISE_G` stands in and the solver scales it). `inc_ref_rad`,
    `tf_ref_rad` (N,): the bench's settings, None in a session where only |g| is known; inclination may be negative
    (the table turned the other way) or beyond 90 deg. `temp_c` (N,), `direction` (N,; +1 or -1, the side from which the
    pose was approached): None where not recorded. `ids`: one name a pose, for messages.
    """

    a: Array
    n: Array
    std: Array
    ids: tuple[str, ...]
    inc_ref_rad: Array | None = None
    tf_ref_rad: Array | None = None
    temp_c: Array | None = None
    direction: Array | None = None
    std_known: bool = True

    @classmethod
    def build(
        cls,
        a: Array,
        *,
        inc_ref_rad: Array | None = None,
        tf_ref_rad: Array | None = None,
        n: Array | float | None = None,
        std: Array | float | None = None,
        temp_c: Array | None = None,
        direction: Array | None = None,
        ids: Sequence[str] | None = None,
        where: str | None = None,
    ) -> PoseSet:
        """Check and collect. `std` may be one number, (3,) or (3, N). Raises InputError, naming what is wrong.

        `where` names the file for messages.
        """
        a = np.ascontiguousarray(np.asarray(a, dtype=float))
        if a.ndim != 2 or a.shape[0] != 3:
            raise InputError(f"raw means must have the shape (3, N), not {a.shape}", where=where)
        count = a.shape[1]
        if count == 0:
            raise InputError("no poses", where=where, remedy="give one row a pose")
        names = tuple(str(i) for i in ids) if ids is not None else tuple(str(i + 1) for i in range(count))
        if len(names) != count:
            raise InputError(f"{len(names)} names for {count} poses", where=where)
        for axis, row in zip("xyz", a, strict=True):
            _require_finite(row, f"a{axis}", names, where)
        _require_plausible_g(a, names, where)
        if (inc_ref_rad is None) != (tf_ref_rad is None):
            raise InputError(
                "only one of inc_ref_deg and tf_ref_deg is given",
                where=where,
                remedy="give both, or neither for |g| alone",
            )
        inc = _vector(inc_ref_rad, count, "inc_ref_deg", names, where)
        tf = _vector(tf_ref_rad, count, "tf_ref_deg", names, where)
        if inc is not None and np.any(np.abs(inc) > np.pi + 1e-9):
            bad = int(np.argmax(np.abs(inc)))
            raise InputError(
                f"{np.rad2deg(inc[bad]):g} is outside of -180 to 180 deg (pose {names[bad]})",
                where=where,
                field="inc_ref_deg",
            )
        counts = _vector(np.full(count, float(n)) if np.isscalar(n) else n, count, "n", names, where)  # type: ignore[arg-type]
        if counts is None:
            counts = np.ones(count)
        if np.any(counts < 1):
            bad = int(np.argmin(counts))
            raise InputError(
                f"{counts[bad]:g} readings in pose {names[bad]}", where=where, field="n", remedy="n is at least 1"
            )
        if std is None:
            scatter = np.full((3, count), DEFAULT_NOISE_G)
        else:
            given = np.asarray(std, dtype=float)
            scatter = np.array(np.broadcast_to(given[:, None] if given.shape == (3,) else given, (3, count)))
            for axis, row in zip("xyz", scatter, strict=True):
                _require_finite(row, f"std_a{axis}", names, where)
            if np.any(scatter < 0) or np.any(np.mean(scatter, axis=1) <= 0):
                raise InputError(
                    "standard deviations must be positive",
                    where=where,
                    field="std_ax, std_ay, std_az",
                    remedy="leave the columns out if they were not measured",
                )
        return cls(
            a=a,
            n=counts,
            std=scatter,
            ids=names,
            inc_ref_rad=inc,
            tf_ref_rad=tf,
            temp_c=_vector(temp_c, count, "temp_c", names, where),
            direction=_vector(direction, count, "direction", names, where),
            std_known=std is not None,
        )

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, Array | Sequence[str]], *, where: str | None = None, reference: str = "pose"
    ) -> PoseSet:
        """From the columns of a pose table (degrees, g). Raises InputError naming the column that lacks or is wrong.

        `reference` "pose" asks for `inc_ref_deg, tf_ref_deg`; "magnitude" leaves them aside.
        """
        needed = ["ax", "ay", "az"] + (["inc_ref_deg", "tf_ref_deg"] if reference == "pose" else [])
        missing = [name for name in needed if name not in columns]
        if missing:
            raise InputError(
                f"missing column{'s' if len(missing) > 1 else ''} {', '.join(missing)}",
                where=where,
                remedy="a pose table has inc_ref_deg, tf_ref_deg, ax, ay, az (or use --reference magnitude)"
                if reference == "pose"
                else "a pose table has ax, ay, az",
            )
        stds = [name for name in ("std_ax", "std_ay", "std_az") if name in columns]
        if stds and len(stds) < 3:
            raise InputError(
                f"only {', '.join(stds)} of std_ax, std_ay, std_az given", where=where, remedy="give all three, or none"
            )

        def numbers(name: str) -> Array | None:
            return np.asarray(columns[name], dtype=float) if name in columns else None

        def radians(name: str) -> Array | None:
            values = numbers(name) if reference == "pose" else None
            return None if values is None else np.deg2rad(values)

        poses = cls.build(
            np.stack([np.asarray(columns[name], dtype=float) for name in ("ax", "ay", "az")]),
            inc_ref_rad=radians("inc_ref_deg"),
            tf_ref_rad=radians("tf_ref_deg"),
            n=numbers("n"),
            std=np.stack([np.asarray(columns[name], dtype=float) for name in stds]) if stds else None,
            temp_c=numbers("temp_c"),
            direction=numbers("direction"),
            ids=[str(name) for name in columns["pose"]] if "pose" in columns else None,
            where=where,
        )
        poses.require_distinct(where)
        return poses

    def __len__(self) -> int:
        return int(self.a.shape[1])

    @property
    def has_reference(self) -> bool:
        """Whether the bench said where the tool was."""
        return self.inc_ref_rad is not None

    def reference(self) -> tuple[Array, Array]:
        """Inclination and toolface (N,) set by the bench. Raises InputError in a session without."""
        if self.inc_ref_rad is None or self.tf_ref_rad is None:
            raise InputError("the poses have no reference attitude", remedy="use --reference magnitude")
        return self.inc_ref_rad, self.tf_ref_rad

    def noise_of_one(self) -> Array:
        """Standard deviation of one reading (3, N), pooled over the session.

        The scatter of ten readings is itself uncertain by a quarter, so each axis takes the pooled value; a pose that
        is clearly rougher than the pool (vibration, a bumped table) keeps its own.
        """
        dof = np.maximum(self.n - 1.0, 0.25)
        # median first, so that one rough pose does not raise the pool it is compared with
        typical = np.median(self.std, axis=1, keepdims=True)
        calm = self.std <= typical * (1.0 + 5.0 / np.sqrt(2.0 * np.maximum(dof, 1.0)))
        weights = np.where(calm, dof, 0.0)
        pooled = np.sqrt((weights * self.std**2).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True))
        floor = np.where(pooled > 0, pooled, 1e-9)
        return np.where(calm, floor, self.std)

    def noise_of_mean(self) -> Array:
        """Standard deviation (3, N) of the mean of each pose by reading noise alone."""
        return np.asarray(self.noise_of_one() / np.sqrt(self.n))

    def subset(self, keep: NDArray[np.bool_] | Indices) -> PoseSet:
        """The poses selected by a mask or by indices."""
        index = np.flatnonzero(keep) if np.asarray(keep).dtype == bool else np.asarray(keep, dtype=np.intp)

        def cut(values: Array | None) -> Array | None:
            return None if values is None else values[index]

        return replace(
            self,
            a=np.ascontiguousarray(self.a[:, index]),
            n=self.n[index],
            std=self.std[:, index],
            ids=tuple(self.ids[i] for i in index),
            inc_ref_rad=cut(self.inc_ref_rad),
            tf_ref_rad=cut(self.tf_ref_rad),
            temp_c=cut(self.temp_c),
            direction=cut(self.direction),
        )

    def rings(self) -> Indices:
        """Which inclination setting each pose belongs to (N,)."""
        return group_settings(self.reference()[0])

    def stations(self) -> Indices:
        """Which toolface setting each pose belongs to (N,)."""
        return group_settings(self.reference()[1], modulo=2 * np.pi)

    def _vertical(self, index: int) -> bool:
        return self.inc_ref_rad is not None and abs(float(np.sin(self.inc_ref_rad[index]))) < 1e-9

    def label(self, index: int) -> str:
        """How a message names a pose."""
        if self.inc_ref_rad is None or self.tf_ref_rad is None:
            return f"pose {self.ids[index]}"
        inc, tf = np.rad2deg(self.inc_ref_rad[index]), np.rad2deg(self.tf_ref_rad[index])
        return f"pose {self.ids[index]} (inclination {inc:.3f}, toolface {tf:.3f} deg)"

    def require_distinct(self, where: str | None = None) -> None:
        """Raise InputError if two poses have the very same readings: a row copied, not a pose repeated.

        (A vertical tool without noise, as simulated, does read the same at every toolface.)"""
        seen: dict[tuple[float, float, float], int] = {}
        for i, (x, y, z) in enumerate(self.a.T.tolist()):
            j = seen.setdefault((x, y, z), i)
            if j != i and not (self._vertical(i) and self._vertical(j)):
                raise InputError(
                    f"{self.label(j)} and {self.label(i)} are the same reading",
                    where=where,
                    remedy="remove one, or measure again",
                )


def _vector(values: Array | None, count: int, field: str, names: tuple[str, ...], where: str | None) -> Array | None:
    if values is None:
        return None
    row = np.asarray(values, dtype=float)
    if row.shape != (count,):
        raise InputError(f"shape {row.shape} for {count} poses", where=where, field=field)
    _require_finite(row, field, names, where)
    return row


def _require_finite(row: Array, field: str, names: tuple[str, ...], where: str | None) -> None:
    bad = np.flatnonzero(~np.isfinite(row))
    if bad.size:
        raise InputError(
            f"not a number in pose {names[int(bad[0])]}", where=where, field=field, remedy="remove or repeat that pose"
        )


def _require_plausible_g(a: Array, names: tuple[str, ...], where: str | None) -> None:
    size = np.linalg.norm(a, axis=0)
    typical = float(np.median(size))
    if 0.5 < typical < 1.5:
        return
    guesses = {"m/s2": STANDARD_GRAVITY_MPS2, "mg": 1e3, "ug": 1e6}
    unit = next((name for name, one in guesses.items() if 0.9 < typical / one < 1.1), None)
    hint = f"looks like {unit}; divide by {guesses[unit]:g}" if unit else "raw counts must be scaled to nominal g first"
    raise InputError(
        f"the magnitude of a still reading is {typical:.6g}, which cannot be g",
        where=where,
        field="ax, ay, az",
        remedy=hint,
    )


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
    an interval are trimmed until they agree with its middle. `labels` (N,), for example a pose number, forces a border
    where it changes. Raises InputError where nothing is still.
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
    kept = [interval for interval in merged if interval.rows().size >= min_s * rate_hz]
    if not kept:
        raise InputError(
            f"no interval of {min_s:g} s is still", remedy="hold each pose longer, or give a shorter minimum duration"
        )
    return kept


def labelled_intervals(a: Array, labels: Array) -> list[StillInterval]:
    """The poses of a recording `a` (3, N) whose rows carry a pose number (N,), negative for rows in no pose.

    Each run of one number is a pose; rows in it that depart from its median by more than six times the noise of a
    reading (the way in and out, a touch) are left out, and a run of which less than half remains was no pose. The noise
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


def _join_disturbed(
    a: Array, intervals: list[StillInterval], noise: Array, labels: Array | None
) -> list[StillInterval]:
    """Join neighbours in the same attitude: one pose, disturbed in between (a touch, a passing lorry)."""
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

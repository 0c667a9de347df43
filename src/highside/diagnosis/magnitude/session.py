"""From the rows of a recording without reference to still readings, of which only the magnitude of gravity is known.

Two kinds of session are distinguished by themselves. A *hand session* holds the tool still in many attitudes: each
still interval is one reading. A *rest* stays in one attitude, or a few: it says nothing of the sensor's matrix, but
shows what follows time and temperature, so its still rows are averaged in short blocks and all blocks of one attitude
share one direction of gravity.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.still_intervals import StillInterval, find_still_intervals, labelled_intervals
from highside.diagnosis.core.floor import SPREADS, NoiseFloor, floor_of_means, floor_of_table
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.result import DiagnosisResult, Finding, NotTestable, Remainder
from highside.diagnosis.magnitude.policy import MAGNITUDE_SESSIONS
from highside.errors import InputError
from highside.physics.effects import all_effects
from highside.physics.gravity import attitude_of, unit
from highside.physics.state import ChainState

Ints = NDArray[np.intp]


@dataclass(frozen=True)
class MagnitudeSession:
    """n still readings: `mean` (3, n) in g, tool frame; `count` (n,) rows of each; `group` (n,) the attitude each was
    taken in; `rest`: whether these are blocks of a rest, not poses; `found` says in words what was found."""

    mean: Array
    count: Array
    group: Ints
    t_s: Array
    temp_c: Array
    vibration_rms_g: Array
    rest: bool
    attitudes: int
    """distinct attitudes"""
    found: str
    row_seconds: float
    gravity_mps2: float
    began_s: float
    """time of the recording's first row: what follows time does so from there, not from the first reading"""
    floor: NoiseFloor | None = None
    """how well the magnitudes repeat, by the rows within the readings"""
    expected: int = 0
    """readings that were held, whether found still or not; 0 where nothing says how many"""

    @property
    def n(self) -> int:
        """Number of readings."""
        return int(self.mean.shape[1])

    @property
    def few(self) -> bool:
        """Whether these are so few averages that any function of anything fits them, and no law is sought."""
        return not self.rest and self.n < MAGNITUDE_SESSIONS.min_attitudes

    @cached_property
    def direction(self) -> Array:
        """(3, n) unit vectors of the readings as they are, each attitude's mean."""
        return unit(self.by_group(self.mean))

    @property
    def state(self) -> ChainState:
        """The chain's state at the directions of the readings as they are."""
        return self.state_at(self.direction)

    def by_group(self, vectors: Array) -> Array:
        """(3, n) means over the readings of each attitude."""
        groups = int(self.group.max()) + 1
        weight = np.bincount(self.group, weights=self.count, minlength=groups)
        means = np.stack([np.bincount(self.group, weights=self.count * row, minlength=groups) for row in vectors])
        return np.asarray((means / weight)[:, self.group])

    def state_at(self, direction: Array) -> ChainState:
        """The chain's state where gravity points along `direction` (3, n)."""
        inc, tf = attitude_of(direction)
        return ChainState.build(
            inc,
            tf,
            t_s=self.t_s,
            temp_c=self.temp_c,
            vibration_rms_g=self.vibration_rms_g,
            pose=self.group.astype(np.int64),
            row_seconds=self.row_seconds,
            gravity_mps2=self.gravity_mps2,
        )


def magnitude_session(columns: Mapping[str, Array], accel_g: Array, *, gravity_mps2: float) -> MagnitudeSession | str:
    """The still readings of a recording, or in words why it has too few of them to be diagnosed by |g|.

    `columns` (N,) as in the Recording format, `accel_g` (3, N) in the tool frame.
    """
    t_s = columns["t_s"]
    # the usual step, also where frames come in bursts
    rate_hz = max(MAGNITUDE_SESSIONS.least_hz, (t_s.size - 1) / max(float(t_s[-1] - t_s[0]), 1e-9))
    try:
        if "pose" in columns:
            intervals = _labelled(accel_g, np.nan_to_num(columns["pose"], nan=-1.0))
        else:
            intervals = _still(accel_g, rate_hz)
    except InputError as error:
        return error.what
    rows = [interval.rows() for interval in intervals]
    attitudes, found = _announced(accel_g, rows, rate_hz)
    averages = all(r.size == 1 for r in rows)
    known = averages and _floor(columns, accel_g, rows) is not None
    if attitudes >= (MAGNITUDE_SESSIONS.few_attitudes if known else MAGNITUDE_SESSIONS.min_attitudes):
        session = _session(columns, accel_g, rows, np.arange(len(rows)), False, attitudes, found, gravity_mps2)
        return replace(session, expected=_held(columns, accel_g, rate_hz))
    if "pose" not in columns:
        # a rest may drift: without the slow change of the magnitude it is detected whole
        with suppress(InputError):
            intervals = _still(accel_g / _slow_magnitude(accel_g, rate_hz), rate_hz)
    rows = [interval.rows() for interval in intervals]
    attitudes, found = _announced(accel_g, rows, rate_hz)
    still = sum(r.size for r in rows) / rate_hz
    means = np.stack([accel_g[:, r].mean(axis=1) for r in rows], axis=1)
    number = _attitudes(means, MAGNITUDE_SESSIONS.same_rad, MAGNITUDE_SESSIONS.distinct_rad)
    blocks, group = _blocks(intervals, number, rate_hz, still)
    # an attitude that was held only for a moment has a level of its own and shows nothing over time
    long = np.bincount(group, minlength=len(rows)) >= MAGNITUDE_SESSIONS.min_share * len(blocks)
    blocks, group = [b for b, g in zip(blocks, group, strict=True) if long[g]], group[long[group]]
    if still < MAGNITUDE_SESSIONS.min_rest_s or len(blocks) < MAGNITUDE_SESSIONS.min_blocks:
        fewer = f" ({MAGNITUDE_SESSIONS.few_attitudes} with columns n, std_ax, std_ay, std_az: how well they repeat)"
        return (
            f"{found}: for the sensor's matrix at least {MAGNITUDE_SESSIONS.min_attitudes} attitudes"
            f"{fewer if averages else ''} are "
            f"needed, for what follows time or temperature at least {MAGNITUDE_SESSIONS.min_rest_s:.0f} s at rest"
        )
    steady = _without_jumps(accel_g, blocks)
    blocks, group = [blocks[k] for k in steady], group[steady]
    return _session(columns, accel_g, blocks, group, True, attitudes, found, gravity_mps2)


def _labelled(accel_g: Array, pose: Array) -> list[StillInterval]:
    """As numbered; a table has one row a pose, which is an average already."""
    held = np.flatnonzero(pose >= 0)
    if held.size and np.unique(pose[held]).size == held.size:
        return [StillInterval(int(row), int(row) + 1) for row in held]
    return labelled_intervals(accel_g, pose)


def _still(accel_g: Array, rate_hz: float) -> list[StillInterval]:
    return find_still_intervals(
        accel_g, rate_hz, window_s=max(MAGNITUDE_SESSIONS.window_s, MAGNITUDE_SESSIONS.window_rows / rate_hz)
    )


def _held(columns: Mapping[str, Array], accel_g: Array, rate_hz: float) -> int:
    """How often the tool was held, still or not: as numbered, else stretches in which it points nearly the same way."""
    if "pose" in columns:
        pose = columns["pose"]
        return int(np.unique(pose[pose >= 0]).size)
    rows = max(MAGNITUDE_SESSIONS.window_rows, round(MAGNITUDE_SESSIONS.window_s * rate_hz))
    windows = accel_g.shape[1] // rows
    direction = unit(accel_g[:, : windows * rows].reshape(3, windows, rows).mean(axis=2))
    near = np.linalg.norm(np.diff(direction, axis=1), axis=0) < MAGNITUDE_SESSIONS.held_rad
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    lengths = (edges[1::2] - edges[::2] + 1) * rows / rate_hz
    return int(np.sum(lengths >= MAGNITUDE_SESSIONS.held_s))


def _slow_magnitude(accel_g: Array, rate_hz: float) -> Array:
    """(N,) running mean of |a|."""
    from scipy.ndimage import uniform_filter1d

    size = np.linalg.norm(accel_g, axis=0)
    return np.asarray(uniform_filter1d(size, max(1, round(MAGNITUDE_SESSIONS.smooth_s * rate_hz)), mode="nearest"))


def _announced(accel_g: Array, rows: list[Ints], rate_hz: float) -> tuple[int, str]:
    """The number of distinct attitudes, and in words what was found."""
    attitudes = (
        int(
            _attitudes(
                np.stack([accel_g[:, r].mean(axis=1) for r in rows], axis=1), MAGNITUDE_SESSIONS.distinct_rad
            ).max()
        )
        + 1
    )
    if all(r.size == 1 for r in rows):
        return attitudes, f"{len(rows)} averages in {attitudes} attitudes"
    still = sum(r.size for r in rows) / rate_hz
    return attitudes, f"{len(rows)} still intervals in {attitudes} attitudes, {still:.0f} s in all"


def _attitudes(means: Array, apart_rad: float, jump_rad: float = 0.0) -> Ints:
    """Number of the attitude (n,) of each reading (3, n): that of the first one that points the same way.

    Up to a turn of `jump_rad` a reading whose magnitude jumps by more than any turn explains has not turned: a step of
    the sensor tilts its reading too.
    """
    kept: list[int] = []
    direction, size = unit(means), np.linalg.norm(means, axis=0)
    number = np.empty(means.shape[1], dtype=np.intp)
    for i in range(means.shape[1]):
        turned = [float(np.linalg.norm(direction[:, i] - direction[:, k])) for k in kept]
        jumped = [
            abs(float(size[i] - size[k])) > MAGNITUDE_SESSIONS.steep * t for k, t in zip(kept, turned, strict=True)
        ]
        near = [t < apart_rad or (t < jump_rad and jump) for t, jump in zip(turned, jumped, strict=True)]
        number[i] = near.index(True) if any(near) else len(kept)
        if not any(near):
            kept.append(i)
    return number


def _blocks(intervals: list[StillInterval], number: Ints, rate_hz: float, still_s: float) -> tuple[list[Ints], Ints]:
    """Rows of blocks of like length within the intervals, and the attitude of each."""
    length = max(2, round(rate_hz * max(MAGNITUDE_SESSIONS.min_block_s, still_s / MAGNITUDE_SESSIONS.max_blocks)))
    rows: list[Ints] = []
    group: list[int] = []
    for interval, own in zip(intervals, number, strict=True):
        within = interval.rows()
        for part in np.array_split(within, max(1, round(within.size / length))):
            if part.size >= length / 2:
                rows.append(part)
                group.append(int(own))
    return rows, np.array(group, dtype=np.intp)


def _without_jumps(accel_g: Array, blocks: list[Ints]) -> Ints:
    """Numbers of the blocks within which no channel jumps: one that does is half of one level and half of another."""
    halves = np.stack(
        [accel_g[:, b[b.size // 2 :]].mean(axis=1) - accel_g[:, b[: b.size // 2]].mean(axis=1) for b in blocks], axis=1
    )
    usual = INTERVALS.from_mad * np.median(np.abs(halves), axis=1, keepdims=True)
    kept = np.flatnonzero(np.all(np.abs(halves) <= MAGNITUDE_SESSIONS.jump * np.maximum(usual, 1e-12), axis=0))
    return np.asarray(kept if kept.size > len(blocks) / 2 else np.arange(len(blocks)), dtype=np.intp)


def _session(
    columns: Mapping[str, Array],
    accel_g: Array,
    rows: list[Ints],
    group: Ints,
    rest: bool,
    attitudes: int,
    found: str,
    gravity_mps2: float,
) -> MagnitudeSession:
    def each(name: str, neutral: float, power: int = 1) -> Array:
        """(n,) means, or roots of mean powers, over the rows of each reading."""
        column = columns.get(name)
        if column is None or np.isnan(column).all():
            return np.full(len(rows), neutral)
        return np.array([float(np.nanmean(column[r] ** power)) ** (1 / power) for r in rows])

    return MagnitudeSession(
        mean=np.stack([accel_g[:, r].mean(axis=1) for r in rows], axis=1),
        count=np.array([float(r.size) for r in rows]),
        group=np.unique(group, return_inverse=True)[1].reshape(-1),
        t_s=each("t_s", 0.0),
        temp_c=each("temp_c", MAGNITUDE_SESSIONS.room_c),
        vibration_rms_g=each("vibration_rms_g", 0.0, 2),
        rest=rest,
        attitudes=attitudes,
        found=found,
        row_seconds=float(np.median(np.diff(columns["t_s"]))),
        gravity_mps2=gravity_mps2,
        began_s=float(columns["t_s"][0]),
        floor=_floor(columns, accel_g, rows),
    )


def _floor(columns: Mapping[str, Array], accel_g: Array, rows: list[Ints]) -> NoiseFloor | None:
    """How well the magnitudes repeat: by their rows, or of a table of averages by what it says of them."""
    if len(accel_g) == len(SPREADS) and all(r.size == 1 for r in rows):
        floor = floor_of_table(columns, np.array([r[0] for r in rows]))
        if floor is not None:
            return NoiseFloor(np.sqrt(np.mean(floor.sigma**2, axis=0))[None], floor.freedom)
    return floor_of_means(np.linalg.norm(accel_g, axis=0)[None], rows, alike=True)


def nothing_testable(
    why: str, intake: tuple[Finding, ...], seed: int, version: str, needs: str = ""
) -> DiagnosisResult:
    """The answer to a recording that is not still enough: no effect can be tested, why, and what would `need` to be."""
    needs = needs or (
        f"hold the tool still in at least {MAGNITUDE_SESSIONS.min_attitudes} attitudes all over the sphere, a few "
        "seconds each, or leave it at rest for minutes; or record its attitude"
    )
    effects = [e for e in all_effects().values() if not e.random]
    return DiagnosisResult(
        "not_testable",
        remainder=Remainder(hints=(why,)),
        not_testable=tuple(NotTestable(e.id, why, needs) for e in effects),
        intake=intake,
        noise={"model": "none", "reference": why},
        seed=seed,
        version=version,
    )

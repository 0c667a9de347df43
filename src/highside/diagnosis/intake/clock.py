"""Intake checks of the frames' order and times: reversed, reordered, lost and repeated frames, a clock that steps or
drifts.

A healthy link may lose, repeat or disorder a frame in ten thousand (`CLOCK.stray`); the p-values are exact binomial
tails beyond that. The clock is judged by its own regularity: times that jitter by more than `CLOCK.jitter` of their
spacing (times of arrival) cannot show a small step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.floor import lattice_step
from highside.diagnosis.core.policy import INTERVALS
from highside.diagnosis.core.probability import straight_line, student_beyond
from highside.diagnosis.core.result import Finding
from highside.diagnosis.intake.policy import CLOCK
from highside.physics.effects.dropped_frames import EFFECT as DROPPED_FRAMES


def chance(count: int, of: int, rate: float) -> float:
    """Probability of at least `count` among `of` where each happens with `rate`: an exact binomial tail."""
    from highside.special import bdtrc

    return 1.0 if count <= 0 else float(bdtrc(count - 1, of, rate))


def clock_findings(columns: Mapping[str, Array], held: NDArray[np.bool_]) -> list[tuple[Finding, bool]]:
    """What is wrong with the times (N,) and the counter, each with whether it spoils the recording.

    `held` (N,) are the rows of stops; between stops a recording may pause.
    """
    t_s = columns["t_s"]
    steps = np.diff(t_s)
    n = steps.size
    if n < 2:
        return []
    back = int(np.sum(steps < 0))
    if back > n / 2:
        return [(Finding("reversed_time", ("t_s",), chance(back, n, 0.5), "sort the rows by time"), True)]
    found: list[tuple[Finding, bool]] = []
    seq = columns["seq"] if "seq" in columns and not np.isnan(columns["seq"]).any() else None
    pose = columns.get("pose", np.zeros(n + 1))
    inside = (pose[1:] == pose[:-1]) & held[1:] & held[:-1]
    forward = steps[inside & (steps > 0)]
    usual = float(np.median(forward)) if forward.size else 0.0
    stepped = _steps_back(t_s, usual)
    if back > len(stepped):
        most = float(-steps.min())
        words = (
            f"{back} rows are out of order, by {most:.4g} s at most: sort by time or counter, or correct the times if "
            "the clock was set back"
        )
        found.append((Finding("reordered_frames", ("t_s",), chance(back, n, CLOCK.stray), words), True))
    if usual <= 0:
        return found
    found += _lost(steps, inside, usual, seq)
    found += _clock(t_s, steps, inside, usual, seq, stepped)
    return found


def _lost(steps: Array, inside: NDArray[np.bool_], usual: float, seq: Array | None) -> list[tuple[Finding, bool]]:
    """Frames that are missing, by the counter, else by gaps within a stop."""
    n = steps.size
    if seq is not None:
        jumps = np.diff(seq)
        lost = int(np.sum(np.maximum(jumps[jumps > 0] - 1, 0)))
        gaps = int(np.sum(jumps > 1))
    else:
        missing = np.round(steps[inside & (steps > 0)] / usual) - 1
        lost, gaps = int(np.sum(missing)), int(np.sum(missing > 0))
        # a stop that lost its first or last rows has no gap, but fewer rows than the others
        sizes = np.diff(np.concatenate([[0], np.flatnonzero(~inside) + 1, [n + 1]]))
        usual_size = np.bincount(sizes).argmax()
        if (
            sizes.size > CLOCK.least_stops
            and usual_size > CLOCK.least_stop
            and np.mean(sizes == usual_size) > CLOCK.alike
        ):
            short = int(np.sum(np.maximum(usual_size - sizes, 0)))
            lost, gaps = max((lost, gaps), (short, int(np.sum(sizes < usual_size))))
    p = chance(lost, n + lost, CLOCK.stray)
    if lost == 0 or p >= CLOCK.sure:
        return []
    share = lost / (n + lost)
    spoils = share > CLOCK.lost_share
    words = f"{lost} frames are lost in {gaps} gaps ({share:.1%}): " + (
        "check the link and record again"
        if spoils
        else "few enough to go on with"
        if share < CLOCK.lost_few
        else "the rows that are there are diagnosed, each at its own time; check the link"
    )
    return [(Finding(DROPPED_FRAMES.id, ("seq" if seq is not None else "t_s",), p, words), spoils)]


def _steps_back(t_s: Array, usual: float) -> list[int]:
    """Rows at which time falls back and goes on from there: the clock was set back; disordered rows recover at once."""
    found = []
    for k in np.flatnonzero(np.diff(t_s) < 0)[: CLOCK.look]:
        ahead = t_s[k + 1 : k + 1 + CLOCK.look]
        # a row that came late is followed by a jump forward to where time had been
        if ahead.size > CLOCK.around and np.all(np.diff(ahead) > 0) and np.all(np.diff(ahead) < CLOCK.even * usual):
            before = t_s[max(0, k - CLOCK.around) : k + 1]
            if (
                np.all(np.diff(before) > 0)
                and t_s[k] - t_s[k + 1] > CLOCK.back * usual
                and np.all(np.diff(before) < CLOCK.even * usual)
            ):
                found.append(int(k) + 1)
    return found


def _clock(
    t_s: Array, steps: Array, inside: NDArray[np.bool_], usual: float, seq: Array | None, back: list[int]
) -> list[tuple[Finding, bool]]:
    found: list[tuple[Finding, bool]] = []
    if back:
        words = f"the clock is set back at t = {t_s[back[0] - 1]:g} s: add the step to the times behind it"
        found.append(
            (Finding("clock_step", ("t_s",), chance(len(back), steps.size, CLOCK.stray / CLOCK.rarer), words), True)
        )
    single = inside & (steps > 0)
    if seq is not None:
        single &= np.diff(seq) == 1
    else:
        # whole spacings more are a gap, not a step of the clock
        single &= np.round(steps / usual) <= 1
    each = steps[single]
    if each.size < CLOCK.look:
        return found
    scatter = INTERVALS.from_mad * float(np.median(np.abs(each - np.median(each))))
    jitter = max(scatter, CLOCK.exact * usual, 1e-9)
    if scatter > CLOCK.jitter * usual:
        return found
    # heavy-tailed jitter is healthy: a step must be a rare one among the spacings themselves
    wide = np.abs(each - np.median(each))
    jumps = np.flatnonzero((wide > CLOCK.step * usual) & (wide > CLOCK.step_jitters * jitter))
    if 0 < jumps.size <= CLOCK.steps:
        p = float(min(1.0, each.size * student_beyond(wide[jumps].max() / jitter, CLOCK.tails)))
        if p < CLOCK.sure:
            row = np.flatnonzero(single)[jumps[0]]
            size = float(each[jumps[0]] - np.median(each))
            words = f"the clock steps by {size:+.4g} s at t = {t_s[row]:g} s without a frame lost: correct the times"
            found.append((Finding("clock_step", ("t_s",), p, words), True))
    found += _drift(each, np.flatnonzero(single), usual, jitter)
    return found


def _drift(each: Array, rows: NDArray[np.intp], usual: float, jitter: float) -> list[tuple[Finding, bool]]:
    """Spacings that grow or shrink steadily: a straight line through them, by medians of twenty parts."""
    parts = [p for p in np.array_split(np.arange(each.size), CLOCK.parts) if p.size]
    at = np.array([rows[p].mean() for p in parts])
    level = np.array([np.median(each[p]) for p in parts])
    slope, p = straight_line(at, level)
    change = float(slope * np.ptp(rows)) / usual
    if p < CLOCK.sure and abs(change) > CLOCK.least_drift and abs(change) * usual > jitter / CLOCK.drift_jitters:
        words = f"the clock's rate changes by {change:+.2%} over the recording: use a clock that counts frames evenly"
        return [(Finding("clock_drift", ("t_s",), p, words), abs(change) > CLOCK.drift)]
    return []


def duplicates(columns: Mapping[str, Array], held: NDArray[np.bool_], accel: Array) -> list[Finding]:
    """Frames that arrived twice: equal counters, or neighbours equal in all channels more often than others are."""
    n = accel.shape[1]
    if n < 3:
        return []
    if "seq" in columns and not np.isnan(columns["seq"]).any():
        twice = int(np.sum(np.diff(columns["seq"]) == 0))
        p = chance(twice, n, CLOCK.stray)
    else:
        poses = "pose" in columns
        twice, of, usual = _equal_in_poses(accel, columns["pose"][held]) if poses else _equal(accel)
        p = chance(twice, of, max(usual, CLOCK.stray))
    if twice and p < CLOCK.sure:
        words = f"{twice} frames are there twice: remove the copies"
        return [Finding("duplicated_frames", ("ax", "ay", "az"), p, words)]
    return []


def _equal(accel: Array) -> tuple[int, int, float]:
    """How many neighbours of (3, n) are equal in all channels, of how many, and how large a share of them may be."""
    same = np.all(np.diff(accel, axis=1) == 0, axis=0)
    apart = np.append(np.all(accel[:, 2:] == accel[:, :-2], axis=0), False)
    stays = _within_a_step(accel)
    moving = stays < CLOCK.moving
    if moving.mean() < CLOCK.half:
        # at rest a coarse converter repeats what it says, as often two rows apart
        moving = np.ones(same.size, dtype=bool)
        stays = np.zeros(same.size)
    usual = max(float(apart[moving].mean()) * CLOCK.twice, float(stays[moving].mean()))
    return int(same[moving].sum()), int(moving.sum()), usual


def _equal_in_poses(accel: Array, pose: Array) -> tuple[int, int, float]:
    """The same within the poses (n,) of a stepped session.

    There a coarse converter repeats what it says as often two rows apart; while a pose drifts, by what it drifts from
    row to row more often. Poses of two rows say nothing of that.
    """
    inside = np.diff(pose) == 0
    both = inside[1:] & inside[:-1]
    if both.sum() < CLOCK.look:
        return 0, 1, 1.0
    same = np.all(np.diff(accel, axis=1) == 0, axis=0)[inside]
    apart = float(np.all(accel[:, 2:] == accel[:, :-2], axis=0)[both].mean())
    stays = np.ones(inside.size)
    for row in accel:
        step = lattice_step(row)
        drift = _drift_of_poses(row, pose)
        stays *= np.maximum(1.0 - np.abs(drift) / step, 0.0) if step > 0.0 else drift == 0.0
    drifts = float(np.minimum(stays, apart + 1.0 - stays)[inside].mean())
    return int(same.sum()), same.size, max(apart * CLOCK.twice, drifts)


def _within_a_step(accel: Array) -> Array:
    """Chance (n - 1,), at most, that a converter's steps make neighbouring rows of (3, n) equal: what moves by a part
    of a step from row to row stays on it as often as the rest of it says. 0 where readings lie on no lattice."""
    alike = np.ones(accel.shape[1] - 1)
    width = 2 * CLOCK.near + 1
    for row in accel:
        if np.ptp(row) == 0.0:
            continue
        step = lattice_step(row)
        if step == 0.0 or row.size <= width:
            return np.zeros(alike.size)
        # the motion of the tool, not the noise of one row
        slope = np.convolve(np.diff(row), np.full(width, 1.0 / width), mode="same")
        alike *= np.maximum(1.0 - np.abs(slope) / step, 0.0)
    return alike


def _drift_of_poses(row: Array, pose: Array) -> Array:
    """(n - 1,) by how much a channel (n,) drifts from row to row of its pose; none where that is its noise."""
    poses = [own for own in np.split(np.arange(row.size), np.flatnonzero(np.diff(pose) != 0) + 1) if own.size > 2]
    slope = np.zeros(row.size - 1)
    if not poses:
        return slope
    noise = float(np.mean(np.concatenate([np.diff(row[own], n=2) for own in poses]) ** 2)) / (1 + 4 + 1)
    for own in poses:
        about = np.arange(own.size) - 0.5 * (own.size - 1)
        power = float(about @ about)
        each = float(about @ row[own]) / power
        slope[own[:-1]] = each if each**2 * power > CLOCK.drifts**2 * noise else 0.0
    return slope

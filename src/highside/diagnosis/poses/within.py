"""What happens within a pose: readings that settle, creep or oscillate while the tool stands still.

A pose counts by its mean, so what its rows do about that mean would be lost. It is looked at here: the rows of all
poses, each less its own mean, laid over one another by the time since the stop. A common course (settling of a bench,
warm-up at each stop) shows in the mean over poses, whatever its shape, and one that grows with the load in what runs
with the poses' readings; a course that differs from pose to pose (creep after a change of load) in the size of the
poses' trends, beyond what neighbouring differences of the rows allow; an oscillation as a line in their spectra.
Whatever else the rows do shows beside the means: noise that scatters the rows by so much leaves the means no better
known than that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.floor import lattice_step, rounding_variance, step_of_rounding
from highside.diagnosis.core.result import DiagnosisResult, Finding
from highside.diagnosis.core.unexplained import in_ug
from highside.diagnosis.poses.policy import WITHIN
from highside.special import fdtrc

Ints = NDArray[np.intp]
CHANNELS = ("ax", "ay", "az")
CHECK = "within_pose"
UNSTEADY = "readings move while a pose is held, by more than their mean does from pose to pose"


@dataclass(frozen=True)
class _Course:
    """What the rows of a channel do within a pose, in words, with its size (g, from start to end) and p of chance."""

    words: str
    size_g: float
    p: float


def within_poses(accel_g: Array, rows: Sequence[Ints], row_seconds: float) -> tuple[Finding, ...]:
    """What the rows (3, N) do within poses of these row numbers; one finding a kind of course."""
    length = int(np.median([r.size for r in rows])) if rows else 0
    kept = [r[:length] for r in rows if r.size >= length]
    if length < WITHIN.fewest_rows or len(kept) < WITHIN.least_poses:
        return ()
    means = np.stack([accel_g[:, r].mean(axis=1) for r in kept])
    found: dict[str, list[tuple[str, _Course]]] = {}
    for c, name in enumerate(CHANNELS):
        stacked = np.stack([accel_g[c, r] for r in kept])
        left = stacked - stacked.mean(axis=1, keepdims=True)
        rounding = _rounding(stacked, left)
        courses = _courses(left, row_seconds, rounding) if length >= WITHIN.least_rows else []
        for course in courses or _of_any_shape(left, means, row_seconds, rounding):
            # where rows stay on their step or leave it, what is less than one is none of theirs
            if course.size_g < step_of_rounding(rounding):
                continue
            found.setdefault(course.words, []).append((name, course))
    return tuple(_finding(words, each) for words, each in found.items())


def moving_pose(accel_g: Array, rows: Sequence[Ints]) -> tuple[int, Finding] | None:
    """Which pose it is in which rows (3, N) move far more than in all others, and by more than they scatter there; None
    where there is none.

    Its trend, all channels together, is compared with the median of all poses' (of a normal deviate's square), and with
    what the pose's own rows leave of it: noise that is louder in one pose scatters there, and does not go one way.
    """
    kept = [(k, r) for k, r in enumerate(rows) if r.size >= WITHIN.fewest_rows]
    if len(kept) < WITHIN.least_poses:
        return None
    trend, one_way = np.empty((2, len(accel_g), len(kept)))
    ranges, usual = np.empty((len(accel_g), len(kept))), np.empty((len(accel_g), 1))
    for c, channel in enumerate(accel_g):
        from_mean = [channel[r] - np.mean(channel[r]) for _, r in kept]
        far = WITHIN.clipped * float(np.median(np.abs(np.concatenate(from_mean)))) / WITHIN.mad
        for k, values in enumerate(from_mean):
            line = np.linspace(-1.0, 1.0, values.size)
            line /= np.linalg.norm(line)
            # a single row that is far off is no trend
            trend[c, k] = float(np.clip(values, -far, far) @ line) ** 2
            ranges[c, k] = np.ptp(values)
            along = float(values @ line) ** 2
            one_way[c, k] = along / max(float(values @ values) - along, 1e-300)
        rounding = rounding_variance(lattice_step(np.concatenate([channel[r] for _, r in kept])))
        usual[c] = max(float(np.median(trend[c])) / WITHIN.mad**2, rounding, 1e-300)
    ratio = np.sum(trend / usual, axis=0)
    freedom = np.array([r.size - 2.0 for _, r in kept]) * len(accel_g)
    own = np.sum(one_way, axis=0) * freedom / len(accel_g) ** 2
    known = len(accel_g) * WITHIN.of_a_median * len(kept)
    p = len(kept) * np.array([float(fdtrc(len(accel_g), known, one / len(accel_g))) for one in ratio])
    alone = np.array([float(fdtrc(len(accel_g), f, one)) for f, one in zip(freedom, own, strict=True)])
    # of many that are loud one goes one way by chance
    alone = alone * max(np.count_nonzero(p < WITHIN.chance), 1)
    k = int(np.argmin(np.where(alone < WITHIN.goes_one_way, p, 1.0)))
    if not (p[k] < WITHIN.chance and alone[k] < WITHIN.goes_one_way):
        return None
    words = f"readings move while pose {kept[k][0] + 1} is held, unlike in the others"
    which = np.flatnonzero(trend[:, k] / usual[:, 0] > ratio[k] / len(accel_g) ** 2)
    each = [(CHANNELS[c], _Course(words, float(ranges[c, k]), float(p[k]))) for c in which]
    return (kept[k][0], _finding(words, each)) if each else None


def _of_any_shape(left: Array, means: Array, row_seconds: float, rounding: float) -> list[_Course]:
    """A course of any shape that rows (poses, length) have in common, and one that grows with the poses' means
    (poses, 3), from rows less their means, of noise of at least this variance.

    What the poses share is compared with what they do not: sums of squares whose degrees of freedom are those of rows
    correlated as they are (Satterthwaite, Biometrics Bull. 2, 1946; the trace of a squared covariance from few samples:
    Srivastava, J. Japan Statist. Soc. 35, 2005).
    """
    poses, length = left.shape
    loads = means - means.mean(axis=0)
    u, size, _ = np.linalg.svd(loads, full_matrices=False)
    # columns (poses,) of unit size: a common course, and the loads that differ from pose to pose
    axes = [np.full((poses, 1), poses**-0.5), u[:, size > WITHIN.least_load * np.sqrt(poses)]]
    many = poses - sum(one.shape[1] for one in axes)
    if many < WITHIN.least_poses - 1:
        axes, many = axes[:1], poses - 1
    own = left - sum(one @ (one.T @ left) for one in axes)
    covariance = own.T @ own / many
    noise = max(float(np.trace(covariance)), rounding * (length - 1))
    if noise <= 0.0:
        return []
    squared = float(np.sum(covariance**2)) - float(np.trace(covariance)) ** 2 / many
    squared = max(squared * many**2 / ((many - 1) * (many + 2)), noise**2 / (length - 1))
    freedom = noise**2 / squared
    found = []
    for number, one in enumerate(axes):
        columns = one.shape[1]
        runs = one.T @ left
        gain = float(np.sum(runs**2)) / noise
        p = float(fdtrc(columns * freedom, many * freedom, gain / columns)) if columns else 1.0
        if p >= WITHIN.chance or gain <= WITHIN.share * freedom:
            continue
        course = left.mean(axis=0) if number == 0 else _largest(one @ runs)
        words = (
            _settles(course, row_seconds)
            if number == 0
            else "readings drift while a pose is held, in proportion to its load"
        )
        found.append(_Course(words, float(np.ptp(course)), p))
    return found


def _largest(courses: Array) -> Array:
    """(length,) the course of the pose in which it is largest."""
    return np.asarray(courses[int(np.argmax(np.ptp(courses, axis=1)))])


def _rounding(rows: Array, left: Array) -> float:
    """Variance that rounding adds to rows (poses, length): where a converter's step is coarser than their noise they
    stay or jump by a whole step, and the scatter of most poses tells nothing of those that jump."""
    step = lattice_step(rows)
    return rounding_variance(step) if float(np.std(left)) < FLOOR.dither * step else 0.0


def unsteady_poses(scatter: Array, count: Array, sigma_g: Array, freedom: float) -> tuple[Finding, ...]:
    """Channels whose rows scatter within the poses by far more than the means of these do about the fit.

    `scatter` (3, n): standard deviation of a row in each pose, of `count` (n,) rows; `sigma_g` (3,): that of a mean, as
    the fit leaves it, with so many degrees of freedom. A walk or any noise with a memory moves the means more.
    """
    ratio = np.sqrt(np.mean(scatter**2 / count, axis=1)) / np.maximum(sigma_g, 1e-300)
    p = fdtrc(float(np.sum(count - 1)), freedom, ratio**2)
    which = np.flatnonzero((ratio > WITHIN.unsteady) & (p < WITHIN.chance))
    size = np.sqrt(np.mean(scatter**2, axis=1))
    each = [(CHANNELS[c], _Course(UNSTEADY, float(size[c]), float(p[c]))) for c in which]
    return (_finding(UNSTEADY, each),) if each else ()


def with_courses(diagnosis: DiagnosisResult, found: Sequence[Finding]) -> DiagnosisResult:
    """The diagnosis with what happens within poses: where that is, the simulation has not explained the recording."""
    if not found:
        return diagnosis
    hints = (*(f"{', '.join(one.channels)}: {one.remedy}" for one in found), *diagnosis.remainder.hints)
    remainder = replace(diagnosis.remainder, hints=hints)
    if diagnosis.verdict == "nothing_left_out":
        p = min(one.p for one in found)
        return replace(
            diagnosis, verdict="unknown", remainder=replace(remainder, p=p), intake=(*diagnosis.intake, *found)
        )
    return replace(diagnosis, remainder=remainder, intake=(*diagnosis.intake, *found))


def _finding(words: str, each: Sequence[tuple[str, _Course]]) -> Finding:
    sizes = ", ".join(f"{name} by {in_ug(course.size_g)}" for name, course in each)
    remedy = f"{words}: {sizes}; wait longer before a pose is read, or look for what moves"
    return Finding(CHECK, tuple(name for name, _ in each), min(course.p for _, course in each), remedy)


def _courses(left: Array, row_seconds: float, rounding: float) -> list[_Course]:
    """Courses of a channel from rows (poses, length) less their means, of noise of at least this variance."""
    poses, length = left.shape
    shapes = _shapes(length)
    phi = _memory(left - (left @ shapes.T) @ shapes)
    # rows that are correlated trend by chance: what a filter makes independent is tested
    white, design = _clipped(_filtered(left, phi)), _filtered(np.vstack([np.ones(length), shapes]), phi)
    q, r = np.linalg.qr(design.T)
    scores = white @ q
    freedom = poses * (length - 1 - len(design))
    noise = max(float(np.sum((white - scores @ q.T) ** 2)) / freedom, rounding * (1 + phi**2))
    if noise <= 0.0:
        return []
    trends = scores[:, 1:]
    found = []
    # the poses' own trends about the course that all have in common, which is no more than their mean
    common, shares = trends.mean(axis=0), (poses - 1) * len(shapes)
    square = float(np.sum((trends - common) ** 2)) / (noise * shares)
    own = float(fdtrc(shares, freedom, square))
    each_its_own = own < WITHIN.chance and square > WITHIN.least_ratio
    scatter, known = (noise * square, shares) if each_its_own else (noise, freedom)
    gain = poses * float(common @ common)
    p = float(fdtrc(len(shapes), known, gain / scatter / len(shapes)))
    if p < WITHIN.chance and gain > WITHIN.share * length * noise:
        course = (left.mean(axis=0) @ shapes.T) @ shapes
        found.append(_Course(_settles(course, row_seconds), float(np.ptp(course)), p))
    if each_its_own:
        each = np.linalg.solve(r, (scores - scores.mean(axis=0)).T)[1:].T @ shapes
        excess = 1.0 - 1.0 / square
        size = float(np.sqrt(excess * np.mean(np.ptp(each, axis=1) ** 2)))
        found.append(_Course("readings creep while a pose is held, each pose its own way", size, own))
    line = _line(left - (left @ shapes.T) @ shapes, phi, row_seconds)
    return [*found, *([line] if line is not None else [])]


def _memory(left: Array) -> float:
    """Correlation of neighbouring rows (poses, length) about their mean and trends, with what taking these off costs
    (Kendall, Biometrika 41, 1954, for the mean; as much again for a trend)."""
    length = left.shape[1]
    found = float(np.sum(left[:, 1:] * left[:, :-1]) / max(float(np.sum(left**2)), 1e-300)) * length / (length - 1)
    return float(np.clip(found + (2 + 4 * found) / length, 0.0, WITHIN.most_memory))


def _filtered(rows: Array, phi: float) -> Array:
    """Rows (m, length) without their correlation, (m, length - 1)."""
    return np.asarray(rows[:, 1:] - phi * rows[:, :-1])


def _clipped(rows: Array) -> Array:
    """Rows with single values far from all others brought in: one at the end of a pose is no trend of it."""
    far = WITHIN.clipped * float(np.median(np.abs(rows))) / WITHIN.mad
    return np.clip(rows, -far, far) if far > 0.0 else rows


def _settles(course: Array, row_seconds: float) -> str:
    """The common course in words: one that dies away, or one that goes on."""
    third = max(1, course.size // 3)
    early, late = abs(course[0] - course[third]), abs(course[-third] - course[-1])
    if early > WITHIN.settled * late:
        return f"readings settle within the first {third * row_seconds:.2g} s of each pose"
    return "readings drift alike in every pose"


def _shapes(length: int) -> Array:
    """(2, length) orthonormal: a straight line, and a decay over a fifth of the pose beyond it."""
    u = np.linspace(0.0, 1.0, length)
    q, _ = np.linalg.qr(np.stack([np.ones(length), u, np.exp(-u / WITHIN.decay)]).T)
    return np.asarray(q[:, 1:].T)


def _line(left: Array, phi: float, row_seconds: float) -> _Course | None:
    """An oscillation that stands out of the mean spectrum of the poses."""
    rows = _filtered(left, phi)
    window = np.hanning(rows.shape[1])
    power = np.mean(np.abs(np.fft.rfft(rows * window, axis=1)) ** 2, axis=0)[WITHIN.first_cell : -1]
    if power.size < 2 * WITHIN.cells:
        return None
    at = int(np.argmax(power))
    cells = np.abs(np.arange(power.size) - at)
    near = (cells > WITHIN.lobe) & (cells <= WITHIN.cells)
    level = float(np.mean(power[near]))
    # a mean over poses of exponentials: a chi-square with two degrees of freedom a pose
    p = power.size * float(fdtrc(2 * len(left), 2 * len(left) * int(near.sum()) / WITHIN.lobe, power[at] / level))
    if p > WITHIN.chance or power[at] < WITHIN.line_ratio * level:
        return None
    turns = (at + WITHIN.first_cell) / rows.shape[1]
    passed = abs(1.0 - phi * np.exp(-2j * np.pi * turns))
    size = 4 * float(np.sqrt(max(power[at] - level, 0.0))) / float(window.sum()) / passed
    return _Course(f"readings oscillate at {turns / row_seconds:.3g} Hz while a pose is held", size, min(p, 1.0))

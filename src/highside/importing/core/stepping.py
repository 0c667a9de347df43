"""What a step of time that is wider than the others is: rows lost, a row written late, a step of the clock.

Of a row k the residual is t_k - k u, with u the mean of the regular steps. Rows that were lost move it by a whole
number of steps for good; a row that was only written late moves it for itself, and the next ones come sooner; a clock
that is set forward moves it for good by any amount. So the residuals before a wide step and behind it are compared, by
their medians over some rows. A counter of the rows, where there is one, says how many are missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.importing.core.policy import POLICY, ImportPolicy
from highside.importing.core.source import Numbers

Nanoseconds = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class WideSteps:
    """Of each (K,): the place of the row behind it among the ordered rows, how many rows are missing, and by how many
    ns the clock stepped instead. Neither: a row that was written late. `usual_ns`: the mean of the regular steps."""

    after: NDArray[np.intp]
    lost: NDArray[np.int64]
    clock_ns: NDArray[np.float64]
    usual_ns: float

    @property
    def late(self) -> NDArray[np.bool_]:
        """(K,): whether it was only a row that was written late."""
        late: NDArray[np.bool_] = (self.lost == 0) & (self.clock_ns == 0.0)
        return late


def wide_steps(ns: Nanoseconds, counter: Numbers | None = None, policy: ImportPolicy = POLICY) -> WideSteps:
    """Judge each step of the ordered times (N,) that is wider than usual and no pause; `counter` (N,) of the rows.

    Of times of which no step goes forward none is judged.
    """
    steps = np.diff(ns)
    usual, scatter = _usual(steps, policy)
    wide = np.flatnonzero(steps > policy.gap_steps * usual) if usual > 0 else np.zeros(0, dtype=np.intp)
    groups = np.split(wide, np.flatnonzero(np.diff(wide) > policy.rows_between) + 1) if wide.size else []
    ends = np.concatenate(([0], [group[-1] + 1 for group in groups], [ns.size])).astype(np.intp)
    begins = np.concatenate(([group[0] + 1 for group in groups], [ns.size])).astype(np.intp)
    after, lost, clock = [], [], []
    for place, group in enumerate(groups):
        if steps[group].max() > policy.pause_steps * usual:
            continue
        first, last = int(group[0]), int(group[-1]) + 1
        before = np.arange(max(ends[place], first + 1 - policy.rows_around), first + 1)
        behind = np.arange(last, min(begins[place + 1], last + policy.rows_around))
        moved = (_residual(ns, behind, first, usual) - _residual(ns, before, first, usual)) / usual
        missing = _missing(moved, scatter, policy)
        if counter is not None and np.isfinite(counter[[first, last]]).all():
            missing = max(0, round(float(counter[last] - counter[first])) - (last - first))
        stepped = abs(moved - missing) > policy.gap_steps - 1.0
        after.append(first + 1)
        lost.append(missing)
        clock.append((moved - missing) * usual if stepped else 0.0)
    return WideSteps(np.array(after, dtype=np.intp), np.array(lost, dtype=np.int64), np.array(clock), usual)


def set_back(ns: Nanoseconds, row: int, usual_ns: float, policy: ImportPolicy = POLICY) -> bool:
    """Whether the clock was set back before this row: among the times before it there is no room for it.

    A row that is out of order, or that comes behind a late one, is missing where it belongs.
    """
    if float(ns[row - 1] - ns[row]) <= (policy.gap_steps - 1.0) * usual_ns:
        return False
    before = np.sort(ns[max(0, row - policy.room_rows) : row])
    place = int(np.searchsorted(before, ns[row]))
    if place == 0:
        # earlier than all of them: rows out of order are followed by a jump to where time had been
        behind = ns[row : row + policy.room_rows]
        caught = np.flatnonzero(behind > before[-1])
        return bool((np.diff(behind[: caught[0] + 1 if caught.size else None]) <= policy.gap_steps * usual_ns).all())
    return float(before[place] - before[place - 1]) <= policy.gap_steps * usual_ns


def _usual(steps: Nanoseconds, policy: ImportPolicy) -> tuple[float, float]:
    """The mean of the regular steps, and their scatter as a share of it."""
    positive = steps[steps > 0]
    if positive.size == 0:
        return 0.0, 0.0
    median = float(np.median(positive))
    regular = positive[(positive > (2.0 - policy.gap_steps) * median) & (positive < policy.gap_steps * median)]
    usual = float(regular.mean())
    return usual, float(np.median(np.abs(regular - usual))) / usual


def _residual(ns: Nanoseconds, rows: NDArray[np.intp], origin: int, usual: float) -> float:
    return float(np.median((ns[rows] - ns[origin]) - (rows - origin) * usual))


def _missing(moved: float, scatter: float, policy: ImportPolicy) -> int:
    """How many whole steps the residuals moved; 0 where it is no whole number of them."""
    whole = max(0, round(moved))
    return whole if abs(moved - whole) <= max(policy.whole_share, policy.whole_scatters * scatter) else 0

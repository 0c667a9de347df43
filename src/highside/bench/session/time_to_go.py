"""How long a session will still take, by how long its own poses took.

The time from one pose to the next is that of turning the table, of rest and of the hold together; what a plan says of
its holds alone would promise too much. Intervals with a pause, a loss of data or an end of the process in them tell
nothing and are left out. Pure: times come as arguments, from any clock that runs evenly.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from highside.bench.session.entries import Began, Entry, Noted, Paused, Resumed, TakenPose

INTERVALS_MIN = 2
"""Poses whose time must be known before anything is said: a first one has the clamping in it."""
INTERVALS_KEPT = 12
"""The last ones count: who turns a table becomes quicker, and inclinations differ."""
LONG = 4.0
"""An interval of so many medians or more is a talk at the bench and not a pose."""
LEAST_SHARE = 0.1
"""Of the usual time: what the pose under way still takes at least while no hold of it has begun."""


class Pace:
    """The intervals of one session."""

    def __init__(self) -> None:
        self._intervals: deque[float] = deque(maxlen=INTERVALS_KEPT)
        self._since: float | None = None

    @classmethod
    def of(cls, entries: Sequence[Entry], times_s: Sequence[float]) -> Pace:
        """That of a journal read back; nothing is under way."""
        pace = cls()
        for entry, at_s in zip(entries, times_s, strict=True):
            pace.note(entry, at_s)
        pace.halt()
        return pace

    def note(self, entry: Entry, at_s: float) -> None:
        """What was written down, and when."""
        match entry:
            case Began() | Resumed():
                self._since = at_s
            case TakenPose():
                if self._since is not None and at_s > self._since:
                    self._intervals.append(at_s - self._since)
                self._since = at_s
            case Paused():
                self.halt()
            case Noted(code):
                if code in ("interrupted", "clock_step"):
                    self.halt()
            case _:
                pass

    def halt(self) -> None:
        """Nothing can be measured for a while: the interval under way tells nothing."""
        self._since = None

    def usual_s(self) -> float | None:
        """The time that a pose takes, s; None while too few were taken."""
        if len(self._intervals) < INTERVALS_MIN:
            return None
        ordered = sorted(self._intervals)
        median = ordered[len(ordered) // 2]
        usual = [one for one in ordered if one < LONG * median]
        return sum(usual) / len(usual)

    def to_go_s(self, poses: int, now_s: float, *, hold: tuple[float, float] | None = None) -> float | None:
        """The time until `poses` more are taken, s; None while it cannot be known. `hold`: how long the hold under way
        has lasted (s), and its progress, 0 to 1."""
        usual = self.usual_s()
        if usual is None or poses < 1:
            return None if usual is None else 0.0
        under_way = 0.0 if self._since is None else now_s - self._since
        left = max(usual - under_way, LEAST_SHARE * usual)
        if hold is not None and hold[1] > 0.0:
            left = hold[0] * (1.0 - hold[1]) / hold[1]
        return (poses - 1) * usual + min(left, usual)


def in_words(to_go_s: float) -> str:
    """As it is shown: no digit that an estimate has not."""
    minutes = to_go_s / 60.0
    if minutes < 0.75:
        return "less than a minute"
    if minutes < 9.5:
        return f"about {minutes:.0f} min"
    rounded = 5 * round(minutes / 5)
    if rounded < 60:
        return f"about {rounded} min"
    return f"about {rounded // 60} h {rounded % 60:02d} min"

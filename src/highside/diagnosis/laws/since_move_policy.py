"""Thresholds of the laws of the time since the last move, what readings do while a pose is held."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawSinceMovePolicy:
    """Laws of the time since the last move."""

    poses: int = 12
    """Poses from which they are sought. Source: as many as a stepped session has at least."""
    rows: int = 5
    """Rows of each pose from which they are sought. Source: a mean, a line, a decay and one to spare, and two steps of
    second differences at a distance of two rows."""
    equally_long: float = 0.5
    """Share of the poses that are held equally long, from which the shorter ones have lost rows. Source: of poses that
    lose up to 30 % of their rows half keep the first and the last."""
    begun: float = 9.0
    """Chi-square by which the rows of a pose that is cut short must be nearer to a law if it began earlier. Source:
    three standard deviations, one of 370 by chance."""
    beginnings: int = 33
    """Beginnings of such a pose that are tried. Source: chosen; of poses of up to 33 rows each row that may be lost."""
    tried: int = 16
    """Time constants tried, and as many again about the best. Source: chosen; neighbours differ by less than a third
    in poses of up to fifty rows."""
    shortest: float = 0.7
    """Shortest of them, in steps from row to row. Source: chosen; half is gone in half a step."""
    straight: float = 100.0
    """Time constant, in lengths of a pose, of a decay that is a straight line. Source: it bends by a half per cent."""
    least: float = 1e-9
    """Noise of a row beside the largest reading, at least. Source: rounding."""


LAW_SINCE_MOVE = LawSinceMovePolicy()


@dataclass(frozen=True)
class LawCoursePolicy:
    """A free course of readings while poses are held."""

    most: int = 8
    """Cosines of it at most. Source: as many bends as a law of few rows can show; a pose has five rows and more."""
    folds: int = 4
    """Sets of poses that are left out in turn. Source: chosen; three quarters of twelve poses still tell an amplitude
    that follows the load."""
    share: float = 0.5
    """Share of what is free of the rows that a course of all poses may take up when the noise of a row is estimated
    beside it. Source: chosen; the standard deviation is then known from half as many."""
    turns: int = 12
    """Times weights and amplitudes are learnt in turn. Source: chosen; the product of two of which one is nearly known
    has settled to a thousandth after five."""
    gain: float = 12.0
    """Nats on the poses left out by which it must be ahead of a straight line, and of a decay. Source: as
    `LawSearchPolicy.gain`."""
    finer: float = 3.0
    """Nats on them for a further cosine. Source: as `LawFormulasPolicy.margin`, below which two forms tie."""
    sure: float = 3.0
    """Standard errors of that lead over the poses, where noise is slower than it looks. Source: chosen; one in 700 by
    chance."""
    rank: float = 1e-9
    """Share of the largest singular value below which a direction is not told. Source: rounding."""


LAW_COURSE = LawCoursePolicy()

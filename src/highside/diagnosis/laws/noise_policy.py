"""The numbers of the noise that laws compete with.

Each stands with its unit, its meaning and what set it. They are no settings for users.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LawNoisePolicy:
    """The noise that laws compete with."""

    factors: tuple[float, ...] = (1.0, 1.15)
    """White noise tried, in units of what the present fit leaves; never below the floor. Source: a fit takes up to a
    third of the values of the shortest sessions."""
    taken: float = 0.13
    """Columns in a value up to which the first of these is the only one. Source: of n values a fit of k columns leaves
    1 - k / n of the variance, and a factor of 1.15 is nearer to what the noise was from a k of 0.13 n on."""
    white: tuple[float, ...] = (1.0, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 10.0, 20.0, 50.0)
    """White noise tried beside errors of the set angles, in units of the floor. Source: chosen; a wide grid."""
    of_what_is_left: float = 0.1
    """Share of what a fit leaves that is the unit of these where no floor was measured. Source: chosen; they then reach
    from a tenth of it to five times as much."""
    shares: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e6)
    """Variances of a level that forgets, in units of the white noise's. Source: chosen, wide, as in the trial."""
    lengths: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1e3)
    """Its lengths, in units of the median step from value to value; drawn apart where there are so many values that the
    longest is below `spans_of_a_walk`. Source: chosen."""
    spans_of_a_walk: float = 4.0
    """Spans of the session over which a level forgets that is a random walk to it. Source: its ends are still alike to
    exp(-1 / 4). Of a fourth of a span (4,500 cells) it returned, and the drift of a walk was named (46 nats)."""
    spans_of_a_ladder: float = 2.0
    """Spans that the slowest level of 1/f noise lasts at least. Source: slower ones are an offset."""
    ladders: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1e3)
    """Variances of each level of 1/f noise, in the same units. Source: chosen; a wide grid."""
    ladder: int = 6
    """Levels of 1/f noise. Source: the trial that set the method."""
    ladder_step: float = 4.0
    """Ratio of their lengths. Source: the same trial."""
    turns: int = 2
    """Passes over the channels in which each one's noise is chosen beside the others'. Source: the evidence changed by
    less than 0.1 nat in a third pass on 20 simulated sessions."""
    finer: int = 4
    """Looks at settings, the first of them coarse, each other one at the neighbours of the best. Source: in 328
    learnings of 30 sessions of the deck of bfce0efc the setting was that of highest evidence among all 117 in 94 %, and
    0.1 nat behind it in the mean, 4.6 in the worst hundredth."""
    cost: float = 2.0
    """Nats a further kind of noise must gain to be taken. Source: chosen; half a logarithm of fifty values each."""
    jitters: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0)
    """Scatter of a set angle, in units of what the floor makes of it. Source: chosen; a wide grid."""
    part: int = 16
    """Rows among which pairs are looked at one by one. Source: of 360,000 rows 8 and 16 take as long, 32
    a fifth longer."""
    group: int = 64
    """Cells of a group whose means are whitened together, at least. Source: chosen; of so many the floor's correlations
    across a border, which are left out, are few, and a filter costs what a column of products does."""
    kept: int = 20_000_000
    """Numbers of the filters of cells that are kept. Source: 160 MB; of 3,000 cells some ninety filters, of the hundred
    and more that a search asks for."""
    ladder_by_bands: int = 3
    """Columns up to which a ladder filters them as a system of few bands. Source: of 2,717 rows each takes 0.13 ms so;
    block by block 16 take 0.3 ms, and the matrices of the blocks, which are kept, 0.4 ms."""
    at_once: int = 100_000
    """Settings times values of one pass. Source: the same memory with forty columns."""
    columns: int = 40
    """Columns of one pass of so many settings. Source: as `at_once`."""
    matrices: int = 50_000
    """Numbers of the inner products of settings whose evidence is taken at once. Source: a processor's cache of 1 MB,
    in which they and their factors have room."""
    clip: float = 4.0
    """Sigmas about the present fit beyond which a value is clipped. Source: the trial that set the method: false laws
    in heavy tails 2 of 60 without, 0 with."""
    clipped: float = 0.03
    """Share of the values that may be clipped: of more it is the fit that is wrong. Source: chosen; a Student noise of
    3 degrees of freedom has 2 % beyond."""


LAW_NOISE = LawNoisePolicy()

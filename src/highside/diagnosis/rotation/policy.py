"""The numbers that decide for rotations.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass

from highside.diagnosis.core.problem_policy import ProblemPolicy, SlowLimits


@dataclass(frozen=True)
class RotationAdvicePolicy:
    """Which rates are advised."""

    inclinations_deg: tuple[float, ...] = (0.0, 30.0, 60.0, 90.0, 120.0)
    """deg; inclinations among which stretches are advised. Source: a definition: from the vertical over the horizontal,
    in thirds of a right angle."""
    rates_hz: tuple[float, ...] = (0.1, 0.5, 1.0, 2.0, 3.0)
    """Hz; rates among which stretches are advised. Source: from the slowest that a turntable holds evenly to the
    fastest of a rotating tool in drilling (180 1/min)."""
    seconds: float = 20.0
    """s; length of an advised stretch. Source: two turns at the slowest rate of `rates_hz`."""
    sample_hz: float = 25.0
    """Hz; rows of an advised stretch, for weighing it. Source: eight rows a turn, about, at the fastest rate of
    `rates_hz`."""
    rows: int = 1500
    """Rows of the recording by which what is known is weighed. Source: a limit of time: what is known adds up over
    rows, and 1500 know a mean square to 4 %."""
    stretches: int = 2
    """Stretches that are advised. Source: a reader's: more is no advice."""
    ramps_hz: tuple[float, float] = (1.0, 2.0)
    """Hz; rates to which ramps are advised. Source: two of `rates_hz`."""
    ramp_s: int = 4
    """s; a ramp to the rate and back, with a second at each end. Source: a second each: up, at the rate, down and
    still, an angular acceleration of 2 pi to 4 pi rad/s2 with `ramps_hz`."""


ROTATION_ADVICE = RotationAdvicePolicy()


@dataclass(frozen=True)
class BurstsPolicy:
    """Vibration that comes and goes."""

    shares: tuple[float, ...] = (0.025, 0.05, 0.1, 0.2)
    """Lengths of the windows, of the rows. Source: each twice the one before: a burst between the shortest and the
    longest is within a factor of 1.4 of one of them."""
    shortest: int = 128
    """Rows of a window, at least. Source: 61 cells from `first_cell` on: their median is known to 18 % (1 / (ln 2
    sqrt(61)), for exponential cells)."""
    first_cell: int = 3
    """What is slower than this in a window is drift: cycles. Source: studies.thresholds, 1 to 6."""
    neighbours: int = 100
    """Cells by whose median the level around a cell is known. Source: the median of as many exponential cells is known
    to 14 % (1 / (ln 2 sqrt(100)))."""
    chance: float = 1e-4
    """Probability by which the highest cell of a recording without a burst is as high. Source: a level of significance;
    all cells of all windows are counted."""
    grid: int = 240
    """Instants between which a burst's ends are sought. Source: six for the shortest of the windows (0.025 of the
    rows)."""
    finer: int = 21
    """Frequencies that are tried about the highest cell's. Source: steps of a tenth of a cell; half of one takes 0.8 %
    of a wave's power."""
    channel_share: float = 0.1
    """Share of the strongest channel's energy from which a channel is reported. Source: arithmetic; a tenth of the
    energy is a third of the amplitude, which a leak across axes of 0.3 would be."""
    odds: float = 1e3
    """Odds against chance from which a channel is reported. Source: a channel without the wave has an energy beyond ln
    1000 by chance in one case of a thousand."""


BURSTS = BurstsPolicy()


@dataclass(frozen=True)
class LinesPolicy:
    """Lines in a rotation."""

    most_rows: int = 1 << 20
    """Rows in which lines are looked for, in the middle of a longer recording. Source: the spectra of so many take 0.1
    GiB; a line that a hundredth of its rows would show in all of 20 million needs 4.5 times the size here."""
    blocks: int = 64
    """Blocks of so many rows by which the frequency of one that was found is known from all. Source: chosen; within one
    a wave that is off by what the stretch leaves open turns by a hundredth of a circle."""
    finer: int = 8
    """Frequencies that are tried for each that all rows distinguish. Source: chosen; a twelfth of one loses a fiftieth
    of the power."""
    max_order: float = 60.0
    """Highest order of the rotation that is looked for. Source: chosen; the teeth and rolling elements of what turns a
    bench come some tens of times a turn."""
    largest_whole: int = 12
    """Whole orders up to this are harmonics of the toolface, which other effects and the scan stand for. Source:
    studies.thresholds, 6 to 24."""
    spare: float = 1.2
    """Cells of a turn beyond what the highest order needs. Source: the sampling theorem needs two for the highest
    order, which `2 max_order` gives; a fifth more for what is just above."""
    beside: float = 2.5
    """Cells beside a whole order that belong to it. Source: from there on the side lobes of a line (sinc squared) are
    below 2 % of its power."""
    whole: float = 0.5
    """Cells off a whole order within which a line has that order. Source: half of what the rows can tell apart."""
    most_whole: int = 4
    """Whole orders that are told, at most. Source: chosen; an error of the toolface makes two."""
    smooth_orders: int = 4
    """Whole orders up to this need no finer sectors. Source: a mean over a thirtieth of a turn keeps 0.97 of them."""
    sure: float = 40.0
    """Height of a peak above its neighbourhood, summed over the channels, from which it is a line beyond doubt. Source:
    a line of strength 100 has about 50; AR(1) noise of 0.9 had none (`python -m studies.rotation_open nulls`)."""
    beside_strongest: float = 0.1
    """Height of a line beside that of the strongest, at least. Source: chosen; an error of the toolface makes two of
    like height, and leakage less than a hundredth."""
    least_order: float = 0.1
    """Orders of the rotation below which nothing is looked for. Source: chosen; a wave of ten turns, and what is slower
    has its own functions."""
    turns: int = 3
    """Turns of a recording from which orders of the rotation can be distinguished. Source: chosen; a cell is then a
    third of an order wide."""


LINES_POLICY = LinesPolicy()


@dataclass(frozen=True)
class StepsPolicy:
    """The instant of a large step."""

    strength: float = 400.0
    """Chi-square of the difference of the means from which its instant is tried to a row. Source: between two of sixty
    instants a step that is a quarter of their distance off leaves some hundredths of it, which 400 makes visible."""
    median_of_differences: float = 0.9539
    """Median size of the difference of two normal values of unit variance. Source: sqrt(2) times 0.6745."""


STEPS = StepsPolicy()


@dataclass(frozen=True)
class MeansPolicy:
    """Proof of a rotation in means."""

    sectors: int = 12
    """of a turn, by which the means of a stretch are taken: of the toolface, or of the phase of a line. Source: twelve
    means know the orders of toolface up to five."""


MEANS = MeansPolicy()


@dataclass(frozen=True)
class PilotPolicy:
    """The pilot fit of a long recording."""

    many_rows: int = 30_000
    """Rows; of a longer recording a subsample are diagnosed first. Source: a limit of time and memory: five
    `pilot_rows`."""
    pilot_rows: int = 6_000
    """So many rows. Source: a limit of time: a fifth of what is diagnosed whole."""
    neighbours: int = 400
    """Rows of a stretch by which noise is distinguished from what is slow. Source: the mean of 400 rows has a twentieth
    of a row's scatter."""


PILOT = PilotPolicy()


@dataclass(frozen=True)
class RotationSupportPolicy:
    """Ranges of a rotation's covariates."""

    fine_cells: int = 36
    """Cells of the toolface in which a range is sought. Source: a definition: ten degrees each."""
    varies: float = 1e-3
    """In the covariate's unit: one that varies less has no ranges. Source: studies.thresholds, 0.0005 to 0.002."""


ROTATION_SUPPORT = RotationSupportPolicy()


@dataclass(frozen=True)
class UnknownSitePolicy:
    """Gyros that feel gravity beside the Earth's rotation of a bench of which nobody said where it stands."""

    seen: float = 1e-3
    """rad/s/g; what is less well known (one standard deviation) is not seen at this inclination. Source: the Earth does
    7e-5; of one inclination that is not seen has 1e-2, the range of the effect."""
    sigmas: float = 3.0
    """Standard deviations by which it must exceed what the Earth can do. Source: 1 in 700 by chance, six are judged."""


UNKNOWN_SITE = UnknownSitePolicy()


ROTATION = ProblemPolicy(
    named_share=0.93,
    marginal=1.0,
    interaction_margin=4.0,
    most_named=2,
    slow=SlowLimits(straight=3.0),
    slow_beside_fast=True,
)
"""Rows are many: what is left beside the whole story is small, so names must explain more. One scan in a hundred is
significant by chance, which beside a name is no reason to doubt it. Unnamed interactions are more than for poses, and
their number counts against them already. Harmonics of the toolface on one channel are matched by several effects of the
bench together: no more than two names. A straight line is what a random walk imitates most easily, and the rates of a
programme usually go one way, as time does. Chosen in 9f89d7b, bbc5ff9, f202a8b and 207dc25; no run is recorded."""

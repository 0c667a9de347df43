"""The numbers that decide beside a prediction.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass

from highside.diagnosis.core.problem_policy import ProblemPolicy, SlowLimits


@dataclass(frozen=True)
class AlignmentPolicy:
    """Time bases brought together."""

    coarse_hz: float = 50.0
    """Hz; a lag is first sought at no more rows. Source: studies.thresholds, 25 to 100."""
    same_clock: float = 0.5
    """Share of the shorter span that must overlap for two clocks to be taken as one. Source: studies.thresholds, 0.25
    to 1."""
    own_lag: float = 0.1
    """Share of the shorter span; a lag up to this on one clock is left to be diagnosed. A prediction that is early by
    2 s of a minute is. Source: tests/unit/test_diagnosis_clock.py."""
    equal: float = 0.05
    """Share of what the best correlation lacks, by which another peak may be lower and still be as high: a motion that
    returns has a peak at each of its periods. Source: tests/unit/test_diagnosis_clock.py."""
    equal_turned: float = 0.5
    """As `equal`, while a rate is sought: one that is not exact yet lets shorter overlaps fit better. Source: as
    `equal`."""
    finer: int = 2
    """Times that a rate is sought about the best of the whole, each time in steps `beside` times finer. Source: as
    `equal`."""
    equal_at_least: float = 1e-3
    """Correlation; peaks that differ by less are equal. Source: as `equal`."""
    beside: int = 4
    """Rows, or steps of a rate, to either side of what was found that are searched. Source: as `equal`."""
    halves: float = 0.5
    """Share of what a correlation lacks, that may be left of it for a rate to be believed beside a lag alone. Source:
    as `equal`."""
    most_rate: float = 0.12
    """s per s; a clock, or a motion, that is faster or slower by more is another one. Source: as `equal`."""
    turn: float = 0.25
    """Periods of the fastest motion by which the rates that are tried let the end of a stretch differ. Source: as
    `equal`."""
    periods: float = 5.0
    """Periods of the fastest motion in the shortest stretch by which a rate is sought: within it 12 % are less than one
    period. Source: as `equal`."""
    least_rows: int = 64
    """Rows of that stretch, at least. Source: as `equal`."""
    content: float = 0.9
    """Share of the power below the frequency of that fastest motion. Source: as `equal`."""
    least_overlap: float = 0.3
    """Share of the shorter span that must overlap for a lag to be tried. Source: studies.thresholds, 0.15 to 0.6."""
    alike: float = 0.3
    """Correlation from which a lag is believed. Source: studies.thresholds, 0.15 to 0.6."""
    nothing: float = 1e-6
    """Share of the largest energy in an overlap below which there is nothing to compare. Source: studies.thresholds,
    5e-07 to 2e-06."""


ALIGNMENT = AlignmentPolicy()


@dataclass(frozen=True)
class SimulationColumnsPolicy:
    """Columns beside a prediction."""

    nothing: float = 1e-12
    """In the channel's unit: a column that is smaller everywhere is none. Source: rounding, as
    `DesignPolicy.nothing`."""
    marginal: float = 3.0
    """Standard deviations; an amplitude that at its largest plausible size adds less is left out. Source: three
    standard deviations, 0.27 % of a normal law."""
    time_waves: int = 8
    """Waves of time that are scanned. Source: studies.thresholds, 4 to 16."""
    line_band: float = 0.9
    """Share of the band compared below which lines are looked for. Source: the low-pass leaves 0.70 of the power there,
    which is given back; a heavy-tailed null (studies/simulation_honesty.py, seed 5012) had a line at 0.87 of it by its
    edge alone."""
    steepness: int = 8
    """Power of the frequency by which the low-pass falls: a Butterworth filter of the fourth order, forwards and
    backwards. Source: a definition."""
    margin: float = 0.03
    """Share of a recording at each end in which a step is not looked for. Source: as `DesignPolicy.step_margin`."""
    least_step: float = 1.0
    """Rows that of a step must lie outside of all effects for it to be looked for. Source: a definition."""
    finer: int = 8
    """Parts of a row's step in which the instant of a step is known. Source: an eighth of the rise of a low-pass that
    takes a row."""
    factor_waves: int = 4
    """Half waves of time by which a factor or a delay of a channel is scanned. Source: as many as tell a step from a
    ramp; each takes one of some hundred directions from a channel's noise."""


SIMULATION_COLUMNS = SimulationColumnsPolicy()


@dataclass(frozen=True)
class SimulationIntakePolicy:
    """Is a prediction of the same things?"""

    near: float = 0.15
    """How near to a factor a slope must be, relative. Source: studies.thresholds, 0.075 to 0.3."""
    follows: float = 0.8
    """Correlation from which a channel is taken to follow another. Source: half of a channel's variance and more (0.64)
    is then the other's."""
    strange: float = 0.4
    """Correlation below which a channel follows nothing. Source: less than a sixth of a channel's variance (0.16) is
    then the other's."""
    prefix: float = 1e3
    """A step of unit prefixes. Source: a definition."""
    least_seconds: float = 4.0
    """s; each second counts as one independent reading, and there are at least so many. Source: a correlation needs
    four independent pairs for a variance by Fisher's transformation, 1 / (n - 3)."""


SIMULATION_INTAKE = SimulationIntakePolicy()


@dataclass(frozen=True)
class SimulationChoicePolicy:
    """Choices beside a prediction."""

    turns: int = 4
    """Times, at most, that columns are made about the delays that were found. Chosen in f84f7d5. Source: of a lag of
    2 s the last two change nothing, tests/unit/test_diagnosis_clock.py."""
    phase: float = 0.3
    """rad, turn of the fastest motion compared within the measured lag from which the shift is tried as a start of its
    own: below, first order finds it. Source: as `turns`."""
    alike: float = 0.01
    """Of two starts the one with fewer effects is taken where their misfits (logarithm of the mean square, summed over
    channels) differ by less. Source: as `turns`."""
    exact: float = 1e-5
    """Relative change of a shift of the clock that shows no more: 20 us of 2 s. Source: as `turns`."""
    clocks_agree_s: float = 1e-3
    """s; by which the shift of the alignment and that of the fit may differ and be the same. Source: in the three
    stretches of `studies/clock_offsets.py` that were looked at the alignment was off by 0.1 to 0.3 ms."""
    most_bins: int = 24
    """Bins of activity in which the noise is measured, at most. Source: studies.thresholds, 12 to 48."""
    least_in_bin: int = 100
    """Rows of a bin, at least. Source: studies.thresholds, 50 to 200."""
    most_named: int = 6
    """Claims, at most: there is no base to absorb the simple ones. Source: studies.thresholds, 3 to 12."""
    far: float = 3.0
    """Standard deviations of a random walk's mean beyond which an offset is none. Source: three standard deviations,
    0.27 % of a normal law."""
    least_named: float = 0.003
    """Of all that is explained, what an effect must explain to be more than a remainder. Source: studies.thresholds,
    0.0015 to 0.006."""
    least_product: float = 0.02
    """Of all that is explained, what an unnamed product must explain to be more than a remainder. Source:
    studies.thresholds, 0.01 to 0.04."""
    beside_clock: float = 0.1
    """Share of `least_named` that an effect other than a delay must explain beside a clock that was moved: what that
    leaves looks like a delay. Source: tests/unit/test_diagnosis_clock.py, a scale of 1 % beside an offset of 30 ms
    explains 0.3 %."""
    settled: float = 0.01
    """Relative change of a delay that shows no more. Source: a definition: 1 % of a delay."""
    least_blocks: int = 6
    """Blocks of rows from which it is known how much a size varies between them. Source: four second differences."""
    median_of_squares: float = 0.4549
    """Median of the square of a normal value of unit variance. Source: chi-square of one degree of freedom."""
    missed: float = 5.1
    """Rows, standard deviation, by which the instant of a step of one standard deviation of a row is missed. Source:
    Yao, Ann. Statist. 15, 1987: the variance is 26."""
    within_a_row: float = 0.29
    """Rows, standard deviation, of an instant known to a row. Source: 1 / sqrt(12)."""
    full: int = 4
    """One in so many of a bin's rows must count. Source: studies.thresholds, 2 to 8."""
    quietest: float = 1e-3
    """Share of the noisiest bin's noise; no row is quieter. Source: chosen; it only keeps a row's weight finite."""
    least_bins: int = 3
    """Bins of activity from which the noise is known to follow it. Source: studies.thresholds, 1 to 6."""


SIMULATION_CHOICE = SimulationChoicePolicy()


@dataclass(frozen=True)
class BandPolicy:
    """Power that no noise of a sensor has."""

    segments: int = 8
    """Segments whose spectra are averaged, at least: with halves in common that are 15, known to a quarter. Source: as
    `ratio`."""
    longest: int = 1024
    """Rows of a segment, at most. Source: as `ratio`."""
    shortest: int = 48
    """Rows of a segment, at least: fewer do not part a band from what is slower. Source: as `ratio`."""
    bands: int = 12
    """Bands in which the spectrum is compared. Source: as `ratio`."""
    ratio: float = 1.5
    """Standard deviations left, in those of noise that is as large at lower frequencies, from which something is left.
    Source: of 1,110 channels of the five kinds of noise of `studies/simulation_honesty.py` none exceeds 1.3; a motion
    that is missing shows 2.5 at a strength of 1e4."""
    chance: float = 3e-3
    """Probability of chance below which what is left is no noise. Source: one session in a hundred may raise an alarm
    (`CandidateSetPolicy.alarm_rate`); a tenth of that is left for each of three tests."""
    halvings: int = 50
    """Halvings of an interval in which a level is sought. Source: rounding of doubles."""
    skipped: int = 2
    """Ordinates of the lowest frequencies that are not looked at: a base that is fitted takes of these. Source: what is
    removed with a mean, and its neighbour."""
    ordinates: int = 8
    """Ordinates of a band, at least, for the law of its likelihood ratio to hold. Source: of 800 draws of six channels
    of 600 white rows the chance of less than 0.1, 0.03 and 0.01 is found as often as that, or less."""
    rounding: float = 1e-15
    """What a coherence lacks of one, at least. Source: rounding of doubles."""
    least_bands: int = 3
    """Octaves from which a spectrum is told to rise. Source: a hump has something on either side."""
    nothing: float = 1e-9
    """Share of the largest level below which there is no power. Source: rounding."""


BAND = BandPolicy()


@dataclass(frozen=True)
class MotionPolicy:
    """A motion that is missing from a prediction."""

    finer: int = 4
    """Steps of rotation from row to row. Source: rates of 60 deg/s of 2 Hz, 12 rows a second, are integrated to 0.1 deg
    in 48 s; the integral carries an angle from axis to axis and need be no better."""
    blocks: int = 48
    """Stretches of time between which a motion begins and ends, at most. Source: as `LawGroupsPolicy.steps`."""
    least_blocks: int = 4
    """Such stretches, at least. Source: a beginning, a middle and an end, and one more."""
    least_rows: int = 12
    """Rows of such a stretch, at least. Source: a power of six channels is known to a sixth from so many."""
    gain: float = 12.0
    """Nats that two levels of power, within a stretch and outside, must gain over one. Source: as
    `LawSearchPolicy.gain`; 1,176 stretches of 48 blocks are 7 nats."""
    larger_part: float = 0.5
    """Share of what departs on a channel from which laws are what it is, and what they leave is the rest. Source: a
    definition: of two, the larger one."""


MOTION = MotionPolicy()


@dataclass(frozen=True)
class ConstantsPolicy:
    """Which factors are one constant of the simulation."""

    least_channels: int = 3
    """Channels that must have the same factor. Source: of two a chance agreement is one in ten at usual errors."""
    alike: float = 0.03
    """Share of a common factor by which those of the channels may differ beyond their errors. Source: chosen; scale
    factors of a triad, drawn independently, agree so well in less than one of a hundred."""
    chance: float = 0.01
    """Probability of chance below which the factors are different. Source: chosen."""
    sure: float = 5.0
    """Standard deviations by which the common factor must differ from 1. Source: chosen, beyond any search."""


CONSTANTS = ConstantsPolicy()


@dataclass(frozen=True)
class SimulationSessionsPolicy:
    """Recording and prediction on one grid."""

    content: float = 0.999
    """Share of the power of a prediction that lies below the frequency up to which it is compared. Source: a
    definition: what is cut off is a thousandth of the power, 3 % of the size."""
    segment_s: float = 10.0
    """s; segments by which coherence is measured. Source: studies.thresholds, 5 to 20."""
    coherent: float = 0.3
    """Mean coherence over an octave from which the two are taken to show the same. Source: over eight segments the
    coherence of unrelated signals is 0.125, with a scatter of 0.11 in a cell: the mean of ten cells of an octave is 0.3
    at five sigma."""
    per_band: float = 2.5
    """Rows per period of that frequency. Source: the sampling theorem needs two; a quarter more for a filter's
    slope."""
    least_rows: int = 600
    """Rows of the grid, at least. Source: studies.thresholds, 300 to 1200."""
    most_rows: int = 60_000
    """Rows of the grid, at most. Source: a limit of time and memory: 20 minutes at 50 Hz."""
    gap_steps: float = 3.0
    """Usual steps; a longer gap is left out. Source: two rows lost one after the other may be interpolated over."""
    warm_span_c: float = 0.2
    """degC; a temperature that changes by less says nothing. Source: studies.thresholds, 0.1 to 0.4."""
    band: float = 0.4
    """Share of the grid's rate up to which both sides are passed: below one half, as filters are not steep. Source:
    four fifths of the Nyquist frequency."""
    no_filter: float = 0.39
    """Share of a side's own rate: where the band reaches it, no low-pass is needed. Source: just below `band`, so that
    the comparison of the two does not hang on rounding."""
    settled: float = 4.0
    """Periods of the band's edge from the ends of a side that are not compared where it is low-passed: the filter goes
    on there as if the motion were turned about its last value, and the other side ends elsewhere. Source: the slowest
    pole, of damping 0.38, decays to 1e-4 in them; beside a prediction that is early by 10 ms the ends were 1,000 times
    the noise."""
    step_reach: int = 12
    """Periods of the band's edge to either side of a step beyond which its low-pass has settled. Source: the filter's
    slowest pole, of damping 0.38, has decayed to 1e-12."""
    step_rows: int = 64
    """Rows per such period in which the low-passed step is known. Source: straight lines between them are off by
    1e-4."""
    room_c: float = 25.0
    """degC; taken where none was recorded. Source: a convention: 25 degC, at which data sheets give a sensor's
    figures."""
    copy: float = 1e-9
    """Share of a recorded channel (rms) that a prediction, scaled and offset, leaves of it if it is the recording
    itself: two equal columns leave 1e-15, six written digits 1e-7. Source: a hundredth of what a file's six digits
    leave, and far above the rounding of doubles."""
    segments: int = 8
    """Segments, at least, by which coherence is measured. Source: Welch's estimate: the coherence of two unrelated
    signals over eight segments is 1/8 on the average."""
    constant: float = 1e-20
    """Share of a prediction's power below which it is constant. Source: rounding: a mean subtracted in doubles leaves
    (2.2e-16)^2 = 5e-32 of its power, and the sums of a long recording some orders more."""
    apart: float = 0.01
    """Usual spacings; rows of a prediction nearer than this to one another are one. Source: of values that are rounded
    to 1e-4 of the motion, nearer ones say less of its slope than their neighbours."""
    least_side: int = 150
    """Rows of either side, at least. Source: studies.thresholds, 75 to 300."""


SIMULATION_SESSIONS = SimulationSessionsPolicy()


@dataclass(frozen=True)
class TurningPolicy:
    """Angular accelerations from rates that have noise."""

    segment: int = 1024
    """Rows of a segment of a spectrum, at most. Source: as `BandPolicy.longest`."""
    highest: float = 0.8
    """Share of half of the rate of rows up to which noise is looked for. Source: rows that are not evenly spaced are
    put on a grid by straight lines, which take of the noise above."""
    lowest: float = 0.5
    """Share of half of the rate of rows from which it is looked for where the band that is compared goes further.
    Source: chosen."""
    bands: int = 4
    """Bands of which the quietest is taken for noise. Source: chosen; the skirt of a motion that ends at the band is
    in the lowest of them."""
    smooth_hz: float = 0.25
    """Hz to either side over which a spectrum is averaged. Source: chosen; 24 ordinates of a minute."""
    rounding: float = 1e-3
    """Share of the noise that is the least level of a spectrum. Source: a definition: far below it nothing is left."""


TURNING = TurningPolicy()


SIMULATION = ProblemPolicy(
    named_share=0.93,
    interaction_margin=4.0,
    most_named=SIMULATION_CHOICE.most_named,
    certain=3.7,
    products_beside_memory=True,
    alarm_rate=0.005,
    slow=SlowLimits(log_p=5.0, quiet_log_p=5.0, forgiven=0.05),
)
"""Rows are many: what is left beside the whole story is small, and unnamed products count against themselves by their
number. There is no base to absorb the simple effects, so more names than usual may be given. Chosen in f84f7d5; no run
is recorded.

Noise is learned from what is left, so all that is chosen must beat a noise with memory: of 43 nulls in a random walk
(`python -m studies.simulation_honesty nulls --names-alone --noise walk`, seeds 20000 to 20029 and 6000 to 6012) 9 had
an alarm where names alone had to, at 2.8, and one has now. `certain`: one session in 200 over some 25 candidates.
`slow.log_p`, `slow.quiet_log_p`: a filter that is learned beside a random walk takes a part of it, so gains are larger
than their law says; of 30 nulls in a random walk (the same, seeds 33000 to 33029) a step had more than 3 in 3 and at
most 4.2, where 1.5 is expected of one in a hundred. `alarm_rate`: candidates and scan share the one session in a
hundred that may raise an alarm. `slow.forgiven`: as at rest (`diagnosis.magnitude.policy.AT_REST`); a step of a gyro's
offset of strength 3e3 and 1e6 (`python -m studies.simulation_honesty sweep --names-alone --only "gyro step"
--first-seed 41`) is ahead of a random walk by 15 and 297 in -log10 p, and was refused as it leaves 15 of 531 and of
2,006 of the evidence of memory."""

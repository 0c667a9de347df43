"""The numbers that decide where recordings are looked at row by row.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BasesPolicy:
    """Functions of covariates for rows."""

    harmonics: int = 8
    """Highest order of the toolface that is scanned. Source: studies.thresholds, 4 to 16."""
    time_waves: int = 12
    """Waves of time that are scanned. Source: studies.thresholds, 6 to 24."""
    warm_span_c: float = 0.5
    """degC; a temperature that changes by less says nothing. Source: as `CandidatesPolicy.warm_span_c`."""
    rate_span: float = 0.02
    """Share of the largest rate; rates that differ by less are one. Source: studies.thresholds, 0.01 to 0.04."""
    inclined_deg: float = 0.1
    """deg; inclinations that differ by less are one. Source: as `CausesPolicy.inclined_rad`, 0.002 rad."""
    ramps: float = 1e-6
    """1/s; change of the rate, in largest rates, from which there are ramps. Source: studies.thresholds, 5e-07 to
    2e-06."""


BASES = BasesPolicy()


@dataclass(frozen=True)
class DesignPolicy:
    """How columns of rows are found out."""

    probe: int = 400
    """Rows, spread evenly, on which it is found out what a column is made of. Source: chosen; what acts in 1 % of the
    rows is missed with a chance of 0.99^400 = 1.8 %, and the ends are probed besides."""
    extremes: int = 4
    """Rows at each end of each covariate that are probed as well: a ramp of the rate may be rare. Source:
    studies.thresholds, 2 to 8."""
    step_margin: float = 0.03
    """Share of a recording at each end in which a step is not looked for. Source: as `CandidatesPolicy.shortest`,
    0.03."""
    nothing: float = 1e-12
    """g or rad/s; a function that is smaller everywhere is none. Source: a millionth of what a row of the quietest
    sensor (1 ug) scatters by."""
    in_memory: int = 30_000
    """Rows up to which stored columns stay in memory. Source: 34 of them are 8 MB."""
    stored: int = 70
    """Columns that are stored, at most about. Source: 34 of a rotation of three channels, and as many for the gyros."""
    far: int = 1 << 40
    """Numbers from which a function is a shared one, until its place is known: more than any design has. Source: a
    definition: 2^40 numbers would be 8 TB, more than any memory; below 2^53 still exact in a double."""


DESIGN = DesignPolicy()


@dataclass(frozen=True)
class SpectrumPolicy:
    """The strongest line of a spectrum."""

    chance: float = 1e-3
    """Probability by which the highest of all peaks of a spectrum without lines is as high. Source: a level of
    significance, usual: one recording of a thousand."""
    padded: int = 2
    """A spectrum is evaluated at so many times as many frequencies: a line between two of them would lose half its
    power. Source: with twice the cells a line is off by a quarter of a cell at most and keeps 81 % of its power (sinc
    squared), with one 41 %."""
    smooth: int = 101
    """Independent cells of a spectrum by whose median the level around a cell is known. Source: the median of as many
    exponential cells is known to 14 % (1 / (ln 2 sqrt(101)))."""
    slowest: int = 12
    """Cycles in the recording: what is slower is drift. Source: studies.thresholds, 6 to 24."""
    about: float = 0.75
    """Cells about a peak in which it is sought more finely. Source: half a cell of a spectrum that is padded twice is a
    quarter; thrice this, as noise moves a peak."""
    finer: int = 31
    """Frequencies that are tried there. Source: steps of a twentieth of a cell: half of one takes 0.2 % of a line's
    power."""


SPECTRUM = SpectrumPolicy()


@dataclass(frozen=True)
class GramsPolicy:
    """Inner products of rows."""

    folds: int = 10
    """Contiguous stretches, each predicted from the others. Source: ten-fold cross-validation: Kohavi (IJCAI 1995)."""
    block_s: float = 0.5
    """s; blocks by whose means a random walk is observed, at most where a recording is short. Source:
    studies.thresholds, 0.25 to 1."""
    block_rows: int = 5
    """Rows of such a block, where that is shorter. Source: white noise with AR(1) noise of 0.95 beside it, as large,
    1,500 rows of 50 Hz: the projection takes what is slow of it, the filter has 1 to 3 terms, and levels in blocks of
    25 rows, longer than its memory, left 13 of 16 nulls with an alarm (one a lever arm); blocks of 5 rows none of
    6."""
    max_blocks: int = 1000
    """Blocks, at most: a long recording has longer ones. Source: a limit of time: filters of blocks cost as their
    number times columns squared."""
    flip_s: float = 3.0
    """s; rows whose signs are flipped together. Source: studies.thresholds, 1.5 to 6."""
    random_walk_shares: tuple[float, ...] = (0.0, 1e-6, 4e-6, 1.6e-5, 6e-5, 2.5e-4, 1e-3, 4e-3, 0.016)
    """Variance of a random walk's step from row to row in units of the white variance of a row. Source: a grid: each
    four times the one before, twice in the scatter."""
    forgetful: tuple[tuple[float, tuple[float, ...]], ...] = (
        (0.5, (0.03, 0.1, 0.3, 1.0, 3.0)),
        (1.5, (0.03, 0.1, 0.3, 1.0, 3.0, 10.0)),
        (4.0, (0.01, 0.04, 0.15, 0.6, 2.4, 10.0)),
        (12.0, (0.04, 0.15, 0.6, 2.4, 10.0, 40.0)),
        (30.0, (0.01, 0.04, 0.15, 0.6, 2.4, 10.0)),
        (60.0, (0.01, 0.04, 0.15, 0.6, 2.4, 10.0)),
    )
    """Levels that forget, what the filter leaves of a noise's colour: their memory in blocks, and variances in units of
    the white variance of a block's mean. Source: AR(1) noise of 0.97 over 1,200 rows is filtered by 0.90 (what is slow
    is projected off), and what is left is 17 in -2 log likelihood nearer to levels of 1.5 blocks of half a second than
    to a random walk, in 6 of 6; with levels of up to 0.3 alone it passed for one in 19 of 20. 60 blocks of `block_rows`
    are the six seconds that 12 of `block_s` are."""
    always_tried: float = 12.0
    """Blocks; memories up to this are tried however short a recording is. Source: the longest of 0.5 s blocks."""
    longest_share: float = 0.2
    """Share of the blocks that a longer memory may have. Source: a level of 24 s in 48 s took steps of strength 300 for
    noise, so that nothing was left out in 5 of 8 (`python -m studies.simulation_honesty sweep --only step "gyro step"
    --strength 3e2`)."""


GRAMS = GramsPolicy()


@dataclass(frozen=True)
class ColourPolicy:
    """Noise whose memory is long beside the recording."""

    stretches: float = 30.0
    """Independent stretches, two memories apart, below which it is reported that slow effects show less. Source:
    chosen; a variance of so many is known to a quarter."""
    lead: float = 12.0
    """-2 log likelihood, summed over the channels that wander, by which a random walk must be ahead of noise that
    forgets to be told from it. Source: AR(1) noise of 0.99 over 1,200 rows led by 6.1 in one of 5 recordings
    (`python -m studies.rotation_open nulls --kind 0.99`, seed 1); random walks of 0.02 of the noise there by 0.1 to
    8."""
    few: int = 10
    """Independent stretches below which the colour is so little known that a finding must be beyond `chance`. Source:
    the false findings of the same command, seeds 0 to 4, had 2 to 6."""
    alone: float = 250.0
    """-2 log likelihood of a memory beyond which an axis that has it, where another has none, may have more than noise.
    Source: of coloured noise in 48 s (`tests/unit/test_simulation_honesty.py`) one axis had 99 beside one with 0.3;
    laws of one axis of strengths 1,100 and 8,500 (law/261 and law/037 of 66ff7ef1) had 1,020 and 737."""
    filtered: float = 100.0
    """Stretches, two memories of the rows' own filter apart, below which a remainder without a name must be beyond
    `chance` too. Source: AR(1) noise of 0.9 over 1,200 rows has 60, and 2 of the first 2 recordings of the same command
    (seeds 100 and 101) had an `unknown`."""
    chance: float = 1e-6
    """Probability of chance below which an effect or a place is believed all the same. Source: the false ones of that
    command had 8e-4 and 2e-5; a strength of 60 has less."""
    law_chance: float = 1e-9
    """As `chance`, for a law. Source: a false one of that command had 2e-6, of which laws have many more forms."""


COLOUR = ColourPolicy()


@dataclass(frozen=True)
class JitterPolicy:
    """Sampling jitter."""

    certain: float = 30.0
    """-2 log likelihood of all channels, gain from which jitter is named: unmodelled tails never reach it. Source:
    chi-square: beyond 30 by chance in 1.4e-6 with three channels, in 4e-5 with six."""


JITTER = JitterPolicy()


@dataclass(frozen=True)
class RowNoisePolicy:
    """The noise of rows."""

    projected_share: float = 0.05
    """Share of the rows' degrees of freedom that the projection takes from which the filter is chosen anew. Source:
    170 functions on 1,200 rows of AR(1) noise of 0.7 gave 0.59 and a random walk in 60 % of nulls, chosen anew 0.69 and
    none in 60 (tests/unit/test_diagnosis_rotation.py); on 5,200 rows neither had any."""
    colour_turns: int = 8
    """Times that the filter of the colour is found anew, at most. Source: chosen; it has settled after three to six."""
    colour_settled: float = 0.005
    """Change of a coefficient of it below which it has settled. Source: chosen; a tenth of its standard deviation at
    1,200 rows."""
    spectrum: int = 16384
    """Lags of the circle on which a filter is taken back. Source: chosen; ten times the memory of a pole at 0.995."""
    max_order: int = 16
    """Terms of a channel's filter, at most. Source: studies.thresholds, 8 to 32."""
    stretch: int = 4096
    """Rows whose draws of rounding are made together. Source: chosen; as many as are worked on at a time."""
    max_rows: int = 24_000
    """Rows that the noise is learned from; of longer recordings, windows spread over all of it. Source: a limit of
    time: each coefficient of a filter is then known to 1 / sqrt(24000) = 0.006."""
    windows: int = 8
    """Such windows. Source: 3000 rows each at `max_rows`, more than a hundred lengths of the longest filter."""
    draws: int = 24
    """Draws of white noise by which it is found out what projecting takes. Source: the mean square of 24 draws of a
    thousand rows or more is known to 1 %."""
    variance_gain: float = 12.0
    """-2 log likelihood, gain from which a dependence of the scatter is believed. Source: chi-square of one degree of
    freedom: beyond 12 by chance in 0.05 %."""
    scale_s: float = 8.0
    """s; time over which the size of the noise is averaged. Source: studies.thresholds, 4 to 16."""
    impulse: float = 6.0
    """Standard deviations from which a row is an impulse. Source: a normal law has 2e-9 beyond six of its standard
    deviations: one in 20,000 recordings of 24,000 rows."""
    max_impulses: float = 2e-3
    """A larger share of outlying rows is the shape of the noise, not impulses. Source: Student's law of four degrees of
    freedom has 0.27 % beyond six scatters: what is as heavy is a shape."""
    rounding: float = 1e-9
    """No reading is taken to be more exact than this share of its size. Source: 30 bits, more than any converter's
    effective number."""
    digits: float = 1e-4
    """What is left of readings is evaluated to four digits: share of its size. Source: a definition: four digits."""
    least: float = 1e-15
    """g or rad/s; no noise is smaller. Source: rounding: five times that of a double of 1 g (2.2e-16)."""
    variance_turns: int = 6
    """Turns of the iterated fit of the variance. Source: studies.thresholds, 3 to 12."""
    least_variance: float = 1e-3
    """Share of the mean variance below which none is fitted. Source: chosen; 3 % of the scatter, which only keeps a
    row's weight finite."""
    least_level: float = 1e-6
    """Squared scatters; least constant part of the variance. Source: chosen; a thousandth of the scatter, which only
    keeps a row's weight finite."""
    least_stretches: int = 4
    """Stretches of `scale_s` from which a slow change can be detected. Source: chosen; a scatter of three degrees of
    freedom."""
    slow_share: float = 0.5
    """Share of the stretches' scatter beyond chance from which the size changes slowly. Source: half: from where the
    change is larger than what chance does to it."""
    quietest: float = 0.05
    """Share of the mean variance; no stretch is quieter. Source: studies.thresholds, 0.025 to 0.1."""


ROW_NOISE = RowNoisePolicy()


@dataclass(frozen=True)
class RowPlacesPolicy:
    """Where rows are looked at."""

    slow_band_hz: float = 0.23
    """Hz; below this a group of slow functions is judged by as many degrees of freedom as the band has. Source:
    studies.thresholds, 0.115 to 0.46."""
    rows: int = 20_000
    """Rows by which intervals of a covariate are found. Source: a limit of time: an interval of 1 % of the range still
    has 200 rows."""
    stretches: int = 4
    """Stretches, spread over a long recording, that these rows are. Source: chosen; 5000 rows each at `rows`."""
    least_seen: float = 0.1
    """Share, of what falls on so many rows of a long recording on the average, below which a function is too little in
    the windows that the noise was learned from for these to say what chance makes of it. Source: chosen; the
    threshold is 3.75 on 1e5, 1e6 and 2e7 rows, where it was 9, 63 and 300 (`python -m studies.giant_recording`)."""
    least_left: float = 0.1
    """Share of the rows that a projection leaves, at least, when its loss is given back. Source: a factor of ten at
    most: beyond it what is left is not worth correcting."""


ROW_PLACES = RowPlacesPolicy()


@dataclass(frozen=True)
class RowSessionsPolicy:
    """Rows of a recording."""

    sample: int = 96_000
    """Rows of a recording that is not in the memory by which laws are sought and figures drawn. Source: chosen; they
    are averaged in 3,000 cells as all rows would be."""
    sample_stretches: int = 16
    """Stretches that these are. Source: chosen; as many as a rate or a temperature has levels."""
    min_rows: int = 1000
    """Fewer rows are too short a stretch for a noise with memory to be known. Source: studies.thresholds, 500 to
    1000."""
    missing: float = 1e-3
    """Share by which a recording lasts longer than its rows, from which rows are missing. Source: a thinned recording
    lasts up to one row more, of a thousand at least."""
    rate_groups: int = 12
    """Groups of steady rates, at most. Source: chosen; the designs have ten steady rates at most."""
    steady: float = 0.02
    """1/s; change of the rate, in spans of the rate, up to which it is steady. Source: studies.thresholds, 0.01 to
    0.04."""
    level: float = 0.02
    """Share of the largest rate within which rates are alike. Source: studies.thresholds, 0.01 to 0.04."""
    least_share: float = 0.01
    """Share of the rows from which a rate is one of the steady ones. Source: chosen; below one in a hundred a ramp's
    rows, which pass through a rate, would be one."""


ROW_SESSIONS = RowSessionsPolicy()

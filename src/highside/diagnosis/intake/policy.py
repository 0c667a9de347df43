"""The numbers that decide whether a recording is what it claims to be.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ChecksPolicy:
    """Faults of channels."""

    stretch: int = 1 << 18
    """Rows of a recording that is not in the memory that are checked together. Source: chosen; 40 MB while they are."""
    clipped_share: float = 0.2
    """Where more of a channel is clipped, the rest says too little. Source: tests/unit/test_diagnosis_intake.py holds
    from 0.1 to 0.4 (seven at once)."""
    missing_share: float = 0.5
    """Share of the rows that may lack a value and be left out of poses. Source: tests/unit/test_diagnosis_gaps.py, 10
    to 30 % missing."""
    most_binary: int = 1000
    """Even odds multiplied, at most: 2^-1000 is still a double. Source: the format: the smallest normal double is
    2^-1022."""
    gravity: tuple[float, float] = (0.7, 1.4)
    """g; between these the median length of a reading is that of gravity. Source: a factor of 1.4 to either side: the
    next unit (1 / 9.81, 9.81, 1000) is far."""
    unit: tuple[float, float] = (0.8, 1.25)
    """Between these factors a length is gravity in another unit. Source: 0.8 and 1/0.8: a length within the 25 % by
    which scale and bias of a sensor that works may change it."""
    away_g: float = 0.3
    """g; a reading whose length is off by more counts against the unit. Source: as the lower end of `gravity`, 1 -
    0.7."""
    follows_g: float = 0.2
    """g; rms up to which readings follow the bench's angles. Source: studies.thresholds, 0.1 to 0.4."""
    off_g2: float = 0.04
    """G^2; a reading off by more counts against the angles. Source: 0.2 g squared: 11.5 deg of an angle, more than any
    bench or misalignment is off."""
    few_off: float = 0.2
    """Share of the rows of stops, below which those that are off so far say nothing of the axes: each stop is looked at
    by itself. Source: chosen; with an axis turned half of the attitudes are."""
    listed: int = 8
    """Poses that are listed by their numbers. Source: chosen; a person reads them."""
    load_steps: int = 10
    """Converter steps by which loads must differ to be different. Source: studies.thresholds, 5 to 20."""
    load_g: float = 2e-3
    """g by which loads must differ to be different. Source: studies.thresholds, 0.001 to 0.004."""
    span_steps: int = 20
    """Converter steps that loads behind one reading must span for it to be a limit. Source:
    tests/unit/test_diagnosis_intake.py holds from 10 to 40 (seven at once)."""
    span_g: float = 5e-3
    """g that loads behind one reading must span for it to be a limit. Source: tests/unit/test_diagnosis_intake.py holds
    from 0.0025 to 0.01 (seven at once)."""
    least_codes: int = 16
    """Different readings from which a converter's step can be detected. Source: studies.thresholds, 8 to 32."""
    off_code: float = 0.02
    """Steps by which readings may be off whole numbers. Source: studies.thresholds, 0.01 to 0.04."""
    still: float = 0.8
    """Share of rows unchanged from the row before, from which the step hides the noise. Source: studies.thresholds, 0.4
    to 0.9."""
    better: float = 3.0
    """Times as well as under the axes given must readings follow the angles under others. Source:
    tests/unit/test_diagnosis_intake.py holds from 1.5 to 6 (seven at once)."""
    least_equal: int = 3
    """Readings at a limit, and different ones below it, from which it can be one. Source: studies.thresholds, 1 to
    6."""


CHECKS = ChecksPolicy()


@dataclass(frozen=True)
class ClockPolicy:
    """Order and times of frames."""

    stray: float = 1e-4
    """Share of frames that a healthy link may lose, repeat or disorder. Source: studies.thresholds, 5e-05 to 0.0002."""
    sure: float = 1e-6
    """Probability of chance below which a fault is reported. Source: studies.thresholds, 5e-07 to 2e-06."""
    lost_share: float = 0.5
    """Where more frames of a rotation are lost, the recording is not what it claims to be. Source:
    tests/unit/test_rotation_gaps.py, 10 to 30 % missing."""
    lost_few: float = 0.01
    """Share of lost frames up to which nobody need look at the link. Source: chosen; a hundred times `stray`, what a
    healthy link loses."""
    jitter: float = 0.02
    """Share of the usual spacing; spacings that scatter more say nothing of a clock. Source: studies.thresholds, 0.01
    to 0.04."""
    drift: float = 1e-3
    """Change of the clock's rate over a recording that spoils it. Source: chosen; ten times `least_drift`: no quartz
    does so."""
    alike: float = 0.6
    """Share of stops of one size from which a shorter one has lost rows. Source: studies.thresholds, 0.3 to 0.8."""
    look: int = 50
    """Rows that are looked at behind a step back, and steps back that are looked at. Source: studies.thresholds, 25 to
    100."""
    around: int = 10
    """Rows around a step back that must run evenly. Source: rows in disorder run forward ten times one after the other
    in 1 of 2^10 = 1024."""
    moving: float = 0.1
    """Chance, by a converter's steps alone, that neighbouring rows are equal, below which the tool moves. Source:
    chosen; nine tenths of a step from row to row."""
    half: float = 0.5
    """Share of rows in which it moves from which copies are looked for in these alone. Source: chosen; most of them."""
    near: int = 4
    """Rows on either side over which the motion from row to row is averaged. Source: chosen; of white noise a third is
    left, and a turn of 800 deg/s at 200 Hz goes on for 36 deg."""
    drifts: float = 3.0
    """Standard errors of the slope of a pose's rows, from which they drift. Source: chosen; one pose in 370
    by chance."""
    even: float = 1.5
    """Usual spacings; neighbours nearer than this follow one another. Source: halfway between the next row and the one
    after."""
    back: float = 0.5
    """Usual spacings by which time must fall for the clock to have been set back. Source: halfway between no step and a
    whole row."""
    rarer: int = 10
    """A clock set back is so many times as rare as a stray frame. Source: chosen; it changes the probability that is
    reported, not whether it is."""
    exact: float = 1e-6
    """Share of the usual spacing; no clock is taken to scatter less. Source: studies.thresholds, 5e-07 to 2e-06."""
    step: float = 0.25
    """Usual spacings from which a spacing is a step of the clock. Source: studies.thresholds, 0.125 to 0.5."""
    step_jitters: int = 20
    """Scatters of the spacings from which one is a step of the clock. Source: studies.thresholds, 10 to 40."""
    steps: int = 5
    """Steps of a clock, at most: more are its jitter. Source: chosen; a clock is set once or a few times in a
    recording."""
    parts: int = 20
    """Parts of a recording by whose medians the clock's drift is observed. Source: studies.thresholds, 10 to 40."""
    least_drift: float = 1e-4
    """Change of the clock's rate that is reported. Source: physics: a plain quartz stays within 100 ppm over its range
    of temperature."""
    drift_jitters: int = 10
    """A drift is distinguished from one in so many of the spacings' scatter. Source: arithmetic; the median of a
    hundred spacings scatters by 1.25 / sqrt(100), an eighth of their own scatter."""
    twice: float = 1.5
    """Times as often as next but one neighbours agree, neighbours may. Source: studies.thresholds, 0.75 to 3."""
    least_stops: int = 3
    """Stops, more than which show how many rows one usually has. Source: studies.thresholds, 1 to 6."""
    least_stop: int = 2
    """Rows of a usual stop, more than which it can have lost some. Source: studies.thresholds, 1 to 4."""
    tails: int = 4
    """Degrees of freedom of Student's t that the jitter of a healthy clock is taken to have. Source: heavy on purpose:
    six scatters are then one difference in 260, for a normal law one in 5e8, so that only what is far out counts."""


CLOCK = ClockPolicy()


@dataclass(frozen=True)
class ImpulsesPolicy:
    """Single readings far off."""

    tails: tuple[float, ...] = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 20.0, 100.0)
    """Degrees of freedom of Student's t that healthy noise may have. Source: a grid: the 98 % quantiles of neighbours
    differ by 7 to 21 %; 100 is a normal law nearly."""
    window: int = 25
    """Rows around a reading by which its scatter is known; of a stop no longer than this the median is taken whole.
    Source: studies.thresholds, 12 to 50."""
    share: float = 0.01
    """Where more readings are impulses, they are no impulses but the recording. Source: chosen; of readings with tails
    of four degrees of freedom 0.4 % lie beyond six sigma, so that 1 % is a law of the noise, which heavy tails take."""
    expected: float = 1e-3
    """Impulses are readings of which a healthy recording has fewer than this. Source: studies.thresholds, 0.0005 to
    0.002."""
    least_rows: int = 100
    """Rows from which impulses can be detected. Source: studies.thresholds, 50 to 200."""
    tail: float = 0.98
    """Quantile of the sizes by which their tails are judged. Source: studies.thresholds, 0.49 to 0.99."""
    middle: float = 0.75
    """Two-sided, the median: the quantile beside which the tail is judged. Source: a definition."""
    slack: float = 0.95
    """Share of the tails observed that a law must reach. Source: studies.thresholds, 0.475 to 0.975."""
    least_stop: int = 5
    """Rows of a stop from which a reading can be compared with the others. Source: studies.thresholds, 2 to 10."""
    neighbours: int = 7
    """Rows whose median a reading is compared with in a long stop. Source: the shortest odd window whose median stays
    with three impulses in it."""
    windows: int = 4
    """Windows over which the scatter is taken. Source: studies.thresholds, 2 to 8."""
    quietest: float = 0.3
    """Share of the usual scatter; no stretch is taken to be quieter. Source: studies.thresholds, 0.15 to 0.6."""


IMPULSES = ImpulsesPolicy()

"""The numbers that decide whether a finding stands: noise floor, stability over the session, what it rests on.

As in `policy`, each with its unit, what it means, and the reference or the run that set it.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FloorPolicy:
    """How well readings repeat, and what stands above that."""

    chance: float = 1e-4
    """Probability of chance below which the floor does not explain what is left. Source: one session in a hundred may
    raise an alarm (`CandidateSetPolicy.alarm_rate`); a hundredth of that is left for this."""
    ratio: float = 1.3
    """Standard deviations left, in those of the floor, from which the difference is reported. Source: as
    `ProblemPolicy.floor_ratio`."""
    stretches: int = 4
    """Stretches of an interval whose means are compared, at least. Source: a definition."""
    least_differences: int = 6
    """Differences of means by which a longer stretch is judged, at least. Source: with the four degrees of freedom
    that they have at `longer`, a standard deviation of twice the shorter ones' passes."""
    many_differences: int = 30
    """Differences by which a variance is known well, to a quarter. Source: the chi-square law, sqrt(2 / 30)."""
    longer: float = 1e-3
    """Probability of chance below which the variance of a longer stretch stands in place of a shorter one's. Source:
    ten lengths are tried; one session in a hundred is then given a floor that is too high."""
    loud: float = 1e-4
    """Probability of chance below which the rows of an interval scatter more than those of all others. Source: as
    `chance`. One row of 36 that was off by 8 mg made the floor of one axis 2.1 mg, and hid laws of that size (law/214
    of the open world of seed 7a20f8c3)."""
    most_loud: float = 0.25
    """Share of the intervals that may be. Source: chosen; where more are, noise changes over a session, or with a
    vibration, and one floor stands for all."""
    overlap: float = 2 / 3
    """Degrees of freedom of a successive difference: neighbours share a mean. Source: von Neumann et al., Ann. Math.
    Statist. 12, 1941, for white noise."""
    dither: float = 0.5
    """Standard deviation in steps of a converter above which averaging removes the lattice. Source: Widrow and Kollar,
    Quantization Noise, 2008: the bias of a mean of Gaussian dither of half a step is below 1 % of the step."""
    sectors: int = 64
    """Sectors of a turn within which a channel is carried over steps of its converter, or is not. Source: a smooth law
    of the toolface has no more than a dozen orders, which are constant over a sixty-fourth of a turn."""
    spans: int = 16
    """Spans of a session over each of which it is looked at by itself. Source: chosen; of up to 30 rates in a session
    one that comes back to the same toolfaces fills one (12 bits, 720 deg/s at 50 Hz: 0.41 mg in one sixteenth, where
    the whole session had 0.06, and a law of 0.03 was told there)."""
    rounded: float = 0.05
    """Share of a step below which the error that rounding leaves in a mean is small. Source: in two rotations, with
    converters of 0.9 and 1 mg, it was 0.005 to 0.023 across the axis and 0.27 to 0.41 along it."""
    lattice_spread: float = 1.5
    """Factor within which differences of neighbouring levels are one step. Source: the next multiple is twice."""
    lattice_off: float = 0.02
    """Share of a step by which a level may be off its lattice. Source: rounding of six written digits."""
    least: float = 1e-12
    """g; no floor is smaller. Source: rounding of doubles."""


FLOOR = FloorPolicy()


@dataclass(frozen=True)
class StabilityPolicy:
    """Whether the size of a claim is a constant."""

    log_p: float = 5.0
    """-log10 p of the splits together from which a size changes. Source: a hundredth of `FloorPolicy.chance` would be
    6; of a thousand claims one in a hundred is then doubted by chance."""
    share: float = 0.01
    """Share of a claim's own gain that its change must add: less is no matter for its size (a tenth). Source: a factor
    of 0.9 and 1.1 in halves adds 0.01."""
    change_log_p: float = 3.5
    """-log10 p from which one change of the size, a step, a straight line or a wave, is believed. Source: one
    direction shows more than a size for each part does; of 4,000 constants in unit noise 2 exceed it, and of 200
    effects of constant size in five kinds of noise 1 was doubted (`studies/simulation_honesty.py sizes`, seeds 810 to
    814)."""
    wave_phases: int = 4
    """Phases at which one wave of the size over the session is tried. Source: between two of them 0.96 of what a wave
    adds is seen (cos^2 of 11 deg)."""
    decimals: int = 4
    """Decimals, in rad or rad/s, to which settings are alike. Source: 0.006 deg, below what benches repeat to."""
    levels: int = 4
    """Settings of a covariate from which its halves are compared. Source: two in each half."""


STABILITY = StabilityPolicy()


@dataclass(frozen=True)
class BesidePolicy:
    """A name beside other names."""

    certain: float = 1e-4
    """Probability of chance, all candidates together, below which it is told although the evidence beside the noise
    that was learnt for laws does not keep it. Source: as `FloorPolicy.chance`; of
    poses with known effects (seeds f225cf13 and 59463cce) all 17 true second names were kept, at 1e-7 and less, and two
    wrong ones, at 1e-3 and 1e-2, were not."""


BESIDE = BesidePolicy()


@dataclass(frozen=True)
class CheckedPolicy:
    """When a reported size must be wider."""

    covered: float = 0.5
    """Share of the holds below which nothing left out of those that were still says nothing of the session. Source: a
    definition, the lesser part."""
    remainder: float = 1.5
    """Mean square that is left, in those of the noise, from which intervals are widened by its root. Source: a fit of
    thirty degrees of freedom exceeds 1.5 by chance in 4 %."""


CHECKED = CheckedPolicy()


@dataclass(frozen=True)
class OutlyingPolicy:
    """Still readings that do not belong to the others."""

    least: int = 24
    """Poses from which one can be told from the others: three readings each, beside twelve free effects and angles.
    Source: chosen; with half as many a pose carries a third of its own prediction."""
    sigma: float = 8.0
    """Deletion residual beyond which a pose is outlying, and below which all that stay are, in robust standard
    deviations. Source:
    tests/unit/test_diagnosis_outlying.py; the largest of 72 poses of white noise is 4.2 in the median."""
    apart: float = 2.5
    """Times the largest of the poses that stay. Source: tests/unit/test_diagnosis_outlying.py; of Student's noise with
    3 degrees of freedom the two largest are so far apart in one session of sixteen (2.5^-3)."""
    share: float = 0.05
    """Share of the poses that may be outlying; more are no exception. Source: chosen."""
    most: int = 20
    """Poses that may be outlying, however many there are. Source: chosen; a person reads the list."""
    least_g: float = 1e-9
    """g; less noise no channel is taken to have. Source: rounding, of simulations without any noise."""
    of_median: float = 1.4826
    """Standard deviation of normal noise in units of the median of its size. Source: the third quartile, 0.6745."""
    rank: float = 1e-9
    """Share of the largest below which a column says nothing of its own. Source: rounding."""


OUTLYING = OutlyingPolicy()


@dataclass(frozen=True)
class ExchangedPolicy:
    """Two poses whose set angles were exchanged."""

    least: int = 12
    """Poses from which a pair can be told from the others. Source: chosen; ten of them determine what is free."""
    tried: int = 20
    """Pairs with which the base is fitted again. Source: chosen; of three pairs exchanged in 60 poses, by 0.03 to 60
    deg, the right one was the first of all without it."""
    most: int = 2
    """Pairs, at most: of more the whole order is in doubt. Source: chosen."""
    gain: float = 12.0
    """Nats that the exchange must gain beyond what the number of pairs makes by chance. Source: as
    `LawSearchPolicy.gain`."""
    falls: float = 2.0
    """Times by which the rms that is left falls, at least. Source: chosen; physics that acts in most poses leaves more
    than half of itself whichever two are exchanged."""
    like_others: float = 4.0
    """Size of what is then left of the two, in that of the median pose, at most. Source: as `sigma` of three readings
    each, whose median size is 1.5 standard deviations."""


EXCHANGED = ExchangedPolicy()

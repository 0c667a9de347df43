"""The numbers that decide, of what all kinds of recordings share.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. Whoever moves one puts the engine to the sealed cases again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class RegressionPolicy:
    """Whether directions and probabilities are there at all."""

    visible: float = 0.005
    """Share of a direction's length that must stand out of the base fit: second-order terms reach less. Source:
    studies.thresholds, 0.0025 to 0.01."""
    independent: float = 1e-6
    """Share of the largest singular value from which a direction is independent of the others. Source:
    studies.thresholds, 5e-07 to 2e-06."""

    rarest: float = 1e-300
    """The smallest probability that is written; -log10 p itself has no limit. Source: the range of doubles."""
    by_logarithm: float = 1e-280
    """Probabilities below this are found by their logarithms. Source: the range of doubles, less what the laws of
    `scipy.special` lose before they are 0."""
    settled: float = 1e-12
    """Relative change of a continued fraction below which it has settled. Source: rounding of doubles."""
    terms: int = 10_000
    """Terms of it, at most. Source: it takes some multiple of the root of half the degrees of freedom, 3,000 of 2e7."""


REGRESSION = RegressionPolicy()


@dataclass(frozen=True)
class CandidatesPolicy:
    """What is tried of an effect's shapes."""

    shortest: float = 0.03
    """Share of a recording: a shorter time constant is over before anything else happens. Source: studies.thresholds,
    0.015 to 0.06."""
    least_at_station: int = 6
    """Poses of an inclination station, on average, for single inclination stations to be looked at: one that is off
    looks like serially correlated noise. Source: studies.thresholds, 3 to 12."""
    from_the_ends: int = 4
    """Poses at each end beside which no step is tried. Source: studies.thresholds, 2 to 8."""
    onsets: int = 300
    """Instants between poses at which an onset is tried, at most. Source: known/192 of 8d0136d1; 60 missed a step."""
    inclination_stations: int = 4
    """A single inclination station is looked at where there are more inclination stations than this. Source:
    studies.thresholds, 2 to 8."""
    warm_span_c: float = 0.5
    """degC; a temperature that changes by less says nothing. Source: studies.thresholds, 0.25 to 1."""


CANDIDATES = CandidatesPolicy()


@dataclass(frozen=True)
class CausesPolicy:
    """What a claim follows."""

    fine: int = 400
    """Cells of a covariate, where every setting is not one: what an effect adds has no noise. Source:
    studies.thresholds, 200 to 800."""
    cells_to_agree: int = 200
    """Cells in which equal values of a covariate are compared. Source: arithmetic; twelve waves over the range vary
    within a cell by (12 pi / 200)^2 / 3 = 1.2 % of their variance, less than `follows`."""
    follows: float = 0.02
    """Share of its variance that may be left within equal values of the covariate it follows. Source:
    studies.thresholds, 0.01 to 0.04."""
    most_rows: int = 20_000
    """Rows; of a longer recording every so many are used. Source: studies.thresholds, 1e+04 to 4e+04."""
    inclined_rad: float = 0.002
    """rad; inclinations that differ by less are one. Source: chosen; 0.11 deg, more than a bench is off at one station
    and less than any step between two."""
    nothing: float = 1e-24
    """Sum of squares, g^2, of an effect that adds nothing. Source: studies.thresholds, 5e-25 to 2e-24."""


CAUSES = CausesPolicy()


@dataclass(frozen=True)
class ChunksPolicy:
    """How long recordings are passed through."""

    rows: int = 4096
    """Rows worked on at a time: they stay near the processor. Source: studies.thresholds, 2048 to 8192."""
    threads: int = 2
    """Runs of rows that are worked on at once, unless more are asked for. Source: studies.thresholds, 1 to 4."""


CHUNKS = ChunksPolicy()


@dataclass(frozen=True)
class ConclusionPolicy:
    """What is reported of what was chosen."""

    changing: float = 0.97
    """Share of the misfit that a claim explains from which it may still vary a little along a covariate. Source:
    arithmetic; what is left of a size that is off by 17 % along a covariate, 0.17^2 = 3 %."""
    manifest: float = 1000.0
    """Chi-square of an effect beside all others from which, if nothing is left, it is no part of a mere fit: several
    names for something that has none leave some percent of it, which would then be detected. Source:
    studies.thresholds, 500 to 2000."""
    station_margin: float = 2.0
    """BIC; as `ProblemPolicy.interaction_margin`, for a single inclination station: its place was searched, and a name
    that is reported beats a random walk besides. Source: studies.thresholds, 1 to 4."""
    own: float = 5e-3
    """Share of the largest singular value from which a term's direction is its own beside the others. Source:
    studies.thresholds, 0.0025 to 0.01."""
    ruled_out: int = 3
    """Rivals that are reported to be ruled out, beside those that are often taken for the effect. Source:
    studies.thresholds, 1 to 6."""


CONCLUSION = ConclusionPolicy()


@dataclass(frozen=True)
class RivalRefitPolicy:
    """Rivals of strong effects, fitted in full."""

    alike: float = 2.0
    """BIC; a smaller difference is not worth a mention. Source: Kass and Raftery, J. Amer. Statist. Assoc. 90, 1995."""
    refitted: int = 3
    """Rivals of a strong effect that are fitted in full. Source: chosen; a limit of time, as each is a whole fit."""
    needed: float = 12.0
    """Chi-square by which the full fit must be worse without a term. Source: a sag of 0.9 deg, beside which a harmonic
    of the inclination was chosen to first order, loses 2 without that; a term is chosen from about 25 on."""
    nothing: float = 3.0
    """Standard deviations within which a fitted size is nothing, and the term is tried to be left away. Source: that
    harmonic came out at 1.1 of them; of what is there 1 in 370 does for each amplitude, and then 12 must be lost."""


RIVAL_REFIT = RivalRefitPolicy()


@dataclass(frozen=True)
class FitsPolicy:
    """Fits of the full model."""

    rich_share: float = 0.5
    """Of all readings, how many directions at most the rich model may take. Source: studies.thresholds, 0.25 to 1."""
    rich_shapes: int = 5
    """Shapes of an effect that the rich model takes. Source: studies.thresholds, 2 to 10."""
    rich_left: float = 0.05
    """Share of a reading that the rich model leaves, at least, when its loss is given back. Source: studies.thresholds,
    0.025 to 0.1."""
    steps: int = 4
    """Gauss-Newton steps of a joint fit, at most. Source: studies.thresholds, 2 to 8."""
    undetermined: float = 1e-8
    """Share of the best determined direction from which a direction in the space of the parameters is determined at
    all. Source: studies.thresholds, 5e-09 to 2e-08."""
    many: int = 3000
    """Readings from which normal equations are formed. Source: studies.thresholds, 1500 to 6000."""
    settled: float = 1e-6
    """Chi-square of a step that is the last. Source: studies.thresholds, 5e-07 to 2e-06."""
    second_order: float = 6.0
    """Chi-square of what effects do beyond first order, from which it is no rounding. Source: studies.thresholds, 3 to
    12."""
    unmoved: float = 1e-12
    """Length of a column beside the longest, below which it is rounding. Source: studies.thresholds, 5e-13 to 2e-12."""
    rank: float = 1e-10
    """Share of the largest singular value below which one is rounding. Source: studies.thresholds, 5e-11 to 2e-10."""
    stride: float = 1.33
    """Factor by which a time constant moves in one step, at most. Source: studies.thresholds, 1.33 to 2.66."""
    partly_undetermined: float = 1e-6
    """Share of a parameter's direction that lies in what is not determined, from which it is given by its plausible
    range. Source: studies.thresholds, 5e-07 to 2e-06."""


FITS = FitsPolicy()


@dataclass(frozen=True)
class IntervalsPolicy:
    """Intervals that hold 95 %."""

    upper: float = 0.975
    """Probability below the upper end of a two-sided interval. Source: a definition."""
    normal: float = 1.96
    """Standard deviations of that end under the normal law. Source: quantile of the standard normal law at 0.975."""
    from_mad: float = 1.4826
    """Standard deviations of a normal law in one median absolute deviation. Source: 1 / quantile of the standard normal
    law at 0.75."""
    mad: float = 0.6745
    """Median absolute deviation of a standard normal law. Source: quantile of the standard normal law at 0.75."""
    chi2_95: float = 2.7
    """-2 log likelihood: the one-sided 95 % quantile of chi-square with one degree of freedom. Source: Chi-square
    table, 2.706."""


INTERVALS = IntervalsPolicy()


@dataclass(frozen=True)
class HeldOutPolicy:
    """Prediction of what was left out."""

    transient: float = 0.1
    """Share of a term's energy outside of a block, below which the other blocks say nothing of it. Source:
    studies.thresholds, 0.05 to 0.2."""
    folds: int = 10
    """Blocks of poses, each predicted from the others. Source: studies.thresholds, 5 to 20."""
    poses_a_fold: int = 3
    """Poses of a block, at least. Source: studies.thresholds, 1 to 6."""


HELD_OUT = HeldOutPolicy()


@dataclass(frozen=True)
class PlacesPolicy:
    """Where a mismatch sits."""

    harmonics: int = 8
    """Highest order of the toolface that is scanned. Source: studies.thresholds, 4 to 16."""
    time_cells: int = 40
    """Cells of time in which a range is sought. Source: studies.thresholds, 20 to 80."""
    inclination_orders: int = 4
    """Orders of the inclination that are scanned end below this. Source: studies.thresholds, 2 to 8."""
    product_orders: int = 4
    """Orders of the toolface that are scanned in products. Source: studies.thresholds, 2 to 8."""
    warm_span_c: float = 0.5
    """degC; a temperature that changes by less says nothing. Source: studies.thresholds, 0.25 to 1."""
    time_orders: int = 7
    """Waves of time that are scanned end below this. Source: studies.thresholds, 3 to 14."""
    poses_a_wave: int = 6
    """Poses for each wave of time that is scanned. Source: studies.thresholds, 3 to 12."""
    channel_share: float = 0.1
    """Share of the strongest channel's energy from which one is reported. Source: studies.thresholds, 0.05 to 0.2."""
    explained: float = 0.9
    """Share of what the best covariate explains that a simpler one must. Source: studies.thresholds, 0.45 to 0.95."""
    ranged: float = 0.25
    """Share of the largest mean energy above which a range is reported. Source: studies.thresholds, 0.125 to 0.5."""


PLACES = PlacesPolicy()


@dataclass(frozen=True)
class CandidateSetPolicy:
    """What chance makes of a whole family of candidates."""

    alarm_rate: float = 0.01
    """Share of sessions without a mismatch in which the family may raise an alarm. Source: the goal that
    docs/evidence.md states; studies/sealed/score.py measures what is reached."""
    flips: int = 300
    """Sets of block signs that are drawn. Source: studies.thresholds, 150 to 600."""
    block_poses: int = 6
    """Poses whose signs are flipped together: noise may be serially correlated over fewer. Source: studies.thresholds,
    3 to 12."""
    half: float = 2 * np.log(2)
    """Chi-square: gain of an amplitude of known sign, half of what one of either sign might have been has been ruled
    out. Source: 2 log 2, Bayes' rule."""
    hysteresis: float = 6.6
    """Chi-square that one direction gains by chance in 1 % of cases: a slack with hysteresis must be better by as much
    than one that does not, which it becomes where the tool hardly ever turns back. Source: Chi-square table, one degree
    of freedom."""


CANDIDATE_SET = CandidateSetPolicy()


@dataclass(frozen=True)
class RivalsPolicy:
    """What cannot be distinguished from a claim."""

    same_class_bic: float = 6.0
    """BIC; a rival that comes nearer to a claim is of its class. Source: agrees with the mark of strong evidence in
    Kass and Raftery, J. Amer. Statist. Assoc. 90, 1995."""
    same_class_evidence: float = 12.0
    """Chi-square that a claim must keep outside of a rival: what one amplitude needs to show with 80 % probability.
    Source: `evidence_80` at p = 0.01 gives 11.5."""
    rival_log_p: float = 1.5
    """-log10 p from which something is a rival at all. Source: studies.thresholds, 0.75 to 3."""
    beyond_reason: float = 100.0
    """Plausible sizes; an effect that must be larger is as good as absorbed. Source: studies.thresholds, 50 to 200."""
    power_80: float = 0.8416
    """Standard normal quantile of 80 %. Source: a definition."""
    most_log_p: float = 12.0
    """-log10 p beyond which the F law's quantile is not computed in double precision. Source: studies.thresholds, 6 to
    24."""
    next_poses: int = 6
    """Poses that are advised. Source: studies.thresholds, 3 to 12."""
    inclinations_deg: int = 15
    """deg; step of the inclinations among which poses are advised. Source: studies.thresholds, 7 to 30."""
    toolfaces_deg: float = 22.5
    """deg; step of the toolfaces among which poses are advised. Source: studies.thresholds, 11.25 to 45."""


RIVALS = RivalsPolicy()


@dataclass(frozen=True)
class SelectionPolicy:
    """How many and which candidates are chosen."""

    most: int = 4
    """Claims, at most. Source: studies.thresholds, 2 to 8."""
    rounding: float = 1e-6
    """Chi-square; gains that differ by less are equal: of these that which stands first in the library is chosen.
    Source: studies.thresholds, 5e-07 to 2e-06."""
    merge_bic: float = 6.0
    """BIC; one name instead of two where it costs less than this. Source: studies.thresholds, 3 to 12."""
    starts: int = 4
    """Candidates from each of which choosing begins. Source: studies.thresholds, 2 to 8."""
    promising: float = 0.3
    """Share of the first choice's gain of BIC from which choosing is begun from another candidate as well. Source:
    studies.thresholds, 0.15 to 0.6."""
    held: float = 0.01
    """Share of an effect's energy outside of another, below which it is a case of that other. Source:
    studies.thresholds, 0.005 to 0.02."""
    shortlist: int = 4
    """Candidates whose held-out gain is compared in one step. Source: studies.thresholds, 2 to 8."""
    swaps: int = 8
    """Rounds of swaps and drops, at most. Source: studies.thresholds, 4 to 16."""


SELECTION = SelectionPolicy()


@dataclass(frozen=True)
class SupportPolicy:
    """The shortest range that explains a mismatch."""

    settings: int = 48
    """A covariate with at most so many values is stepped: each is a cell. Source: studies.thresholds, 24 to 96."""
    cells: int = 24
    """Cells of a covariate that is not stepped. Source: a definition: 15 deg of a turn each."""
    windows: int = 3
    """Windows of one mismatch. Source: studies.thresholds, 1 to 6."""
    ridge: float = 1e-7
    """Share of a cell's energy added to it, so that cells alike can be solved for. Source: above the rounding of inner
    products, 1.5e-8 (the square root of double precision's)."""


SUPPORT = SupportPolicy()


@dataclass(frozen=True)
class UntestablePolicy:
    """When a manoeuvre is lacking."""

    one_inclination_rad: float = 2e-4
    """rad; inclinations that differ by less are one. Source: studies.thresholds, 0.0001 to 0.0004."""


UNTESTABLE = UntestablePolicy()


@dataclass(frozen=True)
class RepeatabilityPolicy:
    """What is left beside how well readings repeat."""

    beyond: float = 4.0
    """Times that readings may disagree more than they repeat and be explained. Source: the real multi-pose recordings
    disagree 0.9, 0.9 and 2.6 times as much (tests/integration/test_diagnose_real.py)."""
    strength: float = 300.0
    """Chi-square that must be gone for what is slow to be believed at the floor, whatever a random walk would do.
    Source: a straight line leaves a tenth of a random walk in one of a hundred, which then is no chance beside 30
    readings."""
    slack: float = 0.5
    """Share of the degrees of freedom that may be left beyond the floor. Source: as `beyond`."""
    remainder: float = 0.02
    """Share of what is gone that may be left beyond the floor: time constants are tried at a few values. Source:
    tests/unit/test_slow_to_the_floor.py, warm-ups of 0.5 to 5 mg."""


REPEATABILITY = RepeatabilityPolicy()


@dataclass(frozen=True)
class ProcedurePolicy:
    """How often the procedure goes round."""

    refined: int = 2
    """Slow effects of which the best time constant is looked for beside a random walk. Source: chosen; a limit of time,
    as each is a search of its own."""
    relinearisations: int = 2
    """Times that what is beyond first order is taken out: the second is exact where the first was nearly. Source:
    studies.thresholds, 1 to 4."""
    doubts: int = 4
    """Times that what is chosen in place of what a random walk explains as well must pass the same test. Source:
    studies.thresholds, 2 to 8."""
    station_certain: float = 3.0
    """-log10 p; so much more is required of one inclination station than of an effect: nothing but its place speaks for
    it. Source: studies.thresholds, 1.5 to 6."""


PROCEDURE = ProcedurePolicy()

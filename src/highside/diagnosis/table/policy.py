"""The numbers that decide for published tables.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array


@dataclass(frozen=True)
class StationAdvicePolicy:
    """Which inclination station to measure next."""

    inclinations_deg: tuple[float, ...] = (
        0.3,
        0.6,
        1.0,
        2.0,
        5.0,
        10.0,
        15.0,
        20.0,
        30.0,
        45.0,
        60.0,
        75.0,
        90.0,
        105.0,
        120.0,
        135.0,
        150.0,
        160.0,
        165.0,
        170.0,
        175.0,
        178.0,
        179.0,
    )
    """deg; inclinations among which an inclination station is advised. Source: a grid: from 5 to 165 deg as a bench's
    stations lie, and finer towards the vertical, where the toolface's errors grow as 1 / sin I."""
    worth: float = 6.0
    """Chi-square; an inclination station that parts two explanations by less is no advice. Source: `believed` of a
    table's verdict: as strong as what a name needs."""
    draws: int = 24
    """Draws of chance by which a new inclination station is predicted. Source: a standard deviation from 24 draws is
    known to 14 %: enough to compare inclinations."""


STATION_ADVICE = StationAdvicePolicy()


@dataclass(frozen=True)
class ChainPolicy:
    """The simulated procedure behind a table."""

    horizontal_rad: float = np.radians(0.6)
    """rad (0.6 deg); nearer to 90 deg than this the balance matrix is degenerate: its inclination is exact by
    construction. Source: geometry; there 1 / cos(89.4 deg) = 95 magnifies what is measured."""
    chunk: int = 16
    """Draws worked on at a time. Source: a processor's cache: 16 draws of a row's 73 stations of four readings, three
    axes in single precision, are 56 KB; no answer depends on it."""
    series_to: float = 0.2
    """Tangent up to which five terms of the series of the arc tangent are exact to single precision. Source: the first
    term that is left out, 0.2^11 / 11 = 2e-9, is 1e-8 of the tangent: below the 6e-8 of single precision."""
    stations: int = 73
    """Stations of a revolution, 0 and 360 deg both counted: one each 5 deg. Source: the balance paper's procedure
    (docs/theory/balance.md): stations 5 deg apart."""
    readings: int = 4
    """Readings averaged at a station. Source: the balance paper's procedure: four unfiltered readings a station."""
    stops: int = 400
    """Draws of a bench's stops by which their covariance is known. Source: a standard deviation from 400 draws is known
    to 3.5 % (1 / sqrt(800))."""
    step: float = 1e-6
    """g; difference by which derivatives are taken. Source: the best step of a central difference in doubles is the
    cube root of their rounding, 6e-6."""
    series: tuple[float, ...] = (1 / 9, -1 / 7, 1 / 5, -1 / 3)
    """Terms of the series of the arc tangent. Source: a definition."""


CHAIN = ChainPolicy()


@dataclass(frozen=True)
class TableVerdictPolicy:
    """What is reported of a table."""

    named_share: float = 0.85
    """Share of the unexplained scatter's variance that names must remove to be given. Source: studies.thresholds, 0.425
    to 0.925."""
    believed: float = 6.0
    """BIC; a term is named where every set without its class scores worse by this. Source: Kass and Raftery (JASA 90,
    1995): a difference of BIC above 6 is strong evidence."""
    off: float = 2.0
    """Sigma; cells that stay off by more are reported. Source: two sigma, 4.6 % of a normal law: said of a cell, and of
    no consequence for the verdict."""
    shows: float = 4.0
    """Chi-square by which a term must move the means to have a name. Source: chi-square of one degree of freedom: two
    sigma, 4.6 %."""
    observed_scatter: float = 12.0
    """Deviance, gain at which the scatter beyond chance is there. Source: a variance at its bound: half of a chi-square
    of one degree of freedom, 2.7e-4 beyond 12."""
    progress: tuple[float, float] = (0.6, 0.35)
    """Shares of the work done: the search, then the rivals. For a bar of progress alone. Source: no answer depends on
    it."""
    no_scatter_rad: float = 1e-7
    """rad; a scatter that is none. Source: a tenth of the least scatter that is tried."""
    of_means: float = 0.1
    """Share of what a term moves that must be means. Source: studies.thresholds, 0.05 to 0.2."""


TABLE_VERDICT = TableVerdictPolicy()


@dataclass(frozen=True)
class ExplainingPolicy:
    """Sets of effects for a table."""

    step_rad: float = float(np.radians(0.009))
    """rad (0.009 deg); half a step of a usual turntable (0.018 deg): where a model does not say how its bench stops.
    Source: a turntable of 20,000 steps a turn, 0.018 deg each, rounds to half of that."""
    min_cells: int = 12
    """Cells of a table, at least. Source: three rows of four cells: three cells for each amplitude at
    `TableFitsPolicy.max_amplitudes`."""
    progress: float = 0.7
    """Share of the work done by the first search. For a bar of progress alone. Source: no answer depends on it."""
    lost: int = 5
    """One in so many rows may stay unexplained. Source: studies.thresholds, 2 to 10."""


EXPLAINING = ExplainingPolicy()


@dataclass(frozen=True)
class TableFitsPolicy:
    """Fits of sets of effects to a table."""

    noise_g: float = 50e-6
    """g; one reading's noise where the model gives none; then known within a factor of about two and fitted. Source:
    near 71e-6, the middle of a logarithm's scale of `noise_range_g`."""
    noise_log_std: float = 0.7
    """Standard deviation beforehand of the logarithm of that noise. Source: ln 2 = 0.69."""
    wide: float = 30.0
    """Typical sizes; standard deviation beforehand of what may be refitted: hardly any knowledge. Source: an amplitude
    that is known to its typical size is drawn towards zero by 1 / 901 = 0.1 %."""
    heavy: float = 3.0
    """Typical sizes; larger ones cost. Source: three sigma of a normal law, 0.27 %."""
    fit_draws: int = 16
    """Draws of chance that a fit sees. Source: a limit of time; a mean of 16 draws adds 1/16 to the variance of chance,
    which is counted."""
    chance_draws: int = 400
    """Draws by which the covariance of chance is known. Source: a standard deviation from 400 draws is known to 3.5 %
    (1 / sqrt(800))."""
    max_amplitudes: int = 4
    """Amplitudes at once: more fit anything that forty numbers can say. Source: ten of forty cells for each, the rule
    of thumb of regression (Harrell, Regression Modeling Strategies: 10 to 20 observations for a parameter)."""
    ridge: float = 0.01
    """Share of a cell's variance added to it: draws leave their covariance uncertain. Source: studies.thresholds, 0.005
    to 0.02."""
    start_tau_rad: float = 3e-4
    """rad; scatter beyond chance from which a fit starts. Source: studies.thresholds, 0.00015 to 0.0006."""
    first_steps: int = 4
    """Steps from each of several starts. Source: studies.thresholds, 2 to 8."""
    guess: float = 0.7
    """Typical sizes from which a new amplitude starts. Source: studies.thresholds, 0.35 to 0.85."""
    steps: int = 12
    """Steps of a fit, at most. Source: a limit of time."""
    damping: float = 1e-3
    """Damping of the first step, of the diagonal. Source: Press et al., Numerical Recipes: Levenberg's and Marquardt's
    method begins at 0.001."""
    noise_range_g: tuple[float, float] = (1e-6, 5e-3)
    """g; noises of a reading that are tried. Source: physics: 1 ug is below the quietest reading of a quartz
    accelerometer, 5 mg above that of any sensor worth a table."""
    settled: float = 0.1
    """Deviance of a step that is the last. Source: a tenth of what one sigma of one parameter costs."""
    damping_factor: int = 8
    """Factor of the damping from step to step. Source: near the ten of Marquardt (SIAM Journal 11, 1963)."""
    least_damping: float = 1e-6
    """Least damping. Source: three and a third of `damping_factor` below the first: a step is then that of Gauss and
    Newton to 1e-6."""
    most_damping: float = 1e5
    """Damping at which a fit is given up. Source: nine of `damping_factor` above the first: a step is then 1e-5 of the
    full one."""
    tau_range_rad: tuple[float, float] = (1e-6, 1e-2)
    """rad; scatters beyond chance that are tried. Source: physics: 1 urad is below what any bench repeats, 10 mrad (0.6
    deg) more than any table in use leaves."""


TABLE_FITS = TableFitsPolicy()


@dataclass(frozen=True)
class InstrumentPolicy:
    """What a table says of its instrument."""

    evidence_80: float = 20.0
    """Chi-square that an effect of few amplitudes needs to be detected with 80 % probability. Source: noncentral
    chi-square of 20: beyond `SearchPolicy.step` and ln 40, 12.7, in 82 % with one amplitude."""
    probe: float = 0.3
    """Typical sizes by which the cells' change with an effect is known. Source: studies.thresholds, 0.15 to 0.6."""
    draws: int = 200
    """Draws of chance by which another table is predicted. Source: a standard deviation from 200 draws is known to 5 %
    (1 / sqrt(400))."""


INSTRUMENT = InstrumentPolicy()


@dataclass(frozen=True)
class PosteriorPolicy:
    """What a table leaves open."""

    there: float = 0.25
    """Probability beforehand that an effect of the library is there: of a dozen that a table can show, three or so.
    Source: a prior: three of a dozen, as said."""
    whole: float = 0.5
    """Probability beforehand that an effect that is there acts with all of its amplitudes; else in any variant alike.
    Source: a prior of ignorance: even odds."""
    size: float = 1.5
    """Typical sizes; scale of the sizes' Cauchy prior: usual sizes count, large ones are not excluded. Source: a prior:
    half of a Cauchy law lies within its scale, 13 % beyond five of them."""
    proposals: int = 1200
    """Proposals of the importance sampling. Source: a limit of time, with `moves`."""
    moves: int = 8
    """Metropolis steps of each draw; with the proposals some 3600 evaluations of the table, some 3 s. Source: a limit
    of time, with `proposals`."""
    move: float = 0.4
    """Standard deviations; length of a step. Source: 2.38 / sqrt(d) is the best step in d dimensions (Roberts, Gelman
    and Gilks, 1997), 0.4 for d = 35: shorter than the best for a table's ten to twenty, and none that is refused
    often."""
    most_sets: int = 60
    """Sets of effects that are kept. Source: a limit of time."""
    searched_sets: int = 8
    """Of the most probable sets other signs are looked for: so many. Source: a limit of time."""
    grown_sets: tuple[int, ...] = (4, 3, 3)
    """So many of the most probable sets have other effects added, then of those that are there then, and once more.
    Source: a limit of time."""
    helpful: int = 14
    """Effects that are added to a set: those whose first step promises most. Source: a limit of time."""
    wider: float = 1.5
    """The noise is proposed from so many times its spread about a mode: it is known less well than the mode says.
    Source: importance sampling: a proposal wider than what is required keeps weights bounded, and costs a third of the
    draws."""
    noises: tuple[float, ...] = (0.4, 0.55, 0.75, 1.0, 1.35, 1.8)
    """Noises at which a mode is fitted again, as multiples of its own. Source: a grid: each 1.3 to 1.4 times the one
    before, within the factor of two and a half to either side that `noise_log_std` thinks likely."""
    between: float = 0.2
    """Spread of the logarithm of the noise about each of these. Source: two thirds of the step from one of `noises` to
    the next (ln 1.35 = 0.3): between two the proposal has 0.75 of its top."""
    signs_kept: int = 3
    """Modes of a set that are fitted so. Source: a limit of time."""
    freedom: int = 6
    """Degrees of freedom of the proposals: heavier tails than what is required. Source: Geweke (Econometrica 57, 1989):
    Student's t as a proposal; weights stay bounded below normal tails, and its fourth moment exists above four."""
    apart: float = 2.0
    """Sigma in the nearest direction; modes nearer to one another are one. Source: two normal laws of one width have
    two tops from two sigma apart."""
    worth: float = 12.0
    """Deviance; a mode worse by this is left out. Source: e^-6, 0.25 % of the best mode's mass: half of what `kept`
    leaves out."""
    taus: Array = field(default_factory=lambda: np.geomspace(1e-6, 3e-3, 40))
    """rad; scatters beyond chance over which is summed. Source: steps of 23 %, about two sigma of a scatter that forty
    cells know (1 / sqrt(80)); a normal law's sum in such steps is off by 1.4 %."""
    quiet_g: float = 1e-7
    """g; a reading's noise beside which chance is the bench's alone. Source: a tenth of the least noise that is
    tried."""
    known: float = 1e12
    """Precision of a noise that the model gives: it is not fitted. Source: a standard deviation of 1e-6 of the
    logarithm: none beside any table's."""
    stream: int = 20
    """Number that keeps these draws apart from those of other stages with the same seed. Source: a definition: any
    number that no other stage has."""
    least_proposals: int = 12
    """Proposals of a set, at least. Source: a hundredth of `proposals`."""
    progress: tuple[float, float] = (0.5, 0.25)
    """Shares of the work done before the proposals, and by them. For a bar of progress alone. Source: no answer depends
    on it."""
    report_every: int = 20
    """Draws between two reports of progress. Source: no answer depends on it."""
    kept: float = 0.995
    """Share of the probability that the sets reported hold. Source: a credible set of 99.5 %, a usual level."""
    tau_move: float = 0.3
    """Spread of a step of the scatter's logarithm. Source: as `move`: 2.38 sigma of a scatter that forty cells know to
    0.11."""


POSTERIOR = PosteriorPolicy()


@dataclass(frozen=True)
class SearchPolicy:
    """Which sets of effects are tried."""

    width: int = 4
    """Sets that are kept in each round of the beam search. Source: a limit of time."""
    max_effects: int = 4
    """Effects of a set, at most. Source: as many as amplitudes at `TableFitsPolicy.max_amplitudes`."""
    finished: int = 10
    """Of the sets that one more effect makes, those that are fitted to the end. Source: a limit of time."""
    step: float = 9.0
    """BIC; what one more effect must improve the score by: strong among some forty candidates. Source: Kass and Raftery
    (JASA 90, 1995): 9 are odds of 90, more than two to one against the luckiest of forty candidates."""
    same: float = 10.0
    """Deviance; sets whose scores differ by less are not distinguished: 6 as a difference of BIC, the rest for what the
    draws leave. Source: `TableVerdictPolicy.believed` and four for draws, as said."""
    clear: float = 20.0
    """Deviance; sets that score worse by more are not looked at again. Source: odds of e^-10 = 5e-5; twice `same`."""
    over: float = 3.0
    """Sigma by which a predicted peak-to-peak may exceed the one that is reported. Source: three sigma on one side,
    0.13 % of a normal law."""
    unexplained_p: float = 1e-3
    """Probability; a row less likely, predicted from the others, is not explained (over all rows). Source: a level of
    significance, usual: one table of a thousand."""
    better: float = 0.1
    """Deviance by which a rival set must be better. Source: `TableFitsPolicy.settled`: a fit ends within that of its
    best."""
    going_on: float = 0.5
    """Steps by which the best set of a round must be better for the search to go on. Source: studies.thresholds, 0.25
    to 1."""


SEARCH = SearchPolicy()

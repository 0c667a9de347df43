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
    """deg; inclinations among which an inclination station is advised. Chosen in b616c3f; no run is recorded."""
    worth: float = 6.0
    """Chi-square; an inclination station that parts two explanations by less is no advice. Chosen in b616c3f; no run is
    recorded."""
    draws: int = 24
    """Draws of chance by which a new inclination station is predicted. Chosen in 5709bc0; no run is recorded."""


STATION_ADVICE = StationAdvicePolicy()


@dataclass(frozen=True)
class ChainPolicy:
    """The simulated procedure behind a table."""

    horizontal_rad: float = np.radians(0.6)
    """rad (0.6 deg); nearer to 90 deg than this the balance matrix is degenerate: its inclination is exact by
    construction. Chosen in 6431964; no run is recorded."""
    chunk: int = 16
    """Draws worked on at a time. Chosen in 9b9d783; no run is recorded."""
    series_to: float = 0.2
    """Tangent up to which five terms of the series of the arc tangent are exact to single precision. Chosen in 9b9d783;
    no run is recorded."""
    stations: int = 73
    """Stations of a revolution, 0 and 360 deg both counted: one each 5 deg. Chosen in 6431964; no run is recorded."""
    readings: int = 4
    """Readings averaged at a station. Chosen in 6431964; no run is recorded."""
    stops: int = 400
    """Draws of a bench's stops by which their covariance is known. Chosen in 5709bc0; no run is recorded."""
    step: float = 1e-6
    """g; difference by which derivatives are taken. Chosen in 6431964; no run is recorded."""
    series: tuple[float, ...] = (1 / 9, -1 / 7, 1 / 5, -1 / 3)
    """Terms of the series of the arc tangent. Source: a definition."""


CHAIN = ChainPolicy()


@dataclass(frozen=True)
class TableVerdictPolicy:
    """What is reported of a table."""

    named_share: float = 0.85
    """Share of the unexplained scatter's variance that names must remove to be given. Chosen in 21ed34d; no run is
    recorded."""
    believed: float = 6.0
    """BIC; a term is named where every set without its class scores worse by this. Chosen in b616c3f; no run is
    recorded."""
    off: float = 2.0
    """Sigma; cells that stay off by more are reported. Chosen in b616c3f; no run is recorded."""
    shows: float = 4.0
    """Chi-square by which a term must move the means to have a name. Chosen in b616c3f; no run is recorded."""
    observed_scatter: float = 12.0
    """Deviance, gain at which the scatter beyond chance is there. Chosen in b616c3f; no run is recorded."""
    progress: tuple[float, float] = (0.6, 0.35)
    """Shares of the work done: the search, then the rivals. For a bar of progress alone. Chosen in 9b9d783; no run is
    recorded."""
    no_scatter_rad: float = 1e-7
    """rad; a scatter that is none. Chosen in b616c3f; no run is recorded."""
    of_means: float = 0.1
    """Share of what a term moves that must be means. Chosen in b616c3f; no run is recorded."""


TABLE_VERDICT = TableVerdictPolicy()


@dataclass(frozen=True)
class ExplainingPolicy:
    """Sets of effects for a table."""

    step_rad: float = float(np.radians(0.009))
    """rad (0.009 deg); half a step of a usual turntable (0.018 deg): where a model does not say how its bench stops.
    Chosen in b616c3f; no run is recorded."""
    min_cells: int = 12
    """Cells of a table, at least. Chosen in b616c3f; no run is recorded."""
    progress: float = 0.7
    """Share of the work done by the first search. For a bar of progress alone. Chosen in 9b9d783; no run is
    recorded."""
    lost: int = 5
    """One in so many rows may stay unexplained. Chosen in 9b9d783; no run is recorded."""


EXPLAINING = ExplainingPolicy()


@dataclass(frozen=True)
class TableFitsPolicy:
    """Fits of sets of effects to a table."""

    noise_g: float = 50e-6
    """g; one reading's noise where the model gives none; then known within a factor of about two and fitted. Chosen in
    11b284e; no run is recorded."""
    noise_log_std: float = 0.7
    """Standard deviation beforehand of the logarithm of that noise. Chosen in 11b284e; no run is recorded."""
    wide: float = 30.0
    """Typical sizes; standard deviation beforehand of what may be refitted: hardly any knowledge. Chosen in 5709bc0; no
    run is recorded."""
    heavy: float = 3.0
    """Typical sizes; larger ones cost. Chosen in 11b284e; no run is recorded."""
    fit_draws: int = 16
    """Draws of chance that a fit sees. Chosen in 9428ae6; no run is recorded."""
    chance_draws: int = 400
    """Draws by which the covariance of chance is known. Chosen in 9428ae6; no run is recorded."""
    max_amplitudes: int = 4
    """Amplitudes at once: more fit anything that forty numbers can say. Chosen in 11b284e; no run is recorded."""
    ridge: float = 0.01
    """Share of a cell's variance added to it: draws leave their covariance uncertain. Chosen in 92037d6; no run is
    recorded."""
    start_tau_rad: float = 3e-4
    """rad; scatter beyond chance from which a fit starts. Chosen in 11b284e; no run is recorded."""
    first_steps: int = 4
    """Steps from each of several starts. Chosen in b616c3f; no run is recorded."""
    guess: float = 0.7
    """Typical sizes from which a new amplitude starts. Chosen in b616c3f; no run is recorded."""
    steps: int = 12
    """Steps of a fit, at most. Chosen in 5709bc0; no run is recorded."""
    damping: float = 1e-3
    """Damping of the first step, of the diagonal. Chosen in 11b284e; no run is recorded."""
    noise_range_g: tuple[float, float] = (1e-6, 5e-3)
    """g; noises of a reading that are tried. Chosen in 11b284e; no run is recorded."""
    settled: float = 0.1
    """Deviance of a step that is the last. Chosen in 5709bc0; no run is recorded."""
    damping_factor: int = 8
    """Factor of the damping from step to step. Chosen in 11b284e; no run is recorded."""
    least_damping: float = 1e-6
    """Least damping. Chosen in 11b284e; no run is recorded."""
    most_damping: float = 1e5
    """Damping at which a fit is given up. Chosen in 11b284e; no run is recorded."""
    tau_range_rad: tuple[float, float] = (1e-6, 1e-2)
    """rad; scatters beyond chance that are tried. Chosen in 11b284e; no run is recorded."""


TABLE_FITS = TableFitsPolicy()


@dataclass(frozen=True)
class InstrumentPolicy:
    """What a table says of its instrument."""

    evidence_80: float = 20.0
    """Chi-square that an effect of few amplitudes needs to be detected with 80 % probability. Chosen in b616c3f; no run
    is recorded."""
    probe: float = 0.3
    """Typical sizes by which the cells' change with an effect is known. Chosen in b616c3f; no run is recorded."""
    draws: int = 200
    """Draws of chance by which another table is predicted. Chosen in 20d1d73; no run is recorded."""


INSTRUMENT = InstrumentPolicy()


@dataclass(frozen=True)
class PosteriorPolicy:
    """What a table leaves open."""

    there: float = 0.25
    """Probability beforehand that an effect of the library is there: of a dozen that a table can show, three or so.
    Chosen in 9b9d783; no run is recorded."""
    whole: float = 0.5
    """Probability beforehand that an effect that is there acts with all of its amplitudes; else in any variant alike.
    Chosen in 9b9d783; no run is recorded."""
    size: float = 1.5
    """Typical sizes; scale of the sizes' Cauchy prior: usual sizes count, large ones are not excluded. Chosen in
    9b9d783; no run is recorded."""
    proposals: int = 1200
    """Proposals of the importance sampling. Chosen in 9b9d783; no run is recorded."""
    moves: int = 8
    """Metropolis steps of each draw; with the proposals some 3600 evaluations of the table, some 3 s. Chosen in
    9b9d783; no run is recorded."""
    move: float = 0.4
    """Standard deviations; length of a step. Chosen in 9b9d783; no run is recorded."""
    most_sets: int = 60
    """Sets of effects that are kept. Chosen in 9b9d783; no run is recorded."""
    searched_sets: int = 8
    """Of the most probable sets other signs are looked for: so many. Chosen in 9b9d783; no run is recorded."""
    grown_sets: tuple[int, ...] = (4, 3, 3)
    """So many of the most probable sets have other effects added, then of those that are there then, and once more.
    Chosen in 9b9d783; no run is recorded."""
    helpful: int = 14
    """Effects that are added to a set: those whose first step promises most. Chosen in 9b9d783; no run is recorded."""
    wider: float = 1.5
    """The noise is proposed from so many times its spread about a mode: it is known less well than the mode says.
    Chosen in 9b9d783; no run is recorded."""
    noises: tuple[float, ...] = (0.4, 0.55, 0.75, 1.0, 1.35, 1.8)
    """Noises at which a mode is fitted again, as multiples of its own. Chosen in 9b9d783; no run is recorded."""
    between: float = 0.2
    """Spread of the logarithm of the noise about each of these. Chosen in 9b9d783; no run is recorded."""
    signs_kept: int = 3
    """Modes of a set that are fitted so. Chosen in 9b9d783; no run is recorded."""
    freedom: int = 6
    """Degrees of freedom of the proposals: heavier tails than what is required. Chosen in 9b9d783; no run is
    recorded."""
    apart: float = 2.0
    """Sigma in the nearest direction; modes nearer to one another are one. Chosen in 9b9d783; no run is recorded."""
    worth: float = 12.0
    """Deviance; a mode worse by this is left out. Chosen in 9b9d783; no run is recorded."""
    taus: Array = field(default_factory=lambda: np.geomspace(1e-6, 3e-3, 40))
    """rad; scatters beyond chance over which is summed. Chosen in 9b9d783; no run is recorded."""
    quiet_g: float = 1e-7
    """g; a reading's noise beside which chance is the bench's alone. Chosen in 9b9d783; no run is recorded."""
    known: float = 1e12
    """Precision of a noise that the model gives: it is not fitted. Chosen in 9b9d783; no run is recorded."""
    stream: int = 20
    """Number that keeps these draws apart from those of other stages with the same seed. Chosen in 9b9d783; no run is
    recorded."""
    least_proposals: int = 12
    """Proposals of a set, at least. Chosen in 9b9d783; no run is recorded."""
    progress: tuple[float, float] = (0.5, 0.25)
    """Shares of the work done before the proposals, and by them. For a bar of progress alone. Chosen in 9b9d783; no run
    is recorded."""
    report_every: int = 20
    """Draws between two reports of progress. Chosen in 9b9d783; no run is recorded."""
    kept: float = 0.995
    """Share of the probability that the sets reported hold. Chosen in 9b9d783; no run is recorded."""
    tau_move: float = 0.3
    """Spread of a step of the scatter's logarithm. Chosen in 9b9d783; no run is recorded."""


POSTERIOR = PosteriorPolicy()


@dataclass(frozen=True)
class SearchPolicy:
    """Which sets of effects are tried."""

    width: int = 4
    """Sets that are kept in each round of the beam search. Chosen in b616c3f; no run is recorded."""
    max_effects: int = 4
    """Effects of a set, at most. Chosen in b616c3f; no run is recorded."""
    finished: int = 10
    """Of the sets that one more effect makes, those that are fitted to the end. Chosen in 5709bc0; no run is
    recorded."""
    step: float = 9.0
    """BIC; what one more effect must improve the score by: strong among some forty candidates. Chosen in 5709bc0; no
    run is recorded."""
    same: float = 10.0
    """Deviance; sets whose scores differ by less are not distinguished: 6 as a difference of BIC, the rest for what the
    draws leave. Chosen in 9428ae6; no run is recorded."""
    clear: float = 20.0
    """Deviance; sets that score worse by more are not looked at again. Chosen in 9428ae6; no run is recorded."""
    over: float = 3.0
    """Sigma by which a predicted peak-to-peak may exceed the one that is reported. Chosen in 20d1d73; no run is
    recorded."""
    unexplained_p: float = 1e-3
    """Probability; a row less likely, predicted from the others, is not explained (over all rows). Chosen in 11b284e;
    no run is recorded."""
    better: float = 0.1
    """Deviance by which a rival set must be better. Chosen in b616c3f; no run is recorded."""
    going_on: float = 0.5
    """Steps by which the best set of a round must be better for the search to go on. Chosen in 11b284e; no run is
    recorded."""


SEARCH = SearchPolicy()

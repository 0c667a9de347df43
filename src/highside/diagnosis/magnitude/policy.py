"""The numbers that decide where only |g| is known.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; what halving and doubling it changes is in studies/thresholds.md. They
are no settings for users: whoever moves one puts the engine to the sealed cases again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.problem_policy import ProblemPolicy, SlowLimits


@dataclass(frozen=True)
class MagnitudeBasesPolicy:
    """Covariates of magnitudes."""

    many: int = 40
    """Readings from which fourth orders of the direction and more waves of time are scanned. Source:
    studies.thresholds, 20 to 80."""
    warm_span_c: float = 0.5
    """degC; a temperature that changes by less says nothing. Source: studies.thresholds, 0.25 to 1."""
    few_waves: int = 4
    """Waves of time end below this where readings are few. Source: studies.thresholds, 2 to 8."""
    waves: int = 7
    """Waves of time end below this else. Source: studies.thresholds, 3 to 14."""


MAGNITUDE_BASES = MagnitudeBasesPolicy()


@dataclass(frozen=True)
class ProjectedRandomWalkPolicy:
    """A random walk observed through the magnitude."""

    shares: tuple[float, ...] = (0.0, *MEMORY.shares[np.inf], 3.0, 12.0)
    """Variance of a step from reading to reading in units of the white variance. Source: the grid of poses, and beyond
    it steps as large as the noise and some times larger, as a recording of |g| may have seconds between readings."""


PROJECTED_RANDOM_WALK = ProjectedRandomWalkPolicy()


@dataclass(frozen=True)
class MagnitudeFitsPolicy:
    """Fits of magnitudes."""

    apart: float = 1.02
    """Ratio of two values of a shape between which its slope is taken. Source: studies.thresholds, 0.51 to 2.04."""


MAGNITUDE_FITS = MagnitudeFitsPolicy()


@dataclass(frozen=True)
class MagnitudeShapesPolicy:
    """Shapes between the values of their grids."""

    independent: float = 1e-4
    """Share of the largest singular value from which a direction counts. Source: as
    `MagnitudeNoisePolicy.independent`."""
    settled: float = 1e-4
    """Relative change of a time constant at which the search ends. Source: a warm-up of a thousand times its noise then
    leaves a tenth of it."""


MAGNITUDE_SHAPES = MagnitudeShapesPolicy()


@dataclass(frozen=True)
class MagnitudeNoisePolicy:
    """The noise of magnitudes."""

    most_required: int = 2
    """Effects that are plainly required, at most, before the noise is measured. Source: studies.thresholds, 1 to 4."""
    least_freedom: int = 6
    """So many readings are kept to measure the scatter by: with fewer no F test shows anything. Source:
    studies.thresholds, 3 to 12."""
    independent: float = 1e-4
    """Share of the largest singular value from which a direction of the rich model is independent. Source:
    studies.thresholds, 5e-05 to 0.0002."""
    resembling: float = 1.5
    """Times that magnitudes disagree more than they repeat from which what resembles something is not nothing. Source:
    thirteen degrees of freedom exceed it by chance in 0.6 %."""
    slow_chance: float = 0.003
    """Probability of chance, of all slow effects together, below which what one of them explains is not nothing.
    Source: a third of `CandidateSetPolicy.alarm_rate`; the variants that are counted overlap."""


MAGNITUDE_NOISE = MagnitudeNoisePolicy()


@dataclass(frozen=True)
class ObservationPolicy:
    """Magnitudes as an observable."""

    turns: int = 6
    """Turns of the search for the direction behind a reading. Source: studies.thresholds, 3 to 12."""
    still: float = 1e-12
    """Change of the direction at which the search ends. Source: studies.thresholds, 5e-13 to 2e-12."""
    ideal: float = 1e-6
    """As `invisible`, of an ideal triad. Source: studies.thresholds, 5e-07 to 2e-06."""
    invisible: float = 1e-4
    """A direction of the parameters that shows less than this share, against the one that shows most, is not moved.
    Source: studies.thresholds, 5e-05 to 0.0002."""
    rounding: float = 1e-7
    """Share of a column's size below which what shows of it is rounding. Source: studies.thresholds, 5e-08 to 2e-07."""


OBSERVATION = ObservationPolicy()


@dataclass(frozen=True)
class MagnitudeChoicePolicy:
    """Choices by magnitudes."""

    one_by_one: int = 60
    """Up to so many poses each is left out by itself. Source: studies.thresholds, 30 to 120."""
    blocks: int = 10
    """Blocks of a longer session, each predicted from the others. Source: studies.thresholds, 5 to 20."""
    flat: float = 0.1
    """Share by which what begins at an onset may vary afterwards and still be a step: a rest turns by far less. Source:
    geometry; a load at 45 deg changes by a tenth when it turns by 6 deg."""
    alike: float = 0.999
    """Cosine from which two columns are one. Source: studies.thresholds, 0.4995 to 0.9995."""
    per_name: int = 6
    """Readings beyond the base for each effect that is given a name. Source: studies.thresholds, 3 to 12."""
    steps: int = 12
    """Steps of a base fit by magnitudes: further from linear than that of poses. Source: studies.thresholds, 6 to
    24."""


MAGNITUDE_CHOICE = MagnitudeChoicePolicy()


@dataclass(frozen=True)
class MagnitudeSessionsPolicy:
    """Still readings of a session."""

    min_attitudes: int = 12
    """Nine unknowns of offset and matrix, and a few readings to judge them by. Source: studies.thresholds, 6 to 24."""
    few_attitudes: int = 6
    """Of a table of averages that says how well they repeat: its misfit is judged by that, and need not be learned from
    the readings. Source: six faces are the least that laboratories measure."""
    least_room: int = 3
    """Readings of so few beyond what may be refitted: fewer are fitted by chance. Source: a misfit of twice what
    readings repeat to has then p = 0.007 (chi-square 12 of 3)."""
    distinct_rad: float = float(np.radians(5.0))
    """rad (5 deg); attitudes nearer to one another are one. Source: studies.thresholds, 0.04363 to 0.1745."""
    same_rad: float = float(np.radians(0.5))
    """rad (0.5 deg); readings of one attitude are this near. Source: studies.thresholds, 0.004363 to 0.01745."""
    steep: float = 0.3
    """g/rad; change of the magnitude with a turn, beyond which the sensor has changed and not turned. Source:
    arithmetic; an offset of 0.2 g and a scale factor that differs by 0.1 between two axes make no more. A step along
    an axis that is up to 55 deg from gravity makes 0.7 and more: of 24 and 50 mg at rest none was told (`hand` of the
    open world of seed 7a20f8c3)."""
    smooth_s: float = 5.0
    """s; readings are averaged over this before stillness is judged. Source: studies.thresholds, 2.5 to 10."""
    min_rest_s: float = 45.0
    """s; a shorter rest is no session. Source: studies.thresholds, 22.5 to 90."""
    min_block_s: float = 1.0
    """s; least length of a rest's block. Source: studies.thresholds, 0.5 to 2."""
    max_blocks: int = 300
    """Blocks of a rest, at most. Source: studies.thresholds, 150 to 600."""
    min_blocks: int = 40
    """Blocks of a rest, at least. Source: studies.thresholds, 20 to 80."""
    min_share: float = 0.2
    """Of all blocks of a rest, how many an attitude needs to be kept. Source: studies.thresholds, 0.1 to 0.4."""
    jump: float = 8.0
    """Differences of the halves of a rest's block, in those of its usual blocks, from which the level jumps within it:
    it belongs to neither side. Source: chance makes one in 1e15 of normal noise."""
    window_s: float = 0.5
    """s; stillness is judged by windows of this length. Source: studies.thresholds, 0.25 to 1."""
    window_rows: int = 10
    """Rows of such a window, at least: of fewer the scatter is not known well enough. Source: studies.thresholds, 5 to
    20."""
    held_rad: float = float(np.radians(2.0))
    """rad (2 deg); turn from window to window below which a tool was held, if not still. Source: a hand that holds
    without a rest trembles by a degree; the next attitude is `distinct_rad` away at least."""
    held_s: float = 2.0
    """s; it was held for so long at least. Source: as `window_s`, the shortest still interval is of four windows."""
    least_hz: float = 1e-3
    """Hz; no recording is taken to be slower. Source: studies.thresholds, 0.0005 to 0.002."""
    room_c: float = 25.0
    """degC; taken where none was recorded. Source: studies.thresholds, 12.5 to 50."""


MAGNITUDE_SESSIONS = MagnitudeSessionsPolicy()


MAGNITUDE = ProblemPolicy()
"""Magnitudes of changing attitudes are judged as the rest is; how many names are given depends on the readings
(`MagnitudeChoicePolicy.per_name`). Chosen in 6be9111; no run is recorded. Untouched public recordings of tools turned
by hand leave 0.9, 0.9 and 0.95 times their floor (tests/integration/test_diagnose_real.py)."""

AT_REST = ProblemPolicy(floor_ratio=2.5, slow=SlowLimits(forgiven=0.05))
"""At rest all that shows is slow: a temperature coefficient that is not quite constant leaves a little that looks like
a random walk. Chosen in f202a8b; no run is recorded."""

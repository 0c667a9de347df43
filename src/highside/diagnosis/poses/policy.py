"""The numbers that decide for stepped sessions.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which a
value was put there by judgement, before any run; *studies.thresholds* (python -m) the range of such a value in which no
answer of its recordings changes. They are no settings for users: whoever moves one puts the engine to the sealed cases
again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.problem_policy import ProblemPolicy, SlowLimits


@dataclass(frozen=True)
class PoseNoisePolicy:
    """The noise of poses."""

    quietest: float = 0.02
    """Share of the noisiest channel's noise that every channel is taken to have. Source: studies.thresholds, 0.01 to
    0.04."""
    table_gain: float = 9.0
    """-2 log likelihood, gain from which the bench's own scatter is believed. Source: studies.thresholds, 4.5 to 18."""
    stretch: int = 16
    """Poses of a stretch over which the size of the noise is averaged. Source: studies.thresholds, 8 to 32."""
    uneven: float = 0.01
    """Chance at which even noise would be taken for uneven. Source: studies.thresholds, 0.005 to 0.02."""
    powers: Array = field(default_factory=lambda: np.linspace(0.0, 1.5, 16))
    """Powers of the scatter within poses that the scatter from pose to pose is tried to go with. Source: a grid in
    steps of a tenth, from none to beyond the first power."""
    least_square: float = 1e-6
    """Least mean square within poses, beside the mean of all. Source: studies.thresholds, 5e-07 to 2e-06."""
    sensor_start: float = -0.3
    """Logarithm of a sensor's size, in those of the residual, from which the likelihood is climbed. Source: chosen;
    sizes below the whole residual's, which all share."""
    angle_start: float = -0.5
    """Logarithm of that of a set angle. Source: as `sensor_start`."""
    sensor_bounds: tuple[int, int] = (-6, 1)
    """Logarithms between which a sensor's size is sought. Source: e^-6 is 0.25 % of the residual, whose square nobody
    sees beside it (6e-6), and e is more than all of it."""
    angle_bounds: tuple[int, int] = (-6, 4)
    """Logarithms between which a bench angle's size is sought. Source: as `sensor_bounds`; upwards e^4 = 55 times the
    residual, for an angle error shows by its sine alone where the load hardly turns with it."""
    turns: int = 40
    """Turns of the climb, at most. Source: studies.thresholds, 20 to 80."""
    settled: float = 1e-7
    """Relative change of the likelihood at which the climb ends. Source: studies.thresholds, 5e-08 to 2e-07."""
    ridge: float = 1e-9
    """Share of the trace that is added to the expected second derivatives: a size at its lower bound has next to none.
    Source: rounding, of six numbers with margin."""
    stride: float = 2.0
    """Change of a logarithm in one step, at most: a factor of 7 of a size. Source: 300 drawn sessions, 12 to 300 poses,
    of which all came within 0.2 of -2 log likelihood of a general minimiser (`tests/unit/test_pose_noise.py`)."""
    halvings: int = 12
    """Halvings of a step that gains nothing, before the climb has ended: it is then 1/4,000 of itself. Source: the same
    sessions."""
    stretches: int = 4
    """Stretches of a session from which its noise is known to change. Source: studies.thresholds, 2 to 8."""


POSE_NOISE = PoseNoisePolicy()


@dataclass(frozen=True)
class PoseSessionsPolicy:
    """Stepped sessions."""

    min_poses: int = 12
    """Fewer leave too little beside twelve base parameters: 36 readings, 24 of them free. What so few cannot show is
    reported as not testable. Source: tests/unit/test_diagnosis_few_poses.py."""
    key: int = 1000
    """Keeps apart the two angles of a setting in one number: a toolface in deg is below it. Source: a definition: more
    than 360, and exact in a double with the other angle's rounding."""


POSE_SESSIONS = PoseSessionsPolicy()


@dataclass(frozen=True)
class WithinPolicy:
    """What rows do within a pose."""

    chance: float = 1e-5
    """Probability below which a course is no chance. Source: three channels, three kinds of course and a hundredth of
    an alarm in a hundred sessions."""
    least_rows: int = 8
    """Rows of a pose from which a course can be distinguished from noise. Source: two shapes, a mean and four second
    differences."""
    fewest_rows: int = 3
    """Rows of a pose from which a course that poses have in common is looked for, of any shape. Source: two are one
    difference, which noise of a filter's settling has too."""
    least_load: float = 0.05
    """g; standard deviation of a pose's mean reading from which a course may be said to grow with it. Source: chosen; 3
    deg of inclination."""
    least_poses: int = 6
    """Poses whose courses are laid over one another. Source: a mean of fewer is known to no better than a half."""
    share: float = 0.5
    """Energy of a common course over all poses, in that of the noise of one pose's rows, from which it is reported.
    Source: half of it, in twenty poses, is a sixth of a row's noise."""
    least_ratio: float = 1.5
    """Mean square of the poses' own trends, in that of the noise, from which they are reported. Source: noise that is
    correlated by 0.8 from row to row reaches 1.2 after the filter, in 24 poses of 50 rows."""
    unsteady: float = 3.0
    """Scatter of the rows of a pose, in that of the means about the fit times the root of their number, from which it
    is no noise. Source: at most 2.1 in 600 channels of 100 sessions with nothing hidden and 100 with known effects,
    drawn by the hash bfce0efc, under all kinds of noise; 6.6 for a course of 33 sigma that follows the toolface."""
    of_a_median: float = 0.37
    """Degrees of freedom that the median of a normal deviate's squares is worth, for each. Source: the asymptotic
    variance of a median of a chi-square of one."""
    goes_one_way: float = 1e-3
    """Probability of a pose's trend beside its own scatter below which it goes one way. Source: of 600 nulls of eight
    noises (seeds of f225cf13, 59463cce and two names) 1 is taken for a pose that moves, 3 at 1e-2, all of noise that
    grows and shrinks; a pose that did move (law/276 of 59463cce) has 9e-5."""
    clipped: float = 4.0
    """Standard deviations beyond which a row's difference is cut off. Source: noise with tails (Student, 3 degrees of
    freedom) in 100 poses of 8 rows crept in 31 of 300 sessions without it."""
    mad: float = 0.6745
    """Median of the size of a normal deviate. Source: the normal distribution."""
    settled: float = 3.0
    """Factor by which a course changes more in its first than in its last third, if it settles. Source: exp(1), the
    decay over one time constant, rounded up."""
    decay: float = 0.2
    """Time constant of a settling, in lengths of a pose. Source: a fifth is over within the pose and is not its first
    row alone."""
    most_memory: float = 0.97
    """Correlation of neighbouring rows that is filtered out, at most: more is a trend. Source: exp(-1 / 33), a
    memory as long as most poses."""
    first_cell: int = 2
    """Cycles within a pose below which a line is a trend. Source: the main lobe of a Hann window."""
    cells: int = 6
    """Cells at each side by which the level about a line is known. Source: twice the main lobe of a Hann window on each
    side."""
    lobe: int = 2
    """Cells at each side of a line that belong to it. Source: the main lobe of a Hann window."""
    line_ratio: float = 2.0
    """Power of a line in that of its neighbourhood from which it is reported. Source: half of the power is then the
    line's."""


WITHIN = WithinPolicy()


@dataclass(frozen=True)
class RowsMemoryPolicy:
    """Noise with a memory, as the rows within the poses show it."""

    found: float = 3.0
    """Nats by which a level that forgets must be ahead of an error of each pose, all channels together, to be what the
    poses scatter by; and behind it, to be not. Source: strong evidence (Kass and Raftery 1995)."""
    rows: float = 2.0
    """Rows of a pose, in the mean, from which they are asked. Source: two differ, one does not."""
    stretches: int = 16
    """Stretches of a pose whose means stand for its rows. Source: chosen; a memory of a sixteenth of a pose is white
    for its mean."""
    shares: tuple[float, ...] = (0.03, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 10.0, 30.0)
    """Variances of the level, in those of a row. Source: chosen; steps of two to three."""
    shortest: float = 2.0
    """Shortest length of the level, in steps from stretch to stretch. Source: a shorter one is white."""
    longest: float = 3000.0
    """Longest one, in the same. Source: chosen; a session's length and more."""
    lengths: int = 14
    """Lengths tried. Source: chosen; neighbours differ by less than a factor of two."""
    errors: tuple[float, ...] = (0.03, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e6)
    """Variances of an error of each pose, in those of a row. Source: as `shares`, and on to any size."""


ROWS_MEMORY = RowsMemoryPolicy()


POSES = ProblemPolicy(marginal=1.0, slow=SlowLimits(over_random_walk=12.5, pairs=True))
"""One scan in a hundred is significant by chance, which beside a name is no reason to doubt it: chosen in 36be2bd; no
run is recorded. The limit over a random walk was set in 6a24687 by simulated random walks: of them one in twenty at
most passes, whatever their size."""

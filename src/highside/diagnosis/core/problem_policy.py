"""What names must show to be given: of each kind of recording its own, in the policy of its room.

Fields as in `policy`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from highside.diagnosis.core.finding_policy import FLOOR
from highside.diagnosis.core.memory_policy import MEMORY
from highside.diagnosis.core.policy import CANDIDATE_SET, SELECTION
from highside.physics.effects import all_effects


@dataclass(frozen=True, slots=True)
class SlowLimits:
    """What a slow effect must show to be believed beside a random walk; each kind of recording has its own."""

    log_p: float = MEMORY.slow_log_p
    """-log10 p beside a random walk. Source: that of `MemoryPolicy.slow_log_p`."""
    remaining: float = MEMORY.remaining
    """-2 log likelihood; evidence of memory that may remain beside it. Source: that of `MemoryPolicy.remaining`."""
    quiet_log_p: float = MEMORY.slow_log_p
    """-log10 p that is required where hardly any memory remains. Source: that of `MemoryPolicy.slow_log_p`."""
    quiet: float = 6.0
    """-2 log likelihood; evidence of memory that is hardly any. Source: studies.thresholds, 3 to 12."""
    straight: float | None = None
    """-log10 p required of what is a straight line in time, which a random walk imitates more easily than others.
    Source: no limit of its own, as is right where a straight line is not free: who has one gives it."""
    forgiven: float = 0.0
    """Share of the evidence of memory that may remain beside one that beats the random walk twice as clearly as
    required. Source: none, the strictest there is: who forgives gives a share."""
    pairs: bool = False
    """Whether two may pass together where neither passes alone. Source: the strictest: who lets pairs pass says so."""
    over_random_walk: float | None = None
    """-2 log likelihood; in place of -log10 p, twice the logarithm of the likelihood ratio that is required of the
    effect without any random walk over a random walk without the effect: either has to explain all that was observed.
    Source: studies.thresholds, 6.25 to 25."""

    def passes(self, effect: str, log_p: float, remaining: float, evidence: float, score: float) -> bool:
        """Whether an effect of -log10 p and score, that leaves so much of the evidence of memory, is believed."""
        if self.over_random_walk is not None:
            return score - remaining > self.over_random_walk and remaining < self.remaining
        straight = self.straight if self.straight is not None and all_effects()[effect].straight_in_time else None
        return (
            (log_p > (self.quiet_log_p if straight is None else straight) and remaining < self.quiet)
            or (log_p > max(self.log_p, straight or 0.0) and remaining < self.remaining)
            or (log_p > 2 * self.log_p and remaining < self.forgiven * evidence)
        )


@dataclass(frozen=True)
class ProblemPolicy:
    """What names must show to be given; each kind of recording has its own (`problem.Problem.policy`)."""

    named_share: float = 0.85
    """Share of the excess misfit that names must explain to be given. Chosen in 21ed34d with the prototype, whose
    scored runs used it; no run that varied it is recorded."""
    marginal: float = 0.0
    """-log10 p; a remainder that is above chance by no more than this withdraws no names. Source: none, the strictest
    there is: who forgives gives a level."""
    interaction_margin: float = 6.0
    """BIC; a name is not given where something without a name comes nearer to it than this. Chosen in 21ed34d with the
    prototype, whose scored runs used it; no run that varied it is recorded."""
    most_named: int = SELECTION.most
    """More effects than this are a fit and no finding: their names are given only if all but one are manifest. Source:
    studies.thresholds, 2 to 8."""
    certain: float = MEMORY.slow_log_p
    """-log10 p from which an effect beats a noise with memory. Source: that of `MemoryPolicy.slow_log_p`."""
    products_beside_memory: bool = False
    """Whether a product without a name must beat a noise with memory as well, and all forms count that were tried of
    what is claimed. Source: as `SIMULATION`."""
    alarm_rate: float = CANDIDATE_SET.alarm_rate
    """Share of sessions without a mismatch in which the candidates, and the scan, may each raise an alarm. Source: that
    of `CandidateSetPolicy.alarm_rate`."""
    slow: SlowLimits = field(default_factory=SlowLimits)
    """What a slow effect must show beside a random walk. Source: that of `SlowLimits`."""
    floor_ratio: float = FLOOR.ratio
    """Standard deviations left, in those of the noise floor, from which the recording is not explained. Source: sealed
    null sessions of poses leave 0.98 to 1.03 where noise is white from row to row; 1.35 to 1.5 where it is correlated
    from pose to pose, which its spectrum identifies."""
    slow_beside_fast: bool = False
    """Whether effects of time run like those of the programme, so that they must be chosen together. Source: a property
    of a session, no limit: rotations have it."""


@dataclass(frozen=True)
class OwnNoisePolicy:
    """When what a candidate leaves is the noise it is tested against: of few readings the rich columns hold less than
    the whole library, and what they lack would pass as noise."""

    below: float = 0.25
    """Variance, in that of the noise learned before, below which it is. Source: chosen; a cross product in 24 poses
    left 0.004 of the noise that the rest of the library had left (known/048 of the open world of seed 06d8469), and
    chance leaves as little as a quarter of ten numbers once in 110 times."""
    freedom: float = 5.0
    """Degrees of freedom of one channel's scatter from which it is. Source: chosen; the F test's tail with fewer is so
    heavy that little is gained by it."""
    channels: int = 3
    """Channels, each of which has a scatter of its own. Source: a triad."""


OWN_NOISE = OwnNoisePolicy()

"""The numbers that decide for stepped sessions.

Each stands with its unit, what it means, and the reference or the run that set it. *Chosen* names the commit in which
a value was put there by judgement: no run that varied it is on record. They are no settings for users: whoever moves
one puts the engine to the sealed cases again (studies/sealed/score.py).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.core.scene_policy import ScenePolicy, SlowLimits


@dataclass(frozen=True)
class PoseNoisePolicy:
    """The noise of poses."""

    quietest: float = 0.02
    """Share of the loudest channel's noise that every channel is taken to have. Chosen in 88fce7b; no run is
    recorded."""
    table_gain: float = 9.0
    """-2 log likelihood, gain from which the bench's own scatter is believed. Chosen in 21ed34d; no run is recorded."""
    stretch: int = 16
    """Poses of a stretch over which the size of the noise is averaged. Chosen in 36be2bd; no run is recorded."""
    uneven: float = 0.01
    """Chance at which even noise would be taken for uneven. Chosen in 36be2bd; no run is recorded."""
    powers: Array = field(default_factory=lambda: np.linspace(0.0, 1.5, 16))
    """Powers of the scatter within poses that the scatter from pose to pose is tried to go with. Chosen in 36be2bd; no
    run is recorded."""
    least_left: float = 0.05
    """Share of a reading that the rich model leaves, at least, when its loss is given back. Chosen in 21ed34d; no run
    is recorded."""
    components: int = 5
    """Sizes of the noise that are fitted where the bench scatters: three sensors and two angles. Chosen in a6e3bcd; no
    run is recorded."""
    least_square: float = 1e-6
    """Least mean square within poses, beside the mean of all. Chosen in 36be2bd; no run is recorded."""
    start: tuple[float, ...] = (-0.3, -0.3, -0.3, -0.5, -0.5)
    """Logarithms of the five sizes, in those of the residual, from which the likelihood is climbed. Chosen in 63c0b1b;
    no run is recorded."""
    sensor_bounds: tuple[int, int] = (-6, 1)
    """Logarithms between which a sensor's size is sought. Chosen in 63c0b1b; no run is recorded."""
    angle_bounds: tuple[int, int] = (-6, 4)
    """Logarithms between which a bench angle's size is sought. Chosen in 63c0b1b; no run is recorded."""
    turns: int = 40
    """Turns of the climb, at most. Chosen in 63c0b1b; no run is recorded."""
    settled: float = 1e-7
    """Relative change of the likelihood at which the climb ends. Chosen in 63c0b1b; no run is recorded."""
    stretches: int = 4
    """Stretches of a session from which its noise can be seen to change. Chosen in 36be2bd; no run is recorded."""


POSE_NOISE = PoseNoisePolicy()


@dataclass(frozen=True)
class PoseSessionsPolicy:
    """Stepped sessions."""

    min_poses: int = 16
    """Twelve base parameters leave too little to judge by with fewer. Chosen in 21ed34d; no run is recorded."""
    key: int = 1000
    """Keeps apart the two angles of a setting in one number: a toolface in deg is below it. Chosen in 21ed34d; no run
    is recorded."""


POSE_SESSIONS = PoseSessionsPolicy()


@dataclass(frozen=True)
class PoseAdvicePolicy:
    """What is advised for poses."""

    shapes: int = 5
    """Shapes of an effect that the rich model takes. Chosen in 1d73a30; no run is recorded."""


POSE_ADVICE = PoseAdvicePolicy()


POSES = ScenePolicy(faint=1.0, slow=SlowLimits(over_walk=12.5, pairs=True))
"""One scan in a hundred is loud by chance, which beside a name is no reason to doubt it: chosen in 36be2bd; no run is
recorded. The limit over a walk was set in 6a24687 by simulated walks: of them one in twenty at most passes, whatever
their size."""

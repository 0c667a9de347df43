"""Measurements that scatter so much that they alone do not tell whether noise has grown or something departs.

One number far from what was expected is as likely under noise that has grown as under a step. So the watch goes on with
it, keeps what it knew before, and waits for those that follow. A step explains all of them by one size; noise leaves
them scattered. With the sum of squares `Q` of `n` whitened innovations and the part `E` of it that the best departure
explains, `(Q - E) / Q` has under noise of any size alone a beta distribution with `(n - 1) / 2` and `1 / 2`: the F test
of one coefficient at an unknown variance. Twice the log-likelihood ratio of noise of the best size is
`Q - n - n ln(Q / n)`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import betainc

from highside.arrays import Array
from highside.watch.measurement import Still, Turning
from highside.watch.memory import WatchMemory
from highside.watch.policy import WatchPolicy

__all__ = ["Hold", "noise_evidence"]

STILL_WIDTH = 9
"""a rest as it is kept: time, mean (3), its standard deviation, temperature, depth, and whether these two are known"""


def noise_evidence(squares: float, numbers: int) -> float:
    """Twice the log-likelihood ratio of noise of the best size against noise as it was expected."""
    if squares <= numbers:
        return 0.0
    return float(squares - numbers - numbers * np.log(squares / numbers))


@dataclass
class Hold:
    """What was known `before` the first of them, the `evidence` of the best departure then, and what was `taken`."""

    before: WatchMemory
    evidence: float
    level: float
    """of the noise, with which they were expected"""
    taken: list[Still | Turning] = field(default_factory=list)
    squares: float = 0.0
    numbers: int = 0

    def add(self, one: Still | Turning, innovations: Array) -> None:
        """One more measurement, with its whitened innovations (M,)."""
        self.taken.append(one)
        self.squares += float(innovations @ innovations)
        self.numbers += innovations.size

    @property
    def scale(self) -> float:
        """Of the noise to the stated one, if it is noise."""
        return self.level * float(np.sqrt(self.squares / max(self.numbers, 1)))

    def departs(self, evidence: float, policy: WatchPolicy) -> bool:
        """Whether noise alone, of whatever size, would hardly look so much like a departure."""
        if self.numbers < 2:
            return False
        # noise does not fall below the expected
        left = max(self.squares - (evidence - self.evidence), self.numbers - 1.0)
        chance = float(betainc(0.5 * (self.numbers - 1), 0.5, min(left / max(self.squares, left), 1.0)))
        return chance < policy.jump_chance

    def is_noise(self, evidence: float, policy: WatchPolicy) -> bool:
        """Whether noise that has grown explains it, and better than any departure."""
        of_noise = noise_evidence(self.squares, self.numbers)
        return len(self.taken) > 1 and of_noise - max(evidence - self.evidence, 0.0) > policy.same_class

    def has_faded(self, policy: WatchPolicy) -> bool:
        """Whether those that followed were as expected."""
        return noise_evidence(self.squares, self.numbers) < 0.5 * policy.jump

    def is_over(self, policy: WatchPolicy) -> bool:
        """Whether so many were waited for that it is judged as it is."""
        return len(self.taken) >= policy.jump_wait

    def rests(self) -> Array | None:
        """(K, `STILL_WIDTH`) to be kept; None where rotation is among them: then what was taken stands."""
        rows = []
        for one in self.taken:
            if not isinstance(one, Still):
                return None
            beside = [0.0 if value is None else 1.0 for value in (one.temp_c, one.depth_km)]
            rows.append([one.t_s, *one.mean_g, one.std_g, one.temp_c or 0.0, one.depth_km or 0.0, *beside])
        return np.array(rows, dtype=float).reshape(-1, STILL_WIDTH)


def rests_of(rows: Array) -> list[Still]:
    """Of what `Hold.rests` kept. Raises ValueError for what is none."""
    if rows.ndim != 2 or rows.shape[1] != STILL_WIDTH:
        raise ValueError("the rests that wait have another shape")
    if not (rows[:, 4] >= 0.0).all() or not (np.linalg.norm(rows[:, 1:4], axis=1) > 0.5).all():
        raise ValueError("a rest that waits is none")
    return [
        Still(float(t), np.array(mean), float(std), float(temp) if warm else None, float(km) if deep else None)
        for t, *mean, std, temp, km, warm, deep in rows
    ]

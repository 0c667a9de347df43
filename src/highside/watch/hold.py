"""Measurements that scatter so much that they alone do not tell whether noise has grown or something departs.

One number far from what was expected is as likely under noise that has grown as under a step. So the watch goes on with
it, keeps what it knew before, and waits for those that follow: a step explains all of them by one size and leaves the
noise that was expected, noise leaves them scattered. The two are rivals. With the sum of squares `Q` of `n` whitened
innovations and what the best departure leaves of it, `R`, twice the log-likelihood ratio of the departure against noise
of the best size is

    n + n ln(Q / n) - R.

Under noise of any size the ratio of a given departure passes `1 / p` with a probability of `p` at most, however often
one looks (Ville's inequality), and noise of the best size is a stronger rival than noise as it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from highside.arrays import Array
from highside.watch.measurement import Still, Turning
from highside.watch.memory import WatchMemory
from highside.watch.policy import WatchPolicy

__all__ = ["Hold", "noise_evidence"]

Judgement = Literal["noise", "departure", "neither", "undecided"]
"""`neither`: those that followed were as expected, or nothing is above the threshold after all"""
STILL_WIDTH = 12
"""a rest as it is kept: time, mean (3), its standard deviation, temperature, depth, whether these two are known, and
how much noisier its axes are by its own rows (3)"""
_WITHOUT_TIMES = 9
"""of memories of before the last three were kept"""


def noise_evidence(squares: float, numbers: int) -> float:
    """Twice the log-likelihood ratio of noise of the best size against noise as it was expected."""
    if squares <= numbers:
        return 0.0
    return float(squares - numbers - numbers * np.log(squares / numbers))


@dataclass
class Hold:
    """What was known `before` the first of them, and what was `taken`. `explained`: by how much the best departure
    lessens the sum of squares of these alone (`Bank.explained`): evidence of before says nothing of their noise."""

    before: WatchMemory
    level: float
    """of the noise, with which they were expected"""
    taken: list[tuple[Still | Turning, Array | None]] = field(default_factory=list)
    """each with what its rows say of its axes (`linear_still`)"""
    squares: float = 0.0
    numbers: int = 0

    def add(self, one: Still | Turning, innovations: Array, times: Array | None = None) -> None:
        """One more measurement, with its whitened innovations (M,) and what its rows say of its axes (3,)."""
        self.taken.append((one, times))
        self.squares += float(innovations @ innovations)
        self.numbers += innovations.size

    @property
    def scale(self) -> float:
        """Of the noise to the stated one, if it is noise."""
        return self.level * float(np.sqrt(self.squares / max(self.numbers, 1)))

    def of_departure(self, explained: float) -> float:
        """Twice the log-likelihood ratio of the best departure, under noise as it was expected, against noise of the
        best size and no departure."""
        # a departure that was found among many leaves less than its noise
        left = max(self.squares - explained, self.numbers - 1.0)
        return self.squares - left - noise_evidence(self.squares, self.numbers)

    def judged(self, explained: float, policy: WatchPolicy, *, over: bool) -> Judgement:
        """What is known by now; `over`: the evidence of a departure is above the threshold."""
        of_departure, ends = self.of_departure(explained), len(self.taken) >= policy.jump_wait
        if over and self.numbers >= policy.jump_fewest and of_departure > -2.0 * np.log(policy.jump_chance):
            return "departure"
        if noise_evidence(self.squares, self.numbers) < 0.5 * policy.jump:
            return "neither"
        # at the end the likelier of the two; what would be said to depart must have shown it
        if len(self.taken) > 1 and (-of_departure > policy.same_class or (ends and (over or of_departure < 0.0))):
            return "noise"
        return "neither" if ends else "undecided"

    def rests(self) -> Array | None:
        """(K, `STILL_WIDTH`) to be kept; None where rotation is among them: then what was taken stands."""
        rows = []
        for one, times in self.taken:
            if not isinstance(one, Still):
                return None
            beside = [0.0 if value is None else 1.0 for value in (one.temp_c, one.depth_km)]
            rows.append([one.t_s, *one.mean_g, one.std_g, one.temp_c or 0.0, one.depth_km or 0.0, *beside])
            rows[-1] += [1.0] * 3 if times is None else [float(value) for value in times]
        return np.array(rows, dtype=float).reshape(-1, STILL_WIDTH)


def rests_of(rows: Array) -> list[tuple[Still, Array]]:
    """Of what `Hold.rests` kept. Raises ValueError for what is none."""
    if rows.ndim == 2 and rows.shape[1] == _WITHOUT_TIMES:
        rows = np.hstack([rows, np.ones((len(rows), STILL_WIDTH - _WITHOUT_TIMES))])
    if rows.ndim != 2 or rows.shape[1] != STILL_WIDTH:
        raise ValueError("the rests that wait have another shape")
    if not (rows[:, _WITHOUT_TIMES:] >= 1.0).all():
        raise ValueError("the scatter of a rest that waits is none")
    if not (rows[:, 4] >= 0.0).all() or not (np.linalg.norm(rows[:, 1:4], axis=1) > 0.5).all():
        raise ValueError("a rest that waits is none")
    return [
        (Still(t, np.array(mean), std, temp if warm else None, km if deep else None), np.array(times))
        for t, *mean, std, temp, km, warm, deep, x, y, z in rows.tolist()
        for times in [[x, y, z]]
    ]

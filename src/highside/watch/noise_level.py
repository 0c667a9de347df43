"""How much noisier a tool is than its class states, measured by what the filter did not expect.

Only what is the sensor's own noise tells: of a window of rotation the centres of x and y are mostly whirl, which stays
what it is when a sensor becomes noisy. With `N` (M, M) the share of the sensor's noise in the unit variance of a
measurement's errors, its eigenvectors are combinations of the measurement and its eigenvalues the share in each; of
those that are mostly noise the innovation is compared with its expected standard deviation.

The level of the last measurements is what the next one is weighted with, so that evidence gathered while the tool is
noisy counts for less, and goes on counting for less after it has become calm again.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from highside.arrays import Array
from highside.watch.bank import Update
from highside.watch.policy import WatchPolicy

__all__ = ["NoiseLevel", "robust_scale"]

_MEDIAN_OF_SQUARE = 0.4549
"""of a standard normal number's square"""
_CLIP = 2.25
"""a square counts as so many variances at most: 1.5 standard deviations bear a departure that is seen in few"""
_CLIPPED = 0.77847
"""mean of a standard normal number's square that is clipped so"""
_EFFICIENCY = 0.75
"""of that scale, against the standard deviation of all, in normal numbers; that of the median is 0.37"""


def robust_scale(squares: Array) -> float:
    """Of numbers with these squares (K,), in standard deviations: the one by which, clipped, they have the mean that
    normal numbers have (Huber, Proposal 2)."""
    q = np.sort(squares)
    # with k of them not clipped: sum of these + CLIP variance (K - k) = K CLIPPED variance
    kept = np.arange(1, q.size + 1)
    share = q.size * _CLIPPED - _CLIP * (q.size - kept)
    variance = np.divide(np.cumsum(q), share, out=np.full(q.size, np.inf), where=share > 0.0)
    fits = (q <= _CLIP * variance) & (np.append(q[1:], np.inf) >= _CLIP * variance)
    return float(np.sqrt(variance[np.argmax(fits)]))


class NoiseLevel:
    """Squares of the innovations that are noise, of the last measurements."""

    def __init__(self, policy: WatchPolicy) -> None:
        self._policy = policy
        self._squares: deque[tuple[float, float]] = deque(maxlen=policy.scale_over)
        """in units of what was expected, and the level that it was expected with"""

        self._jump, self._since = 1.0, policy.scale_over
        """the level that a jump has set, and how many innovations have come since"""

    def jumped(self, level: float) -> None:
        """The noise has jumped to a level: it is followed from here on alone, not over the last 60."""
        self._jump, self._since = level, 0

    @property
    def jumps(self) -> bool:
        """Whether a jump is followed: what came before it is none of the noise that there is."""
        return self._since < self._policy.scale_over

    def take(self, update: Update, share: Array, level: float) -> None:
        """What one measurement says, which was weighted with a `level`."""
        of_noise, directions = np.linalg.eigh(share)
        weights = directions[:, of_noise > self._policy.noise_share].T @ update.root
        own = weights @ update.innovations / np.linalg.norm(weights, axis=1)
        self._squares.extend((float(z * z), level) for z in own)
        self._since += own.size

    @property
    def level(self) -> float:
        """What the next measurement is weighted with, in units of the stated noise; never below one."""
        if self.jumps:
            # as soon as there are as many as were waited for
            if self._since < self._policy.jump_wait:
                return self._jump
            return max(1.0, self._over(min(self._since, self._policy.scale_from)))
        return max(1.0, self.stated_ratio(self._policy.scale_from))

    def stated_ratio(self, over: int | None = None) -> float:
        """Of the noise's standard deviation to the stated one, over all that is kept or the last `over`."""
        if self.jumps and over is None:
            return self._jump if self._since < self._policy.jump_wait else self._over(self._since)
        return self._root_mean([square * level**2 for square, level in self._squares], over)

    def _over(self, last: int) -> float:
        return robust_scale(np.array([square * level**2 for square, level in self._squares][-last:]))

    def expected_ratio(self, over: int | None = None) -> float:
        """The same to the one expected: what the level has not followed yet."""
        return self._root_mean([square for square, _ in self._squares], over)

    def surely_expected_ratio(self, over: int | None = None) -> float:
        """As `expected_ratio`, less its own standard error: what is more than chance. Of 60 numbers it is 11 %."""
        count = min(len(self._squares), over or len(self._squares))
        return self.expected_ratio(over) / (1.0 + float(np.sqrt(0.5 / (_EFFICIENCY * max(count, 1)))))

    def _root_mean(self, squares: list[float], over: int | None) -> float:
        if len(squares) < self._policy.scale_from:
            return 1.0
        return robust_scale(np.array(squares[-(over or len(squares)) :]))

    def memory(self) -> Array:
        """(K, 2), for `recall`."""
        return np.array(self._squares, dtype=float).reshape(-1, 2)

    def memory_of_jump(self) -> Array:
        """(2,) beside it."""
        return np.array([self._jump, float(self._since)])

    def recall(self, memory: Array, jump: Array | None = None) -> None:
        """Go on from a `memory`; `jump`: as `memory_of_jump` has it, or None. Raises ValueError for a wrong one."""
        self._squares.clear()
        self._squares.extend((float(square), float(level)) for square, level in memory)
        if jump is not None:
            if jump.shape != (2,) or not jump[0] >= 1.0 or not jump[1] >= 0.0:
                raise ValueError("a jump of the noise is none")
            self._jump, self._since = float(jump[0]), int(jump[1])

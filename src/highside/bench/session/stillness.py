"""Is the tool still? Judged by the sensor's own noise, which is learnt while the session runs.

Readings are looked at in short windows of equal length. The scatter of a window about its own straight line is noise or
shaking, not turning; the lowest scatters found so far are the noise at rest (`NoiseFloor`), so that no threshold in g
is asked of anybody. How the means of windows wander at rest is learnt from the holds themselves: `AllanCurve` pools the
Allan variance (half the mean square difference of neighbouring means) at averaging times of 1, 2, 4, ... windows over
all holds. It says what the noise of a mean really is: white noise falls as one over time, flicker noise does not.

The tool is still while, over the last half second or so, the scatter stays near the floor, the means show no slope,
and they stay where the hold began; each is measured in units of what noise alone would do, and the largest, divided by
its limit, is the stillness shown: at most 1 is still.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from highside.arrays import Array
from highside.bench.session.reasons import Rejection

WINDOW_S = 0.1
MIN_WINDOW_READINGS = 5
LOOK_BACK = 5
"""windows over which stillness is judged"""

SLOPE_LIMIT = 6.0
STEP_LIMIT = 6.0
"""in standard deviations of what is compared"""
FLOOR_MARGIN = 1.1
EPOCH_WINDOWS = 12
EPOCHS_KEPT = 200
CALM_FACTOR = 1.5
LEVELS = 12
_MIN_PAIRS = 8
FLOOR_OF_FLOOR_G = 1e-9


class ReadingWindow(NamedTuple):
    """Some readings in a row."""

    t_s: float
    """device time of the last reading"""
    a: Array
    """(3, n) raw"""
    mean: Array
    """(3,)"""
    scatter: Array
    """(3,): standard deviation about a straight line"""
    temp_c: float | None
    frozen: bool
    """all readings equal"""


def make_window(t_s: float, a: Array, temp_c: float | None) -> ReadingWindow:
    n = a.shape[1]
    mean = a.mean(axis=1)
    ramp = np.arange(n) - 0.5 * (n - 1)
    slope = a @ ramp / (ramp @ ramp)
    rest = a - mean[:, None] - slope[:, None] * ramp
    scatter = np.sqrt(np.sum(rest**2, axis=1) / (n - 2))
    return ReadingWindow(t_s, a, mean, scatter, temp_c, bool(np.all(a == a[:, :1])))


class RunningNoiseFloor:
    """Noise of one reading at rest (3,), from the calmest times so far.

    The mean square scatter of an epoch of windows is an unbiased measure of its noise; epochs in which the tool was
    moved or shook have more. Those within half again of the calmest count, pooled.
    """

    def __init__(self, known_g: float | None = None) -> None:
        self._known = known_g
        self._epoch: list[Array] = []
        self._epochs: list[Array] = []
        self._value: Array | None = None

    def add(self, window: ReadingWindow) -> None:
        self._epoch.append(window.scatter**2)
        if len(self._epoch) < EPOCH_WINDOWS:
            if not self._epochs:
                self._value = _root(np.mean(self._epoch, axis=0))
            return
        self._epochs.append(np.mean(self._epoch, axis=0))
        self._epoch = []
        squares = np.array(self._epochs)
        size = np.sqrt(squares.sum(axis=1))
        calm = size <= CALM_FACTOR * np.quantile(size, 0.1)
        self._value = _root(squares[calm].mean(axis=0))
        if len(self._epochs) > 2 * EPOCHS_KEPT:
            keep = np.sort(np.argsort(size)[:EPOCHS_KEPT])
            self._epochs = [self._epochs[k] for k in keep]

    @property
    def value(self) -> Array | None:
        """None until something was measured."""
        if self._known is not None:
            return np.full(3, self._known)
        return self._value


def _root(square: Array) -> Array:
    return np.asarray(np.maximum(np.sqrt(square), FLOOR_OF_FLOOR_G))


def scatter_limit(dof: float) -> float:
    """What the root mean square scatter over the true noise exceeds once in 10^8 looks with `dof` degrees of freedom
    (Wilson and Hilferty's approximation of chi-square), with a little for the floor's own uncertainty."""
    part = 2.0 / (9.0 * dof)
    return float(FLOOR_MARGIN * (1.0 - part + 5.5 * np.sqrt(part)) ** 1.5)


class AllanCurve:
    """Allan variance of window means at 1, 2, 4, ... windows, pooled over holds; in g^2, an axis each."""

    def __init__(self) -> None:
        self._sums = np.zeros((LEVELS, 3))
        self._pairs = np.zeros(LEVELS)

    def add(self, means: Array) -> None:
        """The window means (3, K) of one hold."""
        x = means
        for level in range(LEVELS):
            steps = np.diff(x, axis=1)
            if steps.shape[1] == 0:
                return
            self._sums[level] += 0.5 * np.sum(steps**2, axis=1)
            self._pairs[level] += steps.shape[1]
            usable = x.shape[1] // 2 * 2
            x = 0.5 * (x[:, 0:usable:2] + x[:, 1:usable:2])

    def with_hold(self, means: Array) -> AllanCurve:
        """This curve with one more hold in it, the present one."""
        out = AllanCurve()
        out._sums, out._pairs = self._sums.copy(), self._pairs.copy()
        out.add(means)
        return out

    def variance_of_mean(self, windows: int, white: Array) -> Array:
        """Variance (3,) of the mean of `windows` windows; `white` (3,): that of one window if its noise were white.

        The Allan variance at the longest time that is known well, carried on with the slope found there, between that
        of white noise (-1) and flicker noise (0). Never below white noise.
        """
        known = [level for level in range(LEVELS) if self._pairs[level] >= _MIN_PAIRS and 2**level <= windows]
        floor = white / windows
        if not known:
            return np.asarray(floor)
        variance = self._sums[known] / self._pairs[known][:, None]
        last = known[-1]
        exponent = np.ones(3)
        if len(known) >= 3:
            x = np.log(2.0) * np.array(known[-3:], dtype=float)
            y = np.log(np.maximum(variance[-3:], FLOOR_OF_FLOOR_G**2))
            slope = ((x - x.mean()) @ (y - y.mean(axis=0))) / np.sum((x - x.mean()) ** 2)
            # a slope from few pairs is uncertain: only what departs clearly from white noise is accepted
            doubt = 1.5 / np.sqrt(self._pairs[last])
            exponent = np.clip(-slope + doubt, 0.0, 1.0)
        carried = variance[-1] * (2.0**last / windows) ** exponent
        return np.asarray(np.maximum(floor, carried))


class StillnessMonitor:
    """Judges window by window. `value` is the largest departure over its limit; `still` says it is at most 1."""

    def __init__(self, floor: RunningNoiseFloor, allan: AllanCurve) -> None:
        self.floor = floor
        self.allan = allan
        self.value = 0.0
        self.still = False
        self.cause = Rejection.MOVED
        """what kept the last window from being still"""
        self._recent: deque[ReadingWindow] = deque(maxlen=LOOK_BACK)

    @property
    def moving(self) -> bool:
        """Whether the tool is found to move or shake; not so while too few windows are there to say."""
        return not self.still and self.floor.value is not None and len(self._recent) == LOOK_BACK

    @property
    def recent(self) -> tuple[ReadingWindow, ...]:
        """The windows by which stillness is judged, oldest first."""
        return tuple(self._recent)

    def forget(self) -> None:
        """The stream was interrupted."""
        self._recent.clear()
        self.still = False

    def add(self, window: ReadingWindow, hold: Array | None) -> float:
        """Take the next window; `hold` (3,) is the mean of the hold under way over `hold_windows`, if there is one."""
        self.floor.add(window)
        self._recent.append(window)
        noise = self.floor.value
        if noise is None or len(self._recent) < LOOK_BACK:
            self.value, self.still = 2.0, False
            return self.value
        scatter = np.sqrt(np.mean([w.scatter**2 for w in self._recent], axis=0))
        means = np.array([w.mean for w in self._recent])
        readings = window.a.shape[1]
        white = noise**2 / readings
        one = np.maximum(white, self.allan.variance_of_mean(1, white))
        ramp = np.arange(LOOK_BACK) - 0.5 * (LOOK_BACK - 1)
        slope = ramp @ means / (ramp @ ramp)
        slope_sigma = np.sqrt(one / (ramp @ ramp))
        values = [
            np.max(scatter / noise) / scatter_limit(LOOK_BACK * (readings - 2.0)),
            np.max(np.abs(slope) / slope_sigma) / SLOPE_LIMIT,
        ]
        if hold is not None:
            level = 2.0 * np.maximum(white / LOOK_BACK, self.allan.variance_of_mean(LOOK_BACK, white))
            values.append(np.max(np.abs(means.mean(axis=0) - hold) / np.sqrt(level)) / STEP_LIMIT)
        self.value = float(max(values))
        self.cause = Rejection.SHAKEN if values[0] >= self.value else Rejection.MOVED
        self.still = self.value <= 1.0
        return self.value


def drift_sigmas(means: Array, one: Array) -> tuple[float, Array]:
    """Whether a hold crept: the largest slope over its K window means (3, K) in standard deviations, and the change
    (3,) in g from end to end along the fitted line. `one` (3,): variance of one window's mean."""
    count = means.shape[1]
    if count < 3:
        return 0.0, np.zeros(3)
    ramp = np.arange(count) - 0.5 * (count - 1)
    slope = means @ ramp / (ramp @ ramp)
    rest = means - means.mean(axis=1, keepdims=True) - slope[:, None] * ramp
    own = np.sum(rest**2, axis=1) / (count - 2)
    sigma = np.sqrt(np.maximum(one, own) / (ramp @ ramp))
    return float(np.max(np.abs(slope) / sigma)), np.asarray(slope * (count - 1))

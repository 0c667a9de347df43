"""Whether the noise of an axis has changed, by what its own readings scatter at rest.

A calibration may hold while a sensor becomes noisy. Its means then scatter, and one of them alone looks like a step of
an offset; only the readings within the rest tell the two apart. Of each rest the scatter of single readings and that of
means of two seconds are compared with those of the rests before: white noise shows in the first, 1/f noise in the
second. Both are taken from neighbours (the second is the Allan deviation at two seconds), so that neither a drift nor
the length of the rest counts.

What is known of a rest is used in two ways: the floor of its mean is grown by as much at once (`times`), and a change
that lasts is said (`changes`). Vibration scatters, too: of three axes alike it is the likelier reason.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np

from highside.arrays import Array
from highside.watch.policy import WatchPolicy
from highside.watch.result import NoiseChange

__all__ = ["KINDS", "AxisNoise", "block_means", "scatters"]

KINDS = (("reading_noise", "single readings"), ("coloured_noise", "means of two seconds"))
"""effect of the library, and of what it is the scatter: the rows of `Still.scatter_g`"""
_AXES: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
SLOW_S = 2.0
WIDTH = 6
"""scatters of a rest: of each kind those of x, y, z"""
_LOW, _MIDDLE, _HIGH = range(1, 4)
"""where a change keeps the 10, 50 and 90 % quantiles of the scatters before it; its time comes first"""


def scatters(t_s: Array, c: Array) -> Array:
    """(2, 3) g: standard deviation of a reading, and of a mean of two seconds, of readings (3, K) of a rest at `t_s`
    (K,), by the differences of neighbours. NaN where there are fewer than three of either."""
    out = []
    for means in (c, block_means(t_s, c)):
        steps = np.diff(means, axis=1)
        out.append(np.sqrt(np.mean(steps**2, axis=1) / 2.0) if means.shape[1] > 2 else np.full(3, np.nan))
    return np.array(out)


def block_means(t_s: Array, c: Array) -> Array:
    """(3, B) means over two seconds of readings (3, K) at `t_s` (K,)."""
    step = float(np.median(np.diff(t_s))) if t_s.size > 1 else SLOW_S
    width = max(1, round(SLOW_S / max(step, 1e-9)))
    blocks = c.shape[1] // width
    return np.asarray(c[:, : blocks * width].reshape(3, blocks, width).mean(axis=2))


class AxisNoise:
    """Scatters of the last rests, and which of them have changed."""

    def __init__(self, policy: WatchPolicy) -> None:
        self._policy = policy
        self._rests: deque[Array] = deque(maxlen=policy.noise_rests)
        """(1 + `WIDTH`,) each: time, scatters"""
        self._changed = np.full((WIDTH, 4), np.nan)
        """since when, and the quantiles of before; NaN: not changed"""

    def take(self, t_s: float, scatter_g: Array) -> None:
        """A rest, in the order of time: its scatters (2, 3), g. One that is not known or zero counts for nothing: an
        axis that does not move at all is dead, or coarser than its noise."""
        self._rests.append(np.concatenate([[t_s], np.asarray(scatter_g, dtype=float).ravel()]))
        kept = np.array(self._rests)
        for k in range(WIDTH):
            own = kept[np.isfinite(kept[:, 1 + k]) & (kept[:, 1 + k] > 0.0)]
            if own.size:
                self._judge(k, own[:, 0], own[:, 1 + k])

    def _judge(self, k: int, t_s: Array, scatter: Array) -> None:
        policy = self._policy
        last, changed = scatter[-policy.noise_confirm :], self._changed[k]
        if np.isfinite(changed[0]):
            low, high = changed[_LOW] / policy.grown, changed[_HIGH] * policy.grown
            if last.size == policy.noise_confirm and ((last >= low) & (last <= high)).all():
                changed[:] = np.nan
            return
        before = scatter[: -policy.noise_confirm]
        if before.size < policy.noise_fewest:
            return
        low, middle, high = np.quantile(before, (0.1, 0.5, 0.9))
        if (last > policy.grown * high).all() or (last < low / policy.grown).all():
            changed[:] = t_s[-policy.noise_confirm], low, middle, high

    def times(self, scatter_g: Array) -> Array:
        """(3,) by which factor each axis is noisier in a rest than it was before, one at least; one while too few rests
        were seen to say so."""
        return np.asarray(np.maximum(1.0, np.nanmax(np.vstack([self._over(scatter_g), np.ones((1, 3))]), axis=0)))

    def _over(self, scatter_g: Array) -> Array:
        """(2, 3) ratio to the 90 % quantile of the rests before; NaN where it is not known."""
        out = np.full(WIDTH, np.nan)
        kept = np.array(self._rests).reshape(-1, 1 + WIDTH)
        for k, value in enumerate(np.asarray(scatter_g, dtype=float).ravel()):
            high = self._changed[k, _HIGH]
            if not np.isfinite(high):
                before = kept[np.isfinite(kept[:, 1 + k]) & (kept[:, 1 + k] > 0.0), 1 + k]
                if before.size < self._policy.noise_fewest:
                    continue
                high = np.quantile(before, 0.9)
            out[k] = value / high
        return out.reshape(2, 3)

    def changes(self) -> tuple[NoiseChange, ...]:
        """What stands, an axis at most once: by the kind of scatter that has changed most."""
        kept, out = np.array(self._rests).reshape(-1, 1 + WIDTH), []
        for i, axis in enumerate(_AXES):
            found = []
            for kind, (effect, of) in enumerate(KINDS):
                k = 3 * kind + i
                since = float(self._changed[k, 0])
                now = kept[kept[:, 0] >= since, 1 + k] if np.isfinite(since) else np.zeros(0)
                now = now[np.isfinite(now)]
                if now.size:
                    factor = float(np.median(now) / self._changed[k, _MIDDLE])
                    found.append(NoiseChange(axis, effect, of, factor, float(np.median(now)), since, int(now.size)))
            if found:
                out.append(max(found, key=lambda one: abs(np.log(max(one.factor, 1e-12)))))
        return tuple(out)

    def memory(self) -> dict[str, Array]:
        """For `recall`. What is not known is zero."""
        return {
            "noise_rests": np.nan_to_num(np.array(self._rests).reshape(-1, 1 + WIDTH)),
            "noise_changed": np.nan_to_num(self._changed),
        }

    def recall(self, rests: Array, changed: Array) -> None:
        """Go on from a `memory`. Raises ValueError for one that is none."""
        if rests.ndim != 2 or rests.shape[1] != 1 + WIDTH or changed.shape != self._changed.shape:
            raise ValueError("the scatter of rests has another shape")
        if (rests[:, 1:] < 0.0).any() or (changed[:, _LOW:] < 0.0).any():
            raise ValueError("the scatter of rests is none")
        self._rests.clear()
        self._rests.extend(rests.copy())
        self._changed = np.where(changed[:, [_MIDDLE]] > 0.0, changed, np.nan)

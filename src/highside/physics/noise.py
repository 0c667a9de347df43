"""Random sequences of the kinds that real triads show; all seeded through a Generator given by the caller.

A sensor of one-sided noise density n (g/sqrt(Hz)) averaged over tau seconds has the standard deviation
n / sqrt(2 tau): the average passes the bandwidth 1 / (2 tau).
"""

from __future__ import annotations

import numpy as np

from highside.arrays import AnyArray


def std_of_average(density: float, seconds: float) -> float:
    """Standard deviation (g) of an average over `seconds` of white noise of `density` (g/sqrt(Hz), one-sided)."""
    return float(density / np.sqrt(2 * seconds))


def white(shape: tuple[int, ...], sigma: AnyArray | float, rng: np.random.Generator) -> AnyArray:
    """Independent normal numbers; `sigma` broadcasts against `shape`."""
    return np.asarray(sigma) * rng.standard_normal(shape)


def autoregressive(shape: tuple[int, int], sigma: float, coefficient: float, rng: np.random.Generator) -> AnyArray:
    """First-order autoregressive rows (stationary from the first value) with standard deviation `sigma`.

    `coefficient` in (-1, 1) is the correlation of neighbours.
    """
    from scipy.signal import lfilter

    drive = rng.standard_normal(shape) * np.sqrt(1 - coefficient**2)
    drive[:, 0] /= np.sqrt(1 - coefficient**2)
    return sigma * np.asarray(lfilter([1.0], [1.0, -coefficient], drive, axis=1))


def random_walk(t_s: AnyArray, rate: AnyArray | float, rng: np.random.Generator) -> AnyArray:
    """(3, N) random walks from 0 with standard deviation rate * sqrt(elapsed seconds); `rate` scalar or (3,)."""
    steps = np.sqrt(np.clip(np.diff(t_s, prepend=t_s[:1]), 0.0, None)) * rng.standard_normal((3, t_s.size))
    return np.broadcast_to(np.asarray(rate, dtype=float), (3,))[:, None] * np.cumsum(steps, axis=1)


def vibration_modulated(vibration_rms_g: AnyArray, gain: AnyArray | float, rng: np.random.Generator) -> AnyArray:
    """(3, N) white noise whose standard deviation is gain * vibration; `gain` scalar or (3,)."""
    sigma = np.broadcast_to(np.asarray(gain, dtype=float), (3,))[:, None] * vibration_rms_g
    return sigma * rng.standard_normal((3, vibration_rms_g.size))


def quantised(values: AnyArray, step: float) -> AnyArray:
    """Rounded to multiples of `step` (unchanged for a step of 0)."""
    return np.round(values / step) * step if step > 0 else values

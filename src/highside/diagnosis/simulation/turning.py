"""How fast rates change: exact for a motion that is known without noise, and no noise for a motion.

A difference of neighbouring rows shows 64 % of what has four rows a period, and a lever arm that is found from it is
longer by as much. But an exact derivative of rates that were measured is mostly noise, and a lever arm is found from
nothing else then. So each frequency counts as far as it stands out of the noise (Wiener's filter), and that shows where
there is no motion any more: above the band that is compared.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.diagnosis.simulation.alignment import filled, usual_rate
from highside.diagnosis.simulation.policy import TURNING
from highside.physics.channels import changing


def noise_of_rate(t_s: Array, values: Array, band_hz: float) -> float:
    """Noise, in squares of the unit per Hz, of rates (N,) at times (N,), which show motion up to `band_hz`."""
    from scipy.signal import welch

    raw_hz = usual_rate(t_s)
    times = np.arange(t_s[0], t_s[-1], 1 / raw_hz)
    hz, power = welch(filled(times, t_s, values), fs=raw_hz, nperseg=min(times.size, TURNING.segment))
    highest = TURNING.highest * raw_hz / 2
    lowest = min(band_hz, TURNING.lowest * raw_hz / 2)
    above = np.array_split(power[(hz >= lowest) & (hz <= highest)], TURNING.bands)
    return min((float(part.mean()) for part in above if part.size), default=0.0)


def angular_acceleration(rate: Array, step_s: float, noise: float) -> Array:
    """(n,) change per second of a rate (n,), of which so much per Hz is noise."""
    n = rate.size
    if noise <= 0.0:
        return np.asarray(changing(rate, step_s))
    hz = np.fft.rfftfreq(n, step_s)
    waves = np.abs(np.fft.rfft((rate - rate.mean()) * np.hanning(n))) ** 2
    density = 2 * step_s * waves / float(np.sum(np.hanning(n) ** 2))
    width = max(1, round(TURNING.smooth_hz * n * step_s))
    level = np.convolve(density, np.ones(2 * width + 1), mode="same") / np.convolve(
        np.ones(hz.size), np.ones(2 * width + 1), mode="same"
    )
    share = np.maximum(0.0, 1.0 - noise / np.maximum(level, noise * TURNING.rounding))
    return np.asarray(changing(rate, step_s, lambda f: np.interp(f, hz, share)))

"""Two simulated rotors with known truth, in arcminutes: one turn, 6,000 rows, roll, pitch and heading.

Both have a constant, a first harmonic of about 0.045' and a second of about 0.013' (sizes that leave 0.021' after the
first method, as published), irregular harmonics three to eight that fall with k^2, and white noise. `A`: noise
dominates what two harmonics leave. `B`: irregular wobble dominates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.attitude.angles import TURN
from highside.rotation.bases import fourier_sum

CHANNELS = ("roll", "pitch", "heading")
_CONSTANT = (0.012, -0.020, 0.030)
_FIRST = (0.045, 0.038, 0.052)
_FIRST_PHASE = (0.6, 2.2, -1.0)
_SECOND_PHASE = (1.1, -0.4, 2.0)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Sizes in arcminutes: second harmonic of each channel, irregular part, noise of a row."""

    name: str
    second: tuple[float, float, float]
    irregular: float
    noise: float


A = Scenario("A", (0.0140, 0.0135, 0.0145), 0.0126, 0.0018)
B = Scenario("B", (0.0125, 0.0120, 0.0130), 0.040, 0.0010)
SCENARIOS: Mapping[str, Scenario] = {"A": A, "B": B}


@dataclass(frozen=True, slots=True)
class Draw:
    """One channel of one seed: angles (N,) rad, errors as measured and as they truly are (N,), and the true series."""

    theta_rad: Array
    error: Array
    truth: Array
    coefficients: Array
    """Fourier (R0, a1, b1, ...) of the truth, harmonics 0 to 8"""

    def true_at(self, theta_rad: Array) -> Array:
        return fourier_sum(theta_rad, self.coefficients)


def draw(scenario: Scenario, seed: int, channel: int, *, rows: int = 6000, turns: float = 1.0) -> Draw:
    """Rows spread evenly over the turns; the same seed is the same rotor whatever the rows and turns."""
    rng = np.random.default_rng(1000 + 10 * seed + channel)
    theta: Array = np.arange(rows, dtype=float) * (turns * TURN / rows)
    coefficients = np.zeros(17)
    coefficients[0] = _CONSTANT[channel]
    waves = [(1, _FIRST[channel], _FIRST_PHASE[channel]), (2, scenario.second[channel], _SECOND_PHASE[channel])]
    waves += [(k, scenario.irregular * rng.uniform(0.5, 1.0) / k**2, rng.uniform(0.0, TURN)) for k in range(3, 9)]
    for k, size, phase in waves:
        coefficients[2 * k - 1], coefficients[2 * k] = size * np.cos(phase), size * np.sin(phase)
    truth = fourier_sum(theta, coefficients)
    error: Array = truth + scenario.noise * rng.standard_normal(rows)
    return Draw(theta, error, truth, coefficients)

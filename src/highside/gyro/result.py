"""What every drift method returns: attitude, bias, their uncertainties, and where the azimuth comes from."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array


class AzimuthBasis(Enum):
    """Where the azimuth of a result comes from. Gravity alone never gives it for a tool that does not turn."""

    CONSTRAINT = "constraint: the method asserts that the azimuth did not change; a real change is reported as none"
    ZERO_RATE = "zero-rate update: the gyro bias was measured while the tool stood, the azimuth is integrated between"
    ROTATION = "rotation: the turning tool made all three gyro biases visible to gravity, the azimuth is integrated"
    NOTHING = "nothing: the azimuth is the integrated gyro with its bias along the vertical uncorrected"


@dataclass(frozen=True, slots=True)
class DriftResult:
    """N rows. Angles rad (inclination from vertical), vectors in the tool frame, rates rad/s.

    Standard deviations are NaN where a method states none; `notes` are sentences on what was assumed or degraded.
    """

    t_s: Array
    inc_rad: Array
    tf_rad: Array
    azi_rad: Array
    azi_std_rad: Array
    bias_radps: Array
    """(3, N)"""
    bias_std_radps: Array
    """(3, N)"""
    basis: tuple[AzimuthBasis, ...]
    notes: tuple[str, ...] = ()
    scale: float = 0.0
    """scale-factor error of the gyro along the tool axis"""
    motion: NDArray[np.int8] | None = None
    """(N,) verdict of the gate (`Motion`)"""

    @property
    def basis_words(self) -> str:
        """The basis of the azimuth in one line."""
        return "; ".join(basis.value for basis in self.basis)

"""What the live service asks of a calibration: a corrected gravity vector, its covariance, and who made it.

A `Correction` is immutable; swapping one for another between two frames is the hot swap of the service. The
covariance of a corrected vector has two parts: the reading's own, carried through the correction, and that of the
correction itself (equation 6 of the balance-correction paper: `C dM + dC M`).

Covariances of vectors are six floats, the upper triangle `(xx, xy, xz, yy, yz, zz)`, in g^2.

The corrections themselves: one zone of a calibration in `highside.calibration.linear_correction`, several blended by
inclination in `highside.calibration.schedule`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.errors import InputError

Vector = tuple[float, float, float]
Covariance = tuple[float, float, float, float, float, float]

ZERO_COVARIANCE: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
OUTSIDE_ZONE = "outside_zone"
TEMPERATURE_OUTSIDE = "temperature_outside"
TEMPERATURE_UNKNOWN = "temperature_unknown"
LAW_OUTSIDE = "law_outside_range"
LAW_UNKNOWN = "law_not_applied"


class Corrected(NamedTuple):
    """A corrected reading: the gravity direction in the tool frame (g) and the covariance of its error (g^2).

    `zone` names the correction that made it ("global", "zone 3.0", "none"); `flags` say what a user must know
    ("uncalibrated", "outside_zone", "temperature_outside"). With "outside_zone" no correction holds there and the
    vector is not a number: nothing may be published from it.
    """

    gx: float
    gy: float
    gz: float
    cov: Covariance
    zone: str
    flags: tuple[str, ...] = ()


class Correction(Protocol):
    """A calibration in force."""

    @property
    def cal_id(self) -> str:
        """Content hash of the record that made it, or "none"."""

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        """Correct one (averaged) raw reading `a` in g whose own covariance is `cov` in g^2."""


@dataclass(frozen=True, slots=True)
class BlockCorrected:
    """N corrected readings: `g` (3, N) in g, `cov` (6, N) in g^2, not a number where no correction holds.

    `reading` (6, N): that part of `cov` which is the noise of the readings themselves.
    `zone` (N,): which of `names` made it (the one with the greatest weight), -1 for none. `temperature_outside` (N,).
    """

    g: Array
    cov: Array
    reading: Array
    zone: NDArray[np.intp]
    names: tuple[str, ...]
    temperature_outside: NDArray[np.bool_]
    law_outside: NDArray[np.bool_] | None = None
    """(N,) where a law of the sensor was asked beyond the range it was learnt in; None: there are no laws"""
    law_unknown: NDArray[np.bool_] | None = None
    """(N,) where one could not be applied"""


@dataclass(frozen=True, slots=True)
class IdentityCorrection:
    """No calibration: readings pass unchanged, flagged; the uncertainty is that of an uncalibrated sensor.

    `bias_std_g` and `scale_std` are 1-sigma figures of the sensor's data sheet.
    """

    bias_std_g: float = 2e-3
    scale_std: float = 3e-3
    cal_id: str = "none"

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        g2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        own = self.bias_std_g**2 + self.scale_std**2 * g2
        xx, xy, xz, yy, yz, zz = cov
        return Corrected(a[0], a[1], a[2], (xx + own, xy, xz, yy + own, yz, zz + own), "none", ("uncalibrated",))


@dataclass(frozen=True, slots=True)
class TemperatureTrust:
    """How far a calibration may be believed in temperature.

    Within `min_c` to `max_c` as stated; beyond, each degree adds `growth_g_per_c` (one standard deviation, each axis;
    the usual offset drift of a quartz accelerometer is 30 to 100 ug/degC).
    """

    min_c: float
    max_c: float
    growth_g_per_c: float = 50e-6

    def __post_init__(self) -> None:
        if not self.min_c <= self.max_c or self.growth_g_per_c < 0:
            raise InputError(f"temperatures {self.min_c:g} to {self.max_c:g} degC, growth {self.growth_g_per_c:g}")

    def beyond_c(self, temp_c: float) -> float:
        """Degrees outside of the range; 0 inside."""
        return max(self.min_c - temp_c, temp_c - self.max_c, 0.0)


def refused(flags: tuple[str, ...] = ()) -> Corrected:
    """The answer where no correction holds: no vector at all."""
    nan = math.nan
    return Corrected(nan, nan, nan, (nan, nan, nan, nan, nan, nan), "none", (OUTSIDE_ZONE, *flags))

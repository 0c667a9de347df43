"""What the live service asks of a calibration: a corrected gravity vector, its covariance, and who made it.

A `Correction` is immutable; swapping one for another between two frames is the hot swap of the service. The
covariance of a corrected vector has two parts: the reading's own, carried through the correction, and that of the
correction itself (equation 6 of the balance-correction paper: `C dM + dC M`).

Covariances of vectors are six floats, the upper triangle `(xx, xy, xz, yy, yz, zz)`, in g^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

Vector = tuple[float, float, float]
Covariance = tuple[float, float, float, float, float, float]

ZERO_COVARIANCE: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Corrected(NamedTuple):
    """A corrected reading: the gravity direction in the tool frame (g) and the covariance of its error (g^2).

    `zone` names the correction that made it ("global", "zone 3.0", "none"); `flags` say what a user must know
    ("uncalibrated", "outside_zone", "temperature_outside").
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
class IdentityCorrection:
    """No calibration: readings pass unchanged, flagged, with the stated bounds of an uncalibrated sensor as uncertainty.

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

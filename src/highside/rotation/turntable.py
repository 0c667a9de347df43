"""The turntable's own error in the axis frame, so that what was fitted at some inclinations holds at all others.

An encoder error shifts the toolface by as much at every inclination; a wobble of the axis across the tilt, E, shifts it
by -E cot I, and along the tilt, dI, shifts the inclination (`w = Rz(T) Rx(E) Ry(I) v`, first order). With Fourier
series in the rotor angle t,

    toolface error  = A(t) - cot(I) E(t)          inclination error = D(t)

so two turns at two inclinations tell A from E. At one inclination only their sum is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.errors import InputError, Refused
from highside.rotation.bases import fourier_rows, fourier_sum, triangle_of

Floats = NDArray[np.float64]

LEAST_SIN_INCLINATION = 0.05
"""below three degrees the toolface is too uncertain to say anything about a bench"""


@dataclass(frozen=True, slots=True)
class TurntableCurve:
    """Fourier coefficients (R0, a1, b1, ...) in rad: encoder A, wobble across E and along D the tilt; one order.

    `covariance` is that of (A, E) together, `noise_rad` the standard deviation of one toolface about the curve.
    """

    order: int
    encoder: Floats
    across: Floats
    along: Floats
    covariance: Floats
    noise_rad: float

    def toolface_error(self, theta_rad: Floats, inc_rad: Floats | float) -> Floats:
        """(N,) rad, what the toolface reference is off at rotor angles (N,) and inclination(s)."""
        return fourier_sum(theta_rad, self.encoder) - fourier_sum(theta_rad, self.across) / np.tan(inc_rad)

    def inclination_error(self, theta_rad: Floats) -> Floats:
        """(N,) rad, at any inclination."""
        return fourier_sum(theta_rad, self.along)


def fit_turntable(
    theta_rad: Floats,
    inc_rad: Floats,
    toolface_error_rad: Floats,
    inclination_error_rad: Floats,
    largest_order: int = 8,
) -> TurntableCurve:
    """Fit to rows (N,) of whole turns at two or more inclinations; the order by BIC of the toolface errors.

    Raises Refused with fewer than two inclinations that differ in cot I, InputError for rows near vertical.
    """
    theta, inc = np.asarray(theta_rad, dtype=float), np.asarray(inc_rad, dtype=float)
    if np.abs(np.sin(inc)).min() < LEAST_SIN_INCLINATION:
        raise InputError("rows within three degrees of vertical have no toolface to speak of", remedy="leave them out")
    lever = 1.0 / np.tan(inc)
    if float(np.ptp(lever)) < 0.1:
        raise Refused("one inclination cannot tell the encoder from the wobble of the axis; add a turn at another one")
    n = theta.size
    best: tuple[float, int, Floats, Floats, float] | None = None
    for order in range(largest_order + 1):
        rows = fourier_rows(theta, order)
        both = np.vstack([rows, -lever * rows])
        p = both.shape[0]
        if n <= 2 * p:
            break
        triangle = triangle_of(both, toolface_error_rad)
        if np.abs(np.diag(triangle)[:p]).min() < 1e-9 * abs(triangle[0, 0]):
            break
        inverse = np.linalg.inv(triangle[:p, :p])
        rss = max(float(triangle[p, p] ** 2), 1e-300)
        criterion = n * np.log(rss / n) + p * np.log(n)
        if best is None or criterion < best[0]:
            best = criterion, order, inverse @ triangle[:p, p], inverse @ inverse.T, rss / (n - p)
    if best is None:
        raise Refused(f"{n} rows at these angles cannot tell the encoder from the wobble of the axis")
    _, order, solution, cofactor, variance = best
    half = 2 * order + 1
    rows = fourier_rows(theta, order)
    triangle = triangle_of(rows, inclination_error_rad)
    along = np.asarray(np.linalg.solve(triangle[:half, :half], triangle[:half, half]), dtype=float)
    covariance = np.asarray(variance * cofactor, dtype=float)
    return TurntableCurve(order, solution[:half], solution[half:], along, covariance, float(np.sqrt(variance)))

"""The turntable's own error in the axis frame, so that what was fitted at some inclinations holds at all others.

An encoder error shifts the toolface by as much at every inclination; a wobble of the axis across the tilt, E, shifts it
by -E cot I, and along the tilt, dI, shifts the inclination (`w = Rz(T) Rx(E) Ry(I) v`, first order). With Fourier
series in the rotor angle t,

    toolface error  = A(t) - cot(I) E(t)          inclination error = D(t)

so two turns at two inclinations tell A from E. At one inclination only their sum is known. Errors are what a true
level would read minus what the bench reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from highside.arrays import Array
from highside.errors import InputError, Refused
from highside.rotation.bases import fourier_rows, fourier_sum, triangle_of
from highside.rotation.compensation import Compensation, Validity
from highside.rotation.curve import CurveForm, CurveMethod, ErrorCurve
from highside.rotation.samples import AngleCoverage, Samples

ARCMIN = np.pi / 10800.0
AXIS_CHANNELS = ("encoder", "across", "along")
LEAST_SIN_INCLINATION = 0.05
"""below three degrees the toolface is too uncertain to say anything about a bench"""


@dataclass(frozen=True, slots=True)
class TurntableCurve:
    """Fourier coefficients (R0, a1, b1, ...) in rad: encoder A, wobble across E and along D the tilt; one order.

    `covariance` is that of (A, E) together, `noise_rad` the standard deviation of one toolface about the curve.
    """

    order: int
    encoder: Array
    across: Array
    along: Array
    covariance: Array
    noise_rad: float
    along_covariance: Array
    along_noise_rad: float
    coverage: AngleCoverage

    def toolface_error(self, theta_rad: Array, inc_rad: Array | float) -> Array:
        """(N,) rad, what the toolface reference is off at rotor angles (N,) and inclination(s)."""
        return fourier_sum(theta_rad, self.encoder) - fourier_sum(theta_rad, self.across) / np.tan(inc_rad)

    def inclination_error(self, theta_rad: Array) -> Array:
        """(N,) rad, at any inclination."""
        return fourier_sum(theta_rad, self.along)

    def compensation(self, source: str, source_sha256: str) -> Compensation:
        """As a file's content: channels `encoder`, `across` and `along`; the recording's name and hash."""
        half = self.encoder.size

        def curve(values: Array, covariance: Array, noise_rad: float) -> ErrorCurve:
            return ErrorCurve(
                CurveMethod.AUTO,
                CurveForm.FOURIER,
                self.order,
                values / ARCMIN,
                covariance / ARCMIN**2,
                noise_rad / ARCMIN,
                self.coverage,
            )

        curves = {
            "encoder": curve(self.encoder, self.covariance[:half, :half], self.noise_rad),
            "across": curve(self.across, self.covariance[half:, half:], self.noise_rad),
            "along": curve(self.along, self.along_covariance, self.along_noise_rad),
        }
        return Compensation(curves, Validity(), source, source_sha256)


def reference_errors(compensation: Compensation, theta_rad: Array, inc_rad: Array) -> tuple[Array, Array]:
    """Errors (inclination, toolface) of the bench's readings, (N,) rad, to be added to them; `theta_rad` its encoder's.

    The mean of the encoder's curve is omitted: it is the toolface zero, which belongs to tool and fixture. Raises
    Refused for a compensation that was not fitted in the axis frame.
    """
    lacking = [name for name in AXIS_CHANNELS if name not in compensation.curves]
    if lacking:
        raise Refused(
            f"this compensation is for {', '.join(compensation.curves)}, good at one inclination only; a bench needs"
            " one of rotation turntable"
        )
    encoder, across, along = (compensation.curves[name](theta_rad) * ARCMIN for name in AXIS_CHANNELS)
    zero = float(compensation.curves["encoder"].parameters[0]) * ARCMIN
    return along, encoder - zero - across / np.tan(inc_rad)


def correct_settings(
    compensation: Compensation, inc_deg: Array, tf_deg: Array, encoder_deg: Array | None = None
) -> tuple[Array, Array]:
    """Where a bench truly stands at its settings (N,), deg; `encoder_deg` its rotor angle where it is not the toolface.

    A vertical tool has no toolface to correct. Raises Refused as `reference_errors` does.
    """
    inc = np.radians(inc_deg)
    upright = np.abs(np.sin(inc)) < 1e-3
    angle = np.radians(tf_deg if encoder_deg is None else encoder_deg)
    d_inc, d_tf = reference_errors(compensation, angle, np.where(upright, 0.5 * np.pi, inc))
    return inc_deg + np.degrees(d_inc), tf_deg + np.degrees(np.where(upright, 0.0, d_tf))


def fit_turntable(
    theta_rad: Array,
    inc_rad: Array,
    toolface_error_rad: Array,
    inclination_error_rad: Array,
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
        raise Refused(
            "one inclination cannot separate the encoder from the wobble of the axis; add a turn at another one"
        )
    n = theta.size
    best: tuple[float, int, Array, Array, float] | None = None
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
        raise Refused(f"{n} rows at these angles cannot separate the encoder from the wobble of the axis")
    _, order, solution, cofactor, variance = best
    half = 2 * order + 1
    rows = fourier_rows(theta, order)
    triangle = triangle_of(rows, inclination_error_rad)
    inverse = np.linalg.inv(triangle[:half, :half])
    along_variance = float(triangle[half, half] ** 2) / (n - half)
    return TurntableCurve(
        order,
        solution[:half],
        solution[half:],
        np.asarray(inverse @ triangle[:half, half], dtype=float),
        np.asarray(variance * cofactor, dtype=float),
        float(np.sqrt(variance)),
        np.asarray(along_variance * (inverse @ inverse.T), dtype=float),
        float(np.sqrt(along_variance)),
        Samples.build(theta, toolface_error_rad).coverage,
    )

"""The paper's methods 1 to 3, by least squares through QR: one harmonic, two harmonics, polynomial of degree nine.

The normal equations (X = (F'F)^-1 F'R, equation 9) are the same in exact numbers; QR does not square the condition.
"""

from __future__ import annotations

import numpy as np

from highside.arrays import Array
from highside.errors import InputError, Refused
from highside.rotation.bases import RateTerms, chebyshev_rows, fourier_rows, triangle_of
from highside.rotation.curve import CurveForm, CurveMethod, ErrorCurve
from highside.rotation.samples import AngleCoverage, Samples

DEGREE = 9
LEAST_OWN_SHARE = 0.02
"""a rate term of which less than this share is its own (not explained by the angle columns) is not identifiable"""
CONSTANT_RATE = 1e-6


def sine(samples: Samples) -> ErrorCurve:
    """Method 1, R0 + a sin t + b cos t (equation 4). Raises Refused where less than half of the turn is covered."""
    return _harmonics(samples, 1, CurveMethod.SINE)


def harmonics2(samples: Samples) -> ErrorCurve:
    """Method 2, with c sin 2t + d cos 2t (equation 5). Raises Refused where less than half of the turn is covered."""
    return _harmonics(samples, 2, CurveMethod.HARMONICS2)


def four_positions(error: Array, noise: float = 0.0) -> ErrorCurve:
    """Method 1 from the mean errors at 0, 90, 180 and 270 degrees alone, each with standard deviation `noise`.

    R0 is their mean, a = (R90 - R270) / 2, b = (R0deg - R180) / 2. Even harmonics cancel but for the fourth, which goes
    into R0; the third goes into the first in full.
    """
    r = np.asarray(error, dtype=float)
    if r.shape != (4,) or not np.isfinite(r).all():
        raise InputError("four positions need four finite errors, at 0, 90, 180 and 270 degrees")
    parameters = np.array([r.mean(), 0.5 * (r[1] - r[3]), 0.5 * (r[0] - r[2])])
    covariance = noise**2 * np.diag([0.25, 0.5, 0.5])
    coverage = AngleCoverage(4, 0.75, np.pi / 2, 0.0)
    return ErrorCurve(
        CurveMethod.SINE,
        CurveForm.FOURIER,
        1,
        parameters,
        covariance,
        noise,
        coverage,
        remarks=("from four positions: a third harmonic would pass for the first",),
    )


def polynomial9(samples: Samples, rate_terms: int = 0) -> ErrorCurve:
    """Method 3, polynomial of degree nine in x = t / pi - 1 and powers 1..rate_terms of the rate (equation 6).

    The paper's b_0 is omitted: it is a second constant. A power of the rate that the other columns explain is omitted
    with a remark. Raises Refused where less than half of the turn is covered, or where rate terms are requested and the
    rate is constant; InputError where no rate is given.
    """
    samples.require_coverage()
    rows = chebyshev_rows(samples.theta_rad, DEGREE)
    rate: RateTerms | None = None
    remarks: list[str] = []
    if rate_terms:
        rate, remarks = identifiable_rate(samples, rows, rate_terms)
        rows = np.vstack([rows, rate.rows(_rate_of(samples))])
    return _solved(samples, rows, CurveMethod.POLYNOMIAL9, CurveForm.CHEBYSHEV, DEGREE, rate, remarks)


def _harmonics(samples: Samples, order: int, method: CurveMethod) -> ErrorCurve:
    samples.require_coverage()
    return _solved(samples, fourier_rows(samples.theta_rad, order), method, CurveForm.FOURIER, order, None, [])


def _solved(
    samples: Samples,
    rows: Array,
    method: CurveMethod,
    form: CurveForm,
    order: int,
    rate: RateTerms | None,
    remarks: list[str],
) -> ErrorCurve:
    """Least squares on the rows (P, N)."""
    p, n = rows.shape
    if n <= p:
        raise InputError(f"{n} rows cannot determine {p} parameters", remedy=f"give more than {p} rows")
    triangle = triangle_of(rows, samples.error)
    R, z, rss = triangle[:p, :p], triangle[:p, p], float(triangle[p, p] ** 2)
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < 1e-10 * diagonal.max():
        raise Refused(
            f"the rotor stood at too few different angles for the {p} parameters of {method.value};"
            " record a turning rotor or use another method"
        )
    inverse = np.linalg.inv(R)
    noise = float(np.sqrt(rss / (n - p)))
    warning = samples.coverage.warning
    return ErrorCurve(
        method,
        form,
        order,
        inverse @ z,
        noise**2 * (inverse @ inverse.T),
        noise,
        samples.coverage,
        rate,
        remarks=(*remarks, *((warning,) if warning else ())),
    )


def _rate_of(samples: Samples) -> Array:
    if samples.rate_radps is None:
        raise InputError("rate terms need the rotor rate", remedy="give rotor_rate_dps or leave rate_terms= out")
    return samples.rate_radps


def identifiable_rate(samples: Samples, angle_rows: Array, powers: int) -> tuple[RateTerms, list[str]]:
    """Which powers 1..`powers` of the rate the samples can tell from functions of the angle, and remarks on the others.

    With a rate that is itself a function of the angle (unevenness repeating every turn) its terms are explained by the
    angle columns, and with two rates only, its square is a constant: such terms are omitted. Raises Refused where the
    rate is constant or no term is left, InputError where no rate is given.
    """
    if powers not in (1, 2):
        raise InputError(f"{powers} rate terms", field="rate_terms", remedy="0, 1 or 2")
    rate = _rate_of(samples)
    spread = float(rate.std())
    if spread <= CONSTANT_RATE * max(float(np.abs(rate).max()), 1e-12):
        raise Refused("rate terms were requested, but the rotor rate is constant; record at several rates")
    whole = RateTerms(float(rate.mean()), spread, tuple(range(1, powers + 1)))
    columns = whole.rows(rate)
    kept: list[int] = []
    remarks: list[str] = []
    known = angle_rows
    for power, column in zip(whole.powers, columns, strict=True):
        triangle = triangle_of(known, column)
        p = known.shape[0]
        # what is left of the column beside the angle columns, as a share of its scatter
        own = abs(float(triangle[p, p])) / float(np.linalg.norm(column))
        if own > LEAST_OWN_SHARE:
            kept.append(power)
            known = np.vstack([known, column])
        else:
            remarks.append(
                f"rate term {power} omitted: these runs do not separate it from the angle ({100 * own:.1f} % its own);"
                " runs at several rates would"
            )
    if not kept:
        raise Refused(
            "rate terms were requested, but in these runs the rate follows the angle and they cannot be separated;"
            " record at several rates"
        )
    return RateTerms(whole.centre_radps, spread, tuple(kept)), remarks

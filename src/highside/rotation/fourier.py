"""`auto`: a Fourier series that chooses its own order, holds outliers down and stays small where there are no rows.

1. One QR of the largest model with the errors as last column, [F y] = Q [R z]: the columns are nested, so the residual
   sum of squares of every order k follows from it, RSS_k = y'y - sum_{j <= 2k} z_j^2.
2. Huber's estimate (1.345 standard deviations, scale from the median absolute residual of the largest model) by
   modified residuals: beta += (F'F)^-1 F' psi(r), with the same triangle R each time (Huber and Ronchetti, Robust
   Statistics, section 7.8). The pseudo-values F beta + psi(r) are the errors with outliers pulled in.
3. Order by BIC of the pseudo-values, n ln(RSS_k / n) + p_k ln n; then Huber's estimate of that order.
4. Where part of the turn is not covered, no order is chosen: see `gap`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from highside.arrays import Array
from highside.attitude.angles import TURN, wrap_positive
from highside.errors import Refused
from highside.rotation.bases import RateTerms, combined, fourier_rows, projected, triangle_of
from highside.rotation.curve import CurveForm, CurveMethod, ErrorCurve
from highside.rotation.gap import bridged
from highside.rotation.linear import identifiable_rate
from highside.rotation.samples import Samples

LARGEST_ORDER = 12
"""Highest harmonic tried at first; where it is taken, or a higher one comes back in every turn, `fit` looks beyond."""
BEYOND_ORDER = 35
"""Highest harmonic tried where the first range is used up: the last that five-degree sectors of the turn can carry."""
UTMOST_ORDER = 60
"""Highest harmonic ever tried, where one beyond the others comes back in every turn: that of three-degree sectors."""
HUBER = 1.345
_MAD_TO_STD = 1.482602218505602
_ROUNDS = 30
_CONVERGED = 1e-5
"""largest change of a parameter, in standard deviations of a row, at which the robust rounds end"""


def auto(
    samples: Samples, *, rate_terms: int = 0, largest_order: int = LARGEST_ORDER, robust: bool = True
) -> ErrorCurve:
    """Fit. Raises Refused where less than half of the turn is covered or requested rate terms cannot be identified."""
    samples.require_coverage()
    order = _order_allowed(samples, largest_order, 4)
    rows = fourier_rows(samples.theta_rad, order)
    rate: RateTerms | None = None
    remarks: list[str] = []
    if rate_terms:
        rate, remarks = identifiable_rate(samples, rows, rate_terms)
    rows = _with_rate(rows, samples, rate)
    extra = 0 if rate is None else len(rate.powers)
    fit = _Fit(rows, samples.error)
    full = rows.shape[0]
    scale = _robust_std(fit.residual, full) if robust else float(np.sqrt(fit.rss(full) / max(1, samples.n - full)))
    # errors that the curve reproduces to rounding have no scale of their own
    scale = max(scale, 1e-13 * float(np.abs(samples.error).max()), 1e-300)
    pseudo = fit.huber(full, scale) if robust else samples.error
    if samples.coverage.has_gap:
        # with a prior half as many parameters as rows are not too many
        used = _order_allowed(samples, largest_order, 2)
        rows = _with_rate(fourier_rows(samples.theta_rad, used), samples, rate)
        bridge = bridged(rows, samples.error, extra, (fit.residual, scale) if robust else None)
        solution, covariance, spent = bridge.parameters, bridge.covariance, bridge.determined
    else:
        used = fit.order_by_bic(pseudo, order, extra)
        count = 2 * used + 1 + extra
        if robust:
            fit.huber(count, scale)
        else:
            fit.least_squares(count)
        solution, covariance, spent = fit.beta, fit.covariance(count, scale if robust else np.inf), float(count)
    count = solution.size
    residual = samples.error - combined(solution, rows[:count])
    bound = HUBER * scale if robust else np.inf
    psi = np.clip(residual, -bound, bound)
    noise = _robust_std(residual, spent) if robust else float(np.sqrt(residual @ residual / max(1, samples.n - spent)))
    held_down = float(np.mean(np.abs(residual) > 4.0 * scale)) if robust else 0.0
    at_limit = used == order < largest_order and not samples.coverage.has_gap
    remarks += _remarks(samples, held_down, used if at_limit else None)
    weight = float(np.mean(np.where(residual == 0.0, 1.0, psi / np.where(residual == 0.0, 1.0, residual))))
    places = np.concatenate([[0], np.arange(1 + extra, count), np.arange(1, 1 + extra)]).astype(int)
    return ErrorCurve(
        CurveMethod.AUTO,
        CurveForm.FOURIER,
        used,
        solution[places],
        covariance[np.ix_(places, places)],
        noise,
        samples.coverage,
        rate,
        robust_weight=weight,
        remarks=tuple(remarks),
    )


def _remarks(samples: Samples, held_down: float, at_limit: int | None) -> list[str]:
    """Of a curve: rows held down as outliers, what was not covered, and the order, where it is `at_limit`."""
    remarks = []
    if held_down > 0.01:
        remarks.append(f"{100 * held_down:.1f} % of the rows lie more than four standard deviations off: held down")
    if samples.coverage.warning:
        remarks.append(samples.coverage.warning)
    if at_limit is not None:
        remarks.append(
            f"the highest order that these rows can carry ({at_limit}) was taken: finer structure may be left; more"
            " rows over more of the turn would show it"
        )
    return remarks


def _with_rate(rows: Array, samples: Samples, rate: RateTerms | None) -> Array:
    """The rate's columns stand behind the constant, so that the harmonics stay nested."""
    if rate is None:
        return rows
    return np.vstack([rows[:1], rate.rows(np.asarray(samples.rate_radps)), rows[1:]])


def _order_allowed(samples: Samples, largest: int, rows_a_parameter: int) -> int:
    """At most `largest`, so many rows a parameter, and half of the sectors that hold rows: of five degrees, or finer
    ones where higher orders are asked for."""
    fine = 2 * max(largest, BEYOND_ORDER) + 2
    sectors = np.unique((wrap_positive(samples.theta_rad) * (fine / TURN)).astype(np.int64)).size
    order = min(largest, (samples.n // rows_a_parameter - 1) // 2, (sectors - 1) // 2)
    if order < 1:
        raise Refused("the rotor stood at too few different angles for a curve over the turn")
    return order


def _robust_std(residual: Array, parameters: float) -> float:
    """Normal-consistent median absolute residual, widened for the parameters already spent."""
    n = residual.size
    middle = np.abs(residual)
    middle.partition(n // 2)
    return float(_MAD_TO_STD * middle[n // 2] * np.sqrt(n / max(1, n - parameters)))


class _Fit:
    """Nested least squares on rows (P, N) from one QR; `beta` is the estimate made last, `residual` what it leaves."""

    def __init__(self, rows: Array, y: Array) -> None:
        self.rows, self.y = rows, y
        p = rows.shape[0]
        triangle = triangle_of(rows, y)
        self.R, self.z = triangle[:p, :p], triangle[:p, p]
        if np.abs(np.diag(self.R)).min() < 1e-9 * np.abs(self.R[0, 0]):
            raise Refused("the rotor stood at too few different angles for a curve over the turn")
        self._rest = float(triangle[p, p] ** 2)
        self.beta = self._solve(self.z)
        self.residual = y - combined(self.beta, rows)

    def rss(self, count: int) -> float:
        """Residual sum of squares of the first `count` columns."""
        return self._rest + float(self.z[count:] @ self.z[count:])

    def _solve(self, z: Array) -> Array:
        return np.asarray(solve_triangular(self.R[: z.size, : z.size], z, check_finite=False))

    def project(self, values: Array, count: int) -> Array:
        """z = Q' values for the first `count` columns, by R'z = F' values."""
        R = self.R[:count, :count]
        return np.asarray(solve_triangular(R, projected(self.rows[:count], values), trans="T", check_finite=False))

    def least_squares(self, count: int) -> None:
        """The ordinary estimate of the first `count` columns."""
        self.beta = self._solve(self.z[:count])
        self.residual = self.y - combined(self.beta, self.rows[:count])

    def huber(self, count: int, scale: float) -> Array:
        """Huber's estimate of the first `count` columns; gives the pseudo-values (N,)."""
        rows, bound = self.rows[:count], HUBER * scale
        self.beta = self._solve(self.z[:count]) if self.beta.size != count else self.beta
        # the triangle says how far a parameter moves a row: the step's size in rows is |R step| / sqrt(n)
        R = self.R[:count, :count]
        psi = self.y
        for _ in range(_ROUNDS):
            self.residual = self.y - combined(self.beta, rows)
            psi = np.clip(self.residual, -bound, bound)
            step = self._solve(self.project(psi, count))
            self.beta = self.beta + step
            if np.linalg.norm(R @ step) <= _CONVERGED * scale * np.sqrt(self.y.size):
                break
        fitted = combined(self.beta, rows)
        self.residual = self.y - fitted
        return np.asarray(fitted + np.clip(self.residual, -bound, bound))

    def order_by_bic(self, values: Array, largest: int, extra: int) -> int:
        """The order with the least n ln(RSS / n) + p ln n, for the (pulled in) values."""
        n = values.size
        z = self.project(values, 2 * largest + 1 + extra)
        total = float(values @ values)
        counts = 2 * np.arange(0, largest + 1) + 1 + extra
        # below rounding of the sums no order is better than another
        floor = max(1e-15 * total, 1e-300)
        rss = np.maximum(total - np.cumsum(z * z)[counts - 1], floor)
        return int(np.argmin(n * np.log(rss / n) + counts * np.log(n)))

    def covariance(self, count: int, scale: float) -> Array:
        """Asymptotic covariance of Huber's estimate: mean psi^2 / (mean psi')^2 (F'F)^-1."""
        bound = HUBER * scale
        inside = np.abs(self.residual) <= bound
        psi = np.clip(self.residual, -bound, bound)
        factor = float(psi @ psi) / max(1, psi.size - count) / max(float(np.mean(inside)), 0.1) ** 2
        inverse = np.linalg.inv(self.R[:count, :count])
        return np.asarray(factor * (inverse @ inverse.T))

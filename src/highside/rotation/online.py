"""A Fourier curve that follows a drifting error, one row at a time: recursive least squares with forgetting.

What was learnt is forgotten with the *way of the rotor*, not with time: the weight of a row falls to 1/e after
`memory_turns`. A rotor that stands still therefore forgets nothing. A rotor that swings in a sector would forget the
rest of the turn and its covariance would grow without end (wind-up); forgetting therefore stops while the curve is as
uncertain as a single row (trace of the covariance in units of a row's variance: 1). A memory of a sixth of a turn
follows a fast drift, one turn or more averages better.
"""

from __future__ import annotations

import math

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.rotation.curve import CurveForm, CurveMethod, ErrorCurve
from highside.rotation.samples import AngleCoverage

LEAST_MEMORY_TURNS = 1.0 / 6.0
MOST_UNCERTAIN = 1.0
"""trace of the covariance, in units of a row's variance, above which nothing is forgotten"""


class OnlineFit:
    """Feed `update` in time order; `predict` and `curve` give the present state.

    `noise` is the standard deviation of one row, `amplitude` the size of a first harmonic that would not surprise (the
    k-th: amplitude / k^2), both in the unit of the errors. Raises InputError for numbers that cannot be these.
    """

    def __init__(self, *, noise: float, amplitude: float, order: int = 4, memory_turns: float = 1.0) -> None:
        if not (noise > 0.0 and amplitude > 0.0):
            raise InputError("noise and amplitude must be more than 0")
        if not 1 <= order <= 12:
            raise InputError(f"order {order}", remedy="1 to 12")
        if memory_turns < LEAST_MEMORY_TURNS * (1 - 1e-9):
            raise InputError(f"a memory of {memory_turns:g} turns cannot hold the turn", remedy="1/6 or more")
        self.order, self.noise = order, noise
        self._decay_per_rad = 1.0 / (memory_turns * 2.0 * math.pi)
        harmonic = np.repeat(np.arange(1, order + 1), 2)
        prior = np.concatenate([[amplitude], amplitude / harmonic**2])
        p = prior.size
        # covariance in units of the row's variance, times `_factor`, and the parameters as a last row: one product with
        # a row's sines and cosines gives the gain's direction and the prediction
        self._state: Array = np.vstack([np.diag((prior / noise) ** 2), np.zeros(p)])
        self._factor = 1.0
        self._trace = float(np.trace(self._state))
        self._phi: Array = np.ones(p)
        self._product: Array = np.empty(p + 1)
        self._direction = self._product[:p]
        self._column = self._product[:, None]
        self._outer: Array = np.empty_like(self._state)
        self._theta: float | None = None
        self._first_theta = 0.0
        self._travel = 0.0
        self._rows = 0

    @property
    def covariance_trace(self) -> float:
        """Sum of the variances of the parameters, in units of a row's variance."""
        return self._trace

    def update(self, theta_rad: float, error: float) -> float:
        """Take one row in; gives the error left by what was known before. A row that is not finite gives NaN."""
        if not (math.isfinite(theta_rad) and math.isfinite(error)):
            return math.nan
        phi = self._fill(theta_rad)
        forget = 1.0
        if self._theta is not None:
            way = abs(math.remainder(theta_rad - self._theta, 2.0 * math.pi))
            self._travel += way
            if self._trace < MOST_UNCERTAIN:
                # never so much that the bound is passed
                forget = max(math.exp(-way * self._decay_per_rad), self._trace / MOST_UNCERTAIN)
        self._theta = theta_rad
        self._rows += 1
        factor, direction, product = self._factor, self._direction, self._product
        np.dot(self._state, phi, out=product)
        # P phi = factor * direction
        gain = factor / (forget + factor * float(phi.dot(direction)))
        left = error - float(product[-1])
        spent = gain * factor * float(direction.dot(direction))
        # P <- (P - factor gain d d') / forget by its factor alone, parameters <- parameters + gain left d
        product[-1] = -left
        np.multiply(self._column, gain * direction, out=self._outer)
        self._state -= self._outer
        trace = self._trace - spent
        if forget != 1.0:
            self._factor = factor / forget
            trace /= forget
        self._trace = trace
        if not self._rows % 1024 or self._factor > 1e9:
            self._tidy()
        return left

    def _tidy(self) -> None:
        """The factor back to 1, the trace afresh: it loses a digit now and then."""
        P = self._state[:-1]
        P *= self._factor
        self._factor = 1.0
        self._trace = float(np.trace(P))

    def predict(self, theta_rad: float) -> float:
        """The present curve at one angle."""
        return float(self._fill(theta_rad) @ self._state[-1])

    def curve(self) -> ErrorCurve:
        """The present state as a curve like those of the other methods."""
        coverage = AngleCoverage(
            self._rows,
            self._travel / (2.0 * math.pi),
            0.0 if self._travel > 2 * math.pi else max(0.0, 2 * math.pi - self._travel),
            (self._theta or 0.0) % (2 * math.pi),
        )
        return ErrorCurve(
            CurveMethod.ONLINE,
            CurveForm.FOURIER,
            self.order,
            self._state[-1].copy(),
            (self.noise**2 * self._factor) * self._state[:-1],
            self.noise,
            coverage,
        )

    def _fill(self, theta_rad: float) -> Array:
        s1, c1 = math.sin(theta_rad), math.cos(theta_rad)
        s, c = s1, c1
        values = [1.0, s, c]
        for _ in range(self.order - 1):
            s, c = s * c1 + c * s1, c * c1 - s * s1
            values += (s, c)
        self._phi[:] = values
        return self._phi

"""The result of every method: one curve of the error against the rotor angle, with what is known about it.

Whatever made it, a curve is parameters times a basis (`form`): a Fourier series, a Chebyshev polynomial of the wrapped
angle, or the network. All can be evaluated, differentiated by their parameters (so that the covariance gives a standard
deviation at every angle) and written as plain data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.rotation.bases import RateTerms, chebyshev_rows, combined, fourier_rows, fourier_sum, scaled_angle
from highside.rotation.network_output import forward, jacobian_rows
from highside.rotation.samples import AngleCoverage


class CurveMethod(StrEnum):
    """How a curve was made. The first four are the paper's."""

    SINE = "sine"
    HARMONICS2 = "harmonics2"
    POLYNOMIAL9 = "polynomial9"
    NETWORK = "network"
    AUTO = "auto"
    ONLINE = "online"


class CurveForm(StrEnum):
    """What the parameters multiply."""

    FOURIER = "fourier"
    CHEBYSHEV = "chebyshev"
    NETWORK = "network"


class NetworkInput(StrEnum):
    """What the network sees of the angle: t / pi - 1 as in the paper, or (sin t, cos t), which has no seam."""

    SCALED = "scaled"
    PERIODIC = "periodic"

    def rows(self, theta_rad: Array) -> Array:
        """(1, N) or (2, N)."""
        if self is NetworkInput.SCALED:
            return scaled_angle(theta_rad)[None, :]
        return np.stack([np.sin(theta_rad), np.cos(theta_rad)])


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Errors on whole turns that the fit did not use, over all folds."""

    turns: int
    rms: float
    worst: float


@dataclass(frozen=True, slots=True)
class ErrorCurve:
    """The error of one channel against the rotor angle, in the unit of the samples it was fitted to.

    `order` counts harmonics, the degree of the polynomial, or hidden units. `parameters` (P,) with `covariance` (P, P):
    Fourier (R0, a1, b1, a2, b2, ...) for sines and cosines; Chebyshev c0..c9; network (W1 row by row, b1, W2, b2) on
    standardised targets (`target_scale`, `target_centre`); rate terms behind them. `noise` is the standard deviation
    of one row about the curve, `robust_weight` the share of rows that were not held down as outliers.
    """

    method: CurveMethod
    form: CurveForm
    order: int
    parameters: Array
    covariance: Array
    noise: float
    coverage: AngleCoverage
    rate: RateTerms | None = None
    network_input: NetworkInput | None = None
    hidden_bias: bool = True
    target_centre: float = 0.0
    target_scale: float = 1.0
    robust_weight: float = 1.0
    held_out: CrossValidation | None = None
    remarks: tuple[str, ...] = ()

    def __call__(self, theta_rad: Array, rate_radps: Array | None = None) -> Array:
        """The curve at angles (N,) rad, not necessarily wrapped, and where it has rate terms at rates (N,) rad/s.

        Raises InputError if it has rate terms and no rate is given.
        """
        theta = np.asarray(theta_rad, dtype=float)
        angle_part = self.parameters[: self.parameters.size - self._rate_count]
        if self.form is CurveForm.FOURIER:
            value = fourier_sum(theta, angle_part)
        elif self.form is CurveForm.CHEBYSHEV:
            value = np.asarray(np.polynomial.chebyshev.chebval(scaled_angle(theta), angle_part), dtype=float)
        else:
            assert self.network_input is not None
            value = forward(angle_part, self.network_input.rows(theta), self.order, self.hidden_bias)
            value = self.target_centre + self.target_scale * value
        if self._rate_count:
            value = value + combined(self.parameters[angle_part.size :], self._rate_rows(rate_radps))
        return value

    def std(self, theta_rad: Array, rate_radps: Array | None = None) -> Array:
        """Standard deviation of the curve itself (without the noise of a row) at angles (N,) rad, by the covariance."""
        theta = np.asarray(theta_rad, dtype=float)
        if self.form is CurveForm.FOURIER:
            rows = fourier_rows(theta, self.order)
        elif self.form is CurveForm.CHEBYSHEV:
            rows = chebyshev_rows(theta, self.order)
        else:
            assert self.network_input is not None
            inputs = self.network_input.rows(theta)
            rows = self.target_scale * jacobian_rows(self.parameters, inputs, self.order, self.hidden_bias)
        if self._rate_count:
            rows = np.vstack([rows, self._rate_rows(rate_radps)])
        return np.asarray(np.sqrt(np.maximum(np.einsum("in,in->n", rows, self.covariance @ rows), 0.0)), dtype=float)

    @property
    def _rate_count(self) -> int:
        return 0 if self.rate is None else len(self.rate.powers)

    def _rate_rows(self, rate_radps: Array | None) -> Array:
        assert self.rate is not None
        if rate_radps is None:
            raise InputError("this compensation depends on the rotor rate", remedy="give rotor_rate_dps")
        return self.rate.rows(rate_radps)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, numbers exact."""
        return {
            "method": self.method.value,
            "form": self.form.value,
            "order": self.order,
            "parameters": self.parameters.tolist(),
            "covariance": self.covariance.tolist(),
            "noise": self.noise,
            "coverage": self.coverage.to_dict(),
            "rate": None
            if self.rate is None
            else {
                "centre_radps": self.rate.centre_radps,
                "spread_radps": self.rate.spread_radps,
                "powers": list(self.rate.powers),
            },
            "network": None
            if self.network_input is None
            else {
                "input": self.network_input.value,
                "hidden_bias": self.hidden_bias,
                "target_centre": self.target_centre,
                "target_scale": self.target_scale,
            },
            "robust_weight": self.robust_weight,
            "held_out": None
            if self.held_out is None
            else {"turns": self.held_out.turns, "rms": self.held_out.rms, "worst": self.held_out.worst},
            "remarks": list(self.remarks),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Raises KeyError, TypeError or ValueError for data that `to_dict` did not make."""
        rate, network, held_out = data["rate"], data["network"], data["held_out"]
        curve = cls(
            method=CurveMethod(data["method"]),
            form=CurveForm(data["form"]),
            order=int(data["order"]),
            parameters=np.array(data["parameters"], dtype=float),
            covariance=np.array(data["covariance"], dtype=float),
            noise=float(data["noise"]),
            coverage=AngleCoverage.from_dict(data["coverage"]),
            rate=None
            if rate is None
            else RateTerms(float(rate["centre_radps"]), float(rate["spread_radps"]), tuple(map(int, rate["powers"]))),
            network_input=None if network is None else NetworkInput(network["input"]),
            hidden_bias=True if network is None else bool(network["hidden_bias"]),
            target_centre=0.0 if network is None else float(network["target_centre"]),
            target_scale=1.0 if network is None else float(network["target_scale"]),
            robust_weight=float(data["robust_weight"]),
            held_out=None
            if held_out is None
            else CrossValidation(int(held_out["turns"]), float(held_out["rms"]), float(held_out["worst"])),
            remarks=tuple(map(str, data["remarks"])),
        )
        count = curve.parameters.size
        if curve.parameters.ndim != 1 or curve.covariance.shape != (count, count) or count != curve._expected_count():
            raise ValueError("parameters, covariance and order do not belong together")
        if (curve.form is CurveForm.NETWORK) != (curve.network_input is not None):
            raise ValueError("form and network do not belong together")
        return curve

    def _expected_count(self) -> int:
        if self.form is CurveForm.FOURIER:
            return 2 * self.order + 1 + self._rate_count
        if self.form is CurveForm.CHEBYSHEV:
            return self.order + 1 + self._rate_count
        inputs = 2 if self.network_input is NetworkInput.PERIODIC else 1
        return self.order * (inputs + 1 + int(self.hidden_bias)) + 1

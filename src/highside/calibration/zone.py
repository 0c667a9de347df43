"""One sensor model with the covariance of its parameters, and where it may be used.

The sensor is `m = A g + b` (equation 4 of the balance-correction paper), with optional quadratic, cubic and cross terms
and, where several temperatures were visited, A and b as polynomials in temperature. A *zone* is one such sensor model
with the range of inclination and temperature in which it may be used.

The error of a corrected vector is `-C (dA g + db + ...)`, C = A^-1: the second term of equation 6, taken with the
covariance of the parameters. In a balance zone the estimated matrix absorbs the offset, so that `dA` and `db` are
correlated in such a way that an error d common to the poses vanishes at the zone's own inclination Ic and comes back as
`d (1 - cos I / cos Ic)` away from it. The one covariance therefore says both how good a zone is and how it fails
outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from highside.arrays import Array
from highside.calibration.sensor import (
    MATRIX_NAMES,
    OFFSET_NAMES,
    UNITS,
    SensorModel,
    sensor_columns,
    sensor_of,
)
from highside.calibration.student import with_widening
from highside.errors import InputError

TILT_NAMES = ("tilt_x", "tilt_y")
"""Bench tilt in the plane of inclination and across it."""
BENCH_NAMES = ("bench_x", "bench_y")
"""The same tilt where a method takes it for zero: its covariance with the sensor's parameters says how far it moves
them, and hence what several zones of one session have in common."""
SHARED_NAMES = (*BENCH_NAMES, "offset_x", "offset_y", "offset_z")
"""All that is taken for known (zero) and moves every zone of a session, each by its own lever: the tilt of the bench,
and what is not known of the sensor's offset where a method does not observe it."""


@dataclass(frozen=True, slots=True)
class Parameters:
    """P named numbers with their covariance (P, P). Matrix elements have no unit; offsets and K are in g; tilts in rad.

    `student` (P, P): the widening of `covariance` where the variances behind it are themselves estimates; None where
    they are not (see `highside.calibration.student`).

    Names of the sensor: `A_xy` (row, column), `b_x`, `K2_x`, `K3_x`, `KX_x_yz` (channel x, product g_y g_z); with `@k`
    the coefficient of the k-th power of reduced temperature (`b_x@1`).
    """

    names: tuple[str, ...]
    values: Array
    covariance: Array
    student: Array | None = None

    def __post_init__(self) -> None:
        size = len(self.names)
        square = [self.covariance] if self.student is None else [self.covariance, self.student]
        if self.values.shape != (size,) or any(matrix.shape != (size, size) for matrix in square):
            raise InputError(f"{size} names, values {self.values.shape}, covariance {self.covariance.shape}")

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def get(self, name: str, default: float = 0.0) -> float:
        return float(self.values[self.names.index(name)]) if name in self.names else default

    def std(self, name: str) -> float:
        """Standard deviation of one parameter, widening included; 0 for one that is not estimated."""
        if name not in self.names:
            return 0.0
        i = self.names.index(name)
        variance = self.covariance[i, i] + (0.0 if self.student is None else self.student[i, i])
        return float(np.sqrt(max(variance, 0.0)))

    @property
    def estimated(self) -> int:
        """How many of them the poses determine: all but what was taken for known."""
        return sum(name not in SHARED_NAMES for name in self.names)

    def unit(self, name: str) -> str:
        return UNITS.get(name.partition("_")[0], "rad")

    def block(self, names: tuple[str, ...]) -> Array:
        """Values of `names`, zero where absent."""
        return np.array([self.get(name) for name in names])

    def to_dict(self) -> dict[str, Any]:
        out: dict[str, Any] = {
            "names": list(self.names),
            "units": [self.unit(name) for name in self.names],
            "values": self.values.tolist(),
            "covariance": self.covariance.tolist(),
        }
        return out if self.student is None else out | {"student": self.student.tolist()}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Parameters:
        student = data.get("student")
        return cls(
            tuple(data["names"]),
            np.array(data["values"], dtype=float),
            np.array(data["covariance"], dtype=float),
            None if student is None else np.array(student, dtype=float),
        )


@dataclass(frozen=True, slots=True)
class TemperatureRange:
    """Temperatures visited. Reduced temperature is `u = (T - ref_c) / scale_c`."""

    ref_c: float
    scale_c: float
    min_c: float
    max_c: float

    def reduced(self, temp_c: float) -> float:
        return (temp_c - self.ref_c) / self.scale_c

    def inside(self, temp_c: float) -> bool:
        return self.min_c <= temp_c <= self.max_c


@dataclass(frozen=True, slots=True)
class Zone:
    """One sensor model and where it holds.

    `inc_center_rad` is the inclination of a local correction (None for a global one); `inc_min_rad`, `inc_max_rad` the
    range in which it may be used. `parameters` hold the sensor's and, where estimated together, the bench's.
    `condition` is the condition number of the problem that gave them.
    """

    name: str
    inc_center_rad: float | None
    inc_min_rad: float
    inc_max_rad: float
    parameters: Parameters
    condition: float
    temperature: TemperatureRange | None = None

    @property
    def is_local(self) -> bool:
        return self.inc_center_rad is not None

    def holds_at(self, inc_rad: float) -> bool:
        return self.inc_min_rad <= inc_rad <= self.inc_max_rad

    def model(self, temp_c: float | None = None) -> SensorModel:
        """The sensor at a temperature. Outside of the range visited the polynomial goes on along its tangent at the
        edge, and `temperature_covariance` grows. Without polynomials, or without a temperature, that at the
        reference."""
        p = self.parameters

        def block(names: tuple[str, ...], shape: tuple[int, ...]) -> Array:
            values = p.block(names)
            for power, weight in self.temperature_weights(temp_c):
                values = values + weight * p.block(tuple(f"{name}@{power}" for name in names))
            return values.reshape(shape)

        return replace(sensor_of(p.names, p.values), A=block(MATRIX_NAMES, (3, 3)), b=block(OFFSET_NAMES, (3,)))

    def max_power(self) -> int:
        """Highest power of temperature among the parameters."""
        return max((int(name.partition("@")[2] or 0) for name in self.parameters.names), default=0)

    def temperature_weights(self, temp_c: float | None) -> list[tuple[int, float]]:
        powers = range(1, self.max_power() + 1)
        if self.temperature is None or temp_c is None or not powers:
            return []
        u, edge = self.temperature.reduced(temp_c), self.temperature.reduced(self._clamped(temp_c))
        return [(k, edge**k + k * edge ** (k - 1) * (u - edge)) for k in powers]

    def _clamped(self, temp_c: float) -> float:
        assert self.temperature is not None
        return min(max(temp_c, self.temperature.min_c), self.temperature.max_c)

    def design(self, g: Array, temp_c: float | None = None) -> Array:
        """Derivative (3, P, N) of a reading at gravity `g` (3, N) by the parameters; zero columns for the bench's."""
        out = sensor_columns(self.parameters.names, g).transpose(1, 0, 2)
        if self.max_power():
            weights = dict(self.temperature_weights(temp_c))
            powers = [name.partition("@")[2] for name in self.parameters.names]
            out = out * np.array([weights.get(int(power), 0.0) if power else 1.0 for power in powers])[:, None]
        return out

    def covariance_of(self, g: Array, temp_c: float | None = None) -> Array:
        """Covariance (3, 3) in g^2 of the corrected vector `g` (3,) by the errors of the calibration alone.

        For `g` (3, N): (N, 3, 3). Outside of the range of temperature the change beyond its edge is itself taken as one
        standard deviation."""
        wide = np.atleast_2d(np.asarray(g, dtype=float).T).T.reshape(3, -1)
        C = self.model(temp_c).C
        J = np.einsum("ij,jpn->nip", C, self.design(wide, temp_c))
        cov = self.stated_covariance(J, wide, temp_c)
        return np.asarray(cov[0] if np.ndim(g) == 1 else cov)

    def stated_covariance(self, J: Array, g: Array, temp_c: float | None, rest: Array | float = 0.0) -> Array:
        """Covariance (N, 3, 3) in g^2 of corrected vectors `g` (3, N) that `J` (N, 3, P) makes of the errors of the
        parameters, and of errors of their own with covariance `rest`: the reading's noise."""
        p, across = self.parameters, J.transpose(0, 2, 1)
        cov = J @ p.covariance @ across
        beyond = self._beyond_temperature(g, temp_c)
        if beyond is not None:
            cov = cov + np.einsum("in,jn->nij", beyond, beyond)
        return with_widening(cov, None if p.student is None else J @ p.student @ across, rest)

    def _beyond_temperature(self, g: Array, temp_c: float | None) -> Array | None:
        if self.temperature is None or temp_c is None or self.temperature.inside(temp_c) or not self.max_power():
            return None
        edge = self.model(self._clamped(temp_c))
        return np.asarray(edge.C @ (self.model(temp_c).forward(g) - edge.forward(g)))

    def outside_error(self, inc_rad: Array | float, common_g: float) -> Array:
        """Size (g) of what an error `common_g` common to the poses of a local zone leaves at inclination `inc_rad`:
        `d (1 - cos I / cos Ic)`. Zero for a global zone, which estimates the offset itself."""
        if self.inc_center_rad is None:
            return np.zeros_like(np.asarray(inc_rad, dtype=float))
        return np.asarray(common_g * np.abs(1.0 - np.cos(inc_rad) / np.cos(self.inc_center_rad)))

    def to_dict(self) -> dict[str, Any]:
        t = self.temperature
        return {
            "name": self.name,
            "inc_center_rad": self.inc_center_rad,
            "inc_min_rad": self.inc_min_rad,
            "inc_max_rad": self.inc_max_rad,
            "parameters": self.parameters.to_dict(),
            "condition": self.condition,
            "temperature": None
            if t is None
            else {"ref_c": t.ref_c, "scale_c": t.scale_c, "min_c": t.min_c, "max_c": t.max_c},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Zone:
        t = data.get("temperature")
        return cls(
            name=data["name"],
            inc_center_rad=data["inc_center_rad"],
            inc_min_rad=data["inc_min_rad"],
            inc_max_rad=data["inc_max_rad"],
            parameters=Parameters.from_dict(data["parameters"]),
            condition=data["condition"],
            temperature=None if t is None else TemperatureRange(**t),
        )

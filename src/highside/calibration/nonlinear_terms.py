"""Nonlinear terms of a sensor on the way back from reading to gravity, and their share of the covariance.

With the quadratic, cubic, cross-axis and structure terms N(g) the corrected vector solves `g = C (m - b) - C N(g)`, by
fixed-point iteration from the linear answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.correction import Covariance, Vector
from highside.calibration.sensor import (
    CROSS_PAIRS,
    SensorModel,
    sensor_columns,
)
from highside.calibration.student import UPPER


@dataclass(frozen=True, slots=True)
class PolynomialTerms:
    """The quadratic, cubic and cross terms already multiplied by C, (3, 3) each: own squares, own cubes, products."""

    floats: tuple[tuple[float, float, float, float, float, float, float, float, float], ...]
    """the same as plain floats, row by row"""
    squares: Array
    cubes: Array
    products: Array
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    monomials: NDArray[np.intp]
    C: Array
    covariances: Array
    """(1, P, P), or (2, P, P) with its widening"""

    def of(self, x: float, y: float, z: float) -> Vector:
        """The terms at one vector."""
        x2, y2, z2, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        x3, y3, z3 = x2 * x, y2 * y, z2 * z
        u, v, w = [
            s0 * x2 + s1 * y2 + s2 * z2 + c0 * x3 + c1 * y3 + c2 * z3 + p0 * xy + p1 * xz + p2 * yz
            for s0, s1, s2, c0, c1, c2, p0, p1, p2 in self.floats
        ]
        return u, v, w

    def of_block(self, g: Array) -> Array:
        products = np.stack([g[j] * g[k] for j, k in CROSS_PAIRS])
        squares = g * g
        return np.asarray(self.squares @ squares + self.cubes @ (squares * g) + self.products @ products)

    def covariances_at(self, x: float, y: float, z: float) -> list[Covariance]:
        """Covariance of the corrected vector by all parameters of the sensor, and its widening if there is one."""
        x2, y2, z2 = x * x, y * y, z * z
        values = np.array((x, y, z, 1.0, x2, y2, z2, x2 * x, y2 * y, z2 * z, x * y, x * z, y * z))
        D = np.zeros((3, self.covariances.shape[1]))
        D[self.rows, self.columns] = values[self.monomials]
        J = self.C @ D
        both = (J @ self.covariances @ J.T).tolist()
        return [(m[0][0], m[0][1], m[0][2], m[1][1], m[1][2], m[2][2]) for m in both]

    def covariances_block(self, g: Array) -> Array:
        """`covariances_at` of vectors (3, N), as (K, 6, N)."""
        x, y, z = g
        one = np.ones_like(x)
        values = np.stack([x, y, z, one, x * x, y * y, z * z, x**3, y**3, z**3, x * y, x * z, y * z])
        D = np.zeros((g.shape[1], 3, self.covariances.shape[1]))
        D[:, self.rows, self.columns] = values[self.monomials].T
        J = self.C @ D
        return np.stack([upper_elements((J @ covariance) @ J.transpose(0, 2, 1)) for covariance in self.covariances])


@dataclass(frozen=True, slots=True)
class StructureTerms:
    """As `PolynomialTerms`, for a sensor with structure: hundreds of small terms, taken from the effects themselves. A
    reading costs about half a millisecond."""

    model: SensorModel
    C: Array
    names: tuple[str, ...]
    covariances: Array
    """(1, P, P), or (2, P, P) with its widening"""

    def of(self, x: float, y: float, z: float) -> Vector:
        """The terms at one vector."""
        u, v, w = self.of_block(np.array([[x], [y], [z]]))[:, 0].tolist()
        return u, v, w

    def of_block(self, g: Array) -> Array:
        return np.asarray(self.C @ self.model.nonlinear(g))

    def covariances_at(self, x: float, y: float, z: float) -> list[Covariance]:
        """Covariance of the corrected vector by all parameters of the sensor, and its widening if there is one."""
        both = self.covariances_block(np.array([[x], [y], [z]]))[:, :, 0].tolist()
        return [(xx, xy, xz, yy, yz, zz) for xx, xy, xz, yy, yz, zz in both]

    def covariances_block(self, g: Array) -> Array:
        """`covariances_at` of vectors (3, N), as (K, 6, N)."""
        out = np.empty((len(self.covariances), 6, g.shape[1]))
        for at in range(0, g.shape[1], _STRUCTURED_PIECE):
            J = (self.C @ sensor_columns(self.names, g[:, at : at + _STRUCTURED_PIECE])).transpose(2, 1, 0)
            for k, covariance in enumerate(self.covariances):
                out[k, :, at : at + _STRUCTURED_PIECE] = upper_elements((J @ covariance) @ J.transpose(0, 2, 1))
        return out


def upper_elements(matrices: Array) -> Array:
    """The six elements (6, N) of covariances (N, 3, 3)."""
    return np.stack([matrices[:, i, j] for i, j in UPPER])


_STRUCTURED_PIECE = 1024
"""Readings whose derivatives by some hundreds of parameters are held at a time."""

_MONOMIALS = ("x", "y", "z", "1", "xx", "yy", "zz", "xxx", "yyy", "zzz", "xy", "xz", "yz")


def _monomial(base: str) -> tuple[int, int]:
    """Channel and monomial of a parameter's name (without its power of temperature)."""
    kind, _, index = base.partition("_")
    key = {"A": index[1:2], "b": "1", "K2": index[:1] * 2, "K3": index[:1] * 3, "KX": index[2:]}[kind]
    return "xyz".index(index[0]), _MONOMIALS.index(key)


PASSES = 6
"""Passes over nonlinear terms of a few mg; each gains a factor of a hundred."""


def inverted(nonlinear: PolynomialTerms | StructureTerms, x0: float, y0: float, z0: float) -> Vector:
    x, y, z = x0, y0, z0
    for _ in range(PASSES):
        dx, dy, dz = nonlinear.of(x, y, z)
        x, y, z = x0 - dx, y0 - dy, z0 - dz
    return x, y, z


def nonlinear_terms(
    model: SensorModel, C: Array, bases: tuple[str, ...], covariances: Array
) -> PolynomialTerms | StructureTerms:
    if model.S.any() or model.H.any():
        return StructureTerms(model, C, bases, covariances)
    places = [_monomial(base) for base in bases]
    squares, cubes, products = C * model.K2[None, :], C * model.K3[None, :], C @ model.KX
    return PolynomialTerms(
        floats=tuple(tuple(row) for row in np.hstack([squares, cubes, products]).tolist()),
        squares=squares,
        cubes=cubes,
        products=products,
        rows=np.array([row for row, _ in places], dtype=np.intp),
        columns=np.arange(len(places), dtype=np.intp),
        monomials=np.array([monomial for _, monomial in places], dtype=np.intp),
        C=C,
        covariances=covariances,
    )

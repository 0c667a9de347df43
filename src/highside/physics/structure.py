"""Structure that no single effect of the library describes: smooth unknown functions with a finite number of terms.

Two kinds, both Gaussian processes cut off at a finite basis, so that a calibration may estimate their coefficients like
any other parameters, each with a prior variance that the size and the length of the structure give it:

- `OwnLoad`: what the characteristic of each sensor does beyond a line, a function of its own load f_i alone. Sines on
  an interval wider than the loads; the squared-exponential covariance of length l has prior variances by its spectral
  density at the sines' frequencies (Solin and Saerkkae, Statistics and Computing 30, 2020, 419).
- `Direction`: anything else that follows the attitude, one field over the sphere for each channel. Real spherical
  harmonics of degree 2 and more (degree 0 is an offset, degree 1 the matrix), as polynomials in f; prior variances fall
  with degree n as exp(-n (n + 1) l^2 / 2), the heat kernel of length l (rad).

These are no effects of the library: nothing in physics names them, and the evidence must require them.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from highside.arrays import AnyArray
from highside.physics.effect import AXES, LinearEffect, Parameter, Stage, on_own_axis
from highside.physics.state import ChainState

WAVES = 20
"""Sines a channel: structure down to a length of about 0.13 g."""
HALF_WIDTH_G = 1.3
"""The sines vanish here; near it the functions would be drawn to zero."""
MAX_DEGREE = 6
HARMONICS = (MAX_DEGREE + 1) ** 2 - 4
"""Harmonics a channel: structure down to about 0.4 rad."""

_FREQUENCIES = math.pi * np.arange(1, WAVES + 1) / (2.0 * HALF_WIDTH_G)


class OwnLoad(LinearEffect):
    """Coefficients (3 WAVES,), channel by channel."""

    id = "own_load_structure"
    title = "Structure of the characteristic"
    stage = Stage.SENSOR
    formula = "sum over k of s_ik sin(pi k (f_i + 1.3) / 2.6) on axis i"
    story = "The characteristic of each sensor has bends and ripples that neither a square nor a cube describes."
    parameters = tuple(Parameter(f"s_{axis}_{k + 1}", "g", 1e-4, (-0.02, 0.02)) for axis in AXES for k in range(WAVES))

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        waves = np.sin(_FREQUENCIES[:, None, None] * (x + HALF_WIDTH_G)) / math.sqrt(HALF_WIDTH_G)
        out = np.zeros((3, WAVES, *x.shape), dtype=waves.dtype)
        for axis in range(3):
            out[axis, :, axis] = waves[:, axis]
        return out.reshape(3 * WAVES, *x.shape)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        waves = np.sin(_FREQUENCIES * (x[:, :, None] + HALF_WIDTH_G)) / math.sqrt(HALF_WIDTH_G)
        return np.asarray((waves @ p.reshape(3, WAVES, 1))[:, :, 0])

    def input_jacobian(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        slopes = np.cos(_FREQUENCIES * (x[:, :, None] + HALF_WIDTH_G)) * _FREQUENCIES / math.sqrt(HALF_WIDTH_G)
        return on_own_axis((slopes @ p.reshape(3, WAVES, 1))[:, :, 0])

    @staticmethod
    def prior_variances(size_g: float, length_g: float) -> AnyArray:
        """(WAVES,) of a function with standard deviation `size_g` that bends over `length_g`."""
        density = math.sqrt(2.0 * math.pi) * length_g * np.exp(-0.5 * (length_g * _FREQUENCIES) ** 2)
        return np.asarray(size_g**2 * density)


class Direction(LinearEffect):
    """Coefficients (3 HARMONICS,), channel by channel."""

    id = "direction_structure"
    title = "Structure over direction"
    stage = Stage.SENSOR
    formula = "sum over harmonics of h_ij Y_j(f) on axis i, degrees 2 to 6"
    story = "The reading departs from a matrix in a way that follows the attitude smoothly, whatever the cause."
    parameters = tuple(
        Parameter(f"h_{axis}_{j + 1}", "g", 1e-4, (-0.02, 0.02)) for axis in AXES for j in range(HARMONICS)
    )

    def basis(self, state: ChainState, x: AnyArray) -> AnyArray:
        fields = harmonics(x)
        out = np.zeros((3, HARMONICS, *x.shape), dtype=fields.dtype)
        for axis in range(3):
            out[axis, :, axis] = fields
        return out.reshape(3 * HARMONICS, *x.shape)

    def delta(self, state: ChainState, p: AnyArray, x: AnyArray) -> AnyArray:
        return np.asarray(p.reshape(3, HARMONICS) @ harmonics(x))

    @staticmethod
    def prior_variances(size_g: float, length_rad: float) -> AnyArray:
        """(HARMONICS,) of a field with standard deviation `size_g` that bends over `length_rad`."""
        falling = np.exp(-0.5 * _DEGREES * (_DEGREES + 1.0) * length_rad**2)
        return np.asarray(size_g**2 * falling / falling.sum())


def harmonics(x: AnyArray) -> AnyArray:
    """Real spherical harmonics (HARMONICS, N) of mean square one, degrees 2 to 6, at directions (3, N).

    They are written as polynomials in x, y, z (associated Legendre functions by their recursion in degree), analytic
    off the sphere too, where a reading lies by its errors.
    """
    cosine, sine = [np.ones_like(x[0])], [np.zeros_like(x[0])]
    for _ in range(MAX_DEGREE):
        cosine, sine = (
            [*cosine, cosine[-1] * x[0] - sine[-1] * x[1]],
            [*sine, sine[-1] * x[0] + cosine[-1] * x[1]],
        )
    out = np.empty((HARMONICS, x.shape[1]), dtype=x.dtype)
    legendre = _legendre(x[2])
    place = 0
    for degree in range(2, MAX_DEGREE + 1):
        for order in range(degree + 1):
            scaled = _norm(degree, order) * legendre[degree, order]
            out[place] = scaled * cosine[order]
            place += 1
            if order:
                out[place] = scaled * sine[order]
                place += 1
    return out


def _legendre(z: AnyArray) -> dict[tuple[int, int], AnyArray]:
    """Associated Legendre functions by (degree, order), divided by sin^order."""
    out: dict[tuple[int, int], AnyArray] = {}
    for order in range(MAX_DEGREE + 1):
        out[order, order] = np.full_like(z, float(math.prod(range(1, 2 * order, 2))))
        if order < MAX_DEGREE:
            out[order + 1, order] = (2 * order + 1) * z * out[order, order]
        for n in range(order + 2, MAX_DEGREE + 1):
            out[n, order] = ((2 * n - 1) * z * out[n - 1, order] - (n + order - 1) * out[n - 2, order]) / (n - order)
    return out


@cache
def _norm(degree: int, order: int) -> float:
    share = math.factorial(degree - order) / math.factorial(degree + order)
    return math.sqrt((2 * degree + 1) * share * (2.0 if order else 1.0))


_DEGREES = np.array([n for n in range(2, MAX_DEGREE + 1) for _ in range(2 * n + 1)], dtype=float)

OWN_LOAD = OwnLoad()
DIRECTION = Direction()

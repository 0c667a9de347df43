"""The sensor as a calibration writes it: names of its parameters, and the effects of the physics behind each name.

A record says `A_xy`, `b_x`, `K2_x`, ...; the physics has effects (`scale`, `misalignment`, `bias`, `quadratic`, ...)
whose parameters are those numbers, the diagonal of A counted from one. Nothing here knows a formula of its own:
readings and derivatives come from the effects. With `@k` a name stands for the coefficient of the k-th power of
reduced temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache

import numpy as np

from highside.arrays import Array
from highside.errors import InputError
from highside.physics import effects as library
from highside.physics import structure
from highside.physics.effect import AXES, LinearEffect
from highside.physics.state import ChainState

MATRIX_NAMES = tuple(f"A_{i}{j}" for i in AXES for j in AXES)
OFFSET_NAMES = tuple(f"b_{i}" for i in AXES)
QUADRATIC_NAMES = tuple(f"K2_{i}" for i in AXES)
CUBIC_NAMES = tuple(f"K3_{i}" for i in AXES)
CROSS_PAIRS = ((0, 1), (0, 2), (1, 2))
CROSS_NAMES = tuple(f"KX_{i}_{AXES[j]}{AXES[k]}" for i in AXES for j, k in CROSS_PAIRS)
OWN_LOAD_NAMES = tuple(f"S_{i}_{k + 1}" for i in AXES for k in range(structure.WAVES))
"""Coefficients of `physics.structure.OwnLoad`, in g."""
DIRECTION_NAMES = tuple(f"H_{i}_{k + 1}" for i in AXES for k in range(structure.HARMONICS))
"""Coefficients of `physics.structure.Direction`, in g."""

UNITS = {"A": "1", "b": "g", "K2": "1/g", "K3": "1/g^2", "KX": "1/g", "K": "1/g", "S": "g", "H": "g", "offset": "g"}
"""Units by the head of a name; all others are angles."""

_DIAGONAL = ("A_xx", "A_yy", "A_zz")


def effect_parameter(name: str) -> tuple[LinearEffect, int]:
    """The effect of the sensor, and the place among its parameters, behind a parameter's name without its power of
    temperature. Raises InputError for a name that is not the sensor's."""
    found = _effect_parameters().get(name)
    if found is None:
        raise InputError(f"{name} is not a parameter of the sensor")
    return found


@cache
def _effect_parameters() -> dict[str, tuple[LinearEffect, int]]:
    def of(effect: object, names: Sequence[str], parameters: Sequence[str]) -> dict[str, tuple[LinearEffect, int]]:
        assert isinstance(effect, LinearEffect)
        known = [parameter.name for parameter in effect.parameters]
        return {name: (effect, known.index(parameter)) for name, parameter in zip(names, parameters, strict=True)}

    turning = [name for name in MATRIX_NAMES if name not in _DIAGONAL]
    return (
        of(library.get("scale"), _DIAGONAL, [f"s_{i}" for i in AXES])
        | of(library.get("misalignment"), turning, [f"m_{name[2:]}" for name in turning])
        | of(library.get("bias"), OFFSET_NAMES, OFFSET_NAMES)
        | of(library.get("quadratic"), QUADRATIC_NAMES, [f"k2_{i}" for i in AXES])
        | of(library.get("cubic"), CUBIC_NAMES, [f"k3_{i}" for i in AXES])
        | of(library.get("cross_product"), CROSS_NAMES, [name.replace("KX", "k") for name in CROSS_NAMES])
        | of(structure.OWN_LOAD, OWN_LOAD_NAMES, [p.name for p in structure.OWN_LOAD.parameters])
        | of(structure.DIRECTION, DIRECTION_NAMES, [p.name for p in structure.DIRECTION.parameters])
    )


def nominal(names: Sequence[str]) -> Array:
    """Values (P,) of the sensor that reads what it feels: the effects are nothing there."""
    return np.array([1.0 if name in _DIAGONAL else 0.0 for name in names])


def is_sensor_parameter(name: str) -> bool:
    """Whether `name` belongs to the sensor (else to the bench)."""
    return name.partition("@")[0] in _effect_parameters()


@lru_cache(maxsize=256)
def _grouped(names: tuple[str, ...]) -> tuple[tuple[LinearEffect, tuple[int, ...], tuple[int, ...]], ...]:
    """For each effect behind the names (of the sensor, no powers): where in `names`, and which of its parameters."""
    groups: dict[str, tuple[LinearEffect, list[int], list[int]]] = {}
    for place, name in enumerate(names):
        if is_sensor_parameter(name):
            effect, index = effect_parameter(name.partition("@")[0])
            group = groups.setdefault(effect.id, (effect, [], []))
            group[1].append(place)
            group[2].append(index)
    return tuple((effect, tuple(places), tuple(indices)) for effect, places, indices in groups.values())


def sensor_columns(names: tuple[str, ...], g: Array) -> Array:
    """Derivatives (P, 3, N) of a reading at gravity `g` (3, N) by the parameters `names` of the sensor; zero for those
    of the bench. A coefficient of temperature counts as its parameter (the caller knows the temperature)."""
    out = np.zeros((len(names), 3, g.shape[1]))
    for effect, places, indices in _grouped(names):
        out[list(places)] = effect.basis(ChainState.nowhere(), g)[list(indices)]
    return out


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The sensor's forward model at one temperature: `m = A g + b + K2 g^2 + K3 g^3 + KX (g_j g_k) + structure`.

    `A` (3, 3), `b` (3,), `K2` and `K3` (3,): own-axis quadratic and cubic, `KX` (3, 3): channel by product
    (xy, xz, yz), `S` (3, WAVES) and `H` (3, HARMONICS): coefficients of the structures. All in units of g.
    """

    A: Array
    b: Array
    K2: Array = field(default_factory=lambda: np.zeros(3))
    K3: Array = field(default_factory=lambda: np.zeros(3))
    KX: Array = field(default_factory=lambda: np.zeros((3, 3)))
    S: Array = field(default_factory=lambda: np.zeros((3, structure.WAVES)))
    H: Array = field(default_factory=lambda: np.zeros((3, structure.HARMONICS)))

    @property
    def C(self) -> Array:  # noqa: N802 - the name of the matrix in the paper
        """Correction matrix, the inverse of A (equation 5)."""
        return np.asarray(np.linalg.inv(self.A), dtype=np.float64)

    @property
    def is_linear(self) -> bool:
        return not any(p.any() for p in (self.K2, self.K3, self.KX, self.S, self.H))

    def nonlinear(self, g: Array) -> Array:
        """All but the affine terms (3, ...) at true gravity `g` (3, ...)."""
        rows = g.reshape(3, -1)
        out = np.zeros_like(rows)
        for effect, p in (
            (library.get("quadratic"), self.K2),
            (library.get("cubic"), self.K3),
            (library.get("cross_product"), self.KX),
            (structure.OWN_LOAD, self.S),
            (structure.DIRECTION, self.H),
        ):
            if p.any():
                out += effect.delta(ChainState.nowhere(), p.ravel(), rows)
        return np.asarray(out.reshape(g.shape))

    def forward(self, g: Array) -> Array:
        """What the sensor reads (3, ...) where gravity in the tool frame is `g` (3, ...)."""
        wide = (slice(None),) + (None,) * (g.ndim - 1)
        linear = np.tensordot(self.A, g, axes=1) + self.b[wide]
        return linear if self.is_linear else linear + self.nonlinear(g)

    def correct(self, m: Array) -> Array:
        """Gravity in the tool frame (3, ...) from raw readings `m` (3, ...): equation 5, iterated over the small
        nonlinear terms (each pass gains a factor of about 100)."""
        wide = (slice(None),) + (None,) * (m.ndim - 1)
        C = self.C
        linear = np.tensordot(C, m - self.b[wide], axes=1)
        if self.is_linear:
            return linear
        g = linear
        for _ in range(8):
            after = linear - np.tensordot(C, self.nonlinear(g), axes=1)
            if np.all(np.abs(after - g) < 1e-13):
                return after
            g = after
        return g


def sensor_of(names: tuple[str, ...], theta: Array) -> SensorModel:
    """The sensor within a vector of parameters (P,)."""
    value = dict(zip(names, theta.tolist(), strict=True))

    def block(keys: tuple[str, ...]) -> Array:
        return np.array([value.get(key, 0.0) for key in keys]) if keys[0] in value else np.zeros(len(keys))

    whole = names[:12] == MATRIX_NAMES + OFFSET_NAMES
    return SensorModel(
        (theta[:9].copy() if whole else block(MATRIX_NAMES)).reshape(3, 3),
        theta[9:12].copy() if whole else block(OFFSET_NAMES),
        block(QUADRATIC_NAMES),
        block(CUBIC_NAMES),
        block(CROSS_NAMES).reshape(3, 3),
        block(OWN_LOAD_NAMES).reshape(3, -1),
        block(DIRECTION_NAMES).reshape(3, -1),
    )

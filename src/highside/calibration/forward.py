"""The forward model of a calibration session, linearised: what the joint estimator and the advice on poses share.

A session's unknowns are the sensor (A, b and, where admitted, K2, K3, KX) and the bench (tilt, harmonics of the
toolface encoder). A pose's own errors dI and dT are weights, not unknowns: `Variances` says how large they are.

The model is `physics.forward.ForwardModel` of the very effects that simulate and diagnose; this module only knows which
effect stands behind which name of a calibration, and what was known of each beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from highside.arrays import Array
from highside.calibration.linear_errors import BenchAccuracy
from highside.calibration.sensor import (
    CROSS_NAMES,
    CUBIC_NAMES,
    MATRIX_NAMES,
    OFFSET_NAMES,
    QUADRATIC_NAMES,
    effect_parameter,
    is_sensor_parameter,
    nominal,
)
from highside.calibration.zone import TILT_NAMES
from highside.physics import effects as library
from highside.physics import structure
from highside.physics.effect import Effect, LinearEffect, Modulated
from highside.physics.forward import ForwardModel
from highside.physics.state import ChainState

ENCODER_NAMES = ("enc_c1", "enc_s1", "enc_c2", "enc_s2")
"""Harmonics of the toolface encoder: `dT = c1 cos T + s1 sin T + c2 cos 2T + s2 sin 2T` (rad)."""

BASE_NAMES = MATRIX_NAMES + OFFSET_NAMES + TILT_NAMES
"""What every joint solution estimates."""

GROUPS: dict[str, tuple[str, ...]] = {
    "quadratic": QUADRATIC_NAMES,
    "cubic": CUBIC_NAMES,
    "cross": CROSS_NAMES,
    "encoder": ENCODER_NAMES,
}
"""What may be added, a group at a time."""

HYSTERESIS_NAMES = ("hyst_x", "hyst_y", "hyst_z")
"""Offset on the way up in temperature less that on the way down (g)."""

PRIOR_MATRIX = 0.05
PRIOR_OFFSET_G = 0.05
PRIOR_NONLINEAR_G = 1e-3
PRIOR_THERMAL_MATRIX = 0.01
"""Change of an element of A for each power of reduced temperature (-1 to 1 over the range visited)."""
PRIOR_THERMAL_OFFSET_G = 0.01
PRIOR_HYSTERESIS_G = 1e-3
PRIOR_ENCODER_RAD = float(np.deg2rad(0.01))


@dataclass(frozen=True, slots=True)
class Variances:
    """Variance components: of pose errors in rad^2, `reading` as a factor on the stated variance of the readings."""

    pose_inc: float
    pose_tf: float
    station_inc: float
    station_tf: float
    reading: float = 1.0

    def as_array(self) -> Array:
        return np.array([self.pose_inc, self.pose_tf, self.station_inc, self.station_tf, self.reading])


@dataclass(frozen=True, slots=True)
class StructureSize:
    """Size and length of the structures of `physics.structure`: standard deviations in g; g and rad."""

    own_g: float
    own_length_g: float
    field_g: float
    field_length_rad: float

    def variances(self) -> tuple[Array, Array]:
        """Prior variances of the coefficients of one channel: (WAVES,) and (HARMONICS,)."""
        own = structure.OwnLoad.prior_variances(self.own_g, self.own_length_g)
        return own, structure.Direction.prior_variances(self.field_g, self.field_length_rad)


def prior_mean(names: tuple[str, ...]) -> Array:
    """Prior means (P,): the nominal sensor on a level bench."""
    return nominal(names)


def prior_std(names: tuple[str, ...], bench: BenchAccuracy, size: StructureSize | None = None) -> Array:
    """Prior standard deviations (P,), wide against what a session tells; those of structure follow from its `size`."""
    widths = {
        "A": PRIOR_MATRIX,
        "b": PRIOR_OFFSET_G,
        "tilt": bench.tilt_rad,
        "enc": PRIOR_ENCODER_RAD,
        "hyst": PRIOR_HYSTERESIS_G,
    }
    thermal = {"A": PRIOR_THERMAL_MATRIX, "b": PRIOR_THERMAL_OFFSET_G}
    by_head = dict(zip("SH", (np.zeros(0), np.zeros(0)) if size is None else size.variances(), strict=True))

    def one(name: str) -> float:
        head, _, rest = name.partition("_")
        if head in by_head:
            return float(np.sqrt(by_head[head][int(rest.partition("_")[2]) - 1]))
        return (thermal if "@" in name else widths).get(head, PRIOR_NONLINEAR_G)

    return np.array([one(name) for name in names])


@dataclass(frozen=True, slots=True)
class _Term:
    """An effect of the model, its parameters among the names of a calibration, and what modulates it: nothing, a power
    of reduced temperature (1, 2, ...), or the leg of the oven's cycle (0)."""

    effect: Effect
    places: tuple[int, ...]
    """among the names"""
    indices: tuple[int, ...]
    """among the effect's parameters"""
    power: int | None


def _behind(name: str) -> tuple[Effect, int, int | None]:
    """Effect, parameter and modulation behind a name of a calibration."""
    base, _, power = name.partition("@")
    if is_sensor_parameter(base):
        effect, index = effect_parameter(base)
        return effect, index, int(power) if power else None
    if base in HYSTERESIS_NAMES:
        return library.get("bias"), HYSTERESIS_NAMES.index(base), 0
    if base in TILT_NAMES:
        return library.get("base_tilt"), TILT_NAMES.index(base), None
    order = ("first", "second")[int(base[-1]) - 1]
    encoder = library.get(f"encoder_{order}_harmonic")
    return encoder, [parameter.name for parameter in encoder.parameters].index(base[-2:]), None


@lru_cache(maxsize=64)
def _terms(names: tuple[str, ...]) -> tuple[_Term, ...]:
    groups: dict[tuple[str, int | None], tuple[Effect, list[int], list[int]]] = {}
    for place, name in enumerate(names):
        effect, index, power = _behind(name)
        group = groups.setdefault((effect.id, power), (effect, [], []))
        group[1].append(place)
        group[2].append(index)
    return tuple(
        _Term(effect, tuple(places), tuple(indices), power) for (_, power), (effect, places, indices) in groups.items()
    )


@lru_cache(maxsize=64)
def _order(names: tuple[str, ...]) -> tuple[int, ...]:
    """Where in the columns of the model, effect by effect, each name's column stands."""
    first, out = 0, [0] * len(names)
    for term in _terms(names):
        for place, index in zip(term.places, term.indices, strict=True):
            out[place] = first + index
        first += len(term.effect.parameters)
    return tuple(out)


def linearise(
    names: tuple[str, ...], theta: Array, state: ChainState, u: Array | None = None, leg: Array | None = None
) -> tuple[Array, Array, Array, Array]:
    """The forward model at `theta` for N poses: readings (3, N), their derivatives by the parameters (3, N, P), by
    inclination (3, N) and by toolface (3, N).

    `u` (N,): reduced temperature, `leg` (N,): +1 on the way up in temperature, -1 on the way down; needed only where
    `names` require them."""
    values = theta - prior_mean(names)
    pairs: list[tuple[Effect, Array]] = []
    for term in _terms(names):
        p = np.zeros(len(term.effect.parameters))
        p[list(term.indices)] = values[list(term.places)]
        effect = term.effect
        if term.power is not None:
            assert isinstance(effect, LinearEffect)
            known = leg if term.power == 0 else u
            factor = np.zeros(state.n) if known is None else 0.5 * known if term.power == 0 else known**term.power
            effect = Modulated(effect, factor)
        pairs.append((effect, p))
    found = ForwardModel(tuple(pairs)).linearise(state)
    design = found.columns.transpose(1, 2, 0)[:, :, _order(names)]
    return found.reported, design, found.by_pose[:, 0], found.by_pose[:, 2]


def pose_parts(noise: Array, by_inc: Array, by_tf: Array) -> Array:
    """What dI, dT and the reading noise make of the covariance of the N pose means, each at a variance of one:
    (3, N, 9)."""
    count = noise.shape[1]
    out = np.zeros((3, count, 9))
    for part, direction in zip(out, (by_inc, by_tf), strict=False):
        np.multiply(direction.T[:, :, None], direction.T[:, None, :], out=part.reshape(count, 3, 3))
    out[2, :, ::4] = (noise**2).T
    return out


def covariance_of_parts(parts: Array, variances: Variances) -> Array:
    """Covariance (N, 3, 3) of the pose means from `pose_parts`."""
    v = np.array([variances.pose_inc, variances.pose_tf, variances.reading])
    return np.asarray((v @ parts.reshape(3, -1)).reshape(-1, 3, 3))


def pose_covariance(noise: Array, by_inc: Array, by_tf: Array, variances: Variances) -> Array:
    """Covariance (N, 3, 3) of the pose means by reading noise and the pose parts of dI and dT."""
    return covariance_of_parts(pose_parts(noise, by_inc, by_tf), variances)


def whiten(columns: Array, parts: Array, variances: Variances) -> tuple[Array, float]:
    """`L^-1 columns` (N, 3, K), with `L L'` the covariance of each pose (`pose_parts`), and the sum of the logarithms
    of its determinants.
    """
    lower = np.linalg.cholesky(covariance_of_parts(parts, variances)).reshape(-1, 9)
    diagonal = lower[:, ::4]
    out = columns / diagonal[:, :, None]
    first, second, third = out[:, 0], out[:, 1], out[:, 2]
    below = lower[:, (3, 6, 7)] / diagonal[:, (1, 2, 2)]
    second -= below[:, :1] * first
    third -= below[:, 1:2] * first
    third -= below[:, 2:] * second
    return out, 2.0 * float(np.log(diagonal).sum())

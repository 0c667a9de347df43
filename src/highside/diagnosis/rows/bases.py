"""Functions of the covariates of a rotating recording: groups that locate a mismatch, and unnamed interactions.

A long recording is worked through in chunks of rows, so a group is a recipe: a function from a chunk to (k, n). What it
needs of the whole recording (means, spans) is settled when it is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from highside.arrays import Array
from highside.diagnosis.rows.policy import BASES
from highside.long_arrays import mean_and_std
from highside.physics.gravity import gravity_direction
from highside.physics.state import ChainState


@dataclass
class Rows:
    """A chunk of rows from row `first` on, with what many recipes share: harmonics of the toolface and the load."""

    state: ChainState
    first: int = 0
    begun: ChainState | None = None
    """the same rows with the recording's first before them, from which effects reckon time"""
    _harmonics: dict[int, tuple[Array, Array]] = field(default_factory=dict)
    _force: Array | None = None

    def harmonic(self, k: int) -> tuple[Array, Array]:
        """cos kT, sin kT, each (n,)."""
        if k not in self._harmonics:
            if k == 1:
                self._harmonics[1] = np.cos(self.state.tf_rad), np.sin(self.state.tf_rad)
            else:
                (c, s), (c1, s1) = self.harmonic(k - 1), self.harmonic(1)
                self._harmonics[k] = c * c1 - s * s1, s * c1 + c * s1
        return self._harmonics[k]

    def harmonics(self, first: int, last: int) -> list[Array]:
        """cos and sin of the harmonics from first to last."""
        return [part for k in range(first, last + 1) for part in self.harmonic(k)]

    @property
    def force(self) -> Array:
        """(3, n) nominal gravity in the tool frame."""
        if self._force is None:
            self._force = np.asarray(gravity_direction(self.state.inc_rad, self.state.tf_rad), dtype=float)
        return self._force


Recipe = Callable[[Rows], list[Array]]


@dataclass(frozen=True)
class BasisGroup:
    """Functions of a covariate: `make` gives (k,) arrays (n,) for a chunk. `slow` groups vary over seconds at least."""

    covariate: str
    along: Array
    """(N,) of the whole recording, in the units intervals are given in"""
    make: Recipe
    harmonics: tuple[int, ...] = ()
    slow: bool = False


def rotation_groups(state: ChainState) -> list[BasisGroup]:
    """Groups for the covariates that vary in a recording."""
    top = max(float(np.abs(state.rotor_rate_radps).max()), 1e-9)
    return [
        *_attitude_groups(state),
        *_rate_groups(state, top),
        *_acceleration_groups(state, top),
        *_vibration_groups(state),
        *_temperature_groups(state),
        *_time_groups(state),
    ]


def _attitude_groups(state: ChainState) -> list[BasisGroup]:
    found: list[BasisGroup] = []
    if float(np.ptp(state.tf_rad)) > 2 * np.pi:
        tf_deg = np.mod(np.degrees(state.tf_rad), 360.0)
        orders = tuple(range(1, BASES.harmonics + 1))
        found.append(BasisGroup("tf_ref_deg", tf_deg, lambda rows: rows.harmonics(1, BASES.harmonics), orders))
    inc_deg = np.degrees(state.inc_rad)
    if np.ptp(inc_deg) > BASES.inclined_deg:
        found.append(BasisGroup("inc_ref_deg", inc_deg, _of_inclination, slow=True))
        found.append(BasisGroup("gravity_direction", inc_deg, _monomials))
    return found


def _rate_groups(state: ChainState, top: float) -> list[BasisGroup]:
    """Of the rotor's rate in units of `top`, rad/s."""
    rate = state.rotor_rate_radps
    if not float(np.ptp(rate)) > BASES.rate_span * top:
        return []
    rate_dps = np.degrees(rate)

    def speed(rows: Rows) -> Array:
        return np.asarray(rows.state.rotor_rate_radps / top, dtype=float)

    def once(rows: Rows) -> list[Array]:
        return [f(speed(rows)) * part for f in (_same, np.square, np.abs, np.sign) for part in rows.harmonics(1, 1)]

    def twice(rows: Rows) -> list[Array]:
        return [f(speed(rows)) * part for f in (_same, np.square, np.sign) for part in rows.harmonics(2, 3)]

    return [
        BasisGroup("rotor_rate_dps", rate_dps, lambda rows: _powers(speed(rows)), slow=True),
        BasisGroup("rotor_rate_dps x tf_ref_deg", rate_dps, once),
        BasisGroup("rotor_rate_dps x 2 tf_ref_deg", rate_dps, twice),
    ]


def _acceleration_groups(state: ChainState, top: float) -> list[BasisGroup]:
    accel = state.rotor_accel_radps2
    if not np.ptp(accel) > BASES.ramps * top:
        return []
    most = float(np.abs(accel).max())

    def spin_up(rows: Rows) -> list[Array]:
        a = np.asarray(rows.state.rotor_accel_radps2 / most, dtype=float)
        return [a, *(a * part for part in rows.harmonics(1, 1))]

    return [BasisGroup("rotor_accel_dps2", np.degrees(accel), spin_up)]


def _vibration_groups(state: ChainState) -> list[BasisGroup]:
    vibration = state.vibration_rms_g
    if not np.ptp(vibration) > 0:
        return []
    largest = float(vibration.max())

    def shaken(rows: Rows) -> list[Array]:
        v = np.asarray(rows.state.vibration_rms_g / largest, dtype=float)
        return [v, v * v]

    def in_turn(rows: Rows) -> list[Array]:
        return [shaken(rows)[1] * part for part in rows.harmonics(1, 2)]

    return [
        BasisGroup("vibration_rms_g", vibration, shaken, slow=True),
        BasisGroup("vibration_rms_g x tf_ref_deg", vibration, in_turn),
    ]


def _temperature_groups(state: ChainState) -> list[BasisGroup]:
    if not np.ptp(state.temp_c) > BASES.warm_span_c:
        return []
    warm, along = _warmth(state), state.temp_c

    def linear(rows: Rows) -> list[Array]:
        return [warm(rows) * part for part in rows.harmonics(1, 4)]

    def squared(rows: Rows) -> list[Array]:
        return [warm(rows) ** 2 * part for part in rows.harmonics(1, 2)]

    return [
        BasisGroup("temp_c", along, lambda rows: _cubic(warm(rows)), slow=True),
        BasisGroup("temp_c x tf_ref_deg", along, linear),
        BasisGroup("temp_c^2 x tf_ref_deg", along, squared),
    ]


def _time_groups(state: ChainState) -> list[BasisGroup]:
    start, length = float(state.t_s[0]), max(float(np.ptp(state.t_s)), 1e-9)
    along = state.t_s

    def waves(rows: Rows) -> list[Array]:
        u = (rows.state.t_s - start) / length
        return [np.asarray(np.cos(np.pi * k * u)) for k in range(1, BASES.time_waves + 1)]

    def in_turn(rows: Rows) -> list[Array]:
        return [(2 * (rows.state.t_s - start) / length - 1) * part for part in rows.harmonics(1, 3)]

    return [BasisGroup("t_s", along, waves, slow=True), BasisGroup("t_s x tf_ref_deg", along, in_turn)]


@dataclass(frozen=True)
class InteractionGroup:
    """Unnamed products: labels and the functions (k,) of a chunk, each a column on one channel."""

    name: str
    labels: tuple[str, ...]
    make: Recipe
    off_axis: bool = False
    """only on channels other than the one the label names: the own axis is an effect of the library"""
    pairs: bool = False
    """two functions (a cosine and a sine) to each label, that stand together"""


def rotation_interactions(state: ChainState) -> list[InteractionGroup]:
    """Products of temperature, time and sense of rotation with powers of the load, as those of a pose session."""
    found: list[InteractionGroup] = []
    start, length = float(state.t_s[0]), max(float(np.ptp(state.t_s)), 1e-9)

    def time(rows: Rows) -> Array:
        return np.asarray((rows.state.t_s - start) / length)

    def times(covariate: Callable[[Rows], Array], terms: Recipe) -> Recipe:
        def make(rows: Rows) -> list[Array]:
            by = covariate(rows)
            return [by * term for term in terms(rows)]

        return make

    if float(np.ptp(state.tf_rad)) > 2 * np.pi:
        found += [
            InteractionGroup(f"toolface harmonic {k}", (f"{k} T",), _harmonic_pair(k), pairs=True)
            for k in range(2, BASES.harmonics + 1)
        ]
    # at one inclination z is a constant and a product with it nothing new; x^2 is half a constant. Harmonics are not
    terms = _AT_ONE_INCLINATION if np.ptp(np.degrees(state.inc_rad)) < BASES.inclined_deg else _AT_MANY_INCLINATIONS
    rate = state.rotor_rate_radps
    top = max(float(np.abs(rate).max()), 1e-9)
    if float(np.ptp(rate)) > BASES.rate_span * top:

        def speed(rows: Rows) -> Array:
            return np.asarray(rows.state.rotor_rate_radps / top, dtype=float)

        found += [InteractionGroup("rate", labels, times(speed, make)) for labels, make in terms[:2]]
        found.append(InteractionGroup("rate", RATE_POWERS, lambda rows: _rate_powers(speed(rows))))
    if np.ptp(state.temp_c) > BASES.warm_span_c:
        warm = _warmth(state)
        found.append(InteractionGroup("temperature", terms[0][0], times(warm, terms[0][1]), off_axis=True))
        found += [InteractionGroup("temperature", labels, times(warm, make)) for labels, make in terms[1:]]
        found.append(InteractionGroup("temperature^2", terms[0][0], times(lambda rows: warm(rows) ** 2, terms[0][1])))
    found += [InteractionGroup("time", labels, times(time, make)) for labels, make in terms[:2]]
    if np.ptp(state.direction) > 0:

        def sense(rows: Rows) -> Array:
            return np.asarray(rows.state.direction, dtype=float)

        found += [InteractionGroup("sense of rotation", labels, times(sense, make)) for labels, make in terms[:2]]
    return found


LINEAR = ("x", "y", "z")
SQUARE = ("x^2", "y^2", "z^2", "x y", "x z", "y z")
RATE_POWERS = ("|rate| rate", "|rate|^3", "rate^3", "rate^4")
CUBIC = ("x^3", "y^3", "z^3", "|x|", "|y|", "|z|", "x y z")


def _linear(rows: Rows) -> list[Array]:
    return list(rows.force)


def _harmonic_pair(k: int) -> Recipe:
    return lambda rows: list(rows.harmonic(k))


def _rate_powers(speed: Array) -> list[Array]:
    """What |rate| alone does is among the effects; its own powers are nobody's."""
    return [speed * np.abs(speed), np.abs(speed) ** 3, speed**3, speed**4]


def _square(rows: Rows) -> list[Array]:
    x, y, z = rows.force
    return [x * x, y * y, z * z, x * y, x * z, y * z]


def _cubes(rows: Rows) -> list[Array]:
    x, y, z = rows.force
    return [x**3, y**3, z**3, abs(x), abs(y), abs(z), x * y * z]


def _of_turn(first: int, last: int) -> Recipe:
    return lambda rows: rows.harmonics(first, last)


_AT_MANY_INCLINATIONS: tuple[tuple[tuple[str, ...], Recipe], ...] = (
    (LINEAR, _linear),
    (SQUARE, _square),
    (CUBIC, _cubes),
)
_AT_ONE_INCLINATION: tuple[tuple[tuple[str, ...], Recipe], ...] = (
    (("x", "y"), _of_turn(1, 1)),
    (("cos 2T", "sin 2T", "cos 3T", "sin 3T"), _of_turn(2, 3)),
    (("cos 4T", "sin 4T", "cos 5T", "sin 5T"), _of_turn(4, 5)),
)


def _monomials(rows: Rows) -> list[Array]:
    x, y, z = rows.force
    return [x * x, y * y, x * y, x * z, y * z, x**3, y**3, z**3, x * x * y, x * x * z, y * y * z, x * y * z]


def _of_inclination(rows: Rows) -> list[Array]:
    return [np.asarray(f(k * rows.state.inc_rad)) for k in range(1, 4) for f in (np.cos, np.sin)]


def _powers(speed: Array) -> list[Array]:
    return [speed, speed * speed, np.abs(speed), np.sign(speed)]


def _cubic(q: Array) -> list[Array]:
    return [q, q * q, q**3]


def _same(values: Array) -> Array:
    return values


def _warmth(state: ChainState) -> Callable[[Rows], Array]:
    """Standardised temperature of a chunk."""
    mean, std = mean_and_std(state.temp_c)
    return lambda rows: np.asarray((rows.state.temp_c - mean) / std)

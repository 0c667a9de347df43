"""Laws of the sensor in a calibration: what readings depart by as a smooth function of load, temperature and others.

    m = A g + b + (nonlinear) + sum over laws of  P(g) value(covariates, g)

A law acts where `highside.physics.places` says. Those of the *sensor* (`SENSOR_PLACES`) go with the tool and into its
record: they are taken off the poses before these are solved, and off every reading that the record corrects. Those of
the *bench* (`BENCH_PLACES`) are errors of the angles given; they are taken off the references and stay with the bench.

A reading tells its load, inclination and toolface by itself; temperature, rate and further columns must come with it.
What does not, or cannot (time, and all that depends on the readings before), leaves the law unapplied there: its
standard deviation is then the law's own size, the rms of its value over the range that was visited. Beyond that range a
law falls to 0, the mean of its prior, and its standard deviation grows to the same size. Both are flagged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.calibration.correction import (
    LAW_OUTSIDE,
    LAW_UNKNOWN,
    ZERO_COVARIANCE,
    BlockCorrected,
    Corrected,
    Correction,
    Covariance,
    Vector,
)
from highside.calibration.linear_correction import LinearCorrection
from highside.calibration.schedule import ScheduledCorrection
from highside.calibration.student import UPPER
from highside.errors import InputError
from highside.physics.covariates import COVARIATES
from highside.physics.gravity import gravity_direction
from highside.physics.law import Law
from highside.physics.state import ChainState

__all__ = [
    "AT_REST",
    "BENCH_PLACES",
    "BY_LOAD",
    "GIVEN",
    "SENSOR_PLACES",
    "BlockCorrection",
    "LawCorrection",
    "SensorLaws",
    "at_rest",
    "knowing",
    "laws_of_content",
    "pose_covariates",
    "without_laws",
]

SENSOR_PLACES = ("offset", "scale", "scale_all", "matrix")
BENCH_PLACES = ("inclination", "toolface", "level")

BY_LOAD = frozenset({"load", "load_x", "load_y", "load_z", "inc", "tf"})
"""covariates that a reading tells by itself"""
GIVEN = {
    "temp": ("temp_c",),
    "rate": ("rotor_rate_dps",),
    "rate_sign": ("rotor_rate_dps", "direction"),
    "vibration": ("vibration_rms_g",),
}
"""covariates that come beside a reading, and the columns that give them"""
AT_REST = {"rotor_rate_dps": 0.0, "vibration_rms_g": 0.0}
"""what is so of every pose, recorded or not"""
PASSES = 3
"""of the load by which a law is evaluated, from the raw reading on. A law changes by less than 1e-2 per g of load, and
a raw reading is within 0.1 g of it: after three passes the load is known to 1e-7 g, and the law to 1e-9 g."""
STEPS = {1: 201, 2: 41}
"""values of each covariate over which the size of a law is taken, by their number"""

ROWS, COLUMNS = (np.array(which) for which in zip(*UPPER, strict=True))

Columns = Mapping[str, Array | float]


@dataclass(frozen=True, slots=True)
class Departure:
    """What laws say of N readings: `value` (3, N) g, `cov` (6, N) g^2 of its error, and where (N,) one of them was
    asked beyond its range, or could not be applied."""

    value: Array
    cov: Array
    outside: NDArray[np.bool_]
    unknown: NDArray[np.bool_]


@dataclass(frozen=True)
class SensorLaws:
    """Laws of the sensor, ready for use. Raises InputError for one of another place."""

    laws: tuple[Law, ...]

    def __post_init__(self) -> None:
        for law in self.laws:
            if law.place not in SENSOR_PLACES:
                raise InputError(
                    f"acts on the {law.place}, not on the sensor",
                    field=f"laws.{law.slug}.place",
                    remedy=f"of a record: {', '.join(SENSOR_PLACES)}",
                )

    @cached_property
    def _sizes(self) -> tuple[tuple[float, ...], ...]:
        return tuple(size_of(law) for law in self.laws)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns beside the reading that the laws depend on."""
        names = [name for law in self.laws for name in _columns_of(law)]
        return tuple(dict.fromkeys(names))

    @property
    def by_load(self) -> bool:
        """Whether what they say depends on the load, which is known by the corrected reading only."""
        return any(law.place != "offset" or BY_LOAD & set(law.depends_on) for law in self.laws)

    def value_at(self, load: Array, given: Columns) -> Array:
        """(3, N) g: as `at`, without its error."""
        state, value = _state(load, given), np.zeros((3, load.shape[1]))
        for law, table in zip(self.laws, self._tables, strict=True):
            for number, (channel, one) in enumerate(_channels(law, state, load)):
                value += law.at.act(channel, table[number] @ one.basis, load)
        return value

    def at(self, load: Array, given: Columns) -> Departure:
        """What they say under loads (3, N) in g; `given`: values or (N,) by the names of columns, NaN where unknown."""
        n = load.shape[1]
        state = _state(load, given)
        value, cov = np.zeros((3, n)), np.zeros((6, n))
        outside, unknown = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        for law, table, sizes in zip(self.laws, self._tables, self._sizes, strict=True):
            found = [(law.at.act(channel, np.ones(n), load), one) for channel, one in _channels(law, state, load)]
            m = table.shape[1]
            for i, (field_i, one) in enumerate(found):
                value += field_i * (table[i] @ one.basis)
                outside |= one.known & ~law.inside(one.at)
                unknown |= ~one.known
                fall = np.prod([axis.held(u)[1] for u, axis in zip(one.at, law.axes, strict=True)], axis=0) * one.known
                cov += _outer(field_i, field_i) * (sizes[i] ** 2 * (1.0 - fall * fall))
                if not law.covariance:
                    continue
                for j, (field_j, other) in enumerate(found):
                    block = self._spreads[law.slug][i * m : (i + 1) * m, j * m : (j + 1) * m]
                    cov += _outer(field_i, field_j) * np.sum(one.basis * (block @ other.basis), axis=0)
        return Departure(value, cov, outside, unknown)

    @cached_property
    def _tables(self) -> tuple[Array, ...]:
        return tuple(np.array(law.coefficients, dtype=float) for law in self.laws)

    @cached_property
    def _spreads(self) -> dict[str, Array]:
        return {law.slug: np.array(law.covariance, dtype=float) for law in self.laws}


class _OnChannel(NamedTuple):
    """What a law depends on at N rows, on one of its channels."""

    basis: Array
    """(m, N), 0 where it is not known"""
    at: list[Array]
    """(N,) values of each covariate, any within the range where they are not known"""
    known: NDArray[np.bool_]


def _channels(law: Law, state: ChainState, load: Array) -> Iterator[tuple[str, _OnChannel]]:
    """The channels of a law; those that see the same covariates share one evaluation."""
    same, one = not any(COVARIATES[name].own for name in law.depends_on if name in COVARIATES), None
    for channel in law.channels:
        if one is None or not same:
            covariates = _covariates(law, state, load, channel)
            known = np.isfinite(covariates[0])
            for u in covariates[1:]:
                known &= np.isfinite(u)
            safe = [np.where(known, u, axis.low) for u, axis in zip(covariates, law.axes, strict=True)]
            one = _OnChannel(law.basis(safe) * known, safe, known)
        yield channel, one


def size_of(law: Law) -> tuple[float, ...]:
    """Of each channel the rms of a law's value over the range that was visited, its band included; in its unit."""
    count = STEPS.get(len(law.axes), STEPS[2])
    lines = [np.linspace(axis.low, axis.high, count) for axis in law.axes]
    grid = [u.ravel() for u in np.meshgrid(*lines)]
    return tuple(
        float(np.sqrt(np.mean(law.value(grid, number) ** 2 + law.std(grid, number) ** 2)))
        for number in range(len(law.channels))
    )


def _columns_of(law: Law) -> tuple[str, ...]:
    """Columns that give what a law depends on; none for what no single reading can tell."""
    names: list[str] = []
    for name in law.depends_on:
        names += GIVEN.get(name, () if name in COVARIATES else (name,))
    return tuple(names)


def _state(load: Array, given: Columns) -> ChainState:
    """The rows as covariates see them; what is not given is not a number. Made without the checks of `build`, which
    would cost a single reading more than all the rest."""
    n = load.shape[1]

    def rows(name: str) -> Array:
        value = given.get(name, math.nan)
        return value if isinstance(value, np.ndarray) and value.ndim else np.full(n, value)

    none = np.zeros(n)
    return ChainState(
        t_s=none,
        inc_rad=np.arctan2(np.hypot(load[0], load[1]), load[2]),
        tf_rad=np.arctan2(load[1], load[0]),
        direction=rows("direction"),
        temp_c=rows("temp_c"),
        rotor_rate_radps=np.radians(rows("rotor_rate_dps")),
        rotor_accel_radps2=none,
        inc_rate_radps=none,
        vibration_rms_g=rows("vibration_rms_g"),
        pose=np.zeros(n, dtype=np.int64),
        vibration_x_rms_g=none,
        vibration_y_rms_g=none,
        vibration_z_rms_g=none,
        since_move_s=none,
        stay_s=none,
        extra={name: rows(name) for name in given},
    )


def _covariates(law: Law, state: ChainState, load: Array, channel: str) -> list[Array]:
    """The values (N,) of each covariate of a law; not a number where it is not known."""
    axis, found = law.axis_of(channel), []
    for name in law.depends_on:
        if name in BY_LOAD or name in GIVEN:
            found.append(np.asarray(COVARIATES[name].of(state, load, axis), dtype=float))
        elif name in COVARIATES or name not in state.extra:
            found.append(np.full(state.n, np.nan))
        else:
            found.append(np.asarray(state.extra[name]))
    return found


def _outer(one: Array, other: Array) -> Array:
    """(6, N) symmetric part of the outer product of (3, N) with (3, N)."""
    return np.asarray(0.5 * (one[ROWS] * other[COLUMNS] + one[COLUMNS] * other[ROWS]))


# -- readings


@dataclass(frozen=True, slots=True)
class LawCorrection:
    """A correction that first takes what laws say off the readings. `given`: what is known beside them, by column."""

    inner: LinearCorrection | ScheduledCorrection
    laws: SensorLaws
    given: Columns = field(default_factory=dict)

    @property
    def cal_id(self) -> str:
        return self.inner.cal_id

    def knowing(self, given: Columns) -> LawCorrection:
        """The same with more, or other, known beside the readings."""
        return replace(self, given={**self.given, **given})

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        raw = np.array(a)[:, None]
        given = self.given if temp_c is None else {**self.given, "temp_c": temp_c}
        load = raw
        for _ in range(PASSES if self.laws.by_load else 0):
            x, y, z = (raw - self.laws.value_at(load, given))[:, 0].tolist()
            one = self.inner.correct((x, y, z), temp_c=temp_c)
            load = raw if math.isnan(one.gx) else np.array([[one.gx], [one.gy], [one.gz]])
        found = self.laws.at(load, given)
        x, y, z = (raw - found.value)[:, 0].tolist()
        l0, l1, l2, l3, l4, l5 = found.cov[:, 0].tolist()
        c0, c1, c2, c3, c4, c5 = cov
        done = self.inner.correct((x, y, z), (c0 + l0, c1 + l1, c2 + l2, c3 + l3, c4 + l4, c5 + l5), temp_c)
        doubts = (*((LAW_OUTSIDE,) if found.outside[0] else ()), *((LAW_UNKNOWN,) if found.unknown[0] else ()))
        return done._replace(flags=(*done.flags, *doubts)) if doubts else done

    def _departure(self, a: Array, temp_c: Array | float | None) -> Departure:
        given = self.given if temp_c is None else {**self.given, "temp_c": temp_c}
        load = a
        for _ in range(PASSES if self.laws.by_load else 0):
            g = self.inner.correct_block(a - self.laws.value_at(load, given), temp_c)
            load = np.where(np.isfinite(g), g, a)
        return self.laws.at(load, given)

    def correct_block(self, a: Array, temp_c: Array | float | None = None) -> Array:
        """Corrected vectors (3, N) from raw readings (3, N); NaN where no correction holds."""
        return self.inner.correct_block(a - self._departure(a, temp_c).value, temp_c)

    def corrected_block(self, a: Array, noise_g: Array | float, temp_c: Array | float | None = None) -> BlockCorrected:
        """As that of a correction without laws, with their errors in `cov`."""
        found = self._departure(a, temp_c)
        done = self.inner.corrected_block(a - found.value, noise_g, temp_c, found.cov)
        return replace(done, law_outside=found.outside, law_unknown=found.unknown)


BlockCorrection = LinearCorrection | ScheduledCorrection | LawCorrection
"""what corrects readings in blocks"""


class Carries(Protocol):
    """What a live frame carries beside reading and temperature."""

    @property
    def rotor_rate_dps(self) -> float | None: ...

    @property
    def extra(self) -> tuple[float, ...] | None: ...


def knowing(correction: Correction, frame: Carries, extra_columns: Sequence[str]) -> Correction:
    """The correction with what a frame carries beside its reading; the same one where it has no laws."""
    if not isinstance(correction, LawCorrection):
        return correction
    given = dict(zip(extra_columns, frame.extra or (), strict=False))
    return correction.knowing(
        given if frame.rotor_rate_dps is None else {**given, "rotor_rate_dps": frame.rotor_rate_dps}
    )


def at_rest(correction: BlockCorrection) -> BlockCorrection:
    """The correction for readings of poses: the tool did not turn, whether or not that was recorded."""
    return correction.knowing(AT_REST) if isinstance(correction, LawCorrection) else correction


# -- poses and records


def pose_covariates(laws: Sequence[Law], columns: Mapping[str, Any], *, where: str | None = None) -> dict[str, Any]:
    """The columns of a pose table that laws depend on, K values each. Raises InputError for one that is missing."""
    found = {}
    for name in SensorLaws(tuple(laws)).columns:
        if name not in columns:
            if name in AT_REST:
                continue
            raise InputError(
                "is missing: a law of the model depends on it",
                where=where,
                field=name,
                remedy="add this column to the poses",
            )
        values = np.asarray(columns[name], dtype=float)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise InputError(f"has no number in row {row}, and a law depends on it", where=where, field=name)
        found[name] = values.tolist()
    return found


def without_laws(columns: Mapping[str, Any], laws: Sequence[Law], *, where: str | None = None) -> dict[str, Any]:
    """A pose table as the sensor without its laws would have read it. Raises InputError for a covariate that lacks."""
    made = dict(columns)
    if not laws:
        return made
    a = np.array([columns["ax"], columns["ay"], columns["az"]], dtype=float)
    if "inc_ref_deg" in columns and "tf_ref_deg" in columns:
        load = gravity_direction(np.radians(columns["inc_ref_deg"]), np.radians(columns["tf_ref_deg"]))
    else:
        load = a
    given: dict[str, Array | float] = dict(AT_REST)
    given |= {name: np.asarray(v, dtype=float) for name, v in pose_covariates(laws, columns, where=where).items()}
    rest = a - SensorLaws(tuple(laws)).at(load, given).value
    return made | dict(zip(("ax", "ay", "az"), rest.tolist(), strict=True))


def laws_of_content(content: Mapping[str, Any], wanted: bool) -> tuple[Law, ...]:
    """The laws of a record's content. Raises InputError for what is no law of a sensor, and where there are none though
    its schema says that there are, or the other way round."""
    laws = tuple(Law.from_dict(plain) for plain in content.get("laws", ()))
    if bool(laws) != wanted:
        raise InputError("do not go with this schema", field="laws")
    SensorLaws(laws)
    return laws

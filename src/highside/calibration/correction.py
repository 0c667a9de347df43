"""What the live service asks of a calibration: a corrected gravity vector, its covariance, and who made it.

A `Correction` is immutable; swapping one for another between two frames is the hot swap of the service. The
covariance of a corrected vector has two parts: the reading's own, carried through the correction, and that of the
correction itself (equation 6 of the balance-correction paper: `C dM + dC M`).

Covariances of vectors are six floats, the upper triangle `(xx, xy, xz, yy, yz, zz)`, in g^2.

`LinearCorrection` is one zone of a calibration made ready for use: the sensor `m = A g + b + (nonlinear)` turned round,
`g = C (m - b)`. The error of the parameters makes `dg = -C (dA g + db)`, whose covariance is a quadratic form in
(gx, gy, gz, 1): ten coefficients for each of the six elements, worked out once. A reading then costs no more than some
plain float products.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.block import attitude_by, correct_and_attitude
from highside.calibration.result import SHARED_NAMES, Zone
from highside.calibration.sensor import (
    CROSS_PAIRS,
    MATRIX_NAMES,
    OFFSET_NAMES,
    SensorModel,
    is_sensor_parameter,
    sensor_columns,
)
from highside.calibration.student import UPPER, widening, widening_block
from highside.errors import InputError

Vector = tuple[float, float, float]
Covariance = tuple[float, float, float, float, float, float]
Form = tuple[float, float, float, float, float, float, float, float, float, float]

ZERO_COVARIANCE: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
OUTSIDE_ZONE = "outside_zone"
TEMPERATURE_OUTSIDE = "temperature_outside"
TEMPERATURE_UNKNOWN = "temperature_unknown"

TEMPERATURE_STEP_C = 1.0 / 256.0
"""Temperatures are rounded to this before the polynomials are worked out (1 mg/degC moves by 2 ug at most): a sensor's
own noise in temperature would otherwise ask for new coefficients with every frame."""
_TEMPERATURES_KEPT = 512


class Corrected(NamedTuple):
    """A corrected reading: the gravity direction in the tool frame (g) and the covariance of its error (g^2).

    `zone` names the correction that made it ("global", "zone 3.0", "none"); `flags` say what a user must know
    ("uncalibrated", "outside_zone", "temperature_outside"). With "outside_zone" no correction holds there and the
    vector is not a number: nothing may be published from it.
    """

    gx: float
    gy: float
    gz: float
    cov: Covariance
    zone: str
    flags: tuple[str, ...] = ()


class Correction(Protocol):
    """A calibration in force."""

    @property
    def cal_id(self) -> str:
        """Content hash of the record that made it, or "none"."""

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        """Correct one (averaged) raw reading `a` in g whose own covariance is `cov` in g^2."""


@dataclass(frozen=True, slots=True)
class BlockCorrected:
    """N corrected readings: `g` (3, N) in g, `cov` (6, N) in g^2, not a number where no correction holds.

    `reading` (6, N): that part of `cov` which is the noise of the readings themselves.
    `zone` (N,): which of `names` made it (the one with the greatest weight), -1 for none. `temperature_outside` (N,).
    """

    g: Array
    cov: Array
    reading: Array
    zone: NDArray[np.intp]
    names: tuple[str, ...]
    temperature_outside: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class IdentityCorrection:
    """No calibration: readings pass unchanged, flagged; the uncertainty is that of an uncalibrated sensor.

    `bias_std_g` and `scale_std` are 1-sigma figures of the sensor's data sheet.
    """

    bias_std_g: float = 2e-3
    scale_std: float = 3e-3
    cal_id: str = "none"

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        g2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        own = self.bias_std_g**2 + self.scale_std**2 * g2
        xx, xy, xz, yy, yz, zz = cov
        return Corrected(a[0], a[1], a[2], (xx + own, xy, xz, yy + own, yz, zz + own), "none", ("uncalibrated",))


@dataclass(frozen=True, slots=True)
class TemperatureTrust:
    """How far a calibration may be believed in temperature.

    Within `min_c` to `max_c` as stated; beyond, each degree adds `growth_g_per_c` (one standard deviation, each axis;
    the usual offset drift of a quartz accelerometer is 30 to 100 ug/degC).
    """

    min_c: float
    max_c: float
    growth_g_per_c: float = 50e-6

    def __post_init__(self) -> None:
        if not self.min_c <= self.max_c or self.growth_g_per_c < 0:
            raise InputError(f"temperatures {self.min_c:g} to {self.max_c:g} degC, growth {self.growth_g_per_c:g}")

    def beyond_c(self, temp_c: float) -> float:
        """Degrees outside of the range; 0 inside."""
        return max(self.min_c - temp_c, temp_c - self.max_c, 0.0)


@dataclass(frozen=True, slots=True)
class _Nonlinear:
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
        return np.stack([_six((J @ covariance) @ J.transpose(0, 2, 1)) for covariance in self.covariances])


@dataclass(frozen=True, slots=True)
class _Structured:
    """As `_Nonlinear`, for a sensor with structure: hundreds of small terms, taken from the effects themselves. A
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
                out[k, :, at : at + _STRUCTURED_PIECE] = _six((J @ covariance) @ J.transpose(0, 2, 1))
        return out


def _six(matrices: Array) -> Array:
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


@dataclass(frozen=True, slots=True)
class _Coefficients:
    """A zone at one temperature, as plain floats."""

    c: tuple[float, ...]
    """C row by row"""
    o: Vector
    """C b"""
    form: tuple[Form, ...]
    """for each element of the covariance the factors of xx, xy, xz, yy, yz, zz, x, y, z, 1"""
    student: tuple[Form, ...] | None
    """the same for its widening; None where there is none"""
    shared: Array | None
    """(K, 3, 4): error of the vector, by (gx, gy, gz, 1), that one standard deviation of each of `SHARED_NAMES` makes
    and that all corrections of a session have in common; None where the zone does not say"""
    nonlinear: _Nonlinear | _Structured | None
    flags: tuple[str, ...]


class Evaluated(NamedTuple):
    """A corrected vector (g), its covariance by the calibration alone and the widening of that (g^2), and flags."""

    gx: float
    gy: float
    gz: float
    calibration: Covariance
    student: Covariance | None
    flags: tuple[str, ...]


def _quadratic_forms(C: Array, covariance: Array, beyond: Array, extra_variance: float) -> Array:
    """Factors (6, 10) of `_Coefficients.form` from the covariance (12, 12) of (A row by row, b).

    `beyond` (3, 4): an error of the corrected vector, linear in (gx, gy, gz, 1), that counts as one standard deviation;
    `extra_variance`: of each axis.
    """
    order = [3 * i + j if j < 3 else 9 + i for i in range(3) for j in range(4)]
    raw = covariance[np.ix_(order, order)].reshape(3, 4, 3, 4)
    by_g = np.einsum("pi,ijkl,qk->pqjl", C, raw, C) + np.einsum("pj,ql->pqjl", beyond, beyond)
    for i in range(3):
        by_g[i, i, 3, 3] += extra_variance
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2), (0, 3), (1, 3), (2, 3), (3, 3)]
    return np.array([[by_g[p, q, j, m] + (by_g[p, q, m, j] if j != m else 0.0) for j, m in pairs] for p, q in UPPER])


def _of_form(form: tuple[Form, ...], x: float, y: float, z: float) -> Covariance:
    xx, xy, xz, yy, yz, zz = x * x, x * y, x * z, y * y, y * z, z * z
    p0, p1, p2, p3, p4, p5 = [
        f0 * xx + f1 * xy + f2 * xz + f3 * yy + f4 * yz + f5 * zz + f6 * x + f7 * y + f8 * z + f9
        for f0, f1, f2, f3, f4, f5, f6, f7, f8, f9 in form
    ]
    return p0, p1, p2, p3, p4, p5


def carry(c: tuple[float, ...], cov: Covariance) -> Covariance:
    """`C cov C'` for C row by row."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = c
    xx, xy, xz, yy, yz, zz = cov
    if xy == 0.0 and xz == 0.0 and yz == 0.0:
        a0, a1, a2 = c0 * xx, c1 * yy, c2 * zz
        b0, b1, b2 = c3 * xx, c4 * yy, c5 * zz
        d0, d1, d2 = c6 * xx, c7 * yy, c8 * zz
    else:
        a0, a1, a2 = c0 * xx + c1 * xy + c2 * xz, c0 * xy + c1 * yy + c2 * yz, c0 * xz + c1 * yz + c2 * zz
        b0, b1, b2 = c3 * xx + c4 * xy + c5 * xz, c3 * xy + c4 * yy + c5 * yz, c3 * xz + c4 * yz + c5 * zz
        d0, d1, d2 = c6 * xx + c7 * xy + c8 * xz, c6 * xy + c7 * yy + c8 * yz, c6 * xz + c7 * yz + c8 * zz
    return (
        a0 * c0 + a1 * c1 + a2 * c2,
        a0 * c3 + a1 * c4 + a2 * c5,
        a0 * c6 + a1 * c7 + a2 * c8,
        b0 * c3 + b1 * c4 + b2 * c5,
        b0 * c6 + b1 * c7 + b2 * c8,
        d0 * c6 + d1 * c7 + d2 * c8,
    )


@dataclass(frozen=True, slots=True)
class LinearCorrection:
    """One zone of a calibration, ready for use: `g = C (m - b)`, nonlinear terms and temperature included.

    `trust` says in which temperatures; None where no temperature was recorded at calibration. A local zone refuses
    readings whose own corrected inclination lies outside of it, unless `guarded` is False (the schedule, which has
    already chosen, asks so).
    """

    zone: Zone
    cal_id: str = "none"
    trust: TemperatureTrust | None = None
    guarded: bool = True
    _by_step: dict[int | None, _Coefficients] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def name(self) -> str:
        return self.zone.name

    @property
    def is_affine(self) -> bool:
        """Whether the vector is an affine function of the reading alone: no temperature, no nonlinear terms."""
        return self.zone.max_power() == 0 and self.coefficients(None).nonlinear is None

    def coefficients(self, temp_c: float | None = None) -> _Coefficients:
        """The zone at a temperature, rounded to `TEMPERATURE_STEP_C`; where None, at the reference temperature."""
        depends = self.trust is not None or self.zone.temperature is not None
        step = None if temp_c is None or not depends else round(temp_c / TEMPERATURE_STEP_C)
        known = self._by_step.get(step)
        if known is None:
            if len(self._by_step) >= _TEMPERATURES_KEPT:
                self._by_step.clear()
            known = self._by_step[step] = self._work_out(None if step is None else step * TEMPERATURE_STEP_C)
        return known

    def correct(self, a: Vector, cov: Covariance = ZERO_COVARIANCE, temp_c: float | None = None) -> Corrected:
        k = self.coefficients(temp_c)
        one = self.evaluate(a, temp_c)
        if one is None:
            return refused(k.flags)
        p0, p1, p2, p3, p4, p5 = one.calibration
        q0, q1, q2, q3, q4, q5 = carry(k.c, cov)
        total = (p0 + q0, p1 + q1, p2 + q2, p3 + q3, p4 + q4, p5 + q5)
        if one.student is not None:
            s0, s1, s2, s3, s4, s5 = widening(one.student, one.calibration, total)
            q0, q1, q2, q3, q4, q5 = total
            total = (s0 + q0, s1 + q1, s2 + q2, s3 + q3, s4 + q4, s5 + q5)
        return Corrected(one.gx, one.gy, one.gz, total, self.zone.name, k.flags)

    def evaluate(self, a: Vector, temp_c: float | None = None) -> Evaluated | None:
        """The corrected vector of a reading, and what the calibration's errors do to it; None where it does not
        hold."""
        k = self.coefficients(temp_c)
        c = k.c
        m0, m1, m2 = a
        o0, o1, o2 = k.o
        x = c[0] * m0 + c[1] * m1 + c[2] * m2 - o0
        y = c[3] * m0 + c[4] * m1 + c[5] * m2 - o1
        z = c[6] * m0 + c[7] * m1 + c[8] * m2 - o2
        if k.nonlinear is not None:
            x, y, z = _invert(k.nonlinear, x, y, z)
        if self.guarded and self.zone.inc_center_rad is not None and not self.zone.holds_at(_inclination(x, y, z)):
            return None
        cov = _of_form(k.form, x, y, z)
        student = None if k.student is None else _of_form(k.student, x, y, z)
        if k.nonlinear is not None:
            (n0, n1, n2, n3, n4, n5), *widened = k.nonlinear.covariances_at(x, y, z)
            p0, p1, p2, p3, p4, p5 = cov
            cov = p0 + n0, p1 + n1, p2 + n2, p3 + n3, p4 + n4, p5 + n5
            student = widened[0] if widened else None
        return Evaluated(x, y, z, cov, student, k.flags)

    def correct_block(self, a: Array, temp_c: Array | float | None = None) -> Array:
        """Corrected vectors (3, N) from raw readings `a` (3, N); readings outside of a guarded local zone become NaN.

        `temp_c`: one temperature, or one a reading (N,).
        """
        if temp_c is not None and np.ndim(temp_c):
            out = np.empty_like(a)
            for rows, at in _by_temperature(np.asarray(temp_c, dtype=float)):
                out[:, rows] = self.correct_block(a[:, rows], at)
            return out
        k = self.coefficients(None if temp_c is None else float(temp_c))
        g = np.asarray(np.array(k.c).reshape(3, 3) @ a)
        g -= np.array(k.o)[:, None]
        if k.nonlinear is not None:
            linear = g
            for _ in range(_PASSES):
                g = linear - k.nonlinear.of_block(g)
        if self.guarded and self.zone.inc_center_rad is not None:
            inc = np.arctan2(np.hypot(g[0], g[1]), g[2])
            g[:, ~((inc >= self.zone.inc_min_rad) & (inc <= self.zone.inc_max_rad))] = np.nan
        return g

    def covariance_block(self, g: Array, temp_c: Array | float | None = None) -> Array:
        """Covariance (6, N) of corrected vectors `g` (3, N) by the errors of the calibration alone."""
        cov, student = self.covariances_block(g, temp_c)
        return cov if student is None else cov + student

    def covariances_block(self, g: Array, temp_c: Array | float | None = None) -> tuple[Array, Array | None]:
        """`covariance_block` in two parts: without widening, and the widening (6, N) if there is one."""
        if temp_c is not None and np.ndim(temp_c):
            pieces = [
                (rows, self.covariances_block(g[:, rows], at))
                for rows, at in _by_temperature(np.asarray(temp_c, dtype=float))
            ]
            out, wide = np.empty((6, g.shape[1])), np.zeros((6, g.shape[1]))
            for rows, (cov, student) in pieces:
                out[:, rows] = cov
                if student is not None:
                    wide[:, rows] = student
            return out, wide if any(student is not None for _, (_, student) in pieces) else None
        k = self.coefficients(None if temp_c is None else float(temp_c))
        x, y, z = g
        basis = np.stack([x * x, x * y, x * z, y * y, y * z, z * z, x, y, z, np.ones_like(x)])
        cov = np.asarray(np.array(k.form) @ basis)
        student = None if k.student is None else np.asarray(np.array(k.student) @ basis)
        if k.nonlinear is not None:
            by_terms = k.nonlinear.covariances_block(g)
            cov += by_terms[0]
            student = by_terms[1] if len(by_terms) > 1 else None
        return cov, student

    def corrected_block(self, a: Array, noise_g: Array | float, temp_c: Array | float | None = None) -> BlockCorrected:
        """Correct readings `a` (3, N) whose own standard deviation is `noise_g` (one, or (N,)) in each axis."""
        g = self.correct_block(a, temp_c)
        cov, student = self.covariances_block(g, temp_c)
        reading = self.reading_covariance(temp_c) * np.square(np.broadcast_to(noise_g, a.shape[1:]))
        total = cov + reading
        if student is not None:
            total = total + widening_block(student, cov, total)
        inside = np.isfinite(g[2])
        zone = np.where(inside, 0, -1).astype(np.intp)
        return BlockCorrected(g, total, reading, zone, (self.name,), self.temperature_outside(temp_c, a.shape[1]))

    def attitude(
        self,
        a: Array,
        temp_c: Array | float | None = None,
        out_inc: Array | None = None,
        out_tf: Array | None = None,
        *,
        degrees: bool = False,
        threads: int | None = None,
    ) -> tuple[Array, Array]:
        """Inclination and toolface (N,) of raw readings `a` (3, N) in bulk; NaN where no correction holds."""
        if self.is_affine and not (self.guarded and self.zone.inc_center_rad is not None):
            model = self.zone.model()
            return correct_and_attitude(a, model.C, model.b, out_inc, out_tf, degrees=degrees, threads=threads)

        def fill(low: int, high: int, out: Array) -> None:
            part = temp_c[low:high] if isinstance(temp_c, np.ndarray) and temp_c.ndim else temp_c
            out[:] = self.correct_block(a[:, low:high], part)

        return attitude_by(lambda: fill, a.shape[1], out_inc, out_tf, degrees=degrees, threads=threads)

    def reading_covariance(self, temp_c: Array | float | None = None) -> Array:
        """Covariance (6, 1) that a reading noise of one g in each axis becomes (mean temperature, scale is small)."""
        finite = np.asarray(np.nan if temp_c is None else temp_c, dtype=float)
        finite = finite[np.isfinite(finite)]
        C = np.array(self.coefficients(float(finite.mean()) if finite.size else None).c).reshape(3, 3)
        carried = C @ C.T
        return np.array([[carried[i, j]] for i, j in UPPER])

    def temperature_outside(self, temp_c: Array | float | None, count: int) -> NDArray[np.bool_]:
        """Which of `count` readings were made outside of the temperatures trusted."""
        if self.trust is None or temp_c is None:
            return np.zeros(count, dtype=bool)
        t = np.broadcast_to(np.asarray(temp_c, dtype=float), (count,))
        return np.asarray((t < self.trust.min_c) | (t > self.trust.max_c))

    def _work_out(self, temp_c: float | None) -> _Coefficients:
        zone = self.zone
        model = zone.model(temp_c)
        C = model.C
        flags: tuple[str, ...] = ()
        grown = 0.0
        if temp_c is None:
            if zone.temperature is not None and zone.max_power():
                flags = (TEMPERATURE_UNKNOWN,)
        elif self.trust is not None:
            beyond = self.trust.beyond_c(temp_c)
            if beyond > 0.0:
                flags = (TEMPERATURE_OUTSIDE,)
                grown = (beyond * self.trust.growth_g_per_c) ** 2
        covariances, bases = _at_temperature(zone, temp_c)
        linear = [i for i, name in enumerate(MATRIX_NAMES + OFFSET_NAMES) if name in bases]
        affine = np.zeros((len(covariances), 12, 12))
        nonlinear: _Nonlinear | _Structured | None = None
        if model.is_linear:
            index = [bases.index((MATRIX_NAMES + OFFSET_NAMES)[i]) for i in linear]
            for whole, part in zip(affine, covariances, strict=True):
                whole[np.ix_(linear, linear)] = part[np.ix_(index, index)]
        else:
            nonlinear = _nonlinear(model, C, bases, covariances)
        form = _quadratic_forms(C, affine[0], _beyond_temperature(zone, model, temp_c), grown)
        student = None if len(affine) == 1 else _quadratic_forms(C, affine[1], np.zeros((3, 4)), 0.0)
        o = C @ model.b
        return _Coefficients(
            c=tuple(C.ravel().tolist()),
            o=(float(o[0]), float(o[1]), float(o[2])),
            form=tuple(tuple(row) for row in form.tolist()),
            student=None if student is None else tuple(tuple(row) for row in student.tolist()),
            shared=_shared(zone),
            nonlinear=nonlinear,
            flags=flags,
        )


def _by_temperature(temp_c: Array) -> list[tuple[NDArray[np.intp], float | None]]:
    """Rows of equal (rounded) temperature, and that temperature; None for rows without one."""
    steps = np.round(temp_c / TEMPERATURE_STEP_C)
    values, group = np.unique(steps, return_inverse=True)
    order = np.argsort(group, kind="stable")
    edges = np.searchsorted(group[order], np.arange(values.size + 1))
    return [
        (order[edges[i] : edges[i + 1]], None if np.isnan(step) else float(step) * TEMPERATURE_STEP_C)
        for i, step in enumerate(values)
    ]


_PASSES = 6
"""Passes over nonlinear terms of a few mg; each gains a factor of a hundred."""


def _invert(nonlinear: _Nonlinear | _Structured, x0: float, y0: float, z0: float) -> Vector:
    x, y, z = x0, y0, z0
    for _ in range(_PASSES):
        dx, dy, dz = nonlinear.of(x, y, z)
        x, y, z = x0 - dx, y0 - dy, z0 - dz
    return x, y, z


def _nonlinear(model: SensorModel, C: Array, bases: tuple[str, ...], covariances: Array) -> _Nonlinear | _Structured:
    if model.S.any() or model.H.any():
        return _Structured(model, C, bases, covariances)
    places = [_monomial(base) for base in bases]
    squares, cubes, products = C * model.K2[None, :], C * model.K3[None, :], C @ model.KX
    return _Nonlinear(
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


def _at_temperature(zone: Zone, temp_c: float | None) -> tuple[Array, tuple[str, ...]]:
    """Covariance of the sensor's parameters at one temperature, polynomial coefficients summed up, with its widening if
    there is one (K, P, P), and their names."""
    names = tuple(name for name in zone.parameters.names if is_sensor_parameter(name))
    bases = tuple(dict.fromkeys(name.partition("@")[0] for name in names))
    by_power = dict(zone._temperature_weights(temp_c))
    index = [zone.parameters.names.index(name) for name in names]
    B = np.zeros((len(bases), len(names)))
    for j, name in enumerate(names):
        base, _, power = name.partition("@")
        B[bases.index(base), j] = by_power.get(int(power), 0.0) if power else 1.0
    p = zone.parameters
    parts = [p.covariance] if p.student is None else [p.covariance, p.student]
    return np.stack([B @ part[np.ix_(index, index)] @ B.T for part in parts]), bases


def _shared(zone: Zone) -> Array | None:
    """`_Coefficients.shared`: regression of the parameters' errors on what was taken for known (at the reference
    temperature: a matrix near unity does not care); zero for what did not move this zone."""
    p, C = zone.parameters, zone.model().C
    if not set(SHARED_NAMES) & set(p.names) or not all(name in p for name in MATRIX_NAMES + OFFSET_NAMES):
        return None
    index = [p.names.index(name) for name in MATRIX_NAMES + OFFSET_NAMES]
    levers = np.zeros((len(SHARED_NAMES), 3, 4))
    for lever, name in zip(levers, SHARED_NAMES, strict=True):
        place = p.names.index(name) if name in p else -1
        if place >= 0 and p.covariance[place, place] > 0.0:
            moved = p.covariance[index, place] / math.sqrt(p.covariance[place, place])
            lever[:] = C @ np.column_stack([moved[:9].reshape(3, 3), moved[9:]])
    return levers


def _beyond_temperature(zone: Zone, model: SensorModel, temp_c: float | None) -> Array:
    """What the polynomials change beyond the temperatures visited, as an error (3, 4) by (gx, gy, gz, 1)."""
    t = zone.temperature
    if t is None or temp_c is None or t.inside(temp_c) or not zone.max_power():
        return np.zeros((3, 4))
    edge = zone.model(min(max(temp_c, t.min_c), t.max_c))
    return np.asarray(edge.C @ np.column_stack([model.A - edge.A, model.b - edge.b]))


def _inclination(x: float, y: float, z: float) -> float:
    return math.atan2(math.hypot(x, y), z)


def refused(flags: tuple[str, ...] = ()) -> Corrected:
    """The answer where no correction holds: no vector at all."""
    nan = math.nan
    return Corrected(nan, nan, nan, (nan, nan, nan, nan, nan, nan), "none", (OUTSIDE_ZONE, *flags))

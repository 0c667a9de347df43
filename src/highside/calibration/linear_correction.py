"""One zone of a calibration made ready for use: `g = C (m - b)`, nonlinear terms and temperature included.

The sensor `m = A g + b + (nonlinear)` is inverted. The error of the parameters makes `dg = -C (dA g + db)`, whose
covariance is a quadratic form in (gx, gy, gz, 1): ten coefficients for each of the six elements, computed once a
temperature (`highside.calibration.zone_coefficients`). A reading then costs no more than some plain float products.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from highside.arrays import Array
from highside.attitude.block import attitude_by, correct_and_attitude
from highside.calibration.correction import (
    ZERO_COVARIANCE,
    BlockCorrected,
    Corrected,
    Covariance,
    TemperatureTrust,
    Vector,
    refused,
)
from highside.calibration.nonlinear_terms import PASSES, inverted
from highside.calibration.student import UPPER, widening, widening_block
from highside.calibration.zone import Zone
from highside.calibration.zone_coefficients import CoefficientForm, Coefficients, coefficients_at

TEMPERATURE_STEP_C = 1.0 / 256.0
"""Temperatures are rounded to this before the polynomials are computed (1 mg/degC moves by 2 ug at most): a sensor's
own noise in temperature would otherwise require new coefficients with every frame."""
_TEMPERATURES_KEPT = 512


class Evaluated(NamedTuple):
    """A corrected vector (g), its covariance by the calibration alone and the widening of that (g^2), and flags."""

    gx: float
    gy: float
    gz: float
    calibration: Covariance
    student: Covariance | None
    flags: tuple[str, ...]


def _of_form(form: tuple[CoefficientForm, ...], x: float, y: float, z: float) -> Covariance:
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
    _by_step: dict[int | None, Coefficients] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def name(self) -> str:
        return self.zone.name

    @property
    def is_affine(self) -> bool:
        """Whether the vector is an affine function of the reading alone: no temperature, no nonlinear terms."""
        return self.zone.max_power() == 0 and self.coefficients(None).nonlinear is None

    def coefficients(self, temp_c: float | None = None) -> Coefficients:
        """The zone at a temperature, rounded to `TEMPERATURE_STEP_C`; where None, at the reference temperature."""
        depends = self.trust is not None or self.zone.temperature is not None
        step = None if temp_c is None or not depends else round(temp_c / TEMPERATURE_STEP_C)
        known = self._by_step.get(step)
        if known is None:
            if len(self._by_step) >= _TEMPERATURES_KEPT:
                self._by_step.clear()
            known = self._by_step[step] = coefficients_at(
                self.zone, self.trust, None if step is None else step * TEMPERATURE_STEP_C
            )
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
            x, y, z = inverted(k.nonlinear, x, y, z)
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
            for _ in range(PASSES):
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

    def corrected_block(
        self, a: Array, noise_g: Array | float, temp_c: Array | float | None = None, more: Array | None = None
    ) -> BlockCorrected:
        """Correct readings `a` (3, N) whose own standard deviation is `noise_g` (one, or (N,)) in each axis.

        `more` (6, N) g^2: covariance of what was taken off them before.
        """
        g = self.correct_block(a, temp_c)
        cov, student = self.covariances_block(g, temp_c)
        reading = self.reading_covariance(temp_c) * np.square(np.broadcast_to(noise_g, a.shape[1:]))
        total = cov + reading
        if more is not None:
            total += self.carried_block(more, temp_c)
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
        C = self._matrix(temp_c)
        carried = C @ C.T
        return np.array([[carried[i, j]] for i, j in UPPER])

    def carried_block(self, cov: Array, temp_c: Array | float | None = None) -> Array:
        """Covariances (6, N) of readings as those of corrected vectors (mean temperature)."""
        C, full = self._matrix(temp_c), np.empty((3, 3, cov.shape[1]))
        for k, (i, j) in enumerate(UPPER):
            full[i, j] = full[j, i] = cov[k]
        full = np.einsum("ij,jkn,lk->iln", C, full, C)
        return np.stack([full[i, j] for i, j in UPPER])

    def _matrix(self, temp_c: Array | float | None) -> Array:
        """(3, 3) at the mean temperature."""
        finite = np.asarray(np.nan if temp_c is None else temp_c, dtype=float)
        finite = finite[np.isfinite(finite)]
        return np.array(self.coefficients(float(finite.mean()) if finite.size else None).c).reshape(3, 3)

    def temperature_outside(self, temp_c: Array | float | None, count: int) -> NDArray[np.bool_]:
        """Which of `count` readings were made outside of the temperatures trusted."""
        if self.trust is None or temp_c is None:
            return np.zeros(count, dtype=bool)
        t = np.broadcast_to(np.asarray(temp_c, dtype=float), (count,))
        return np.asarray((t < self.trust.min_c) | (t > self.trust.max_c))


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


def _inclination(x: float, y: float, z: float) -> float:
    return math.atan2(math.hypot(x, y), z)
